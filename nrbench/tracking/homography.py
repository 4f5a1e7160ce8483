"""The homography that maps points of one plane to those of another, fitted to pairs of points with outliers."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Points

_ROUNDS: Final = 4
"""Number of fits; before each but the first, outliers are left out."""
_OUTLYING = 4.0
"""Distance, in median distances, above which a pair is an outlier."""
LEAST_PAIRS: Final = 12
"""Least number of pairs: a homography has 8 parameters, an affine map 6."""


def fit_homography(points: Points, images: Points) -> Points | None:
    """Return the 3 x 3 matrix H, H[2, 2] = 1, such that H (x, y, 1) is parallel to (x', y', 1) for most pairs.

    The direct linear transform minimizes an algebraic error; each further fit weights the equations such that their
    error is the distance in the image.

    Parameters
    ----------
    points, images
        ``(n, 2)`` each.

    Returns
    -------
    Points or None
        None if there are too few pairs, or if the horizon crosses the points.
    """
    if len(points) < LEAST_PAIRS:
        return None
    before, after = _normalization(points), _normalization(images)
    p, q = map_points(before, points), map_points(after, images)
    weights, kept = np.ones(len(p)), np.ones(len(p), np.bool_)
    matrix = np.eye(3)
    for _ in range(_ROUNDS):
        homogeneous = np.column_stack([p, np.ones(len(p))])
        nothing = np.zeros_like(homogeneous)
        equations = np.concatenate(
            [
                np.column_stack([homogeneous, nothing, -q[:, :1] * homogeneous]),
                np.column_stack([nothing, homogeneous, -q[:, 1:] * homogeneous]),
            ]
        )
        rows = np.tile(weights * kept, 2)[:, np.newaxis] * equations
        matrix = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
        depth = homogeneous @ matrix[2]
        if depth[kept].min() * depth[kept].max() <= 0:
            return None
        weights = 1 / np.maximum(np.abs(depth) / np.abs(depth[kept]).mean(), 1e-3)
        off = np.hypot(*(map_points(matrix, p) - q).T)
        kept = off <= _OUTLYING * max(float(np.median(off)), 1e-9)
    matrix = np.linalg.inv(after) @ matrix @ before
    return np.asarray(matrix / matrix[2, 2])


def map_points(matrix: Points, points: Points) -> Points:
    """Return the images of points ``(..., 2)`` under a homography."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def _normalization(points: Points) -> NDArray[np.float64]:
    """Return the similarity that moves the mean of points to 0 and their mean distance from it to sqrt 2 (Hartley)."""
    mean = points.mean(0)
    scale = np.sqrt(2) / max(float(np.hypot(*(points - mean).T).mean()), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])
