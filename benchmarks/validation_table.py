"""Tables of the validation of the judge of regularity: false alarms, distance from the limits, detectability."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from validation_textures import auc, upper_bound

STATISTICS = (
    "misplaced windows",
    "worst neighborhood",
    "bent",
    "structure",
    "tiles elsewhere",
    "courses",
    "single tiles",
)
"""What the judge's suspicions are of, in their order."""
SPREAD, LEAST_SPREAD, LEAST_SHARE = ("phase-step", "slipped-course", "stretch", "warp", "off-lattice"), 0.15, 0.4
"""Faults that many tiles share, and from which size and regular share on they are to be seen."""
SINGLE = (("displaced-tile", 0.3), ("missing-tile", 1.0), ("doubled-tile", 0.3))
"""Faults of one tile, and from which size on they are to be seen, where the regular share is 0.7 or more."""
_SINGLE_SHARE = 0.7
_WORDS = {True: "preserved", False: "lost", None: "undecided"}


@dataclass(frozen=True)
class Verdict:
    """What the judge said of one image."""

    seed: int
    share: float
    side: int
    kind: str
    size: float
    draw: int
    preserved: str
    intact: str
    suspicions: tuple[float, ...]

    @property
    def key(self) -> tuple[int, int, str, float, int]:
        """Which image it is."""
        return self.seed, self.side, self.kind, self.size, self.draw

    @property
    def worst(self) -> float:
        """How far the worst fault exceeds its limit."""
        return max(self.suspicions)

    def cells(self) -> list[object]:
        """Return its row of the file."""
        first = (self.seed, self.share, self.side, self.kind, self.size, self.draw, self.preserved, self.intact)
        return [*first, *(f"{one:.4f}" for one in self.suspicions)]


def word(verdict: bool | None) -> str:
    """Return a verdict in a word."""
    return _WORDS[verdict]


def read(path: Path) -> list[Verdict]:
    """Return the verdicts of a file; none where there is no file. A last row that was cut is left out."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [row for row in csv.reader(file) if len(row) == 8 + len(STATISTICS)]
    return [_verdict(row) for row in rows]


def _verdict(row: list[str]) -> Verdict:
    seed, share, side, kind, size, draw, preserved, intact, *suspicions = row
    figures = tuple(map(float, suspicions))
    return Verdict(int(seed), float(share), int(side), kind, float(size), int(draw), preserved, intact, figures)


def print_tables(verdicts: list[Verdict]) -> None:
    """Print all tables."""
    print_statistics(verdicts)
    print_false_alarms(verdicts)
    for side in sorted({verdict.side for verdict in verdicts if verdict.kind != "none"}):
        print_detection([verdict for verdict in verdicts if verdict.side == side], side)
    print_bounds(verdicts)


def print_statistics(verdicts: list[Verdict]) -> None:
    """Print the largest of each statistic over fresh draws, as a share of its limit."""
    print("\nLargest share of its limit over fresh draws (q99, max); above 1 is a false alarm.\n")
    _head("share", "px", "n", *STATISTICS)
    for (share, side), rows in _groups(_fresh(verdicts), "share", "side"):
        table = np.array([row.suspicions for row in rows])
        _row(share, side, len(rows), *(f"{np.quantile(one, 0.99):.2f}, {one.max():.2f}" for one in table.T))


def print_false_alarms(verdicts: list[Verdict]) -> None:
    """Print how many fresh draws are called lost or undecided, by regular share and by output size."""
    print("\nFalse alarms: fresh draws called lost, with the one-sided 95 % bound of the rate.\n")
    _head("fresh draws", "n", "lost", "95 % bound", "undecided")
    for name in ("share", "side"):
        for (value,), found in _groups(_fresh(verdicts), name):
            lost, undecided = (sum(one.preserved == which for one in found) for which in ("lost", "undecided"))
            _row(f"{name} {value}", len(found), lost, f"{upper_bound(lost, len(found)):.4f}", undecided)


def print_detection(verdicts: list[Verdict], side: int) -> None:
    """Print AUC over all images, n, share called lost and share undecided, by defect and share."""
    print(f"\n{side} x {side}: AUC (n with the defect) lost / undecided, by regular share.\n")
    shares = sorted({verdict.share for verdict in verdicts}, reverse=True)
    _head("defect", "size", *(f"{share:.2f}" for share in shares))
    groups = dict(_groups(verdicts, "kind", "size", "share"))
    for kind, size in dict.fromkeys((one.kind, one.size) for one in verdicts if one.kind != "none"):
        cells = (_cell(groups.get(("none", 0.0, share), []), groups.get((kind, size, share), [])) for share in shares)
        _row(kind, size, *cells)


def _cell(right: list[Verdict], wrong: list[Verdict]) -> str:
    if not wrong:
        return "-"
    lost, undecided = (np.mean([one.preserved == which for one in wrong]) for which in ("lost", "undecided"))
    return f"{_auc(right, wrong):.3f} ({len(wrong)}) {lost:.2f} / {undecided:.2f}"


def print_bounds(verdicts: list[Verdict]) -> None:
    """Print, for each fault that is to be seen, the AUC over all sizes and shares where it is, and at the worst."""
    print("\nFaults that are to be seen: AUC over all of them, AUC at the worst share, called lost.\n")
    _head("defect", "from size", "from share", "px", "n", "AUC", "worst", "lost")
    for kind, size, share in _asked():
        for (side,), found in _groups((one for one in verdicts if one.share >= share), "side"):
            wrong = [one for one in found if one.kind == kind and one.size >= size]
            if not wrong:
                continue
            right = list(_fresh(found))
            by_share = (
                _auc([one for one in right if one.share == some], [one for one in wrong if one.share == some])
                for some in {one.share for one in wrong}
            )
            lost = np.mean([one.preserved == "lost" for one in wrong])
            cells = (f"{_auc(right, wrong):.4f}", f"{min(by_share):.4f}", f"{lost:.3f}")
            _row(kind, f"{size:g}", f"{share:g}", side, len(wrong), *cells)


def _asked() -> list[tuple[str, float, float]]:
    spread = [(kind, LEAST_SPREAD, LEAST_SHARE) for kind in SPREAD]
    return spread + [(kind, size, _SINGLE_SHARE) for kind, size in SINGLE]


def _auc(right: list[Verdict], wrong: list[Verdict]) -> float:
    return auc([one.worst for one in right], [one.worst for one in wrong])


def _fresh(verdicts: Iterable[Verdict]) -> Iterable[Verdict]:
    return (verdict for verdict in verdicts if verdict.kind == "none")


def _groups(verdicts: Iterable[Verdict], *names: str) -> list[tuple[tuple[object, ...], list[Verdict]]]:
    groups = defaultdict(list)
    for verdict in verdicts:
        groups[tuple(getattr(verdict, name) for name in names)].append(verdict)
    return sorted(groups.items(), key=lambda pair: tuple(map(str, pair[0])))


def _head(*names: str) -> None:
    print(f"| {' | '.join(names)} |\n|{' --- |' * len(names)}")


def _row(*cells: object) -> None:
    print(f"| {' | '.join(map(str, cells))} |")
