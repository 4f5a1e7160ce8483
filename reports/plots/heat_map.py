"""Plot the quality of every method on every texture as a heat map."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.textpath import TextPath
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

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
    fields: list[tuple[float, float, Any, Any]] = []
    marks: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for i, row in enumerate(rows):
        y = above + _SIDE * i
        axes.text(left - 6, y + _SIDE / 2, row.texture, ha="right", va="center", color=INK)
        for j, entry in enumerate(row.entries):
            if entry is None:
                continue
            x, known = left + _SIDE * j, entry.score is not None
            fields.append((x, y, colors(entry.score) if known else "none", "none" if known else GRAY))
            dark = known and (entry.score or 0) < 0.55
            mark = {"N/A": "–"}.get(entry.mark, entry.mark)
            ink = ("#fefefe" if dark else "#010101") if known else GRAY
            marks.setdefault((mark, ink), []).append((x + _SIDE / 2, y + _SIDE / 2))
    _draw_fields(axes, fields)
    for (mark, ink), places in marks.items():
        _draw_marks(axes, mark, ink, np.array(places))
    x = left + _SIDE * len(comparison.methods) + 16
    steps = np.linspace(0, 1, 21)
    for k, value in enumerate(steps):
        axes.add_patch(Rectangle((x, above + 100 - 5 * k - 5), 10, 5.2, fc=colors(value), ec="none"))
    for value in (0, 0.5, 1):
        axes.text(x + 14, above + 100 - 100 * value, f"{value:g}", va="center", **SMALL)
    axes.text(x, above + 114, "quality", **SMALL)
    return figure


def _draw_fields(axes: Axes, fields: Sequence[tuple[float, float, Any, Any]]) -> None:
    """Draw all fields as one artist: a run can have thousands."""
    corners = np.array([(0.5, 0.5), (_SIDE - 0.5, 0.5), (_SIDE - 0.5, _SIDE - 0.5), (0.5, _SIDE - 0.5)])
    squares = [corners + np.array([x, y]) for x, y, _, _ in fields]
    axes.add_collection(
        PolyCollection(squares, facecolors=[one[2] for one in fields], edgecolors=[one[3] for one in fields], lw=0.5)
    )


def _draw_marks(axes: Axes, mark: str, ink: str, places: NDArray[np.float64]) -> None:
    """Draw the same mark at many places, as one glyph that the file repeats."""
    glyph = TextPath((0, 0), mark, size=8)
    box = glyph.get_extents()
    centered = glyph.transformed(Affine2D().translate(-(box.x0 + box.x1) / 2, -(box.y0 + box.y1) / 2))
    size = 2 * float(np.abs(centered.vertices).max())  # a path as a marker is scaled to the size of the marker
    axes.plot(*places.T, ls="none", marker=centered, ms=size, mfc=ink, mec="none")


def _mean(scores: list[float | None]) -> float:
    """Return the mean of the known scores; infinity without any, so that such textures come last."""
    known = [score for score in scores if score is not None]
    return sum(known) / len(known) if known else np.inf
