"""The command sheet, which shows what all methods make of one photograph."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nrbench.cli.options import check_output, limit_options
from nrbench.cli.runs import show_steps

if TYPE_CHECKING:
    from nrbench.imaging.convert import Image
    from nrbench.runs.records import CellRecord
    from nrbench.suites.suite import Suite

_PATH = click.Path(path_type=Path)
_COLUMNS = (4, 5, 6)
"""Numbers of columns of which one is chosen."""
_LETTERS = 15
"""px; height of the letters."""
_PERILS = ("regularity", "integrity", "randomness", "appearance")


@click.command("sheet")
@click.argument("photo", type=_PATH)
@click.option("-o", "--output", required=True, type=_PATH, metavar="SHEET.png", help="The sheet.")
@click.option(
    "-m", "methods", multiple=True, metavar="METHOD[:param=value,...]", help="A method; repeatable.  [default: all]"
)
@click.option("--sample", default="384x384", show_default=True, metavar="WxH", help="Largest sample; PHOTO is cropped.")
@click.option("--size", default="384x384", show_default=True, metavar="WxH", help="Size of the outputs.")
@click.option(
    "--lattice",
    default="consensus",
    show_default=True,
    metavar="x1,y1,x2,y2[,x,y]|DETECTOR",
    help="The lattice of PHOTO, or the detector that finds it, once for all methods.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Equal seeds give equal outputs.")
@click.option("--jobs", type=click.IntRange(0), help="Number of methods at the same time.  [default: number of cores]")
@limit_options("synthesis or metric")
def sheet_command(
    photo: Path,
    output: Path,
    methods: tuple[str, ...],
    sample: str,
    size: str,
    lattice: str,
    seed: int,
    jobs: int | None,
    timeout: float,
    memory: float,
) -> int:
    """Show what all methods make of PHOTO on one sheet, the best first, with the quality and the seconds of each.

    The lattice is detected once and given to all methods that use one. Methods without an output are printed with the
    reason.
    """
    from nrbench.imaging.files import write_image
    from nrbench.running.plugin_children import plan_run
    from nrbench.running.runner import Options, execute

    check_output(output)
    suite = _photo_suite(photo, methods, sample, size, lattice, seed)
    options = Options(jobs=os.cpu_count() or 1 if jobs is None else jobs, timeout=timeout, memory=memory)
    with tempfile.TemporaryDirectory() as folder:
        with show_steps(False) as progress:
            records = execute(plan_run(suite), Path(folder) / "run", options, progress).cells
        made = sorted((one for one in records if one.status == "ok"), key=lambda one: -_quality(one))
        if made:
            write_image(output, _draw(made))
    for one in made:
        print(_caption(one).rstrip().replace("\n", "  "))
    for one in records:
        if one.status != "ok":
            print(f"{one.method}  {one.status}: {one.message}")
    print(output if made else "no method has an output: no sheet is written")
    return int(not made)


def _photo_suite(photo: Path, methods: Sequence[str], sample: str, size: str, lattice: str, seed: int) -> Suite:
    """Return a suite of one photograph with some methods, or all that are no references and need no parameter."""
    from nrbench import plugins
    from nrbench.imaging.files import read_shape
    from nrbench.plugins.parameters import parse_size
    from nrbench.suites.suite import validated_suite

    height, width = map(min, read_shape(photo)[:2], parse_size(sample))
    row = {"name": "photo", "dataset": "images", "parameters": {"path": str(photo.absolute())}}
    content = {
        "name": "sheet",
        "seed": seed,
        "sample": f"{width}x{height}",
        "size": size,
        "lattice": [lattice],
        "metrics": ["quality"],
        "methods": list(methods) or [name for name in plugins.names("synthesizers") if _runs_alone(name)],
        "texture": [row],
    }
    return validated_suite(content, "sheet")


def _runs_alone(name: str) -> bool:
    """Return whether a method is no reference and can be built without a parameter."""
    from nrbench import plugins
    from nrbench.errors import BadInput

    try:
        return not plugins.build("synthesizers", name).reference
    except BadInput:
        return False


def _quality(one: CellRecord) -> float:
    value = one.values.get("quality.score")
    return -1.0 if value is None else float(value)


def _caption(one: CellRecord) -> str:
    """Return the method, its quality and its seconds, and what limits the quality, in three lines."""
    value = one.values.get("quality.score")
    bound = "at most " if one.values.get("quality.complete") is False else ""
    quality = "quality not measured" if value is None else f"quality {bound}{value:.2f}"
    perils = {name: one.values.get(f"quality.{name}") for name in _PERILS}
    scores = {name: float(score) for name, score in perils.items() if score is not None}
    lost = [name for name, score in scores.items() if score == min(scores.values()) < 1]
    missing = [name for name in perils if name not in scores] if bound else []
    words = (("lost: ", lost), ("not measured: ", missing))
    why = "; ".join(title + ", ".join(names) for title, names in words if names)
    return f"{one.method}\n{quality}, {one.seconds or 0:.1f} s\n{why}"


def _draw(made: Sequence[CellRecord]) -> Image:
    """Return the sample with its lattice, and the outputs, each below its caption."""
    from nrbench.imaging.files import read_image
    from nrbench.imaging.overlays import contact_sheet, draw_lattice

    sample = read_image(made[0].folder / "sample.png")
    lattice = next((one.cell.lattice_given for one in made if one.cell.lattice_given), None)
    first = sample if lattice is None else draw_lattice(sample, lattice)
    found = "no lattice" if lattice is None else "lattice " + ",".join(f"{x:.2f}" for x in (*lattice.t1, *lattice.t2))
    columns = min(_COLUMNS, key=lambda count: (-(len(made) + 1) % count, count))  # the fewest empty places
    outputs = [read_image(one.folder / "output.png") for one in made]
    return contact_sheet([first, *outputs], [f"sample\n{found}", *map(_caption, made)], columns, _LETTERS)
