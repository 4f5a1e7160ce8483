"""Plot the average ranks of methods, and bars over methods that do not differ: a critical-difference diagram."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

from ..statistics.method_comparison import Comparison
from .figure_file import GRAY, INK, SMALL, make_figure, render_figure

_ROW = 13.0
_MOST_TICKS = 12
_GAP = 14.0
"""Distance between the axis and the names, with that to the border, pt."""


def plot_ranks(comparison: Comparison, kind: str = "svg", width: float = 5.5) -> bytes:
    """Return the diagram as a file of a kind (``svg``, ``pdf``, ``png``).

    Parameters
    ----------
    comparison
        A comparison with :attr:`~nrbench.reports.statistics.method_comparison.Comparison.tests`.
    kind
        The kind of file.
    width
        Width in inches.
    """
    return render_figure(partial(_figure, comparison, width), kind)


def _figure(comparison: Comparison, width: float) -> Figure:
    tests = comparison.tests
    assert tests is not None
    labels, count = [comparison.ranked[i].label for i in tests.order], len(tests.order)
    places = np.array([tests.ranks[i] for i in tests.order])
    left = (count + 1) // 2
    rows, bars = max(left, count - left), len(tests.cliques)
    height = 40 + 7 * bars + _ROW * rows + 12
    figure = make_figure(width, height)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 72 * width), ylim=(0, height))
    axes.axis("off")
    words = [
        f"{label}  {place:.2f}" if i < left else f"{place:.2f}  {label}"
        for i, (label, place) in enumerate(zip(labels, places, strict=True))
    ]
    margin, font = _fit_names(axes, words)
    low, high = 1.0, float(max(2, count))
    across = margin + (places - low) / (high - low) * (72 * width - 2 * margin)
    top = height - 30
    axes.plot((margin, 72 * width - margin), (top, top), color=INK, lw=0.9)
    for tick in np.arange(low, high + 0.5, -(-count // _MOST_TICKS)):
        x = margin + (tick - low) / (high - low) * (72 * width - 2 * margin)
        axes.plot((x, x), (top, top + 4), color=INK, lw=0.7)
        axes.text(x, top + 6, f"{tick:g}", ha="center", fontsize=7, color=INK)
    axes.text(36 * width, top + 18, f"average rank over {tests.n} textures, 1 is the best", ha="center", **SMALL)
    first = top - 10 - 7 * bars
    for i, x in enumerate(across):
        is_left = i < left
        y = first - _ROW * (i if is_left else count - 1 - i)
        end = margin - 6 if is_left else 72 * width - margin + 6
        axes.plot((x, x, end), (top, y, y), color=GRAY, lw=0.7, zorder=1)
        axes.text(
            *(end + (-3 if is_left else 3), y, words[i]),
            ha="right" if is_left else "left",
            va="center",
            color=INK,
            fontsize=font,
        )
        axes.plot(x, top, "o", ms=4, color=INK, zorder=3)
    for row, (start, stop) in enumerate(tests.cliques):
        y = top - 8 - 7 * row
        axes.plot((across[start] - 3, across[stop] + 3), (y, y), color=INK, lw=3, solid_capstyle="butt", zorder=2)
    return figure


def _fit_names(axes: Axes, words: Sequence[str], size: float = 8.0) -> tuple[float, float]:
    """Return the width of the margins, pt, and the size of the names: they shrink where a margin is too small."""
    widest = max(TextPath((0, 0), text, size=size).get_extents().width for text in words)
    across = axes.get_window_extent().width
    margin = float(np.clip(widest + _GAP, 0.2 * across, 0.36 * across))
    return margin, size * min(1.0, (margin - _GAP) / widest)
