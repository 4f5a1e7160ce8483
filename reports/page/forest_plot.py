"""Lay out the forest plot: the estimates of all methods as points with intervals, on one axis for each score."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nrbench.plugins.forms import Column

from ..statistics.format import format_number, format_percent
from ..statistics.summaries import COSTS, SummaryRow

Scale = Callable[[float | None], float | None]
"""Maps a value to its place on an axis, from 0 to 100."""


Point = tuple[float | None, float | None, float | None]
"""Places of a value and of the ends of its interval on an axis; None if there is none."""


@dataclass(frozen=True)
class ForestAxis:
    """One axis, with a point for each method.

    Parameters
    ----------
    row
        The numbers of the methods.
    ends
        The ends of the axis as text.
    one
        Place of the value 1, 0 to 100, for a score that is best there; else None.
    better
        Which values are better, in words.
    points
        One for each method.
    """

    row: SummaryRow
    ends: tuple[str, str]
    one: float | None
    better: str
    points: Sequence[Point]


_BETTER = {"higher": "better →", "lower": "← better", "one": "best at 1", "none": ""}


def forest_axes(rows: Sequence[SummaryRow]) -> list[ForestAxis]:
    """Return an axis for each number that summarizes the methods, without the variants."""
    return [_axis(row) for row in rows if not row.variant]


def _axis(row: SummaryRow) -> ForestAxis:
    text = format_percent if row.rate else format_number
    known = [x for one in row.estimates if one for x in (one.value, one.low, one.high) if x is not None]
    logarithmic = row.name in COSTS and bool(known) and min(known) > 0
    low, high = _whole_decades(known) if logarithmic else _linear_range(row.column, known)
    scale = _scale(low, high, math.log if logarithmic else float)
    return ForestAxis(
        row,
        ends=(text(low), text(high)),
        one=scale(1.0) if row.column.better == "one" else None,
        better=_BETTER[row.column.better],
        points=[
            (scale(one.value), scale(one.low), scale(one.high)) if one else (None, None, None) for one in row.estimates
        ],
    )


def _whole_decades(known: Sequence[float]) -> tuple[float, float]:
    low, high = 10.0 ** math.floor(math.log10(min(known))), 10.0 ** math.ceil(math.log10(max(known)))
    return low, high if high > low else 10 * low


def _linear_range(column: Column, known: Sequence[float]) -> tuple[float, float]:
    """Return the declared range if it is narrow, else a range that holds the known values."""
    low, high = column.range
    if column.better == "one":
        known = [*known, 1.0]
    low = low if math.isfinite(low) else min([0.0, *known])
    if not (math.isfinite(high) and high <= low + 1):
        high = max([low + 1e-9, *known]) * 1.05
    return low, high if high > low else low + 1


def _scale(low: float, high: float, transform: Callable[[float], float]) -> Scale:
    """Return the map from [low, high] to [0, 100] that is linear in the transformed value."""
    ends = (transform(low), transform(high))

    def scale(value: float | None) -> float | None:
        return None if value is None else round(float(np.interp(transform(max(value, low)), ends, (0, 100))), 2)

    return scale
