"""What the command ``lattice`` does: detect, pick, compare, straighten, draw and print lattices."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import os
import secrets
import sys
import textwrap
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer  # noqa: TID251 - it listens, and connects to nothing
from importlib.resources import files
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from nrbench import plugins
from nrbench.api.arguments import as_lattice, masked_in
from nrbench.api.picture_folders import (
    SHOWN,
    Survey,
    candidate_dict,
    draw_candidates,
    known_vectors,
    lattice_text,
    rank_candidates,
    vector_texts,
)
from nrbench.api.textures import FOLLOWS_BENT, find_defects
from nrbench.cli.lattice_question import LatticeQuestion
from nrbench.cli.progress import live_progress, waiting
from nrbench.displacement.bent_detection import find_deformation, recognize
from nrbench.errors import BadInput, require
from nrbench.imaging.convert import Image, depth_of, quantize
from nrbench.imaging.masks import MaskedImage
from nrbench.imaging.wallpaper_group import FoundGroup, find_wallpaper_group
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice, Vector, require_visible
from nrbench.lattice.vertices import Vertex, lay_vertices
from nrbench.pictures.files import encode_png, write_image
from nrbench.pictures.overlays import (
    COLOR,
    contact_sheet,
    draw_outlines,
    draw_overlay,
    draw_vertices,
    stack,
)
from nrbench.pictures.truth import vertices_text
from nrbench.plugins.forms import Alternative, Curve, Detection, NoLatticeFound, Surface, detect_known
from nrbench.plugins.parameters import parse_spec
from nrbench.storage import write_aside, write_text
from nrbench.work import work_clock

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nrbench.displacement.bent_detection import Followed
    from nrbench.displacement.deformation_field import Deformation


@dataclass(frozen=True)
class LatticeResult:
    """The result of a detector or of the user: a lattice, or why there is none.

    ``detection`` is that of a detector. ``has_origin`` says whether the origin is known. ``seconds`` is set in a
    comparison. ``failed`` marks a detector that raised an error. ``deformation`` is that of a bent image, of which
    ``lattice`` is the mean lattice, and ``detection`` what the detector found in the straightened image, whose own
    lattice is ``straightened`` if it was written. ``detector`` is empty if a lattice was given that was followed.
    ``symmetry`` is that of the image, or of the straightened one, if it was looked for. ``superposed`` are the lattices
    of an image that has several.
    """

    detector: str
    lattice: Lattice | None
    detection: Detection | None = None
    reason: str = ""
    has_origin: bool = False
    seconds: float | None = None
    failed: bool = False
    deformation: Deformation | None = None
    straightened: Lattice | None = None
    symmetry: FoundGroup | None = None
    superposed: tuple[Lattice, ...] = ()

    @classmethod
    def of_detection(cls, detector: str, detection: Detection, seconds: float | None = None) -> LatticeResult:
        """Return the result of a detector."""
        return cls(detector, detection.lattice, detection, has_origin=detection.has_origin, seconds=seconds)

    @classmethod
    def of_followed(cls, detector: str, followed: Followed, straightened: Lattice | None = None) -> LatticeResult:
        """Return the mean lattice of an image that may be bent; its origin is known if the image was straightened."""
        (found, detection), known = followed, straightened is not None
        if detection is not None:
            detection = replace(detection, lattice=found.lattice, has_origin=known)
        return cls(detector, found.lattice, detection, has_origin=known, deformation=found, straightened=straightened)

    @property
    def candidates(self) -> list[Alternative]:
        """The first candidates of a detector, the chosen lattice among them."""
        return rank_candidates(self.detection)[:SHOWN] if self.detection else []

    @property
    def vectors(self) -> str:
        """The two vectors, and the origin where it is known, as text."""
        return ", ".join(vector_texts(self.lattice, self.has_origin)) if self.lattice else ""

    @property
    def vertices(self) -> tuple[Vertex, ...]:
        """The points of the lattice where they were followed; none if the lattice is regular."""
        if self.deformation is not None:
            return self.deformation.lattice_points
        return self.detection.vertices if self.detection else ()

    def finish(self, image: Image, options: LatticeQuestion) -> None:
        """Print the result on standard output, and write a file of the points of the lattice if one is named."""
        if options.vertices is not None:
            vertices = self.vertices or (lay_vertices(self.lattice, image.shape[:2]) if self.lattice else ())
            if vertices:
                write_text(options.vertices, vertices_text(vertices))
            state = f"{len(vertices)} vertices" if vertices else "not written, there is no lattice in the picture"
            click.echo(f"{options.vertices}: {state}", err=True)
        self.print(options.as_json)

    def print(self, as_json: bool) -> None:
        """Print the result on standard output."""
        if as_json:
            print(json.dumps(self.as_dict()))
        elif self.lattice is None:
            print(f"no lattice: {self.reason}")
        else:
            found = self.vectors if self.deformation is None else describe_deformation(self.deformation)
            confidence = "" if self.detection is None else f", confidence {self.detection.confidence:.3f}"
            print(f"{found}{self.detector and f', {self.detector}'}{confidence}")
            for number, each in enumerate(self.candidates[1:], 2):
                vectors = ", ".join(vector_texts(each.lattice, each.has_origin))
                print(f"candidate {number}: {vectors}, {each.relation}, confidence {each.confidence:.3f}")
            if self.symmetry is not None:
                print(self.symmetry)

    def with_symmetry(self, image: Image, options: LatticeQuestion) -> LatticeResult:
        """Return the result with the symmetry of the image, if asked for; a bent image is straightened first."""
        if self.lattice is None or not options.symmetry:
            return self
        require(self.detection is None or not self.detection.vertices, FOLLOWS_BENT)
        straight = self.deformation.straighten() if self.deformation else (image, self.lattice)
        return replace(self, symmetry=find_wallpaper_group(*straight))

    def as_dict(self) -> dict[str, Any]:
        """Return the lattice for JSON, with the alternatives and the probabilities of a detector; or the reason."""
        if self.lattice is None:
            several = {"lattices": [known_vectors(each, False) for each in self.superposed]} if self.superposed else {}
            return {"lattice": None, "reason": self.reason, **several}
        found: dict[str, Any] = dict(known_vectors(self.lattice, self.has_origin))
        if self.detector:
            found |= {"detector": self.detector, "confidence": self.detection and self.detection.confidence}
        if self.detection is not None:
            probabilities = self.detection.probabilities
            found["probabilities"] = probabilities and probabilities._asdict()
            found["alternatives"] = [candidate_dict(each) for each in self.detection.alternatives]
        if self.deformation is not None:
            straight = {"straightened": self.straightened.as_dict()} if self.straightened else {}
            found["deformation"] = {**self.deformation.as_dict(), **straight}
        if self.symmetry is not None:
            found["symmetry"] = self.symmetry.as_dict()
        return found

    def comparison_dict(self) -> dict[str, Any]:
        """Return the entry of a comparison for JSON."""
        head = {} if self.lattice else {"detector": self.detector}
        seconds = {} if self.seconds is None else {"seconds": self.seconds}
        return {**head, **self.as_dict(), **seconds, **({"error": True} if self.failed else {})}

    def rows(self) -> list[str]:
        """Return the lines of a comparison's table: one for each of the first candidates, or why there is none."""
        seconds = "-" if self.seconds is None else f"{self.seconds:.3f}"
        if self.lattice is None:
            why = self.reason if self.failed else f"no lattice: {self.reason}"
            return [f"{self.detector:<12} {'-':<20} {'-':<20} {'-':>10} {seconds:>8}  {why}"]
        lines = []
        for number, candidate in enumerate(self.candidates, 1):
            t1, t2 = (f"({x:.3f}, {y:.3f})" for x, y in candidate.lattice.matrix)
            name, cost = (self.detector, seconds) if number == 1 else (f"  {number}", "")
            line = f"{name:<12} {t1:<20} {t2:<20} {candidate.confidence:>10.3f} {cost:>8}  {candidate.relation}"
            lines.append(line.rstrip())
        return lines


