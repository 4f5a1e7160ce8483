"""The command lattice, which detects, compares and draws the lattices of a picture or of a folder of pictures."""

from __future__ import annotations

import json
import textwrap
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.lattice.geometry import Lattice
    from nrbench.plugins.forms import Alternative, Detection

WHOLE = 1024
"""px; largest side of an image that a comparison of detectors shows as a whole."""
ZOOM = 480
"""px; side of the picture that shows the middle of a larger image."""


@click.command("lattice")
@click.argument("image", type=click.Path(path_type=Path), metavar="IMAGE|FOLDER")
@click.option("-d", "--detector", metavar="DETECTOR[:param=value,...]", help="The detector.  [default: consensus]")
@click.option("--all", "every", is_flag=True, help="Compare all detectors.")
@click.option("--pick", is_flag=True, help="Pick a lattice in a window by clicking its origin and the ends of t1, t2.")
@click.option("--lattice", metavar="x1,y1,x2,y2[,x,y]", help="Use this lattice; -o draws it.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="OVERLAY.png|DIR",
    help="Draw the lattice over the image. For a folder: the directory of truth.csv.  [default: FOLDER]",
)
@click.option(
    "--diagnostics",
    type=click.Path(path_type=Path),
    metavar="OUT.png",
    help="Draw how the detector found the lattice.",
)
@click.option(
    "--least",
    type=click.FloatRange(0, 1),
    metavar="CONFIDENCE",
    help="For a folder: lattices of a lower confidence are listed as candidates only.  [default: 0.5]",
)
@click.option("--keep", is_flag=True, help="For a folder: keep the lines of truth.csv, and add the missing pictures.")
@click.option("--force", is_flag=True, help="For a folder: replace truth.csv.")
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
    least: float | None,
    keep: bool,
    force: bool,
    straighten: Path | None,
    as_json: bool,
) -> int:
    """Detect the lattice of IMAGE, or those of all pictures in FOLDER.

    "No lattice" is a valid result: the exit code is 0. For a folder, the command writes truth.csv, which `nrbench run
    FOLDER` reads, and contact sheets by which you can check it.
    """
    from nrbench.cli.images import check_output
    from nrbench.errors import BadInput
    from nrbench.imaging.files import read_image

    options = {"-d": detector, "--all": every, "--pick": pick, "--lattice": lattice}
    chosen = [name for name, value in options.items() if value not in (None, False)]
    if len(chosen) > 1:
        raise BadInput(f"{' and '.join(chosen)}: choose one of them")
    of_folders = [
        name for name, given in (("--least", least is not None), ("--keep", keep), ("--force", force)) if given
    ]
    if image.is_dir():
        of_one = (("--diagnostics", diagnostics), ("--straighten", straighten))
        wrong = [*(name for name in chosen if name != "-d"), *(name for name, given in of_one if given is not None)]
        if wrong:
            raise BadInput(f"{wrong[0]}: needs one picture, and {image} is a folder; pass a picture in it")
        if keep and force:
            raise BadInput("--keep and --force: choose one of them")
        existing = "keep" if keep else "replace" if force else "refuse"
        return _survey(image, detector or "consensus", output, least, existing, as_json)
    if of_folders and image.is_file():
        raise BadInput(f"{of_folders[0]}: is for a folder of pictures, and {image} is none; leave it out")
    if diagnostics is not None and chosen not in ([], ["-d"]):
        raise BadInput(f"--diagnostics: draws how one detector works; leave {chosen[0]} out")
    if straighten is not None and (every or pick or diagnostics is not None):
        raise BadInput("--straighten: follows one lattice; leave --all, --pick and --diagnostics out")
    written: set[Path] = set()
    for path in filter(None, (output, diagnostics, straighten)):
        check_output(path)
        if path.resolve() == image.resolve():
            raise BadInput(f"{path}: is the picture itself, which would be lost; choose another name")
        if path.resolve() in written:
            raise BadInput(f"{path}: would be written twice; choose another name for one of the pictures")
        written.add(path.resolve())
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

    ``detection`` is that of a detector. ``has_origin`` says whether the origin is known. ``seconds`` is set in a
    comparison. ``failed`` marks a detector that raised an error.
    """

    detector: str
    lattice: Lattice | None
    detection: Detection | None = None
    reason: str = ""
    has_origin: bool = False
    seconds: float | None = None
    failed: bool = False

    @classmethod
    def of_detection(cls, detector: str, detection: Detection, seconds: float | None = None) -> _Result:
        """Return the result of a detector."""
        return cls(detector, detection.lattice, detection, has_origin=detection.has_origin, seconds=seconds)

    @property
    def vectors(self) -> dict[str, Any]:
        """The two vectors for JSON, and the origin where it is known."""
        from nrbench.suites.surveying import known_vectors

        assert self.lattice is not None
        return {name: list(vector) for name, vector in known_vectors(self.lattice, self.has_origin).items()}

    @property
    def candidates(self) -> list[Alternative]:
        """The first candidates of a detector, the chosen lattice among them."""
        from nrbench.suites.surveying import SHOWN, rank_candidates

        return rank_candidates(self.detection)[:SHOWN] if self.detection else []

    def text(self, separator: str = ", ") -> str:
        """Return the two vectors, and the origin where it is known, as text."""
        return separator.join(f"{name} = ({x:.3f}, {y:.3f}) px" for name, (x, y) in self.vectors.items())

    def print(self, as_json: bool) -> None:
        """Print the result on standard output."""
        if as_json:
            found = self._found_dict() if self.lattice else {"lattice": None, "reason": self.reason}
            print(json.dumps(found))
        elif self.lattice is None:
            print(f"no lattice: {self.reason}")
        else:
            confidence = "" if self.detection is None else f", confidence {self.detection.confidence:.3f}"
            role = f", {self.detection.role} lattice" if self.detection and self.detection.role else ""
            print(f"{self.text()}, {self.detector}{confidence}{role}")
            for number, candidate in enumerate(self.candidates[1:], 2):
                print(f"candidate {number}: {_describe(candidate)}")

    def _found_dict(self) -> dict[str, Any]:
        """Return the lattice for JSON, with the alternatives and the probabilities of a detector."""
        if self.detection is None:
            return {**self.vectors, "detector": self.detector, "confidence": None}
        from nrbench.suites.surveying import candidate_dict

        probabilities = self.detection.probabilities
        return {
            **self.vectors,
            "detector": self.detector,
            "confidence": self.detection.confidence,
            "probabilities": probabilities and probabilities._asdict(),
            "role": self.detection.role,
            "alternatives": [candidate_dict(each) for each in self.detection.alternatives],
        }

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of a comparison for JSON."""
        seconds = {} if self.seconds is None else {"seconds": self.seconds}
        if self.lattice is not None:
            return {**self._found_dict(), **seconds}
        error = {"error": True} if self.failed else {}
        return {"detector": self.detector, "lattice": None, "reason": self.reason, **seconds, **error}

    def rows(self) -> list[str]:
        """Return the lines of a comparison's table: one for each of the first candidates, or why there is none."""
        seconds = "-" if self.seconds is None else f"{self.seconds:.3f}"
        if self.lattice is None:
            why = self.reason if self.failed else f"no lattice: {self.reason}"
            return [f"{self.detector:<12} {'-':<20} {'-':<20} {'-':>10} {seconds:>8}  {why}"]
        lines = []
        for number, candidate in enumerate(self.candidates, 1):
            t1, t2 = (f"({x:.3f}, {y:.3f})" for x, y in (candidate.lattice.t1, candidate.lattice.t2))
            name, cost = (self.detector, seconds) if number == 1 else (f"  {number}", "")
            line = f"{name:<12} {t1:<20} {t2:<20} {candidate.confidence:>10.3f} {cost:>8}  {_notes(candidate)}"
            lines.append(line.rstrip())
        return lines

    def captions(self, letters: int) -> list[str]:
        """Return captions of a comparison's pictures, one for each of the first candidates.

        There is one that says why if there is no lattice. A line has at most ``letters`` characters.
        """
        if self.detection is None:
            lines = textwrap.wrap(self.reason, letters, max_lines=4, placeholder=" ...")
            return ["\n".join([f"{self.detector}: no lattice", *lines])]
        texts = []
        for number, candidate in enumerate(self.candidates, 1):
            name = self.detector if number == 1 else f"{self.detector}, candidate {number}"
            lines = [f"{name}, confidence {candidate.confidence:.3f}", *textwrap.wrap(_notes(candidate), letters)]
            texts.append("\n".join([*lines, _of_alternative(candidate).text(separator="\n")]))
        return texts


