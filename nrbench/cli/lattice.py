"""The command lattice, which detects, compares and draws the lattices of a picture or of a folder of pictures."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from nrbench import plugins
from nrbench.cli.lattice_results import LatticeResult
from nrbench.cli.options import check_output
from nrbench.cli.progress import live_progress, waiting
from nrbench.cli.straightening import draw_deformed_lattice, find_bent_lattice, straighten_picture
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.imaging.files import read_image, write_image
from nrbench.imaging.overlays import contact_sheet, draw_lattice, draw_overlay, stack, zoom_panels
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Alternative, NoLatticeFound
from nrbench.plugins.parameters import parse_spec
from nrbench.storage import write_aside
from nrbench.suites.surveying import LEAST_CONFIDENCE, Survey, draw_candidates

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
        straighten_picture(picture, detector or "consensus", lattice, output, straighten, as_json)
        return 0
    if every:
        return _compare_detectors(picture, output, as_json)
    if pick or lattice is not None:
        _use_given(picture, lattice, output, as_json)
    else:
        _detect(picture, detector, output, diagnostics, as_json)
    return 0


def _survey(folder: Path, detector: str, output: Path | None, least: float | None, existing: str, as_json: bool) -> int:
    """Detect the lattices of a folder; return 1 if a picture could not be read or the detector failed, else 0."""
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
    if numbers is None:
        from nrbench.cli.lattice_figures import pick

        lattice, has_origin = pick(image), True
        _print_numbers(lattice)
    else:
        lattice, has_origin = Lattice.parse(numbers), numbers.count(",") == 5
    if output is not None:
        write_image(output, draw_overlay(image, lattice))
    LatticeResult("picked" if numbers is None else "given", lattice, has_origin=has_origin).print(as_json)


def _print_numbers(lattice: Lattice) -> None:
    """Print the six numbers of a lattice, as other verbs take them, on standard error."""
    numbers = (*lattice.t1, *lattice.t2, *lattice.origin)
    text = ",".join(repr(round(float(x), 4) + 0.0) for x in numbers)
    click.echo(f"for other verbs: --lattice {text}", err=True)


def _detect(image: Image, chosen: str | None, output: Path | None, diagnostics: Path | None, as_json: bool) -> None:
    """Print and draw the lattice that one detector finds.

    If the default detector finds none, the mean lattice of a bent image is looked for.
    """
    spec = chosen or "consensus"
    name, parameters = parse_spec(spec)
    detector = plugins.build("detectors", name, parameters)
    try:
        with waiting(f"{name} looks for the lattice"):
            detection = detector.detect(image)
    except NoLatticeFound as none:
        bent = None
        if chosen is None:
            with waiting(f"{name} looks for a bent lattice"):
                bent = find_bent_lattice(image, name)
        if bent is not None:
            title = f"{spec}, of the straightened image: {bent.text()}"
            _draw_diagnostics(bent.detection.diagnostics if bent.detection else {}, title, diagnostics)
            if output is not None and bent.deformation is not None:
                write_image(output, draw_deformed_lattice(image, bent.deformation))
            bent.print(as_json)
            return
        title = f"{spec}: no lattice: {none.reason}"
        _draw_diagnostics(none.best.diagnostics if none.best else {}, title, diagnostics)
        if output is not None:
            click.echo(f"{output}: not written, there is no lattice to draw", err=True)
        LatticeResult(name, None, reason=none.reason).print(as_json)
        return
    result = LatticeResult.of_detection(name, detection)
    title = f"{spec}: {result.text()}, confidence {detection.confidence:.3f}"
    _draw_diagnostics(detection.diagnostics, title, diagnostics)
    if output is not None:
        _draw_overlay(image, result.candidates, output)
        _print_numbers(detection.lattice)
    result.print(as_json)


def _draw_overlay(image: Image, candidates: Sequence[Alternative], output: Path) -> None:
    """Write the image with the chosen lattice; below it, if there are alternatives, the middle with each candidate.

    The image stays in the upper left corner, enlarged by a whole factor if it or its cells are small.
    """
    drawn = draw_overlay(image, candidates[0].lattice)
    if len(candidates) > 1:
        drawn = stack(drawn, contact_sheet(*draw_candidates(image, candidates)))
    write_image(output, drawn)


def _compare_detectors(image: Image, output: Path | None, as_json: bool) -> int:
    """Print and draw the lattices of all detectors; return 1 if one of them failed, else 0."""
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


def _run_detector(image: Image, name: str) -> LatticeResult:
    """Return the result of a detector; an error of the detector is a failed result."""
    detector = plugins.build("detectors", name)
    start = time.perf_counter()
    try:
        detection = detector.detect(image)
    except NoLatticeFound as none:
        return LatticeResult(name, None, reason=none.reason, seconds=time.perf_counter() - start)
    except BadInput:
        raise
    except Exception as error:
        return LatticeResult(name, None, reason=f"failed: {type(error).__name__}: {error}", failed=True)
    return LatticeResult.of_detection(name, detection, time.perf_counter() - start)


def _draw_comparison(image: Image, results: Sequence[LatticeResult], output: Path) -> None:
    """Write a sheet with a captioned picture for each candidate of each detector; of a large image, its middle."""
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

    figure = diagram(diagnostics, title)
    if figure is None:
        click.echo(f"{output}: not written, the detector returned nothing that can be drawn", err=True)
        return
    write_aside(output, lambda aside: figure.savefig(aside, dpi=110))