def describe_deformation(found: Deformation) -> str:
    """Return the mean lattice and the deformation in one line of text."""
    vectors = ", ".join(vector_texts(found.lattice, has_origin=False))
    if not found.covered:
        return f"{vectors}, could not be followed: whether the image is bent is not known"
    if not found.bent:
        return f"{vectors}, not bent"
    kind = "smooth displacements" if found.homography is None else "a homography (perspective)"
    return f"mean lattice {vectors}, bent by {kind} of amplitude {found.amplitude:.2f} s"


def answer_question(options: LatticeQuestion) -> int:
    """Print and draw the answer; return the exit code, which is 1 if a detector failed."""
    if options.image.is_dir():
        return _survey_folder(options)
    masked = masked_in(options.image, options.mask)
    image = masked.image
    if masked.known is not None and (options.symmetry or options.straighten):
        click.echo("--symmetry and --straighten see pixels that are left out in the nearest color", err=True)
    if options.every:
        return _compare_detectors(masked, options)
    try:
        if options.defects:
            require(masked.known is None, "--defects: compares all cells, so none can be left out; see synth --fill")
            _show_defects(image, options, options.defects)
        elif options.straighten:
            _straighten_picture(image, options, options.straighten)
        elif options.pick or options.lattice is not None:
            _show_given(image, options)
        else:
            _show_detection(masked, options)
    except NoLatticeFound as none:
        click.echo(f"{options.defects or options.straighten}: not written, there is no lattice", err=True)
        LatticeResult("", None, reason=none.reason).print(options.as_json)
    return 0


