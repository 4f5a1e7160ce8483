"""The command lattice, which detects, compares and draws lattices."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.lattice.geometry import Lattice


@click.command("lattice")
@click.argument("image", type=click.Path(path_type=Path))
@click.option("-d", "--detector", metavar="DETECTOR[:param=value,...]", help="The detector.  [default: consensus]")
@click.option("--all", "every", is_flag=True, help="Compare all detectors.")
@click.option("--pick", is_flag=True, help="Pick a lattice in a window by clicking its origin and the ends of t1, t2.")
@click.option("--lattice", metavar="x1,y1,x2,y2[,x,y]", help="Use this lattice; -o draws it.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), metavar="OVERLAY.png", help="Draw the lattice over the image."
)
@click.option(
    "--diagnostics",
    type=click.Path(path_type=Path),
    metavar="OUT.png",
    help="Draw how the detector found the lattice.",
)
@click.option(
    "--straighten",
    type=click.Path(path_type=Path),
    metavar="OUT.png",
    help="Follow the lattice through a bent image, and write the image with its deformation undone.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def lattice_command(
    image: Path,
    detector: str | None,
    every: bool,
    pick: bool,
    lattice: str | None,
    output: Path | None,
    diagnostics: Path | None,
    straighten: Path | None,
    as_json: bool,
) -> int:
    """Detect the lattice of IMAGE.

    "No lattice" is a valid result: the exit code is 0.
    """
    from nrbench.cli.images import check_output
    from nrbench.errors import BadInput
    from nrbench.imaging.files import read_image

    options = {"-d": detector, "--all": every, "--pick": pick, "--lattice": lattice}
    chosen = [name for name, value in options.items() if value not in (None, False)]
    if len(chosen) > 1:
        raise BadInput(f"{' and '.join(chosen)}: choose one of them")
    if diagnostics is not None and chosen not in ([], ["-d"]):
        raise BadInput(f"--diagnostics: draws how one detector works; leave {chosen[0]} out")
    if straighten is not None and (every or pick or diagnostics is not None):
        raise BadInput("--straighten: follows one lattice; leave --all, --pick and --diagnostics out")
    for path in filter(None, (output, diagnostics, straighten)):
        check_output(path)
    picture = read_image(image)
    if straighten is not None:
        from nrbench.cli.straightening import straighten_picture

        straighten_picture(picture, detector or "consensus", lattice, output, straighten, as_json)
        return 0
    if every:
        return _compare_detectors(picture, output, as_json)
    if pick or lattice is not None:
        _use_given(picture, lattice, output, as_json)
    else:
        _detect(picture, detector or "consensus", output, diagnostics, as_json)
    return 0


@dataclass(frozen=True)
class _Result:
    """The result of a detector or of the user: a lattice, or why there is none.

    ``seconds`` is set in a comparison. ``failed`` marks a detector that raised an error.
    """

    detector: str
    lattice: Lattice | None
    confidence: float | None = None
    reason: str = ""
    seconds: float | None = None
    failed: bool = False

    @property
    def vectors(self) -> dict[str, Any]:
        """The two vectors for JSON, and the origin where it is known."""
        assert self.lattice is not None
        known = ("t1", "t2", "origin") if self._has_origin else ("t1", "t2")
        return {name: value for name, value in self.lattice.as_dict().items() if name in known}

    @property
    def _has_origin(self) -> bool:
        """Whether the origin is known; (0, 0) stands for an unknown one."""
        return self.lattice is not None and self.lattice.origin != (0.0, 0.0)

    def text(self, separator: str = ", ") -> str:
        """Return the two vectors, and the origin where it is known, as text."""
        assert self.lattice is not None
        return separator.join(f"{name} = ({x:.3f}, {y:.3f}) px" for name, (x, y) in self.vectors.items())

    def print(self, as_json: bool) -> None:
        """Print the result on standard output."""
        if as_json:
            found = {**self.vectors, "detector": self.detector, "confidence": self.confidence} if self.lattice else None
            print(json.dumps(found or {"lattice": None, "reason": self.reason}))
        elif self.lattice is None:
            print(f"no lattice: {self.reason}")
        else:
            confidence = "" if self.confidence is None else f", confidence {self.confidence:.3f}"
            print(f"{self.text()}, {self.detector}{confidence}")

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of a comparison for JSON."""
        seconds = {} if self.seconds is None else {"seconds": self.seconds}
        if self.lattice is not None:
            return {"detector": self.detector, **self.vectors, "confidence": self.confidence, **seconds}
        error = {"error": True} if self.failed else {}
        return {"detector": self.detector, "lattice": None, "reason": self.reason, **seconds, **error}

    def row(self) -> str:
        """Return the line of a comparison's table."""
        seconds = "-" if self.seconds is None else f"{self.seconds:.3f}"
        if self.lattice is None:
            why = self.reason if self.failed else f"no lattice: {self.reason}"
            return f"{self.detector:<12} {'-':<20} {'-':<20} {'-':>10} {seconds:>8}  {why}"
        t1, t2 = (f"({x:.3f}, {y:.3f})" for x, y in (self.lattice.t1, self.lattice.t2))
        return f"{self.detector:<12} {t1:<20} {t2:<20} {self.confidence:>10.3f} {seconds:>8}"

    def caption(self, letters: int) -> str:
        """Return the caption of a comparison's picture, with at most ``letters`` characters a line."""
        if self.lattice is None:
            lines = textwrap.wrap(self.reason, letters, max_lines=4, placeholder=" ...")
            return "\n".join([f"{self.detector}: no lattice", *lines])
        vectors = self.text(separator="\n")
        return f"{self.detector}, confidence {self.confidence:.3f}\n{vectors}"


