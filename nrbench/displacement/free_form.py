"""Multilevel free-form deformation: a smooth map of the plane that moves given points to given places."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import interpolate_planes
from nrbench.lattice.geometry import Points

TAPS: Final = 4
"""Control points along each axis that decide a value of a cubic B-spline."""
REPEATS: Final = 4
"""How often each grid takes what is left. Once, as in the paper, leaves 1.5 to 2.5 times the error between points."""
Controls = NDArray[np.float64]
"""``(rows, columns, 2)``: displacement (x, y) px of each control point."""


@dataclass(frozen=True, eq=False)
class FreeForm:
    """A displacement of the plane by a uniform cubic B-spline.

    Parameters
    ----------
    controls
        The displacements of the control points.
    start
        (x, y) px of the second control point along each axis, where the domain begins.
    spacing
        Distance of the control points, px.
    """

    controls: Controls
    start: Points
    spacing: float

    @classmethod
    def fit(cls, points: Points, displacements: Points, nearest: float, repeats: int = REPEATS) -> FreeForm:
        """Return the map that moves each point by its displacement: multilevel B-spline approximation.

        Lee, Wolberg and Shin 1997 (Scattered data interpolation with multilevel B-splines), algorithm MBA with
        refinement; their earlier name for it, when it deforms images, is multilevel free-form deformation. The coarsest
        grid of control points is as wide as the points spread. Each finer one, of half the spacing, takes what the
        coarser ones left, ``repeats`` times over. The finest is so fine that two points share no control point, so
        that the sum interpolates. Beyond the points the coarse grids continue the map. The condition that keeps the map
        one-to-one (Lee, Chwa and Shin 1995) is not imposed: it would change the given displacements. Time
        is linear in the points and in the area over ``nearest`` squared.

        Parameters
        ----------
        points, displacements
            ``(n, 2)`` px each, n at least 1.
        nearest
            Distance of the two nearest points, px. Points that are nearer to each other are approximated.
        repeats
            How often each grid takes what is left; once, as published, or several times, which brings it closer.

        Examples
        --------
        >>> points = np.array([(0.0, 0.0), (20.0, 0.0), (0.0, 20.0)])
        >>> moved = FreeForm.fit(points, np.array([(1.0, 0.0), (0.0, 2.0), (3.0, 3.0)]), 20.0)
        >>> moved.at(points).round(6).tolist()
        [[1.0, 0.0], [0.0, 2.0], [3.0, 3.0]]
        """
        low, high = points.min(0), points.max(0)
        spacing = max(float((high - low).max()), nearest)
        middle = (low + high) / 2
        cells = 1
        start = middle - spacing / 2
        controls = np.zeros((cells + 3, cells + 3, 2))
        rest = displacements
        while True:
            for _ in range(repeats):
                level = cls(approximate(points - start, rest, spacing, controls.shape[:2]), start, spacing)
                controls = controls + level.controls
                rest = rest - level.at(points)
            if TAPS * spacing <= nearest:
                return cls(controls, start, spacing)
            controls, spacing = refine(controls), spacing / 2

    def at(self, points: Points) -> Points:
        """Return the displacements at points ``(..., 2)`` px, as ``(..., 2)``. Outside the domain they are constant."""
        inside = np.clip((points - self.start) / self.spacing, 0, np.array(self.controls.shape[1::-1]) - 3) + 1
        return interpolate_planes(self.controls, np.moveaxis(inside, -1, 0)[::-1], 3, "nearest", prefilter=False)


def approximate(points: Points, values: Points, spacing: float, shape: tuple[int, int]) -> Controls:
    """Return the control points that approximate scattered values on one grid (Lee et al. 1997, algorithm BA).

    A point alone would set the control points around it so that their spline has its value there with the least sum of
    squares. A control point that several points set takes their mean, weighted by the squares of its spline's values.

    Parameters
    ----------
    points
        ``(n, 2)`` px from the domain's start.
    values
        ``(n, 2)``.
    spacing
        Distance of the control points, px.
    shape
        Rows and columns of control points.
    """
    last = np.array(shape[::-1]) - TAPS
    at = np.clip(points / spacing, 0, last + 1)
    first = np.minimum(np.floor(at).astype(np.intp), last)
    across, down = np.moveaxis(basis(at - first), 1, 0)
    weights = down[:, :, np.newaxis] * across[:, np.newaxis]
    squares = weights**2
    taps = np.arange(TAPS)
    index = (first[:, 1, np.newaxis] + taps)[:, :, np.newaxis] * shape[1] + (first[:, :1] + taps)[:, np.newaxis]
    shares = squares * weights / squares.sum((1, 2), keepdims=True)
    size = math.prod(shape)
    total = np.bincount(index.ravel(), squares.ravel(), size)
    shared = (shares * part[:, np.newaxis, np.newaxis] for part in values.T)
    sums = [np.bincount(index.ravel(), part.ravel(), size) for part in shared]
    return np.asarray(np.stack(sums, -1) / np.maximum(total, 1e-300)[:, np.newaxis]).reshape(*shape, 2)


def basis(t: Points) -> NDArray[np.float64]:
    """Return the four cubic B-splines at fractions t in [0, 1] of a step, along a new last axis."""
    u = 1 - t
    return np.stack([u**3, 3 * t**3 - 6 * t**2 + 4, 3 * u**3 - 6 * u**2 + 4, t**3], -1) / 6


def refine(controls: Controls) -> Controls:
    """Return the same spline on control points of half the spacing."""
    for axis in (0, 1):
        a = np.moveaxis(controls, axis, 0)
        fine = np.empty((2 * len(a) - 3, *a.shape[1:]))
        fine[0::2] = (a[:-1] + a[1:]) / 2
        fine[1::2] = (a[:-2] + 6 * a[1:-1] + a[2:]) / 8
        controls = np.moveaxis(fine, 0, axis)
    return controls