def _survey_folder(options: LatticeQuestion) -> int:
    """Detect the lattices of a folder; return 1 if a picture could not be read or the detector failed, else 0."""
    existing = "keep" if options.keep else "replace" if options.force else "refuse"
    survey = Survey(options.image, options.spec, options.output, options.least, existing)
    load_kernels()
    with live_progress() as progress:
        survey.run(progress)
    failed = sum(each.failed for each in survey.findings)
    if options.as_json:
        pictures = [each.as_dict() for each in survey.findings]
        content = {"truth": str(survey.table), "sheets": [str(page) for page in survey.pages], "pictures": pictures}
        print(json.dumps(content, indent=1))
        return int(failed > 0)
    print(survey.table, *survey.pages, sep="\n")
    counts = {
        "with a lattice": sum(each.lattice is not None for each in survey.findings),
        "to be decided": sum(each.is_doubtful for each in survey.findings),
        "failed": failed,
    }
    counts["without a lattice"] = len(survey.findings) - sum(counts.values())
    words = ", ".join(f"{number} {state}" for state, number in counts.items() if number)
    print(f"{len(survey.findings)} pictures: {words}")
    print(f"Look at the sheets and correct {survey.table.name}. Then run the command with --keep to see the result.")
    return int(failed > 0)


def _show_given(image: Image, options: LatticeQuestion) -> None:
    """Print and draw the user's lattice, given as numbers or picked on a page."""
    if options.lattice is None:
        lattice, has_origin = pick(image, lambda address: click.echo(f"open in a browser: {address}", err=True)), True
        _print_numbers(lattice)
    else:
        lattice, has_origin = Lattice.parse(options.lattice), options.lattice.count(",") == 5
    result = LatticeResult("given" if options.lattice else "picked", lattice, has_origin=has_origin)
    result = result.with_symmetry(image, options)
    if options.output is not None:
        write_image(options.output, draw_overlay(image, lattice, result.symmetry))
    result.finish(image, options)


def _print_numbers(lattice: Lattice) -> None:
    """Print the six numbers of a lattice, as other verbs take them, on standard error."""
    click.echo(f"for other verbs: --lattice {lattice_text(lattice, has_origin=True)}", err=True)


