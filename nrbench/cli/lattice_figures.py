"""Figures of the command ``lattice``: how a detector found its lattice, and a window in which to pick a lattice."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.imaging.overlays import COLOR, draw_lattice
from nrbench.lattice.geometry import Lattice, Vector
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


CLICKS = "click a corner of a tile, the same corner of the next tile (t1), and of the next in another direction (t2)"
"""The title of the window before the clicks."""
ACCEPT = "any key accepts this lattice, a click begins again, closing the window cancels"
"""The title of the window after the clicks."""


def lattice_of(points: Sequence[Vector]) -> Lattice:
    """Return the lattice of three points (x, y) px: its origin, the end of t1, the end of t2.

    Raises
    ------
    BadInput
        When the points lie on one line.
    """
    (x, y), (x1, y1), (x2, y2) = points
    return Lattice((x1 - x, y1 - y), (x2 - x, y2 - y), (x, y))


def pick(image: Image) -> Lattice:
    """Open a window, and return the lattice that the user clicks and accepts.

    Raises
    ------
    BadInput
        Where no window can be opened, or the user cancels.
    """
    try:
        figure = plt.figure("nrbench lattice --pick", figsize=(9, 9))
    except Exception as error:  # of the toolkit: no display, no such module
        raise _no_window(str(error)) from error
    try:
        if getattr(figure.canvas, "required_interactive_framework", None) is None:
            raise _no_window(f"matplotlib's backend is {plt.get_backend()}")
        return pick_in(figure, image)
    finally:
        plt.close(figure)


def pick_in(figure: Figure, image: Image) -> Lattice:
    """Return the lattice that the user clicks and accepts in a figure.

    Parameters
    ----------
    figure
        An empty figure, whose canvas receives the events of the user.
    image
        The texture.

    Raises
    ------
    BadInput
        If the user cancels, by Escape or Enter before the third click, or by closing the window.
    """
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.88))
    axes.axis("off")
    color = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image
    picture = axes.imshow(color, interpolation="nearest")
    figure.canvas.mpl_connect("close_event", lambda event: figure.canvas.stop_event_loop())
    title, cancelled = CLICKS, BadInput("--pick: cancelled, no lattice was picked")
    while True:
        picture.set_data(color)
        axes.set_title(title, fontsize=10)
        figure.canvas.draw_idle()
        points = figure.ginput(3, timeout=0)
        if len(points) < 3:
            raise cancelled
        try:
            lattice = lattice_of(points)
        except BadInput:
            title = f"these points lie on one line; {CLICKS}"
            continue
        picture.set_data(draw_lattice(color, lattice))
        axes.set_title(ACCEPT, fontsize=10)
        figure.canvas.draw_idle()
        accepted = figure.waitforbuttonpress()
        if accepted is None:
            raise cancelled
        if accepted:
            return lattice
        title = CLICKS


def _no_window(why: str) -> BadInput:
    return BadInput(
        f"--pick: no window can be opened ({why}); it needs a display and a toolkit such as Tk or Qt. Without them, "
        "read the points in any viewer and pass --lattice x1,y1,x2,y2[,x,y]"
    )