def _use_given(image: Image, numbers: str | None, output: Path | None, as_json: bool) -> None:
    """Print and draw the user's lattice, given as numbers or picked in a window."""
    from nrbench.lattice.geometry import Lattice

    if numbers is None:
        from nrbench.cli.lattice_figures import pick

        lattice = pick(image)
        text = ",".join(repr(round(float(x), 4)) for x in lattice.numbers)
        click.echo(f"for other verbs: --lattice {text}", err=True)
    else:
        lattice = Lattice.parse(numbers)
    _draw_lattice(image, lattice, output)
    _Result("picked" if numbers is None else "given", lattice).print(as_json)


def _detect(image: Image, spec: str, output: Path | None, diagnostics: Path | None, as_json: bool) -> None:
    """Print and draw the lattice that one detector finds."""
    from nrbench.api import detect_lattice
    from nrbench.plugins.forms import NoLatticeFound
    from nrbench.plugins.parameters import parse_spec

    name, parameters = parse_spec(spec)
    try:
        detection = detect_lattice(image, name, **parameters)
    except NoLatticeFound as none:
        title = f"{spec}: no lattice: {none.reason}"
        _draw_diagnostics(none.best.diagnostics if none.best else {}, title, diagnostics)
        if output is not None:
            click.echo(f"{output}: not written, there is no lattice to draw", err=True)
        _Result(name, None, reason=none.reason).print(as_json)
        return
    result = _Result(name, detection.lattice, detection.confidence)
    title = f"{spec}: {result.text()}, confidence {detection.confidence:.3f}"
    _draw_diagnostics(detection.diagnostics, title, diagnostics)
    _draw_lattice(image, detection.lattice, output)
    result.print(as_json)


def _compare_detectors(image: Image, output: Path | None, as_json: bool) -> int:
    """Print and draw the lattices of all detectors; return 1 if one of them failed, else 0."""
    from nrbench import plugins
    from nrbench.jit import load_kernels

    load_kernels()
    names = [plugin.name for plugin in plugins.inventory("detectors") if plugin.cls is not None]
    results = [_run_detector(image, name) for name in names]
    if output is not None:
        _draw_comparison(image, results, output)
    if as_json:
        print(json.dumps([result.as_dict() for result in results], indent=1))
    else:
        print(f"{'detector':<12} {'t1 (px)':<20} {'t2 (px)':<20} {'confidence':>10} {'seconds':>8}")
        print("\n".join(result.row() for result in results))
    return int(any(result.failed for result in results))


def _run_detector(image: Image, name: str) -> _Result:
    """Return the result of a detector; an error of the detector is a failed result."""
    from nrbench import plugins
    from nrbench.errors import BadInput
    from nrbench.plugins.forms import timed_detection

    try:
        detection = timed_detection(plugins.build("detectors", name), image)
    except BadInput:
        raise
    except Exception as error:
        return _Result(name, None, reason=f"failed: {type(error).__name__}: {error}", failed=True)
    return _Result(name, detection.lattice, detection.confidence, detection.reason, detection.seconds)


def _draw_comparison(image: Image, results: Sequence[_Result], output: Path) -> None:
    """Write a sheet with one captioned picture for each detector."""
    from nrbench.imaging.drawing import contact_sheet, draw_lattice
    from nrbench.imaging.files import write_image

    pictures = [image if result.lattice is None else draw_lattice(image, result.lattice) for result in results]
    letters = max(32, image.shape[1] // 6)
    write_image(output, contact_sheet(pictures, [result.caption(letters) for result in results], columns=3))


def _draw_lattice(image: Image, lattice: Lattice, output: Path | None) -> None:
    from nrbench.imaging.drawing import draw_lattice
    from nrbench.imaging.files import write_image

    if output is not None:
        write_image(output, draw_lattice(image, lattice))


def _draw_diagnostics(diagnostics: Mapping[str, Any], title: str, output: Path | None) -> None:
    if output is None:
        return
    from nrbench.cli.lattice_figures import diagram
    from nrbench.storage import write_aside

    figure = diagram(diagnostics, title)
    if figure is None:
        click.echo(f"{output}: not written, the detector returned nothing that can be drawn", err=True)
        return
    write_aside(output, lambda aside: figure.savefig(aside, dpi=110))