def _show_detection(masked: MaskedImage, options: LatticeQuestion) -> None:
    """Print and draw the lattice that one detector finds; the default detector also that of a bent image."""
    image, spec = masked.image, options.spec
    name, parameters = parse_spec(spec)
    detector = plugins.build("detectors", name, parameters)
    detection: Detection | None
    try:
        with waiting(f"{name} looks for the lattice"):
            plugins.require_abilities("detectors", detector, masks=masked.known is not None)
            usual = options.detector is None
            found, bent = recognize(image, detector, masked.known) if usual else (detect_known(detector, *masked), None)
        result = LatticeResult.of_followed(name, bent) if bent else LatticeResult.of_detection(name, found)
        detection = found
        title = f"{spec}: {result.vectors}, confidence {found.confidence:.3f}{', straightened' if bent else ''}"
    except NoLatticeFound as none:
        result = LatticeResult(name, None, reason=none.reason, superposed=none.lattices)
        detection = none.best
        title = f"{spec}: no lattice: {none.reason}"
    result = result.with_symmetry(image, options)
    if options.diagnostics is not None:
        _draw_diagnostics(detection.diagnostics if detection else {}, title, options.diagnostics)
    if options.output is not None:
        _draw_result(image, result, options.output)
    result.finish(image, options)


def _draw_result(image: Image, result: LatticeResult, output: Path) -> None:
    """Write the image with the chosen lattice; below it, if there are alternatives, the middle with each candidate.

    The image stays in the upper left corner, enlarged by a whole factor if it or its cells are small.
    """
    if result.lattice is None:
        click.echo(f"{output}: not written, there is no lattice to draw", err=True)
    elif result.vertices:
        write_image(output, draw_vertices(image, result.vertices))
        if result.symmetry is not None:
            click.echo(f"{output}: without signs; for these, write the straight picture with --straighten", err=True)
    else:
        drawn = draw_overlay(image, result.lattice, result.symmetry)
        if len(result.candidates) > 1:
            drawn = stack(drawn, contact_sheet(*draw_candidates(image, result.candidates)))
        write_image(output, drawn)
        _print_numbers(result.lattice)


def _draw_diagnostics(diagnostics: Mapping[str, Any], title: str, output: Path) -> None:
    figure = diagram(diagnostics, title)
    if figure is None:
        click.echo(f"{output}: not written, the detector returned nothing that can be drawn", err=True)
    else:
        write_aside(output, lambda file: figure.savefig(file, dpi=110, format=output.suffix.lstrip(".") or "png"))


def _compare_detectors(masked: MaskedImage, options: LatticeQuestion) -> int:
    """Print and draw the lattices of all detectors; return 1 if one of them failed, else 0."""
    load_kernels()
    names = [plugin.name for plugin in plugins.inventory("detectors") if plugin.cls is not None]
    results = []
    unable = [name for name in names if not getattr(plugins.find("detectors", name).cls, "masks", False)]
    if masked.known is not None:
        click.echo(f"{', '.join(unable)}: cannot leave pixels out; they see them filled", err=True)
    with live_progress(patience=True) as progress:
        for number, name in enumerate(names, 1):
            results.append(_run_detector(masked, name))
            progress(number, len(names), name)
    if options.output is not None:
        _draw_comparison(masked.image, results, options.output)
    if options.as_json:
        print(json.dumps([result.comparison_dict() for result in results], indent=1))
    else:
        print(f"{'detector':<12} {'t1 (px)':<20} {'t2 (px)':<20} {'confidence':>10} {'seconds':>8}")
        print("\n".join(line for result in results for line in result.rows()))
    return int(any(result.failed for result in results))


def _run_detector(masked: MaskedImage, name: str) -> LatticeResult:
    """Return the result of a detector; an error of the detector is a failed result."""
    detector = plugins.build("detectors", name)
    start = work_clock()
    try:
        detection = detect_known(detector, *masked)
    except NoLatticeFound as none:
        return LatticeResult(name, None, reason=none.reason, seconds=work_clock() - start)
    except BadInput:
        raise
    except Exception as error:
        return LatticeResult(name, None, reason=f"failed: {type(error).__name__}: {error}", failed=True)
    return LatticeResult.of_detection(name, detection, work_clock() - start)


def _draw_comparison(image: Image, results: Sequence[LatticeResult], output: Path) -> None:
    """Write a sheet with a captioned picture for each candidate of each detector."""
    pictures, captions = [], []
    for result in results:
        panels, texts = draw_candidates(image, result.candidates)
        if not panels:
            panels, texts = [image[:1, :1]], [f"no lattice\n{result.reason}"]
        pictures += panels
        captions += [f"{result.detector}\n{text}" for text in texts]
    write_image(output, contact_sheet(pictures, captions, columns=3))


