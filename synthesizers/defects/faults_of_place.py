"""Faults of place: content that lies where the lattice does not want it."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from nrbench.lattice.geometry import Points

from .planting import Field, Planting, Plot, read

_PATCH_TILES = 2.0
_WORST = 0.5
_SPLINE_MARGIN = 8


def none(plot: Plot) -> Planting:
    """Leave the fresh draw as it is."""
    return _moved(plot, plot.still())


def phase_step(plot: Plot) -> Planting:
    """Move everything beyond a line through the middle."""
    field = plot.still()
    half = np.s_[plot.shape[0] // 2 :] if plot.rng.integers(2) else np.s_[:, plot.shape[1] // 2 :]
    field[half] = plot.step()
    return _moved(plot, field)


def slipped_course(plot: Plot) -> Planting:
    """Slide one course along t1, by half of t1 at most."""
    courses = _Courses(plot, reach=plot.lattice.s)
    distance = min(plot.size * plot.lattice.s, courses.length / 2)
    field = plot.still()
    field[(courses.beyond >= 0) & (courses.beyond < 1)] = _whole(courses.sign * distance * courses.along)
    return _moved(plot, field, courses.margin)


def dropped_row(plot: Plot) -> Planting:
    """Take away a part of a course, half of it at most: everything beyond closes up."""
    courses = _Courses(plot, reach=plot.lattice.area / math.hypot(*plot.lattice.t1) / 2)
    field = plot.still()
    field[courses.beyond >= 0] = -_whole(min(plot.size, _WORST) * courses.height * courses.across)
    return _moved(plot, field, courses.margin)


def doubled_row(plot: Plot) -> Planting:
    """Draw a part of a course twice, half of it at most: everything beyond makes room."""
    courses = _Courses(plot, reach=plot.lattice.area / math.hypot(*plot.lattice.t1) / 2)
    step = _whole(min(plot.size, _WORST) * courses.height * courses.across)
    field = plot.still()
    field[courses.at(plot.pixels() - step) >= 0] = step
    return _moved(plot, field, courses.margin)


def displaced_tile(plot: Plot) -> Planting:
    """Move the content of one cell."""
    field = plot.still()
    field[plot.cell()] = plot.step()
    return _moved(plot, field)


def doubled_tile(plot: Plot) -> Planting:
    """Lay a copy of one cell over it and its neighbors, half of s away at most."""
    cell, step = plot.cell(), plot.step(_WORST)
    field = plot.still()
    y, x = np.nonzero(cell)
    x, y = x + step[0], y + step[1]
    seen = (x >= 0) & (y >= 0) & (x < plot.shape[1]) & (y < plot.shape[0])
    field[y[seen], x[seen]] = step
    return _moved(plot, field, 0)


def off_lattice(plot: Plot) -> Planting:
    """Move every patch of two tiles in a direction of its own."""
    field = plot.still()
    width, height = np.maximum(np.rint(_PATCH_TILES * plot.box), 1).astype(int)
    for top in range(0, plot.shape[0], height):
        for left in range(0, plot.shape[1], width):
            field[top : top + height, left : left + width] = plot.step()
    return _moved(plot, field)


def warp(plot: Plot) -> Planting:
    """Move content smoothly: white noise blurred by a Gaussian of standard deviation s, which correlates over 2 s."""
    scale = plot.lattice.s
    margin = math.ceil(3 * scale)
    noise = plot.rng.standard_normal((plot.shape[0] + 2 * margin, plot.shape[1] + 2 * margin, 2))
    smooth = gaussian_filter(noise, (scale, scale, 0), truncate=3, mode="constant")[margin:-margin, margin:-margin]
    field = smooth * (plot.size * scale / np.hypot(*np.moveaxis(smooth, -1, 0)).max())
    return _bent(plot, field, math.ceil(scale) + _SPLINE_MARGIN)


def stretch(plot: Plot) -> Planting:
    """Stretch along a random axis, away from the middle."""
    angle = plot.rng.uniform(0, math.pi)
    axis = np.array([math.cos(angle), math.sin(angle)])
    away = (plot.pixels() - (plot.room - 1) / 2) @ axis
    field = plot.size / (1 + plot.size) * away[..., np.newaxis] * axis
    moved = _bent(plot, field, _SPLINE_MARGIN)
    return Planting(moved.image, field, np.full(plot.shape, field.any()), f"{100 * plot.size:g} % at {angle:.2f} rad")


class _Courses:
    """The courses of a lattice: the rows along t1, their joints half-way between lattice points.

    ``margin`` is that of the draw, wide enough for content to move by ``reach`` px, whatever the size.
    """

    def __init__(self, plot: Plot, reach: float) -> None:
        self.margin = math.ceil(reach) + 1
        lattice = plot.lattice.shifted((-self.margin, -self.margin))
        self._lattice = lattice
        self.length = math.hypot(*lattice.t1)
        self.height = lattice.area / self.length
        self.along = lattice.matrix[0] / self.length
        right = np.array([-self.along[1], self.along[0]])
        self.across = right if right @ lattice.matrix[1] > 0 else -right
        self._chosen = np.rint(lattice.to_cell(plot.middling())[1])
        self.sign = 1 if plot.rng.integers(2) else -1
        self.beyond = self.at(plot.pixels())

    def at(self, points: Points) -> Points:
        """Return how far points lie beyond the near joint of the chosen course, in courses."""
        return np.asarray(self._lattice.to_cell(points)[..., 1] - self._chosen + 0.5)


def _whole(vector: Points) -> Field:
    return np.rint(vector).astype(np.intp)


def _moved(plot: Plot, field: Field, margin: int | None = None) -> Planting:
    """Plant a displacement: draw wider by as much as content moves, then read each pixel from where it came."""
    margin = int(np.abs(field).max()) if margin is None else margin
    return Planting(read(plot.fresh(margin), margin, field), field)


def _bent(plot: Plot, field: Points, margin: int) -> Planting:
    """Plant a displacement of parts of a pixel: cubic splines read between the pixels of a draw."""
    draw = plot.fresh(margin)
    if not field.any():
        return Planting(read(draw, margin, plot.still()), field)
    y, x = np.indices(plot.shape) + margin
    places = [y - field[..., 1], x - field[..., 0]]
    channels = [map_coordinates(plane, places, order=3, mode="mirror") for plane in np.moveaxis(draw, -1, 0)]
    return Planting(np.clip(np.stack(channels, -1), 0, 1).astype(np.float32), field)
