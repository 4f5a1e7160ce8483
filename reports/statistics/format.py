"""Format numbers, intervals and column descriptions as text for every report, and read the templates of reports."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from nrbench.labelling.labels import content_hash
from nrbench.plugins.forms import Column

from . import verdicts
from .estimates import Estimate
from .verdicts import BOUND_SIGN


def format_number(value: float | bool | None) -> str:
    """Return a score with two decimals near 1, three if it is small, fewer if it is large; a dash if there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    size = abs(value)
    if size >= 9.995:
        digits = ".1f" if size < 99.95 else ".0f" if size < 1e6 else ".2e"
    elif size == 0 or size >= 0.0995:
        digits = ".2f"
    else:
        digits = ".3f" if size >= 0.001 else ".1e"
    return format(value, digits).replace("-", "−")


def format_percent(value: float | None) -> str:
    """Return a share in whole percent."""
    return "–" if value is None else f"{100 * value:.0f} %"


def format_value(estimate: Estimate, as_percent: bool = False) -> str:
    """Return the value of an estimate, behind the sign of an upper bound if it is one."""
    text = format_percent if as_percent else format_number
    return BOUND_SIGN * estimate.at_most + text(estimate.value)


def format_signed(value: float | None) -> str:
    """Return a difference with its sign."""
    return format_number(value) if value is None or value <= 0 else f"+{format_number(value)}"


def format_interval(estimate: Estimate, as_percent: bool = False) -> str:
    """Return ``"[low, high]"``; empty if there is no interval, or both ends are the same at the printed digits."""
    if estimate.ends is None:
        return ""
    low, high = (f"{100 * end:.0f}" if as_percent else format_number(end) for end in estimate.ends)
    return "" if low == high else f"[{low}, {high}]"


def round_small(estimate: Estimate) -> Estimate:
    """Round values below 0.001 to 0. Use it for scores in [0, 1]."""
    low, value, high = (
        0.0 if number is not None and number < 0.001 else number
        for number in (estimate.low, estimate.value, estimate.high)
    )
    return replace(estimate, value=value, low=low, high=high)


def format_count(estimate: Estimate) -> str:
    """Return ``"n of N"``: how many textures the estimate counts."""
    return f"{estimate.n} of {estimate.of}"


def format_successes(estimate: Estimate) -> str:
    """Return ``"k of n"`` for a success rate, and how many textures it leaves out.

    k has a fraction if replicates disagree.
    """
    left_out = estimate.of - estimate.n
    return f"{(estimate.value or 0) * estimate.n:.3g} of {estimate.n}" + (f", {left_out} left out" if left_out else "")


def format_limit(value: float) -> str:
    """Return one end of a column's range, with a sign for infinity."""
    return ("∞" if value > 0 else "−∞") if math.isinf(value) else f"{value:g}".replace("-", "−")


def describe_direction(column: Column) -> str:
    """Return which values of a column are better, in words."""
    return {"one": "nearest to 1", "none": "no better way"}.get(column.better, column.better)


@cache
def describe_column(column: Column) -> str:
    """Return the meaning of a column, and on a second line its unit, its range and which values are better."""
    span = f"{format_limit(column.range[0])} to {format_limit(column.range[1])}"
    better = describe_direction(column) if column.better == "none" else f"better: {describe_direction(column)}"
    return f"{column.meaning}\nunit: {column.unit or 'none'}; range: {span}; {better}"


def pluralize(count: int, noun: str) -> str:
    """Return ``"1 cell"``, ``"2 cells"``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def break_name(name: str, letters: int) -> list[str]:
    """Return a name in lines of at most so many letters, broken behind spaces and signs, and within very long words."""
    lines = [""]
    for piece in re.findall(rf"[^-:,./_ ]{{1,{max(14, letters)}}}[-:,./_ ]?|[-:,./_ ]", name):
        if lines[-1] and len(lines[-1] + piece.rstrip()) > letters:
            lines.append("")
        lines[-1] += piece
    return [line.rstrip() for line in lines]


_FORMATS = (
    *(format_number, format_percent, format_value, format_signed, format_interval, format_count, format_successes),
    *(format_limit, describe_direction, describe_column, pluralize),
)


def make_environment(filters: Mapping[str, Callable[..., Any]], **options: Any) -> jinja2.Environment:
    """Return the templates of reports as Jinja reads them.

    Parameters
    ----------
    filters
        Filters of one format, beside those that format numbers and columns.
    options
        Further options of Jinja.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parents[1] / "page" / "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **options,
    )
    environment.globals["verdicts"] = verdicts
    environment.filters.update({function.__name__: function for function in _FORMATS}, **filters)
    return environment


def render_page(template: str, content: Mapping[str, Any], filters: Mapping[str, Callable[..., Any]]) -> str:
    """Return a page. Its content policy names style and script by hash, so that nothing else on it can run.

    Parameters
    ----------
    template
        The file of its template.
    content
        The variables of the template.
    filters
        See :func:`make_environment`.
    """
    environment = make_environment(filters, autoescape=True)
    style, script = (Markup(environment.get_template(file).render(content)) for file in ("style.css", "script.js"))
    hashes = {"style_hash": content_hash(style), "script_hash": content_hash(script)}
    return environment.get_template(template).render(content, style=style, script=script, **hashes)