def _straighten_picture(image: Image, options: LatticeQuestion, output: Path) -> None:
    """Print the mean lattice, the deformation and the short list, and write the image with its deformation undone."""
    name, parameters = parse_spec(options.spec)
    detector = plugins.build("detectors", name, parameters)
    followed = find_deformation(image, as_lattice(options.lattice), detector)
    straight, straight_lattice = followed.deformation.straighten()
    write_image(output, quantize(straight, depth_of(image)))
    if options.output is not None:
        write_image(options.output, draw_vertices(image, followed.deformation.lattice_points))
    numbers = ",".join(f"{number:.4f}" for number in straight_lattice.numbers)
    click.echo(f"{output}: its lattice is {numbers}", err=True)
    LatticeResult.of_followed("" if options.lattice else name, followed, straight_lattice).finish(image, options)


def _show_defects(image: Image, options: LatticeQuestion, output: Path) -> None:
    """Print the defects of an image, or that there are none, and draw them."""
    with waiting("each cell is compared with all others"):
        defects = find_defects(image, options.lattice or options.detector)
    write_image(output, draw_outlines(image, [each.outline for each in defects]))
    if options.as_json:
        print(json.dumps({"defects": [each.as_dict() for each in defects]}, indent=1))
    else:
        lines = [f"{number}: {each}" for number, each in enumerate(defects, 1)]
        print("\n".join(lines) or "no defects: no cell stands out from the others")


PANEL = (5.6, 4.8)
"""Width and height of a panel, inches."""
LETTERS = 72
"""Number of letters on a line of text as wide as a panel."""


def diagram(diagnostics: Mapping[str, Any], title: str = "") -> Figure | None:
    """Draw the diagnostics of a detection: surfaces as pictures, curves as lines, numbers as text below.

    A surface shows its candidates as circles and the chosen vectors as arrows from its zero. A vector outside the
    surface is drawn as its negative. A curve shows the chosen values as vertical lines.

    Parameters
    ----------
    diagnostics
        Those of a :class:`~nrbench.plugins.forms.Detection`.
    title
        Text above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        On an Agg canvas of its own; None if nothing can be drawn.
    """
    panels = {name: value for name, value in diagnostics.items() if isinstance(value, Surface | Curve)}
    if not panels:
        return None
    columns = min(2, len(panels))
    rows = math.ceil(len(panels) / columns)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    for i, (name, value) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(rows, columns, i)
        axes.set_title(name, fontsize=10)
        _draw_surface(axes, value) if isinstance(value, Surface) else _draw_curve(axes, value)
    figure.suptitle(textwrap.fill(title, LETTERS * columns), fontsize=10)
    known = {name: value for name, value in diagnostics.items() if isinstance(value, Real | str)}
    words = [f"{name} {value if isinstance(value, str) else format(value, '.4g')}" for name, value in known.items()]
    figure.supxlabel(textwrap.fill(", ".join(words), LETTERS * columns), fontsize=8)
    return figure


