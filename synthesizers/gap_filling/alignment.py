"""Small moves that make a patch meet what is around it, by Lucas and Kanade's steps (1981).

Both pictures are compared where a weight says; a step moves each point by the least-squares solution of
``gradient . move = old - new``, so that where both agree already nothing moves at all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

Map = NDArray[np.float64]
DAMPING: Final = 1e-4
"""Added to the mean squared gradient, in squared values (0 to 1) a px: gray levels of noise move nothing."""


def moved_to_meet(shown: Callable[[Points], Image], place: Points, old: Image, weight: Map, steps: int = 2) -> Points:
    """Return the place at which a patch meets its surroundings best.

    Parameters
    ----------
    shown
        The patch at a place (x, y), ``(h, w, C)``.
    place
        Where to start, at most about a pixel away.
    old
        ``(h, w, C)``: what it is to meet.
    weight
        ``(h, w)``, not negative: where that is known.
    steps
        How often.

    Returns
    -------
    Points
        (x, y); each step moves by half a pixel at most along x and y.
    """
    for _ in range(steps):
        tensor, slope = _terms(old, shown(place))
        total = max(float(weight.sum()), 1e-12)
        (xx, xy, yy), (ex, ey) = ([float((weight * part).sum()) / total for part in parts] for parts in (tensor, slope))
        matrix = np.array([[xx + DAMPING, xy], [xy, yy + DAMPING]])
        place = place + np.clip(np.linalg.solve(matrix, [ex, ey]), -0.5, 0.5)
    return place


def field_to_meet(
    shown: Callable[[Map], Image], old: Image, weight: Map, fade: Map, limit: float, steps: int = 3
) -> Map:
    """Return the smooth field of displacements with which a patch meets its surroundings best.

    Parameters
    ----------
    shown
        The patch under a displacement of each pixel, ``(h, w, 2)``.
    old, weight
        As in :func:`moved_to_meet`.
    fade
        ``(h, w)`` in [0, 1]: the share of the displacement that is allowed; 0 where nothing may move.
    limit
        Largest displacement, px.
    steps
        How often.

    Returns
    -------
    Map
        ``(h, w, 2)`` (x, y) px: smooth over about a third of the weight's reach.
    """
    sigma = max(2.0, 0.08 * max(old.shape[:2]))
    share = np.maximum(ndimage.gaussian_filter(weight, sigma), 1e-6)
    field = np.zeros((*old.shape[:2], 2))
    for _ in range(steps):
        tensor, slope = _terms(old, shown(field))
        xx, xy, yy, ex, ey = (ndimage.gaussian_filter(weight * part, sigma) / share for part in (*tensor, *slope))
        xx, yy = xx + DAMPING, yy + DAMPING
        determinant = xx * yy - xy**2
        step = np.stack([yy * ex - xy * ey, xx * ey - xy * ex], -1) / determinant[..., np.newaxis]
        field = _bounded(field + fade[..., np.newaxis] * step, fade * limit)
    return field


def _terms(old: Image, new: Image) -> tuple[tuple[Map, Map, Map], tuple[Map, Map]]:
    """Return each pixel's products of gradients (xx, xy, yy), and of gradient and difference (x, y)."""
    y, x = (np.asarray(part, np.float64) for part in np.gradient(new, axis=(0, 1)))
    difference = (old - new).astype(np.float64)
    xx, xy, yy, ex, ey = (
        np.einsum("ijk,ijk->ij", *two) for two in ((x, x), (x, y), (y, y), (x, difference), (y, difference))
    )
    return (xx, xy, yy), (ex, ey)


def _bounded(field: Map, limit: Map) -> Map:
    """Return the field, shortened where it is longer than allowed."""
    length = np.maximum(np.hypot(field[..., 0], field[..., 1]), 1e-12)
    return np.asarray(field * np.minimum(1.0, limit / length)[..., np.newaxis])
