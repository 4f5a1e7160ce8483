"""What the judge of regularity sees, and what it takes for a fault: planted defects against fresh draws.

``OMP_NUM_THREADS=1 python benchmarks/regularity_validation.py calibration`` prints, for one set of models and seeds,
the largest of each statistic over fresh draws as a share of its limit, which is what the limits in
``metrics/limits.py`` were set on; then false alarms by regular share and output size, and for each kind and size of
defect, regular share and output size the AUC of the worst suspicion, how many images it rests on, and the shares called
lost and undecided. ``report`` prints the same for another set of models and seeds. Textures are brick, weave and
hexagon of random periods, joints and mix of departures, every second one rotated.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from validation_textures import FIRST_SEED, SHARES, Specimen, auc, specimen, upper_bound

from nrbench.metrics.judgement import Judgement

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


@dataclass(frozen=True)
class Verdict:
    """What the judge said of one image."""

    share: float
    kind: str
    size: float
    side: int
    preserved: bool | None
    intact: bool | None
    suspicions: tuple[float, ...]

    @classmethod
    def of(cls, item: Specimen, kind: str, size: float, side: int, judgement: Judgement) -> Verdict:
        """Keep the figures, let the images go."""
        suspicions = tuple(judgement.suspicions.values())
        return cls(item.share, kind, size, side, judgement.preserved, judgement.intact, suspicions)


def planted(item: Specimen, side: int, seed: int, kinds: tuple[str, ...]) -> Iterator[Verdict]:
    """Judge one image with each defect of some kinds; those that come to nothing are left out."""
    for kind, size in DEFECTS + SILENT:
        image = None if kinds and kind not in kinds else item.planted(kind, size, side, seed)
        if image is not None:
            yield Verdict.of(item, kind, size, side, item.judged(image))


def run(first: int, count: int, side: int, draws: int, defects: int, kinds: tuple[str, ...]) -> list[Verdict]:
    """Judge fresh draws of ``count`` textures, and one of each defect in every ``defects``-th round of six shares."""
    verdicts: list[Verdict] = []
    for seed in range(first, first + count):
        item = specimen(seed)
        verdicts += [Verdict.of(item, "none", 0.0, side, item.judged(item.fresh(side, k))) for k in range(draws)]
        if defects and (seed - first) // (6 * len(SHARES)) % defects == 0:
            verdicts += planted(item, side, seed, kinds)
        if (seed - first) % 12 == 11:
            print(f"{side} px: {seed - first + 1} of {count} textures", file=sys.stderr, flush=True)
    return verdicts


def print_statistics(verdicts: list[Verdict]) -> None:
    """Print the largest of each statistic over fresh draws, as a share of its limit."""
    names = ("misplaced windows", "worst neighborhood", "bent", "structure", "courses", "single tiles")
    print("\nLargest share of its limit over fresh draws (q99, max); above 1 is a false alarm.\n")
    print(f"| share | px | n | {' | '.join(names)} |\n|{' --- |' * (3 + len(names))}")
    groups = defaultdict(list)
    for verdict in verdicts:
        if verdict.kind == "none":
            groups[verdict.share, verdict.side].append(verdict.suspicions)
    for (share, side), rows in sorted(groups.items(), reverse=True):
        table = np.array(rows)
        cells = (f"{np.quantile(column, 0.99):.2f}, {column.max():.2f}" for column in table.T)
        print(f"| {share:.2f} | {side} | {len(rows)} | {' | '.join(cells)} |")


def print_false_alarms(verdicts: list[Verdict]) -> None:
    """Print how many fresh draws are called lost or undecided, by regular share and by output size."""
    print("\nFalse alarms: fresh draws called lost, with the one-sided 95 % bound of the rate.\n")
    print(f"| fresh draws | n | lost | bound | undecided |\n|{' --- |' * 5}")
    for title, key in (("share", lambda v: v.share), ("px", lambda v: v.side)):
        groups = defaultdict(list)
        for verdict in verdicts:
            if verdict.kind == "none":
                groups[key(verdict)].append(verdict.preserved)
        for value, found in sorted(groups.items()):
            lost, undecided = sum(f is False for f in found), sum(f is None for f in found)
            bound = upper_bound(lost, len(found))
            print(f"| {title} {value} | {len(found)} | {lost} | {bound:.4f} | {undecided} |")


def print_detection(verdicts: list[Verdict], side: int) -> None:
    """Print AUC over all images, n, share called lost and share undecided, by defect and share."""
    groups = defaultdict(list)
    for verdict in verdicts:
        if verdict.side == side:
            groups[verdict.kind, verdict.size, verdict.share].append(verdict)
    print(f"\n{side} x {side}: AUC (n with the defect) lost / undecided, by regular share.\n")
    print(f"| defect | size | {' | '.join(f'{share:.2f}' for share in SHARES)} |\n|{' --- |' * (2 + len(SHARES))}")
    for kind, size in DEFECTS + SILENT:
        cells = [_cell(groups["none", 0.0, share], groups[kind, size, share]) for share in SHARES]
        print(f"| {kind} | {size:g} | {' | '.join(cells)} |")


def _cell(right: list[Verdict], wrong: list[Verdict]) -> str:
    if not wrong:
        return "-"
    area = auc(_worst(right), _worst(wrong))
    lost, open_ = (np.mean([verdict.preserved is answer for verdict in wrong]) for answer in (False, None))
    return f"{area:.3f} ({len(wrong)}) {lost:.2f} / {open_:.2f}"


def _worst(verdicts: list[Verdict]) -> list[float]:
    return [max(verdict.suspicions) for verdict in verdicts]


def main() -> None:
    """Run one of the two halves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("half", choices=FIRST_SEED)
    parser.add_argument("--count", type=int, default=108, help="textures; multiples of 36 hold each kind equally often")
    parser.add_argument("--draws", type=int, default=4, help="fresh draws of each texture and size")
    parser.add_argument("--sides", type=int, nargs="*", default=(256, 512, 1024), help="output sizes in px")
    parser.add_argument("--defects", type=int, default=1, help="defects in every n-th 36 textures; 0: none")
    parser.add_argument("--kinds", nargs="*", default=(), help="defects to plant; none given: all")
    arguments = parser.parse_args()
    first, rest = FIRST_SEED[arguments.half], (arguments.draws, arguments.defects, tuple(arguments.kinds))
    verdicts = []
    for side in arguments.sides:
        verdicts += run(first, arguments.count, side, *rest)
    print_statistics(verdicts)
    print_false_alarms(verdicts)
    for side in arguments.sides if arguments.defects else ():
        print_detection(verdicts, side)


if __name__ == "__main__":
    main()
