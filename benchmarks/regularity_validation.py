"""What the judge of regularity sees, and what it takes for a fault: planted defects against fresh draws.

``OMP_NUM_THREADS=1 python benchmarks/regularity_validation.py run report --out report.csv`` judges fresh draws and
planted defects of one set of models and seeds, and writes a row an image as it goes. Cut and started again it skips
what the file holds; ``--part 0/2`` and ``--part 1/2``, each with a file of its own, share the textures between two
processes. ``... table report.csv ...`` prints, of any number of such files: the largest of each statistic over fresh
draws as a share of its limit, which is what the limits in ``metrics/limits.py`` were set on (``calibration``); false
alarms by regular share and output size; for each kind and size of defect, regular share and output size the AUC of the
worst suspicion, how many images it rests on, and the shares called lost and undecided. Textures are brick, weave and
hexagon of random periods, joints and mix of departures, every second one rotated.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from pathlib import Path

import validation_textures
from validation_table import Verdict, print_tables, read, word
from validation_textures import FIRST_SEED, SHARES, Specimen, specimen

from nrbench.imaging.convert import Image

DEFECTS = (
    *((kind, size) for kind in ("phase-step", "slipped-course", "stretch", "warp") for size in (0.1, 0.15, 0.3)),
    *(("off-lattice", size) for size in (0.1, 0.15, 0.3)),
    ("dropped-row", 0.5),
    ("doubled-row", 0.5),
    *(("displaced-tile", size) for size in (0.15, 0.3, 0.4)),
    *(("missing-tile", size) for size in (0.6, 1.0)),
    *(("doubled-tile", size) for size in (0.3, 0.5)),
)
SILENT = (
    ("blurred-band", 0.2),
    ("seam", 0.2),
    ("color-mean", 0.2),
    ("two-tone", 0.3),
    ("over-regular", 0.6),
    ("verbatim", 0.4),
)
"""Faults of appearance and variety, which other scores are for: of these regularity is to say nothing."""
_APART = 1_000_003
"""Between the seeds of defects that are planted in one texture."""

Wanted = tuple[int, str, float, int]
"""Output side, kind and size of the defect, number of the draw."""


def wanted(options: argparse.Namespace) -> list[Wanted]:
    """Return the images of each texture: fresh draws, then every defect."""
    kinds = [one for one in DEFECTS + SILENT if not options.kinds or one[0] in options.kinds]
    images: list[Wanted] = []
    for side in options.sides:
        images += [(side, "none", 0.0, draw) for draw in range(options.draws)]
        images += [(side, kind, size, draw) for kind, size in kinds for draw in range(options.plantings)]
    return images


def image_of(item: Specimen, seed: int, one: Wanted) -> Image | None:
    """Return an image; None where a defect comes to nothing."""
    side, kind, size, draw = one
    return item.fresh(side, draw) if kind == "none" else item.planted(kind, size, side, seed + _APART * draw)


def judged(seed: int, images: list[Wanted], given: bool) -> Iterator[Verdict]:
    """Judge images of one texture; those that come to nothing are left out."""
    item = specimen(seed, given)
    for one in images:
        image = image_of(item, seed, one)
        if image is not None:
            found = item.judged(image)
            verdicts = word(found.preserved), word(found.intact)
            side, kind, size, draw = one
            figures = tuple(found.suspicions.values())
            yield Verdict(seed, item.share, side, kind, size, draw, *verdicts, figures)


def run(options: argparse.Namespace) -> None:
    """Judge what the file does not hold yet, a texture after the other."""
    validation_textures.SHARES = tuple(options.shares)
    part, parts = (int(number) for number in options.part.split("/"))
    known = {verdict.key for verdict in read(options.out)}
    for number in range(part, options.count, parts):
        seed = FIRST_SEED[options.half] + number
        missing = [one for one in wanted(options) if (seed, *one) not in known]
        with options.out.open("a", newline="") as file:
            for verdict in judged(seed, missing, options.given) if missing else ():
                csv.writer(file).writerow(verdict.cells())
                file.flush()
        print(f"{number + 1} of {options.count} textures", file=sys.stderr, flush=True)


def table(options: argparse.Namespace) -> None:
    """Print the tables of all files together; an image that two of them hold counts once."""
    print_tables(list({verdict.key: verdict for path in options.files for verdict in read(path)}.values()))


def main() -> None:
    """Run one of the two halves, or print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True)
    runs = commands.add_parser("run", help="judge images, and write a row each")
    runs.set_defaults(call=run)
    runs.add_argument("half", choices=FIRST_SEED)
    runs.add_argument("--out", type=Path, required=True, help="CSV file; what it holds is not judged again")
    runs.add_argument("--count", type=int, default=108, help="textures; multiples of 36 hold each kind equally often")
    runs.add_argument("--draws", type=int, default=3, help="fresh draws of each texture and size")
    runs.add_argument("--plantings", type=int, default=1, help="of each defect in each texture and size; 0: none")
    runs.add_argument("--sides", type=int, nargs="*", default=(256, 512, 1024), help="output sizes in px")
    runs.add_argument("--shares", type=float, nargs="*", default=SHARES, help="regular shares of the textures")
    runs.add_argument("--kinds", nargs="*", default=(), help="defects to plant; none given: all")
    runs.add_argument("--given", action="store_true", help="judge by sample and lattice alone, not by the model")
    runs.add_argument("--part", default="0/1", help="i/n: every n-th texture from the i-th on, counted from 0")
    tables = commands.add_parser("table", help="print the tables of files")
    tables.set_defaults(call=table)
    tables.add_argument("files", type=Path, nargs="+")
    options = parser.parse_args()
    options.call(options)


if __name__ == "__main__":
    main()
