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
_PORTS = (2.6, 1.3, 0.6, 0.0)


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


def draw_captions(axes: Axes, anchors: Floats, texts: Sequence[str], slanted: Sequence[bool]) -> None:
    """Draw a caption for each point, in a column at the right of the axes, with a leader.

    Parameters
    ----------
    axes
        The plot. Its figure has 72 dots an inch.
    anchors
        ``(n, 2)``: the points, in pixels of the figure.
    texts
        The captions; a caption may have several lines.
    slanted
        Whether a caption is italic.
    """
    if not len(anchors):
        return
    frame = axes.get_window_extent()
    total = sum(text.count("\n") + 1 for text in texts) * LINE + 3.0 * len(texts)
    shrink = min(1.0, (frame.height + 2 * LINE) / total)
    heights = np.array([(text.count("\n") + 1) * LINE + 3.0 for text in texts]) * shrink
    order = np.lexsort((anchors[:, 0], -anchors[:, 1]))
    ports, places = lay_out_leaders(anchors[order], heights[order], frame.x1, (frame.y0 - LINE, frame.y1 + LINE))
    back = axes.transAxes.inverted()
    for index, port, place in zip(order, ports, places, strict=True):
        bend, end = (frame.x1 + 3, port), (frame.x1 + _GUTTER - 2, place)
        line = back.transform(np.array([anchors[index], bend, end]))
        axes.plot(*line.T, color=GRAY, lw=0.45, zorder=1, transform=axes.transAxes, clip_on=False)
        x, y = back.transform((frame.x1 + _GUTTER, place))
        axes.text(
            float(x),
            float(y),
            texts[index],
            transform=axes.transAxes,
            va="center",
            color=INK,
            fontsize=7 * shrink,
            linespacing=1.05,
            style="italic" if slanted[index] else "normal",
        )


def lay_out_leaders(
    anchors: Floats, heights: Floats, edge: float, limits: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Place captions of given heights so that they keep the order of their points, and leaders do not cross.

    A leader goes from its point straight to its port at the right edge, and from there to the caption. Points of equal
    height get ports that lie apart as far as no leaders cross; with ports at the height of the points the leaders are
    parallel.

    Parameters
    ----------
    anchors
        ``(n, 2)``: points from the highest to the lowest; among equally high ones from left to right.
    heights
        Heights of the captions.
    edge
        The x at which the ports lie, at the right of all points.
    limits
        Lowest and highest place of a caption.

    Returns
    -------
    ports, places
        The heights of the ports and of the middles of the captions.
    """
    gaps = (heights[:-1] + heights[1:]) / 2
    places = spread(anchors[:, 1], gaps, limits)
    for gap in _PORTS:
        ports = spread(anchors[:, 1], np.full(len(anchors) - 1, gap))
        if not count_crossings(anchors, ports, edge):
            break
    return ports, places


def spread(heights: Floats, gaps: Floats, limits: tuple[float, float] = (-np.inf, np.inf)) -> Floats:
    """Return the places nearest to falling ``heights`` that lie at least ``gaps`` apart, within limits if they fit."""
    below = np.concatenate([[0.0], np.cumsum(gaps)])
    level = np.asarray(isotonic_regression(heights + below, increasing=False).x, np.float64)
    within: Floats = np.minimum(np.maximum(level, limits[0] + below[-1]), limits[1]) - below
    return within


def count_crossings(anchors: Floats, ports: Floats, edge: float) -> int:
    """Count the pairs of leaders that cross between the points and the right edge."""
    starts = np.maximum(anchors[:, None, 0], anchors[None, :, 0])
    share = (starts - anchors[:, None, 0]) / np.maximum(edge - anchors[:, None, 0], 1e-9)
    first = anchors[:, None, 1] + share * (ports - anchors[:, 1])[:, None]
    gap = first - first.T
    end = ports[:, None] - ports[None, :]
    return int((np.triu(gap * end < -1e-9, 1)).sum())
