"""How numbers read in every report."""

from __future__ import annotations

import math
import re

from nrbench.plugins.forms import Column

from ..statistics.statistics import Estimate

_CONTROL = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]|[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def number(value: float | bool | None) -> str:
    """Return a score as people read it: two decimals near 1, three for small values, fewer for large."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return _digits(abs(value), value).replace("-", "−")


def _digits(size: float, value: float) -> str:
    if size >= 9.995:
        return f"{value:.1f}" if size < 99.95 else f"{value:.0f}" if size < 1e6 else f"{value:.2e}"
    if size == 0 or size >= 0.0995:
        return f"{value:.2f}"
    return f"{value:.3f}" if size >= 0.001 else f"{value:.1e}"


def percent(value: float | None) -> str:
    """Return a share as whole percent."""
    return "–" if value is None else f"{100 * value:.0f} %"


def signed(value: float | None) -> str:
    """Return a difference with its sign."""
    return number(value) if value is None or value <= 0 else f"+{number(value)}"


def interval(estimate: Estimate, as_percent: bool = False) -> str:
    """Return ``"[low, high]"``; empty where there is no interval."""
    if estimate.low is None or estimate.high is None:
        return ""
    if as_percent:
        return f"[{100 * estimate.low:.0f}, {100 * estimate.high:.0f}]"
    return f"[{number(estimate.low)}, {number(estimate.high)}]"


def counted(estimate: Estimate) -> str:
    """Return ``"n of N"``."""
    return f"{estimate.n} of {estimate.of}"


def successes(estimate: Estimate) -> str:
    """Return ``"k of n"`` of a success rate, and how many were left out; k has a fraction where replicates disagree."""
    left_out = estimate.of - estimate.n
    return f"{(estimate.value or 0) * estimate.n:.3g} of {estimate.n}" + (f", {left_out} left out" if left_out else "")


def end(value: float) -> str:
    """Return an end of a column's range; infinity as a sign."""
    return ("∞" if value > 0 else "−∞") if math.isinf(value) else f"{value:g}".replace("-", "−")


def way(column: Column) -> str:
    """Return a column's better way in words."""
    return {"one": "nearest to 1", "none": "no better way"}.get(column.better, column.better)


def tip(column: Column) -> str:
    """Return all that a column declares, for a tooltip: its sentence; below it unit, range and better way."""
    span = f"{end(column.range[0])} to {end(column.range[1])}"
    better = way(column) if column.better == "none" else f"better: {way(column)}"
    return f"{column.meaning}\nunit: {column.unit or 'none'}; range: {span}; {better}"


def plural(count: int, noun: str) -> str:
    """Return ``"1 cell"``, ``"2 cells"``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def plain(text: str) -> str:
    """Return what a method wrote without terminal escapes and control characters, line breaks and tabs kept."""
    return _CONTROL.sub("", text.replace("\r\n", "\n"))
