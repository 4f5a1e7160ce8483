"""Plot the quality of every method on every texture as a heat map."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from ..statistics.method_comparison import Comparison, Entry
from .figure_file import GRAY, INK, add_axes, make_figure, render_figure

_SIDE = 17.0
"""Side of a field, pt."""
_DARK = 0.55
"""Fields of a lower quality have white marks."""


def plot_heat_map(comparison: Comparison, kind: str = "svg") -> bytes:
    """Return the heat map as a file of a kind: methods across from the best, textures down from the hardest.

    The palette is ordered by lightness, so that it can be read without color. Each field has the mark of the verdict.
    """
    return render_figure(partial(_figure, comparison), kind)


def _figure(comparison: Comparison) -> Figure:
    scores = np.array([[_score(entry) for entry in row.entries] for row in comparison.rows])
    known = np.isfinite(scores)
    hardness = np.where(known.any(1), np.where(known, scores, 0).sum(1) / np.maximum(known.sum(1), 1), np.inf)
    order = np.argsort(hardness, kind="stable")
    rows, scores = [comparison.rows[i] for i in order], scores[order]
    left = 12 + 4.6 * max(len(row.texture) for row in rows)
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


def _score(entry: Entry | None) -> float:
    return np.nan if entry is None or entry.score is None else entry.score
