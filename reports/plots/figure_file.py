"""The style of all plots, and their files."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

INK, GRAY, FAINT = "black", "0.45", "0.8"
SMALL: Any = {"color": GRAY, "fontsize": 7}
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "svg.hashsalt": "nrbench",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "axes.linewidth": 0.7,
}


def make_figure(width: float, height: float) -> Figure:
    """Return an empty figure; width in inches, height in points."""
    figure = Figure(figsize=(width, height / 72), dpi=72)
    FigureCanvasAgg(figure)
    return figure


def render_figure(draw: Callable[[], Figure], kind: str) -> bytes:
    """Return the figure that ``draw`` makes, as a file of a kind (``svg``, ``pdf``, ``png``) without a date."""
    with matplotlib.rc_context(_STYLE):
        file = io.BytesIO()
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        draw().savefig(file, format=kind, metadata=dates.get(kind), dpi=160 if kind == "png" else 72)
    return file.getvalue()