def _notes(candidate: Alternative) -> str:
    """Return how a candidate relates to the chosen lattice, and its role."""
    return ", ".join(filter(None, (candidate.relation, candidate.role and f"{candidate.role} lattice")))


def _of_alternative(candidate: Alternative) -> _Result:
    """Return a result without a detector, for the forms of its vectors."""
    return _Result("", candidate.lattice, has_origin=candidate.has_origin)


def _describe(candidate: Alternative) -> str:
    return f"{_of_alternative(candidate).text()}, {_notes(candidate)}, confidence {candidate.confidence:.3f}"


def _survey(folder: Path, detector: str, output: Path | None, least: float | None, existing: str, as_json: bool) -> int:
    """Detect the lattices of a folder; return 1 if a picture could not be read or the detector failed, else 0."""
    from nrbench.cli.progress import live_progress
    from nrbench.errors import BadInput
    from nrbench.jit import load_kernels
    from nrbench.suites.surveying import LEAST_CONFIDENCE, Survey

    if output is not None and (output.suffix.lower() == ".png" or output.is_file()):
        raise BadInput(f"-o {output}: {folder} is a folder of pictures; give a directory for truth.csv")
    survey = Survey(folder, detector, output, LEAST_CONFIDENCE if least is None else least, existing)
    load_kernels()
    with live_progress() as progress:
        survey.run(progress)
    failed = [each for each in survey.findings if each.failed]
    if as_json:
        pictures = [each.as_dict() for each in survey.findings]
        content = {"truth": str(survey.table), "sheets": [str(page) for page in survey.pages], "pictures": pictures}
        print(json.dumps(content, indent=1))
        return int(bool(failed))
    for path in (survey.table, *survey.pages):
        print(path)
    counts = {
        "with a lattice": sum(each.lattice is not None for each in survey.findings),
        "to be decided": sum(each.is_doubtful for each in survey.findings),
        "failed": len(failed),
    }
    counts["without a lattice"] = len(survey.findings) - sum(counts.values())
    words = ", ".join(f"{number} {state}" for state, number in counts.items() if number)
    print(f"{len(survey.findings)} pictures: {words}")
    print(f"Look at the sheets and correct {survey.table.name}. Then run the command with --keep to see the result.")
    return int(bool(failed))


