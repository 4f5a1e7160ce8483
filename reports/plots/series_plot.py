"""Plot scores by level: the quality of each method by difficulty, and the series of a claim."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..statistics.estimates import Estimate
from ..statistics.expectations import ClaimResult
from ..statistics.levels import BROKEN, LevelPanel
from ..statistics.summaries import Method
from .captions import LINE, draw_captions
from .figure_file import COLORS, FAINT, GRAY, SIGNS, SMALL, add_axes, make_figure, open_frame, returns_file

_NARROWEST = 2.9
"""Smallest width of a panel with its labels, inches."""
_LONGEST = 26
"""Characters of a label, at most."""
_LETTER = 3.75
"""Mean width of a letter of a label, pt."""
_SPREAD = 0.07
"""Distance of the points of two series at one level, in levels, so that their intervals do not cover each other."""


@returns_file
def plot_levels(panels: Sequence[LevelPanel], width: float = 5.5) -> Figure:
    """Plot the quality by level, one panel for each difficulty.

    Parameters
    ----------
    panels
        At least one.
    width
        Width in inches. The number of columns follows from it.
    """
    columns = min(len(panels), max(1, int(width / _NARROWEST + 0.15)))
    methods = [series.method for series in panels[0].series]
    sources = {method.lattice_source for method in methods if not method.reference} - {"none"}
    labels = [_shorten(method.name if len(sources) == 1 else method.label) for method in methods]
    styles = [_line_style(methods, i) for i in range(len(methods))]
    inner = max(92.0, (LINE + 3) * len(methods) - 2 * LINE)
    across, down = 72 * width / columns, inner + 40
    total = down * -(-len(panels) // columns) + 14
    beside = 26 + _LETTER * max(map(len, labels))
    figure = make_figure(width, total)
    for i, panel in enumerate(panels):
        row, column = divmod(i, columns)
        left, top = across * column + 32, down * row + 16
        axes = add_axes(figure, left, total - top - inner, 72 * width - across * (column + 1) + beside, top)
        axes.set(xlim=(-0.15, len(panel.levels) - 0.85), ylim=(-0.04, 1.04), yticks=(0, BROKEN, 1))
        axes.set_title(panel.departure, loc="left", fontsize=8, pad=4)
        axes.set_ylabel("quality", labelpad=2)
        axes.axhline(BROKEN, color=FAINT, lw=0.6, zorder=0)
        ends = [
            _draw_line(axes, panel.levels, series.levels, series.estimates, styles[k])
            for k, series in enumerate(panel.series)
        ]
        named = [k for k, end in enumerate(ends) if end is not None]
        anchors = np.array([ends[k] for k in named], float)
        slanted, colors = [methods[k].reference for k in named], [styles[k]["color"] for k in named]
        draw_captions(axes, anchors, [labels[k] for k in named], slanted, colors)
    source = f" Lattice: {sources.pop()}." if len(sources) == 1 else ""
    note = f"Below the gray line at {BROKEN:g} a method breaks.{source} References are gray."
    figure.text(0.5, 3 / total, note, ha="center", **SMALL)
    return figure


def _shorten(label: str) -> str:
    return label if len(label) <= _LONGEST else f"{label[: _LONGEST - 1]}…"


def _line_style(methods: Sequence[Method], index: int) -> dict[str, Any]:
    """Return the color, the sign and the dashes of a method; references are gray."""
    reference = methods[index].reference
    place = sum(other.reference == reference for other in methods[:index])
    signs = "d<" if reference else SIGNS
    color = GRAY if reference else COLORS[place % len(COLORS)]
    dashes = "-" if place < len(signs) else "--"
    return {"color": color, "marker": signs[place % len(signs)], "ls": dashes, "zorder": 2 if reference else 3}


def _draw_line(
    axes: Axes,
    levels: Sequence[float],
    own: Sequence[float],
    estimates: Sequence[Estimate],
    style: dict[str, Any],
    shift: float = 0.0,
    bars: bool = False,
) -> tuple[float, float] | None:
    """Draw the estimates of one series at its ``own`` levels of a panel, and return its last point."""
    open_frame(axes)
    axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
    pairs = zip(own, estimates, strict=True)
    known = [(levels.index(level) + shift, one.value, one.ends) for level, one in pairs if one.value is not None]
    if not known:
        return None
    places, values = [place for place, _, _ in known], [value for _, value, _ in known]
    axes.plot(places, values, lw=1.1, ms=4.6, mew=0.5, mec="white", clip_on=False, **style)
    for place, _, ends in known:
        if bars and ends:
            axes.plot([place, place], ends, color=style["color"], lw=0.8, zorder=1)
    return places[-1], values[-1]


@returns_file
def plot_claim(result: ClaimResult) -> Figure:
    """Plot the panel of a claim.

    All levels of all series lie at equal distances, in the order of their numbers. The scale of the scores shows 0, and
    1 if it is the best or the highest value.
    """
    figure = make_figure(4.3, 150)
    axes = add_axes(figure, 34, 30, 102, 9)
    levels = sorted({level for series in result.series for level in series.levels})
    for i, series in enumerate(result.series):
        shift = _SPREAD * (i - (len(result.series) - 1) / 2)
        style = {"color": COLORS[i % len(COLORS)], "marker": SIGNS[i % len(SIGNS)], "label": series.name}
        _draw_line(axes, levels, series.levels, series.estimates, style, shift, bars=True)
    axes.set_xlim(-0.3, len(levels) - 0.7)
    low, high = axes.get_ylim()
    column = result.column
    shows_one = column is None or column.better == "one" or column.range[1] == 1
    high = max(high, 1.04 if shows_one else 0.0)
    axes.set_ylim(min(low, -0.04 * high), high)
    axes.set_xlabel(result.claim.axis, labelpad=2)
    axes.set_ylabel(result.score_with_unit, labelpad=2)
    axes.axhline(0, color=FAINT, lw=0.6, zorder=0)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=7)
    return figure
