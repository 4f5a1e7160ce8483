"""Label the points of a plot in a column beside it, ordered by height, with leaders that do not cross."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from .figure_file import GRAY, INK

Floats = NDArray[np.float64]
LINE = 8.6
"""Height of a line of a caption, pt."""
MOST_NAMES = 20
"""Most points of a plot that have names; names of more would be too small to read."""
_GUTTER = 20.0


def choose_named(references: Sequence[bool]) -> list[bool]:
    """Return which points of a plot have names: the references and the first others, :data:`MOST_NAMES` in total."""
    left = MOST_NAMES - sum(references)
    return [reference or sum(not one for one in references[:i]) < left for i, reference in enumerate(references)]


def describe_unnamed(named: Sequence[bool]) -> str:
    """Return the sentence that explains points without names; empty if all points have one."""
    rest = len(named) - sum(named)
    if not rest:
        return ""
    return f"The best methods and the references have names and intervals; {rest} further methods have neither."


def draw_captions(
    axes: Axes, anchors: Floats, texts: Sequence[str], slanted: Sequence[bool], colors: Sequence[str] = ()
) -> None:
    """Draw a caption for each point, in a column at the right of the axes, with a leader.

    A leader goes from its point straight to the right edge, and from there to the caption. The captions have the order
    of the heights of the points, so leaders do not cross.

    Parameters
    ----------
    axes
        The plot. Its figure has 72 dots an inch.
    anchors
        ``(n, 2)``: the points, in the units of the axes.
    texts
        The captions; a caption may have several lines.
    slanted
        Whether a caption is italic.
    colors
        The colors of the leaders; by default they are gray.
    """
    if not len(anchors):
        return
    frame, back = axes.get_window_extent(), axes.transAxes.inverted()
    heights = np.array([(text.count("\n") + 1) * LINE + 3.0 for text in texts])
    shrink = min(1.0, (frame.height + 2 * LINE) / heights.sum())
    points = axes.transData.transform(anchors)
    order = np.lexsort((points[:, 0], -points[:, 1]))
    sorted_heights = heights[order] * shrink
    gaps = (sorted_heights[:-1] + sorted_heights[1:]) / 2
    places = spread(points[order, 1], gaps, (frame.y0 - LINE, frame.y1 + LINE))
    for index, place in zip(order, places, strict=True):
        x, y = points[index]
        line = back.transform([(x, y), (frame.x1 + 3, y), (frame.x1 + _GUTTER - 2, place)])
        color = colors[index] if colors else GRAY
        axes.plot(*line.T, color=color, lw=0.45, zorder=1, transform=axes.transAxes, clip_on=False)
        left, middle = back.transform((frame.x1 + _GUTTER, place))
        axes.text(
            left,
            middle,
            texts[index],
            transform=axes.transAxes,
            va="center",
            color=INK,
            fontsize=7 * shrink,
            linespacing=1.05,
            style="italic" if slanted[index] else "normal",
        )


def spread(heights: Floats, gaps: Floats, limits: tuple[float, float] = (-np.inf, np.inf)) -> Floats:
    """Return the places nearest to falling ``heights`` that lie at least ``gaps`` apart, within limits if they fit."""
    below = np.concatenate([[0.0], np.cumsum(gaps)])
    level = np.asarray(isotonic_regression(heights + below, increasing=False).x, np.float64)
    within: Floats = np.minimum(np.maximum(level, limits[0] + below[-1]), limits[1]) - below
    return within
