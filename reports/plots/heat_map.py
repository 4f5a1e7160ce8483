"""Plot the quality of every method on every texture as a heat map."""

from __future__ import annotations

from functools import partial

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..statistics.comparison import Comparison
from .figure_file import GRAY, INK, SMALL, make_figure, render_figure

_SIDE = 17.0
_MAP = "cividis"


def plot_heat_map(comparison: Comparison, kind: str = "svg") -> bytes:
    """Return the heat map as a file of a kind: methods across from the best, textures down from the hardest.

    The palette is ordered by lightness, so that it can be read without color. Each field has the mark of the verdict.
    """
    return render_figure(partial(_figure, comparison), kind)


def _figure(comparison: Comparison) -> Figure:
    hardness = [_mean([entry.score for entry in row.entries if entry]) for row in comparison.rows]
    rows = [comparison.rows[i] for i in np.argsort(hardness, kind="stable")]
    left = 12 + 4.6 * max(len(row.texture) for row in rows)
    above = 14 + 3.3 * max(len(method.label) for method in comparison.methods)
    width, height = left + _SIDE * len(comparison.methods) + 110, above + _SIDE * len(rows) + 8
    figure = make_figure(width / 72, height)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    colors = matplotlib.colormaps[_MAP]
    for j, method in enumerate(comparison.methods):
        x = left + _SIDE * (j + 0.5)
        style = "italic" if method.reference else "normal"
        axes.text(x, above - 5, method.label, rotation=45, rotation_mode="anchor", color=INK, style=style)
    for i, row in enumerate(rows):
        y = above + _SIDE * i
        axes.text(left - 6, y + _SIDE / 2, row.texture, ha="right", va="center", color=INK)
        for j, entry in enumerate(row.entries):
            if entry is None:
                continue
            x, known = left + _SIDE * j, entry.score is not None
            fill = colors(entry.score) if known else "none"
            axes.add_patch(
                Rectangle((x + 0.5, y + 0.5), _SIDE - 1, _SIDE - 1, fc=fill, ec="none" if known else GRAY, lw=0.5)
            )
            dark = known and (entry.score or 0) < 0.55
            mark = {"N/A": "–"}.get(entry.mark, entry.mark)
            ink = ("#fefefe" if dark else "#010101") if known else GRAY
            axes.text(x + _SIDE / 2, y + _SIDE / 2, mark, ha="center", va="center", fontsize=8, color=ink)
    x = left + _SIDE * len(comparison.methods) + 16
    steps = np.linspace(0, 1, 21)
    for k, value in enumerate(steps):
        axes.add_patch(Rectangle((x, above + 100 - 5 * k - 5), 10, 5.2, fc=colors(value), ec="none"))
    for value in (0, 0.5, 1):
        axes.text(x + 14, above + 100 - 100 * value, f"{value:g}", va="center", **SMALL)
    axes.text(x, above + 114, "quality", **SMALL)
    return figure


def _mean(scores: list[float | None]) -> float:
    known = [score for score in scores if score is not None]
    return sum(known) / len(known) if known else -1.0
