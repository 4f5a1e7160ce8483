"""Plot the comparison of methods: their average ranks, their quality on every texture, and quality against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from ..statistics.estimates import as_numbers, mean_of_known
from ..statistics.method_comparison import Comparison, ComparisonRow
from ..statistics.summaries import MethodSummary
from ..statistics.verdicts import RANKING
from .captions import choose_named, describe_unnamed, draw_captions
from .figure_file import FAINT, GRAY, INK, SMALL, add_axes, make_figure, open_frame, returns_file

_SIDE = 17.0
"""Side of a field, pt."""
_DARK = 0.55
"""Fields of a lower quality have white marks."""
_LETTER = 4.6
"""Width of a letter of a name, pt."""


@returns_file
def plot_ranks(comparison: Comparison, width: float = 5.5) -> Figure:
    """Plot the average rank of each method, the best at the top; bars at the right join methods that do not differ.

    Parameters
    ----------
    comparison
        A comparison with :attr:`~nrbench.reports.statistics.method_comparison.Comparison.tests`.
    width
        Width in inches.
    """
    tests = comparison.tests
    assert tests is not None
    names = [f"{comparison.ranked[i].label}  {tests.ranks[i]:.2f}" for i in tests.order]
    left, right = 12 + _LETTER * max(map(len, names)), 12 + 7 * len(tests.cliques)
    figure = make_figure(width, 13 * len(names) + 40)
    axes = add_axes(figure, left, 34, right, 6)
    open_frame(axes)
    axes.plot([tests.ranks[i] for i in tests.order], range(len(names)), "o", ms=4, color=INK, clip_on=False)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(True, axis="y", color=FAINT, lw=0.5)
    axes.set_xlabel(f"average rank over {tests.n} textures, 1 is the best", loc="right")
    for place, clique in enumerate(tests.cliques):
        x = 1 + 7 * (place + 1) / (72 * width - left - right)
        style: Any = {"color": INK, "lw": 3, "solid_capstyle": "butt", "clip_on": False}
        axes.plot((x, x), clique, transform=axes.get_yaxis_transform(), **style)
    return figure


@returns_file
def plot_heat_map(comparison: Comparison) -> Figure:
    """Plot the heat map: methods across from the best, textures down from the hardest.

    The palette is ordered by lightness, so that it can be read without color. Each field has the mark of the verdict.
    """
    rows, scores = hardest_first(comparison)
    left = 12 + _LETTER * max(len(row.texture) for row in rows)
    above = 14 + 3.3 * max(len(method.label) for method in comparison.methods)
    height = above + _SIDE * max(len(rows), 7) + 8
    figure = make_figure((left + _SIDE * len(comparison.methods) + 110) / 72, height)
    axes = add_axes(figure, left, height - above - _SIDE * len(rows), 110, above)
    fields = axes.pcolormesh(np.ma.masked_invalid(scores), cmap="cividis", vmin=0, vmax=1, edgecolors="white", lw=0.5)
    axes.invert_yaxis()
    axes.set_yticks(np.arange(len(rows)) + 0.5, [row.texture for row in rows])
    axes.xaxis.tick_top()
    labels = [method.label for method in comparison.methods]
    axes.set_xticks(np.arange(len(labels)) + 0.5, labels, rotation=45, rotation_mode="anchor", ha="left")
    for label, method in zip(axes.get_xticklabels(), comparison.methods, strict=True):
        label.set_fontstyle("italic" if method.reference else "normal")
    axes.tick_params(length=0, labelcolor=INK)
    axes.set_frame_on(False)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row.entries):
            if entry is not None:
                ink = GRAY if not np.isfinite(scores[i, j]) else "#fefefe" if scores[i, j] < _DARK else "#010101"
                mark = {"N/A": "–"}.get(entry.mark, entry.mark)
                axes.text(j + 0.5, i + 0.5, mark, ha="center", va="center", color=ink)
    scale = add_axes(figure, left + _SIDE * len(labels) + 16, height - above - 100, 84, above)
    figure.colorbar(fields, cax=scale, ticks=(0, 0.5, 1)).set_label("quality")
    return figure


def hardest_first(comparison: Comparison) -> tuple[list[ComparisonRow], NDArray[np.float64]]:
    """Return the textures from the lowest mean score, those without a score last, and the scores of all methods."""
    scores = np.array([as_numbers([entry and entry.score for entry in row.entries]) for row in comparison.rows])
    order = np.argsort(mean_of_known(scores, 1), kind="stable")
    return [comparison.rows[i] for i in order], scores[order]


def timed_methods(comparison: Comparison) -> list[MethodSummary]:
    """Return the methods with a quality and a time."""
    scored = (one for one in comparison.summaries if RANKING in one.means)
    return [one for one in scored if one.means[RANKING].value is not None and one.means["seconds"].value]


@returns_file
def plot_cost(methods: Sequence[MethodSummary], width: float = 5.5) -> Figure:
    """Plot mean seconds across, logarithmic, and mean quality upwards, of some :func:`timed_methods`."""
    figure = make_figure(width, 72 * width * 0.62)
    axes = add_axes(figure, 46, 40, 150, 12)
    places = np.array([(one.means["seconds"].value, one.means[RANKING].value) for one in methods], float)
    axes.set_xscale("log")
    axes.set(ylim=(-0.03, 1.03), xlim=(places[:, 0].min() / 2, places[:, 0].max() * 2))
    axes.set_xlabel("seconds, mean over textures (better: left)")
    axes.set_ylabel("quality (better: up)")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, color=FAINT, lw=0.5)
    axes.set_axisbelow(True)
    references = [one.method.reference for one in methods]
    named = choose_named(references)
    for one, (x, y), chosen, reference in zip(methods, places, named, references, strict=True):
        if (ends := one.means[RANKING].ends) is not None and chosen:
            axes.plot((x, x), ends, color=GRAY if reference else INK, lw=0.9, zorder=2)
        sign, size, fill = ("D", 5.0, FAINT) if reference else ("o", 6.4 if chosen else 3.0, INK)
        axes.plot(x, y, marker=sign, ms=size, mfc=fill, mec=INK, mew=0.8, zorder=3)
    shown = [one.method for one, chosen in zip(methods, named, strict=True) if chosen]
    draw_captions(axes, places[named], [one.label for one in shown], [one.reference for one in shown])
    figure.text(0.02, 3 / (72 * width * 0.62), describe_unnamed(named), **SMALL)
    return figure