def _draw_surface(axes: Axes, surface: Surface) -> None:
    height, width = surface.values.shape
    left, top = -surface.zero[0] - 0.5, -surface.zero[1] - 0.5
    box = (left, left + width, top + height, top)
    # Extremes, like the peak at zero, are cut off.
    finite = surface.values[np.isfinite(surface.values)]
    low, high = np.quantile(finite, (0.005, 0.995)) if finite.size else (0, 1)
    shown = axes.imshow(surface.values, extent=box, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    axes.figure.colorbar(shown, ax=axes, shrink=0.8)
    peaks = np.reshape(surface.peaks, (-1, 2))
    axes.plot(*peaks.T, "o", mfc="none", mec="tab:cyan", ms=5, mew=0.9, label=f"{len(peaks)} candidates")
    for vector in () if surface.vectors is None else surface.vectors:
        inside = box[0] <= vector[0] <= box[1] and box[3] <= vector[1] <= box[2]
        tip = vector if inside else -vector
        axes.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": COLOR, "lw": 1.8})
        axes.plot(*tip, ".", color=COLOR, ms=3)
    axes.set(xlim=box[:2], ylim=box[2:])
    axes.legend(loc="upper right", fontsize=7, framealpha=0.7)


def _draw_curve(axes: Axes, curve: Curve) -> None:
    axes.plot(curve.x, curve.y, color="black", lw=1)
    for mark in curve.marks:
        axes.axvline(mark, color=COLOR, lw=1.2)
        axes.annotate(f"{mark:.4g}", (mark, 1.0), xycoords=("data", "axes fraction"), fontsize=7, color=COLOR)
    axes.set_xlabel(curve.label, fontsize=8)


POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'"
MOST_BYTES = 10_000
"""Size of the largest answer that is read."""


def lattice_of(points: Sequence[Vector]) -> Lattice:
    """Return the lattice of three points (x, y) px: its origin, the end of t1, the end of t2.

    Raises
    ------
    BadInput
        When the points lie on one line, or so close together that no pixel shows the period.
    """
    (x, y), (x1, y1), (x2, y2) = points
    return require_visible(Lattice((x1 - x, y1 - y), (x2 - x, y2 - y), (x, y)), "picked")


def pick(image: Image, announce: Callable[[str], None]) -> Lattice:
    """Serve a page on this machine until the user picks a lattice on it, and return the lattice.

    Only this machine can reach the page, and only with the token that is part of its address. On a desktop, the page is
    opened.

    Parameters
    ----------
    image
        The texture.
    announce
        Is called with the address of the page.

    Raises
    ------
    BadInput
        If the user cancels.
    """
    with PickServer(image) as server:
        announce(server.address)
        if sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(server.address)
        server.serve_forever(poll_interval=0.1)
    if server.lattice is None:
        raise BadInput("--pick: cancelled, no lattice was picked")
    return server.lattice


class PickServer(ThreadingHTTPServer):
    """Serves the page of one image to this machine, and takes the answer.

    Parameters
    ----------
    image
        The texture.

    Attributes
    ----------
    address
        The address of the page.
    lattice
        The lattice; None before the answer, and if the user cancelled.
    """

    def __init__(self, image: Image) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        page = files(__package__).joinpath("templates/pick.html").read_text("utf-8")
        self.page = page.replace("IMAGE", base64.b64encode(encode_png(image)).decode("ascii")).encode()
        self.path = f"/{secrets.token_urlsafe(16)}"
        self.address = f"http://127.0.0.1:{self.server_port}{self.path}"
        self.lattice: Lattice | None = None

    def answer(self, text: bytes) -> str:
        """Take the answer of the page, and return what the page shows.

        Raises
        ------
        BadInput
            If it is no lattice.
        """
        try:
            points = json.loads(text)["points"]
            self.lattice = None if points is None else lattice_of([(float(x), float(y)) for x, y in points])
        except (ValueError, TypeError, KeyError) as error:
            raise BadInput(f"no three points: {error}") from None
        return "Cancelled." if points is None else "The lattice is printed in the terminal. You can close this page."


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of the page; all others get a 404."""

    server: PickServer

    def do_GET(self) -> None:
        """Send the page."""
        with self._of_page():
            self._send(200, "text/html; charset=utf-8", self.server.page)

    def do_POST(self) -> None:
        """Take the answer."""
        with self._of_page():
            size = int(self.headers.get("Content-Length") or 0)
            require(0 < size <= MOST_BYTES, f"an answer of {size} bytes; at most {MOST_BYTES} are read")
            text = self.server.answer(self.rfile.read(size))
            self._send(200, "text/plain; charset=utf-8", text.encode())
            self.server.shutdown()

    @contextlib.contextmanager
    def _of_page(self) -> Iterator[None]:
        """Send 404 instead if the path is not that of the page, and 400 with the message after bad input."""
        try:
            if not secrets.compare_digest(self.path.encode(), self.server.path.encode()):
                raise FileNotFoundError
            yield
        except FileNotFoundError:
            self._send(404, "text/plain", b"not found")
        except (BadInput, ValueError) as error:
            self._send(400, "text/plain; charset=utf-8", str(error).encode())

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, "Content-Length": str(len(content)), "Content-Security-Policy": POLICY}
        for name, value in {**headers, "Cache-Control": "no-store"}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Log nothing."""
