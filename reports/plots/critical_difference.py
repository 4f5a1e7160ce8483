"""Plot the average ranks of methods, and bars over methods that do not differ: a critical-difference diagram."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from ..statistics.comparison import Comparison
from .figure_file import GRAY, INK, SMALL, make_figure, render_figure

_ROW = 13.0


def plot_ranks(comparison: Comparison, kind: str = "svg", width: float = 5.5) -> bytes:
    """Return the diagram as a file of a kind (``svg``, ``pdf``, ``png``).

    Parameters
    ----------
    comparison
        A comparison with :attr:`~nrbench.reports.statistics.comparison.Comparison.tests`.
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
    margin = 0.3 * 72 * width
    low, high = 1.0, float(max(2, count))
    across = margin + (places - low) / (high - low) * (72 * width - 2 * margin)
    top = height - 30
    axes.plot((margin, 72 * width - margin), (top, top), color=INK, lw=0.9)
    for tick in np.unique(np.linspace(low, high, min(count, 9)).round()):
        x = margin + (tick - low) / (high - low) * (72 * width - 2 * margin)
        axes.plot((x, x), (top, top + 4), color=INK, lw=0.7)
        axes.text(x, top + 6, f"{tick:g}", ha="center", fontsize=7, color=INK)
    axes.text(36 * width, top + 18, f"average rank over {tests.n} textures, 1 is the best", ha="center", **SMALL)
    first = top - 10 - 7 * bars
    for i, (label, x) in enumerate(zip(labels, across, strict=True)):
        is_left = i < left
        y = first - _ROW * (i if is_left else count - 1 - i)
        end = margin - 6 if is_left else 72 * width - margin + 6
        axes.plot((x, x, end), (top, y, y), color=GRAY, lw=0.7, zorder=1)
        words = f"{label}  {places[i]:.2f}" if is_left else f"{places[i]:.2f}  {label}"
        axes.text(end + (-3 if is_left else 3), y, words, ha="right" if is_left else "left", va="center", color=INK)
        axes.plot(x, top, "o", ms=4, color=INK, zorder=3)
    for row, (start, stop) in enumerate(tests.cliques):
        y = top - 8 - 7 * row
        axes.plot((across[start] - 3, across[stop] + 3), (y, y), color=INK, lw=3, solid_capstyle="butt", zorder=2)
    return figure
