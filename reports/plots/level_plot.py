"""Plot where each method breaks: its quality at each level of a difficulty, one panel for each difficulty."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..statistics.comparison import Method
from ..statistics.levels import BROKEN, LevelPanel
from .figure_file import COLORS, FAINT, GRAY, INK, SIGNS, SMALL, make_figure, render_figure

_REFERENCE_SIGNS = "d<"
_WIDEST = 2.9
"""Width of a panel with its labels, inches, at least."""
_LONGEST = 26
"""Characters of a label, at most."""
_LETTER = 3.75
"""Mean width of a letter of a label, points."""
_LEFT = 32.0
_TOP = 16.0
_BOTTOM = 22.0
_NOTE = 14.0
_LINE = 8.5
"""Distance of the labels, points."""


def plot_levels(panels: Sequence[LevelPanel], kind: str, width: float = 5.5) -> bytes:
    """Return the panels as a file of a kind (``svg``, ``pdf``, ``png``); the same panels give the same bytes.

    Parameters
    ----------
    panels
        At least one.
    kind
        The kind of file.
    width
        Width in inches. The number of columns follows from it.
    """
    return render_figure(partial(_levels_figure, panels, width), kind)


def _levels_figure(panels: Sequence[LevelPanel], width: float) -> Figure:
    columns = min(len(panels), max(1, int(width / _WIDEST + 0.15)))
    rows = -(-len(panels) // columns)
    methods = [series.method for series in panels[0].series]
    labels, source = _shorten_labels(methods)
    styles = _line_styles(methods)
    plot_height = max(92.0, _LINE * len(methods) + 4)
    height, across = _TOP + plot_height + _BOTTOM, 72 * width / columns
    total = rows * height + _NOTE
    beside = _LEFT + 16 + _LETTER * max(map(len, labels))
    figure = make_figure(width, total)
    for i, panel in enumerate(panels):
        row, column = divmod(i, columns)
        box = (column * across + _LEFT, total - (row + 1) * height + _BOTTOM, across - beside, plot_height)
        axes = figure.add_axes((box[0] / (72 * width), box[1] / total, box[2] / (72 * width), box[3] / total))
        _draw_panel(axes, panel, labels, styles, plot_height)
    note = f"Below the gray line at {BROKEN:g} a method breaks.{source} References are gray."
    figure.text(0.5, 3 / total, note, ha="center", **SMALL)
    return figure


def _shorten_labels(methods: Sequence[Method]) -> tuple[list[str], str]:
    """Return the labels, and a sentence that names the source of the lattice if the labels leave it out."""
    sources = {method.lattice_source for method in methods if not method.reference} - {"none"}
    labels = [method.name if len(sources) == 1 else method.label for method in methods]
    short = [label if len(label) <= _LONGEST else f"{label[: _LONGEST - 1]}…" for label in labels]
    return short, f" Lattice: {sources.pop()}." if len(sources) == 1 else ""


def _line_styles(methods: Sequence[Method]) -> list[dict[str, Any]]:
    """Return the color, the sign and the dashes of each method; references are gray."""
    styles: list[dict[str, Any]] = []
    for method in methods:
        place = sum(other.reference == method.reference for other in methods[: len(styles)])
        signs = _REFERENCE_SIGNS if method.reference else SIGNS
        color = GRAY if method.reference else COLORS[place % len(COLORS)]
        dashes = "-" if place < len(signs) else "--"
        styles.append({"color": color, "marker": signs[place % len(signs)], "ls": dashes})
    return styles


def _draw_panel(
    axes: Axes, panel: LevelPanel, labels: Sequence[str], styles: Sequence[dict[str, Any]], height: float
) -> None:
    last = len(panel.levels) - 1
    axes.set(xlim=(-0.15, last + 0.15), ylim=(-0.04, 1.04), xticks=range(last + 1), yticks=(0, BROKEN, 1))
    axes.set_xticklabels([f"{level:g}" for level in panel.levels])
    axes.set_title(panel.departure, loc="left", fontsize=8, pad=4)
    axes.set_ylabel("quality", labelpad=2)
    axes.axhline(BROKEN, color=FAINT, lw=0.6, zorder=0)
    axes.tick_params(length=3, width=0.7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    shown = [one for one in zip(panel.series, labels, styles, strict=True) if one[0].scored]
    for series, _, style in shown:
        levels, values = zip(*series.scored, strict=True)
        order = 2 if series.method.reference else 3
        axes.plot(levels, values, lw=1.1, ms=4.6, mew=0.5, mec="white", zorder=order, clip_on=False, **style)
    ends = np.array([series.scored[-1] for series, _, _ in shown])
    heights = spread_labels(ends[:, 1], 1.08 * _LINE / height)
    for (series, label, style), end, y in zip(shown, ends.tolist(), heights.tolist(), strict=True):
        _draw_label(axes, label, series.method.reference, style["color"], end, (last + 0.15, y))


def _draw_label(
    axes: Axes, label: str, reference: bool, color: str, end: tuple[float, float], place: tuple[float, float]
) -> None:
    """Write the name of a method to the right of the panel, with a dotted line to its last point."""
    text = axes.annotate(
        label,
        place,
        (9, 0),
        textcoords="offset points",
        va="center",
        annotation_clip=False,
        fontsize=6.5,
        color=GRAY if reference else INK,
        style="italic" if reference else "normal",
    )
    line = {"arrowstyle": "-", "color": color, "lw": 0.7, "ls": (0, (1, 1.5)), "shrinkA": 1, "shrinkB": 3}
    axes.annotate("", end, (0, 0.5), textcoords=text, annotation_clip=False, arrowprops=line)


def spread_labels(heights: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
    """Move the heights of labels apart, as little as possible, and keep their order.

    Labels that are nearer to each other than ``distance`` become a block of even spacing about their mean.

    Parameters
    ----------
    heights
        Heights of the labels, one-dimensional.
    distance
        The least distance of two labels, in the unit of the heights.

    Returns
    -------
    numpy.ndarray
        The heights, ``distance`` or more apart.
    """
    order = np.argsort(-heights, kind="stable")
    blocks: list[list[int]] = []

    def middle(block: list[int]) -> float:
        return float(heights[block].mean())

    for i in order:
        blocks.append([int(i)])
        while len(blocks) > 1:
            above, below = blocks[-2:]
            if middle(above) - middle(below) >= distance * (len(above) + len(below)) / 2:
                break
            blocks[-2:] = [above + below]
    placed = np.empty(len(heights))
    for block in blocks:
        placed[block] = middle(block) + distance * ((len(block) - 1) / 2 - np.arange(len(block)))
    return placed
