"""What led a detector to its lattice, drawn."""

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
from numpy.typing import NDArray

from nrbench.imaging.overlay import COLOR
from nrbench.plugins.forms import Curve, Surface

PANEL = (5.6, 4.8)
"""Width and height of a panel, inches."""
LETTERS = 72
"""On a line of text as wide as a panel."""


def diagram(diagnostics: Mapping[str, Any], title: str = "") -> Figure | None:
    """Return one figure of all that can be drawn of a detection: surfaces as pictures, curves as lines.

    A surface shows its candidates as circles and the chosen vectors as arrows from its zero (where the surface holds
    only one half, the vector or its negative); a curve marks what was chosen. Plain numbers stand below.

    Parameters
    ----------
    diagnostics
        Those of a :class:`~nrbench.plugins.forms.Detection`.
    title
        Stands above.

    Returns
    -------
    matplotlib.figure.Figure
        On an Agg canvas of its own; None where there is nothing to be drawn.
    """
    drawn = {name: one for name, one in diagnostics.items() if isinstance(one, Surface | Curve)}
    if not drawn:
        return None
    columns = min(2, len(drawn))
    rows = math.ceil(len(drawn) / columns)
    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    for i, (name, one) in enumerate(drawn.items(), 1):
        axes = figure.add_subplot(rows, columns, i)
        axes.set_title(name, fontsize=10)
        _surface(axes, one) if isinstance(one, Surface) else _curve(axes, one)
    figure.suptitle(textwrap.fill(title, LETTERS * columns), fontsize=10)
    figure.supxlabel(textwrap.fill(_numbers(diagnostics), LETTERS * columns), fontsize=8)
    return figure


def _numbers(diagnostics: Mapping[str, Any]) -> str:
    known = {name: value for name, value in diagnostics.items() if isinstance(value, Real | str)}
    return ", ".join(
        f"{name} {value if isinstance(value, str) else format(value, '.4g')}" for name, value in known.items()
    )


def _surface(axes: Axes, surface: Surface) -> None:
    height, width = surface.values.shape
    left, top = -surface.zero[0] - 0.5, -surface.zero[1] - 0.5
    box = (left, left + width, top + height, top)
    low, high = _limits(surface.values)
    shown = axes.imshow(surface.values, extent=box, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    axes.figure.colorbar(shown, ax=axes, shrink=0.8)
    peaks = np.reshape(surface.peaks, (-1, 2))
    axes.plot(*peaks.T, "o", mfc="none", mec="tab:cyan", ms=5, mew=0.9, label=f"{len(peaks)} candidates")
    for vector in () if surface.vectors is None else surface.vectors:
        tip = vector if _within(vector, box) else -vector
        axes.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": COLOR, "lw": 1.8})
        axes.plot(*tip, ".", color=COLOR, ms=3)
    axes.set(xlim=box[:2], ylim=box[2:])
    axes.legend(loc="upper right", fontsize=7, framealpha=0.7)


def _limits(values: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Return the values shown black and white: extreme ones, like the peak at zero, must not hide the rest."""
    low, high = np.quantile(values[np.isfinite(values)], (0.005, 0.995)) if np.isfinite(values).any() else (0, 1)
    return float(low), float(high)


def _within(point: NDArray[np.float64], box: tuple[float, float, float, float]) -> bool:
    return bool(box[0] <= point[0] <= box[1] and box[3] <= point[1] <= box[2])


def _curve(axes: Axes, curve: Curve) -> None:
    axes.plot(curve.x, curve.y, color="black", lw=1)
    for mark in curve.marks:
        axes.axvline(mark, color=COLOR, lw=1.2)
        axes.annotate(f"{mark:.4g}", (mark, 1.0), xycoords=("data", "axes fraction"), fontsize=7, color=COLOR)
    axes.set_xlabel(curve.label, fontsize=8)
