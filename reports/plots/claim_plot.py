"""Plot a claim: the mean score of each series at each level, with intervals."""

from __future__ import annotations

from functools import partial

from matplotlib.figure import Figure

from ..statistics.claims import ClaimResult
from .figure_file import COLORS, FAINT, SIGNS, make_figure, render_figure

_SPREAD = 0.07
"""Distance of the points of two series at one level, in levels, so that their intervals do not cover each other."""


def plot_claim(result: ClaimResult, kind: str, width: float = 4.3, height: float = 150.0) -> bytes:
    """Return the panel of a claim as a file of a kind (``svg``, ``pdf``, ``png``); width in inches, height in points.

    All levels of all series lie at equal distances, in the order of their numbers. The scale of the scores shows 0, and
    1 if it is the best or the highest value.
    """
    return render_figure(partial(_claim_figure, result, width, height), kind)


def _claim_figure(result: ClaimResult, width: float, height: float) -> Figure:
    figure = make_figure(width, height)
    axes = figure.add_axes((0.11, 0.2, 0.56, 0.74))
    levels = sorted({level for series in result.series for level in series.levels})
    for i, series in enumerate(result.series):
        shift = _SPREAD * (i - (len(result.series) - 1) / 2)
        color, sign = COLORS[i % len(COLORS)], SIGNS[i % len(SIGNS)]
        known = [
            (levels.index(level) + shift, one.value, one.ends)
            for level, one in zip(series.levels, series.estimates, strict=True)
            if one.value is not None
        ]
        places, values = [place for place, _, _ in known], [value for _, value, _ in known]
        axes.plot(places, values, color=color, marker=sign, lw=1.1, ms=4.6, mew=0.5, mec="white", label=series.name)
        for place, _, ends in known:
            if ends:
                axes.plot([place, place], ends, color=color, lw=0.8, zorder=1)
    axes.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
    axes.set_xlim(-0.3, len(levels) - 0.7)
    low, high = axes.get_ylim()
    column = result.column
    shows_one = column is None or column.better == "one" or column.range[1] == 1
    high = max(high, 1.04 if shows_one else 0.0)
    axes.set_ylim(min(low, -0.04 * high), high)
    axes.set_xlabel(result.claim.axis, labelpad=2)
    axes.set_ylabel(result.score_with_unit, labelpad=2)
    axes.axhline(0, color=FAINT, lw=0.6, zorder=0)
    axes.tick_params(length=3, width=0.7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=7)
    return figure
