"""Every method's numbers side by side, as points with intervals on one axis a column."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nrbench.plugins.forms import Column

from ..page.format import counted, interval, number, percent, successes, tip
from ..statistics.statistics import Estimate
from ..statistics.summary import COSTS, Summary


@dataclass(frozen=True)
class Strip:
    """One estimate on its axis.

    Parameters
    ----------
    value, low, high
        Places on the axis, 0 to 100; None where there is none.
    text, interval, counted
        The same in words.
    """

    value: float | None
    low: float | None
    high: float | None
    text: str
    interval: str
    counted: str


@dataclass(frozen=True)
class Panel:
    """One axis, with a strip for each column of the comparison.

    Parameters
    ----------
    name, meaning
        The score, and all that its column declares.
    ends
        The axis' ends in words.
    one
        Where 1 lies on the axis, 0 to 100, for a score that is best there; else None.
    better
        The better way in words.
    strips
        One a column.
    """

    name: str
    meaning: str
    ends: tuple[str, str]
    one: float | None
    better: str
    strips: Sequence[Strip]


_BETTER = {"higher": "better →", "lower": "← better", "one": "best at 1", "none": ""}
_RATE = Column("Share of textures whose lattice is preserved.", better="higher")


def panels(summaries: Sequence[Summary], columns: dict[str, Column]) -> list[Panel]:
    """Return the panel of the success rate, and one for each of ``columns``."""
    rates = [one.success for one in summaries]
    found = [_panel("preserved", _RATE, rates, percent, successes)]
    for name, column in columns.items():
        found.append(_panel(name, column, [one.means[name] for one in summaries], number, counted))
    return found


def _panel(
    name: str,
    column: Column,
    estimates: Sequence[Estimate],
    text: Callable[[float | None], str],
    count: Callable[[Estimate], str],
) -> Panel:
    place, ends = _axis(name, column, estimates)
    strips = [
        Strip(
            place(one.value),
            place(one.low),
            place(one.high),
            text(one.value),
            interval(one, as_percent=text is percent),
            count(one) if one.n else "",
        )
        for one in estimates
    ]
    shown = (text(ends[0]), text(ends[1]))
    return Panel(
        name, tip(column), shown, place(1.0) if column.better == "one" else None, _BETTER[column.better], strips
    )


def _axis(
    name: str, column: Column, estimates: Sequence[Estimate]
) -> tuple[Callable[[float | None], float | None], tuple[float, float]]:
    """Return the map of values to places from 0 to 100, and the values at its ends."""
    known = [x for one in estimates for x in (one.value, one.low, one.high) if x is not None]
    if name in COSTS and known and min(known) > 0:
        low, high = _decade(min(known), math.floor), _decade(max(known), math.ceil)
        high = high if high > low else 10 * low
        return _placer(low, high, math.log), (low, high)
    low, high = _ends(column, known)
    return _placer(low, high, lambda value: value), (low, high)


def _decade(value: float, rounded: Callable[[float], int]) -> float:
    return float(10.0 ** rounded(math.log10(value)))


def _ends(column: Column, known: Sequence[float]) -> tuple[float, float]:
    """Return the declared range where it is narrow, else one that holds what is known."""
    low, high = column.range
    if column.better == "one":
        known = [*known, 1.0]
    low = low if math.isfinite(low) else min([0.0, *known])
    if not (math.isfinite(high) and high <= low + 1):
        high = max([low + 1e-9, *known]) * 1.05
    return low, high if high > low else low + 1


def _placer(low: float, high: float, scale: Callable[[float], float]) -> Callable[[float | None], float | None]:
    def place(value: float | None) -> float | None:
        if value is None:
            return None
        share = (scale(max(value, low)) - scale(low)) / (scale(high) - scale(low))
        return round(100 * min(1.0, share), 2)

    return place
