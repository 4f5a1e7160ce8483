"""Figures of the command ``lattice``: how a detector found its lattice."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nrbench.pictures.overlays import COLOR
from nrbench.plugins.forms import Curve, Surface

PANEL = (5.6, 4.8)
"""Width and height of a panel, inches."""
LETTERS = 72
"""Number of letters on a line of text as wide as a panel."""


def diagram(diagnostics: Mapping[str, Any], title: str = "") -> Figure | None:
    """Draw the diagnostics of a detection: surfaces as pictures, curves as lines, numbers as text below.

    A surface shows its candidates as circles and the chosen vectors as arrows from its zero. A vector outside the
    surface is drawn as its negative. A curve shows the chosen values as vertical lines.

    Parameters
    ----------
    diagnostics
        Those of a :class:`~nrbench.plugins.forms.Detection`.
    title
        Text above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        On an Agg canvas of its own; None if nothing can be drawn.
    """
    panels = {name: value for name, value in diagnostics.items() if isinstance(value, Surface | Curve)}
    if not panels:
        return None
    columns = min(2, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    for i, (name, value) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(rows, columns, i)
        axes.set_title(name, fontsize=10)
        _draw_surface(axes, value) if isinstance(value, Surface) else _draw_curve(axes, value)
    figure.suptitle(textwrap.fill(title, LETTERS * columns), fontsize=10)
    known = {name: value for name, value in diagnostics.items() if isinstance(value, Real | str)}
    words = [f"{name} {value if isinstance(value, str) else format(value, '.4g')}" for name, value in known.items()]
    figure.supxlabel(textwrap.fill(", ".join(words), LETTERS * columns), fontsize=8)
    return figure


def _draw_surface(axes: Axes, surface: Surface) -> None:
    height, width = surface.values.shape
    left, top = -surface.zero[0] - 0.5, -surface.zero[1] - 0.5
    box = (left, left + width, top + height, top)
    # Extremes, like the peak at zero, are cut off.
    finite = surface.values[np.isfinite(surface.values)]
    low, high = np.quantile(finite, (0.005, 0.995)) if finite.size else (0, 1)
    shown = axes.imshow(surface.values, extent=box, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    axes.figure.colorbar(shown, ax=axes, shrink=0.8)
    peaks = np.reshape(surface.peaks, (-1, 2))
    axes.plot(*peaks.T, "o", mfc="none", mec="tab:cyan", ms=5, mew=0.9, label=f"{len(peaks)} candidates")
    for vector in () if surface.vectors is None else surface.vectors:
        inside = box[0] <= vector[0] <= box[1] and box[3] <= vector[1] <= box[2]
        tip = vector if inside else -vector
        axes.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": COLOR, "lw": 1.8})
        axes.plot(*tip, ".", color=COLOR, ms=3)
    axes.set(xlim=box[:2], ylim=box[2:])
    axes.legend(loc="upper right", fontsize=7, framealpha=0.7)


def _draw_curve(axes: Axes, curve: Curve) -> None:
    axes.plot(curve.x, curve.y, color="black", lw=1)
    for mark in curve.marks:
        axes.axvline(mark, color=COLOR, lw=1.2)
        axes.annotate(f"{mark:.4g}", (mark, 1.0), xycoords=("data", "axes fraction"), fontsize=7, color=COLOR)
    axes.set_xlabel(curve.label, fontsize=8)
