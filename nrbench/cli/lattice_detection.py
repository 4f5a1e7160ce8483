"""What the command ``lattice`` does: detect, compare, straighten, and draw lattices."""

from __future__ import annotations

import json
import textwrap
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from nrbench import plugins
from nrbench.api.arguments import as_lattice
from nrbench.api.surveying import Survey, draw_candidates, lattice_text
from nrbench.api.textures import follow_bent_lattice
from nrbench.cli.lattice_results import LatticeResult
from nrbench.cli.progress import live_progress, waiting
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import write_image
from nrbench.pictures.overlays import contact_sheet, draw_lattice, draw_overlay, draw_segments, stack
from nrbench.plugins.forms import NoLatticeFound
from nrbench.plugins.parameters import parse_spec
from nrbench.storage import write_aside

if TYPE_CHECKING:
    from nrbench.tracking.bent_lattice import Deformation

LETTERS = 38
"""Number of letters on a line of a caption."""
LARGEST = 1024
"""px; a larger image is followed only if ``--straighten`` is given, because it takes long."""


def survey_folder(folder: Path, detector: str, output: Path | None, least: float, existing: str, as_json: bool) -> int:
    """Detect the lattices of a folder; return 1 if a picture could not be read or the detector failed, else 0."""
    if output is not None and (output.suffix.lower() == ".png" or output.is_file()):
        raise BadInput(f"-o {output}: {folder} is a folder of pictures; give a directory for truth.csv")
    survey = Survey(folder, detector, output, least, existing)
    load_kernels()
    with live_progress() as progress:
        survey.run(progress)
    failed = sum(each.failed for each in survey.findings)
    if as_json:
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


def print_given(image: Image, numbers: str | None, output: Path | None, as_json: bool) -> None:
    """Print and draw the user's lattice, given as numbers or picked on a page."""
    if numbers is None:
        from nrbench.cli.lattice_picking import pick

        lattice, has_origin = pick(image, lambda address: click.echo(f"open in a browser: {address}", err=True)), True
        _print_numbers(lattice)
    else:
        lattice, has_origin = Lattice.parse(numbers), numbers.count(",") == 5
    if output is not None:
        write_image(output, draw_overlay(image, lattice))
    LatticeResult("picked" if numbers is None else "given", lattice, has_origin=has_origin).print(as_json)


def _print_numbers(lattice: Lattice) -> None:
    """Print the six numbers of a lattice, as other verbs take them, on standard error."""
    click.echo(f"for other verbs: --lattice {lattice_text(lattice, has_origin=True)}", err=True)


def print_detection(
    image: Image, chosen: str | None, output: Path | None, diagnostics: Path | None, as_json: bool
) -> None:
    """Print and draw the lattice that one detector finds.

    If the default detector finds none, the mean lattice of a bent image is looked for.
    """
    spec = chosen or "consensus"
    name, parameters = parse_spec(spec)
    detector = plugins.build("detectors", name, parameters)
    try:
        with waiting(f"{name} looks for the lattice"):
            detection = detector.detect(image)
        result = LatticeResult.of_detection(name, detection)
        title = f"{spec}: {result.vectors}, confidence {detection.confidence:.3f}"
    except NoLatticeFound as none:
        result, detection = LatticeResult(name, None, reason=none.reason), none.best
        title = f"{spec}: no lattice: {none.reason}"
    if result.lattice is None and chosen is None:
        with waiting(f"{name} looks for a bent lattice"):
            bent = find_bent_lattice(image, name)
        if bent is not None:
            result, detection = bent, bent.detection
            title = f"{spec}, of the straightened image: {bent.vectors}"
    if diagnostics is not None:
        _draw_diagnostics(detection.diagnostics if detection else {}, title, diagnostics)
    if output is not None:
        _draw_result(image, result, output)
    result.print(as_json)


def _draw_result(image: Image, result: LatticeResult, output: Path) -> None:
    """Write the image with the chosen lattice; below it, if there are alternatives, the middle with each candidate.

    The image stays in the upper left corner, enlarged by a whole factor if it or its cells are small.
    """
    if result.lattice is None:
        click.echo(f"{output}: not written, there is no lattice to draw", err=True)
    elif result.deformation is not None:
        write_image(output, draw_deformed_lattice(image, result.deformation))
    else:
        drawn = draw_overlay(image, result.lattice)
        if len(result.candidates) > 1:
            drawn = stack(drawn, contact_sheet(*draw_candidates(image, result.candidates)))
        write_image(output, drawn)
        _print_numbers(result.lattice)