def _use_given(image: Image, numbers: str | None, output: Path | None, as_json: bool) -> None:
    """Print and draw the user's lattice, given as numbers or picked in a window."""
    from nrbench.imaging.drawing import draw_lattice
    from nrbench.imaging.files import write_image
    from nrbench.lattice.geometry import Lattice

    if numbers is None:
        from nrbench.cli.lattice_figures import pick

        lattice, has_origin = pick(image), True
        _print_numbers(lattice)
    else:
        lattice, has_origin = Lattice.parse(numbers), numbers.count(",") == 5
    if output is not None:
        write_image(output, draw_lattice(image, lattice))
    _Result("picked" if numbers is None else "given", lattice, has_origin=has_origin).print(as_json)


def _print_numbers(lattice: Lattice) -> None:
    """Print the six numbers of a lattice, as other verbs take them, on standard error."""
    numbers = (*lattice.t1, *lattice.t2, *lattice.origin)
    text = ",".join(repr(round(float(x), 4) + 0.0) for x in numbers)
    click.echo(f"for other verbs: --lattice {text}", err=True)


def _detect(image: Image, spec: str, output: Path | None, diagnostics: Path | None, as_json: bool) -> None:
    """Print and draw the lattice that one detector finds."""
    from nrbench import plugins
    from nrbench.cli.progress import waiting
    from nrbench.plugins.forms import NoLatticeFound
    from nrbench.plugins.parameters import parse_spec

    name, parameters = parse_spec(spec)
    detector = plugins.build("detectors", name, parameters)
    try:
        with waiting(f"{name} looks for the lattice"):
            detection = detector.detect(image)
    except NoLatticeFound as none:
        title = f"{spec}: no lattice: {none.reason}"
        _draw_diagnostics(none.best.diagnostics if none.best else {}, title, diagnostics)
        if output is not None:
            click.echo(f"{output}: not written, there is no lattice to draw", err=True)
        _Result(name, None, reason=none.reason).print(as_json)
        return
    result = _Result.of_detection(name, detection)
    title = f"{spec}: {result.text()}, confidence {detection.confidence:.3f}"
    _draw_diagnostics(detection.diagnostics, title, diagnostics)
    if output is not None:
        _draw_overlay(image, result.candidates, output)
        _print_numbers(detection.lattice)
    result.print(as_json)


