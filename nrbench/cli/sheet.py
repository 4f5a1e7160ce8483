"""The command sheet, which shows what all methods make of one photograph."""

from __future__ import annotations

import os
from pathlib import Path

import click

from nrbench.cli.options import check_output, limit_options
from nrbench.cli.run_commands import show_steps

_PATH = click.Path(path_type=Path)


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
    from nrbench.api.photo_sheet import describe_row
    from nrbench.api.runs import sheet_rows
    from nrbench.running.runner import Options

    check_output(output)
    options = Options(jobs=os.cpu_count() or 1 if jobs is None else jobs, timeout=timeout, memory=memory)
    with show_steps(False) as progress:
        rows = sheet_rows(photo, output, methods, sample, size, lattice, seed, progress, options)
    made = [row for row in rows if row["status"] == "ok"]
    for row in made:
        print(describe_row(row).rstrip().replace("\n", "  "))
    for row in rows[len(made) :]:
        print(f"{row['method']}  {row['status']}: {row['message']}")
    print(output if made else "no method has an output: no sheet is written")
    return int(not made)