def _draw_diagnostics(diagnostics: Mapping[str, Any], title: str, output: Path) -> None:
    from nrbench.cli.lattice_figures import diagram

    figure = diagram(diagnostics, title)
    if figure is None:
        click.echo(f"{output}: not written, the detector returned nothing that can be drawn", err=True)
    else:
        write_aside(output, lambda file: figure.savefig(file, dpi=110, format=output.suffix.lstrip(".") or "png"))


def print_comparison(image: Image, output: Path | None, as_json: bool) -> int:
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
        print(json.dumps([result.comparison_dict() for result in results], indent=1))
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
    """Write a sheet with a captioned picture for each candidate of each detector."""
    pictures, captions = [], []
    for result in results:
        panels, texts = draw_candidates(image, result.candidates)
        if not panels:
            lines = textwrap.wrap(result.reason, LETTERS, max_lines=4, placeholder=" ...")
            panels, texts = [image[:1, :1]], ["\n".join(["no lattice", *lines])]
        pictures += panels
        captions += [f"{result.detector}\n{text}" for text in texts]
    write_image(output, contact_sheet(pictures, captions, columns=3))


def straighten_picture(
    image: Image, spec: str, lattice: str | None, overlay: Path | None, output: Path, as_json: bool
) -> None:
    """Print the mean lattice, the deformation and the short list, and write the image with its deformation undone.

    Parameters
    ----------
    image
        The image.
    spec
        The detector, with its parameters.
    lattice
        The lattice as text; None: it is detected.
    overlay
        Where to draw the lattice as it lies in the image; None: nowhere.
    output
        Where to write the straight image.
    as_json
        Whether to print JSON.
    """
    name, parameters = parse_spec(spec)
    try:
        followed = follow_bent_lattice(image, as_lattice(lattice), name, parameters)
    except NoLatticeFound as none:
        click.echo(f"{output}: not written, there is no lattice to straighten by", err=True)
        LatticeResult(name, None, reason=none.reason).print(as_json)
        return
    straight, straight_lattice = followed.deformation.straighten()
    write_image(output, straight)
    if overlay is not None:
        write_image(overlay, draw_deformed_lattice(image, followed.deformation))
    numbers = ",".join(f"{number:.4f}" for number in straight_lattice.numbers)
    click.echo(f"{output}: its lattice is {numbers}", err=True)
    LatticeResult.of_followed("" if lattice else name, followed, straight_lattice).print(as_json)


def find_bent_lattice(image: Image, detector: str) -> LatticeResult | None:
    """Return the mean lattice of a bent image in which a detector finds no lattice; None if there is none.

    Little time is spent on images without a lattice, and none on large ones (:data:`LARGEST`).
    """
    if max(image.shape[:2]) > LARGEST:
        return None
    try:
        followed = follow_bent_lattice(image, detector=detector, only_promising=True)
    except NoLatticeFound:
        return None
    return LatticeResult.of_followed(detector, followed) if followed.deformation.bent else None


def draw_deformed_lattice(image: Image, found: Deformation) -> Image:
    """Return the image with the cells of its lattice drawn where they lie."""
    if not found.bent:
        return draw_lattice(image, found.lattice)
    steps = 4
    numbers = np.unique(np.floor(found.cells + 1e-6).astype(np.int64), axis=0)
    pieces = []
    for step in np.eye(2) / steps:
        start = (numbers[:, np.newaxis] + np.arange(steps)[:, np.newaxis] * step).reshape(-1, 2)
        pieces.append((start, start + step))
    starts, ends = (found.locate(found.lattice.from_cell(np.concatenate(part))) for part in zip(*pieces, strict=True))
    size = np.array(image.shape[1::-1])
    seen = ((starts >= -1) & (starts <= size) & (ends >= -1) & (ends <= size)).all(1)
    return draw_segments(image, starts[seen], ends[seen])
