"""The style of all plots, and their files."""

from __future__ import annotations

import functools
import io
import warnings
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

P = ParamSpec("P")

INK, GRAY, FAINT = "black", "0.45", "0.8"
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""The palette of M. Okabe and K. Ito, "Color universal design", 2008; it is safe for color-blind readers."""
SIGNS = "osD^vPX*"
"""The markers of lines, so that color is not the only difference."""
SMALL: Any = {"color": GRAY, "fontsize": 7}
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "text.parse_math": False,
    "svg.hashsalt": "nrbench",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "axes.linewidth": 0.7,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


def make_figure(width: float, height: float, **more: Any) -> Figure:
    """Return an empty figure; width in inches, height in points, and further arguments of ``Figure``."""
    figure = Figure(figsize=(width, height / 72), dpi=72, **more)
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Figure, left: float, bottom: float, right: float, top: float) -> Axes:
    """Add axes to a figure and return them; the arguments are the margins to the edges of the figure, points."""
    width, height = 72 * figure.get_size_inches()
    return figure.add_axes((left / width, bottom / height, 1 - (left + right) / width, 1 - (bottom + top) / height))


def open_frame(axes: Axes) -> None:
    """Give axes short ticks, and a frame that is open at the top and at the right."""
    axes.tick_params(length=3, width=0.7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def returns_file(draw: Callable[P, Figure]) -> Callable[Concatenate[str, P], bytes]:
    """Let a function that draws a figure return its file. Its new first argument is the kind: svg, pdf or png."""

    @functools.wraps(draw)
    def render(kind: str, /, *args: P.args, **kwargs: P.kwargs) -> bytes:
        file = io.BytesIO()
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # equal runs give equal bytes
        with matplotlib.rc_context(_STYLE), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from font")  # an emoji in a name is drawn as a box
            back, dots = ("white", 160) if kind == "png" else ("none", 72)
            draw(*args, **kwargs).savefig(file, format=kind, facecolor=back, metadata=dates.get(kind), dpi=dots)
        return file.getvalue()

    return render
