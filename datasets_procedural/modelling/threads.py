"""Threads that pass over and under each other by a draft."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .coordinates import Field, Index, nearest
from .shades import round_profile
from .shapes import coverage, stripe


@dataclass(frozen=True)
class Thread:
    """One family of threads, as seen at each point.

    Parameters
    ----------
    index
        Which thread it is.
    distance
        To its edge in px, negative inside.
    coverage
        The share of each pixel in which it is seen.
    shade
        Of a round thread that rises over the others and dives under them.
    """

    index: Index
    distance: Field
    coverage: Field
    shade: Field


def interlaced(
    x: Field, y: Field, spacings: tuple[float, float], gap: float, draft: NDArray[np.bool_], depth: float = 0.45
) -> tuple[Thread, Thread]:
    """Return warp and weft threads.

    Parameters
    ----------
    x, y
        The points in px; the origin is a crossing.
    spacings
        From a warp thread to the next along x, and from a weft thread to the next along y, in px.
    gap
        Between the threads, in px.
    draft
        Whether the warp lies above: a row for each weft thread, a column for each warp thread; it repeats.
    depth
        How dark the sides of a thread are.
    """
    (i, right), (j, down) = nearest(x, spacings[0]), nearest(y, spacings[1])
    sides = stripe(right, spacings[0] - gap), stripe(down, spacings[1] - gap)
    above = _looked_up(draft, i, j)
    warp, weft = (coverage(side) for side in sides)
    warp_next = _looked_up(draft, i, j + np.where(down >= 0, 1, -1))
    weft_next = _looked_up(draft, i + np.where(right >= 0, 1, -1), j)
    warp_shade = round_profile(right, spacings[0] - gap, depth) * _height(above, warp_next, down / spacings[1])
    weft_shade = round_profile(down, spacings[1] - gap, depth) * _height(~above, ~weft_next, right / spacings[0])
    warp_seen = np.where(above, warp, warp * (1 - weft))
    weft_seen = np.where(above, weft * (1 - warp), weft)
    return Thread(i, sides[0], warp_seen, warp_shade), Thread(j, sides[1], weft_seen, weft_shade)


def _looked_up(draft: NDArray[np.bool_], i: Index, j: Index) -> NDArray[np.bool_]:
    return np.asarray(draft[j % draft.shape[0], i % draft.shape[1]])


def _height(here: NDArray[np.bool_], beyond: NDArray[np.bool_], along: Field) -> Field:
    """Return the shade of a thread between two crossings, at each of which it lies above or below."""
    start, end = np.where(here, 1.0, -1.0), np.where(beyond, 1.0, -1.0)
    return np.asarray(0.78 + 0.22 * ((start + end) / 2 + (start - end) / 2 * np.cos(np.pi * along)))
