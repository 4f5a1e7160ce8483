"""The gallery: each texture's sample, its lattice, and every output side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nrbench.lattice.geometry import Lattice
from nrbench.runs.records import CellRecord, Run

from ..statistics.comparison import Comparison, Row
from .figures import Figure, figure, head_of
from .overlay import Overlay, beside, overlay, parsed
from .pictures import Picture, Pictures

SAME = 0.05
"""Lattices whose reduced vectors agree within this many px are drawn once."""


@dataclass(frozen=True)
class FoundLattice:
    """A lattice that methods used and that is not the true one."""

    labels: Sequence[str]
    overlay: Overlay


@dataclass(frozen=True)
class Draw:
    """One replicate of a texture: its sample, the lattices, the outputs.

    Parameters
    ----------
    replicate
        Its number.
    sample
        The sample's pixels; None where it could not be drawn.
    scale
        Page pixels a pixel of the outputs.
    truth, agreeing
        The true lattice, and the columns that found it by themselves.
    found
        Every other lattice that was used.
    figures
        The outputs.
    """

    replicate: int
    sample: Picture | None
    scale: float
    truth: Overlay | None
    agreeing: Sequence[str]
    found: Sequence[FoundLattice]
    figures: Sequence[Figure]


@dataclass(frozen=True)
class Section:
    """A texture of the gallery: its line of the comparison, and its draws."""

    row: Row
    draws: Sequence[Draw]


def gallery(run: Run, found: Comparison, pictures: Pictures) -> list[Section]:
    """Return a section for every texture of the comparison."""
    return [Section(row, [_draw(run, pictures, draw) for draw in _replicates(row)]) for row in found.rows]


def _replicates(row: Row) -> Iterable[list[CellRecord]]:
    by_replicate: dict[int, list[CellRecord]] = {}
    for entry in row.entries:
        for record in entry.records if entry else ():
            by_replicate.setdefault(record.replicate, []).append(record)
    return (by_replicate[key] for key in sorted(by_replicate))


def _draw(run: Run, pictures: Pictures, records: Sequence[CellRecord]) -> Draw:
    sample = next(filter(None, (pictures.picture(record.folder / "sample.png") for record in records)), None)
    figures = [figure(run, record, pictures) for record in records]
    outputs = [one.output for one in figures if one.output]
    known = next(filter(None, (parsed(record.lattice_truth) for record in records)), None)
    truth = known.reduced() if known else None
    shape = (sample.height, sample.width) if sample else (1, 1)
    return Draw(
        replicate=records[0].replicate,
        sample=sample,
        scale=outputs[0].scale if outputs else 1.0,
        truth=overlay(truth, shape) if truth and sample else None,
        agreeing=[head_of(record).label for record in records if _agrees(record, truth)],
        found=_found_lattices(records, truth, shape) if sample else [],
        figures=figures,
    )


def _agrees(record: CellRecord, truth: Lattice | None, handed: bool = False) -> bool:
    """Return whether a cell used the true lattice, and found it by itself unless ``handed`` ones count too."""
    used = parsed(record.lattice_used)
    if used is None or truth is None or (record.lattice_source in ("given", "none") and not handed):
        return False
    return used.is_equivalent(truth, SAME)


def _found_lattices(records: Sequence[CellRecord], truth: Lattice | None, shape: tuple[int, int]) -> list[FoundLattice]:
    groups: list[tuple[Lattice, list[str]]] = []
    for record in records:
        used = parsed(record.lattice_used)
        if used is None or _agrees(record, truth, handed=True):
            continue
        names = next((names for known, names in groups if known.is_equivalent(used, SAME)), None)
        if names is None:
            names = []
            groups.append((used, names))
        names.append(head_of(record).label)
    return [FoundLattice(names, overlay(beside(used, truth, shape), shape)) for used, names in groups]