def _draw_overlay(image: Image, candidates: Sequence[Alternative], output: Path) -> None:
    """Write the image with the chosen lattice; below it, if there are alternatives, the middle with each candidate.

    The image stays in the upper left corner, so pixels have the same coordinates.
    """
    from nrbench.imaging.drawing import contact_sheet, draw_lattice, stack
    from nrbench.imaging.files import write_image
    from nrbench.suites.surveying import draw_candidates

    drawn = draw_lattice(image, candidates[0].lattice)
    if len(candidates) > 1:
        drawn = stack(drawn, contact_sheet(*draw_candidates(image, candidates)))
    write_image(output, drawn)


def _compare_detectors(image: Image, output: Path | None, as_json: bool) -> int:
    """Print and draw the lattices of all detectors; return 1 if one of them failed, else 0."""
    from nrbench import plugins
    from nrbench.cli.progress import live_progress
    from nrbench.jit import load_kernels

    load_kernels()
    names = [plugin.name for plugin in plugins.inventory("detectors") if plugin.cls is not None]
    results = []
    with live_progress(patience=True) as progress:
        for number, name in enumerate(names, 1):
            results.append(_run_detector(image, name))
            progress(number, len(names), name)
    if output is not None:
        _draw_comparison(image, results, output)
    if as_json:
        print(json.dumps([result.as_dict() for result in results], indent=1))
    else:
        print(f"{'detector':<12} {'t1 (px)':<20} {'t2 (px)':<20} {'confidence':>10} {'seconds':>8}")
        print("\n".join(line for result in results for line in result.rows()))
    return int(any(result.failed for result in results))


def _run_detector(image: Image, name: str) -> _Result:
    """Return the result of a detector; an error of the detector is a failed result."""
    from nrbench import plugins
    from nrbench.errors import BadInput
    from nrbench.plugins.forms import NoLatticeFound

    detector = plugins.build("detectors", name)
    start = time.perf_counter()
    try:
        detection = detector.detect(image)
    except NoLatticeFound as none:
        return _Result(name, None, reason=none.reason, seconds=time.perf_counter() - start)
    except BadInput:
        raise
    except Exception as error:
        return _Result(name, None, reason=f"failed: {type(error).__name__}: {error}", failed=True)
    return _Result.of_detection(name, detection, time.perf_counter() - start)


def _draw_comparison(image: Image, results: Sequence[_Result], output: Path) -> None:
    """Write a sheet with a captioned picture for each candidate of each detector; of a large image, its middle."""
    from nrbench.imaging.drawing import contact_sheet, draw_lattice, zoom_panels
    from nrbench.imaging.files import write_image

    lattices = [each.lattice for result in results for each in result.candidates]
    is_large = max(image.shape[:2]) > WHOLE
    drawn = zoom_panels(image, lattices, ZOOM) if is_large else [draw_lattice(image, each) for each in lattices]
    queue, nothing = iter(drawn), image[:1, :1] if is_large else image
    pictures = [picture for result in results for picture in [next(queue) for _ in result.candidates] or [nothing]]
    letters = max(32, max(picture.shape[1] for picture in pictures) // 6)
    captions = [text for result in results for text in result.captions(letters)]
    write_image(output, contact_sheet(pictures, captions, columns=3))


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
