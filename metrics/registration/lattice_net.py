"""The points of a picture in the order of its lattice, and its values on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.masks import known_at
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Shape

from ..perception import limits
from .net_kernels import average_blocks, interpolate_pixels

Values = NDArray[np.float32]
Mask = NDArray[np.bool_]
_BAND = 1 << 19
"""Number of points of which a larger net is divided into bands."""


@dataclass(frozen=True)
class LatticeNet:
    """A net of points that holds n1 x n2 samples of each cell, so that a cell is a rectangle of an array.

    Parameters
    ----------
    shape
        Shape of the picture.
    vectors
        ``(2, 2)``: the generating vectors, reduced, as rows (x, y) px.
    origin
        (x, y) px of a lattice point.
    known
        The pixels of the picture that count; None: all.
    """

    shape: Shape
    vectors: Points
    origin: Points
    known: Mask | None = None

    @cached_property
    def s(self) -> float:
        """Length of the shortest lattice vector, px."""
        return float(np.linalg.norm(self.vectors, axis=1).min())

    @cached_property
    def area(self) -> float:
        """Area of a cell, px^2."""
        return abs(float(np.linalg.det(self.vectors)))

    @property
    def shown(self) -> float:
        """Number of cells that the picture shows, by its area."""
        return self.shape[0] * self.shape[1] / self.area

    @cached_property
    def samples(self) -> NDArray[np.intp]:
        """(n1, n2): samples of a cell along each vector, a multiple of the number of places."""
        most = limits.MOST_SAMPLES // limits.PLACES
        multiples = np.clip(np.rint(np.linalg.norm(self.vectors, axis=1) / limits.PLACES), 1, most)
        return np.asarray(limits.PLACES * multiples, np.intp)

    @cached_property
    def _range(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        height, width = self.shape
        corners = np.array([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)]) - self.origin
        numbers = corners @ np.linalg.inv(self.vectors)
        return np.floor(numbers.min(0)).astype(np.intp), np.ceil(numbers.max(0)).astype(np.intp)

    @property
    def first(self) -> NDArray[np.intp]:
        """Cell coordinates of the first point."""
        return self._range[0]

    @cached_property
    def cells(self) -> NDArray[np.intp]:
        """(N1, N2): number of cells along each vector, those outside the picture included."""
        return np.asarray(self._range[1] - self._range[0])

    def to_cell(self, points: NDArray[Any]) -> Points:
        """Return the cell coordinates of points (x, y) px, from the first point of the net."""
        return np.asarray((points - self.origin) @ np.linalg.inv(self.vectors) - self.first)

    def locate_pixels(self, shape: Shape, top: int) -> NDArray[np.float64]:
        """Return the cell coordinates of pixels from row ``top`` on, ``(2, H, W)``, from the first point of the net."""
        (a, b), (c, d) = np.linalg.inv(self.vectors)
        (u, v), (y, x) = self.to_cell(np.zeros(2)), np.ogrid[top : top + shape[0], : shape[1]]
        return np.stack([u + x * a + y * c, v + x * b + y * d])

    @cached_property
    def points(self) -> Points:
        """``(N1 n1, N2 n2, 2)``: (x, y) px of all points."""
        steps = [
            first + np.arange(cells * n) / n
            for first, cells, n in zip(self.first, self.cells, self.samples, strict=True)
        ]
        return np.asarray(np.stack(np.meshgrid(*steps, indexing="ij"), -1) @ self.vectors + self.origin)

    @cached_property
    def inside(self) -> Mask:
        """``(N1 n1, N2 n2)``: the points inside the picture that count."""
        return np.concatenate([part.contains(part.points) for part in self.parts()])

    def contains(self, points: Points, border: int = 0) -> Mask:
        """Return which points lie inside the picture, ``border`` px from its sides or more, and count."""
        inside = find_inside(points - border, (self.shape[0] - 2 * border, self.shape[1] - 2 * border))
        return inside if self.known is None else inside & known_at(self.known, points)

    def cut_strips(self, axis: int, count: int) -> list[Mask]:
        """Return the points of each of ``count`` strips of the picture, side by side along x (axis 0) or y (axis 1)."""
        edges = np.linspace(0, self.shape[1 - axis], count + 1)
        places = (np.ascontiguousarray(part.points[..., axis]) for part in self.parts())
        found = [[(place >= low) & (place < high) for low, high in pairwise(edges)] for place in places]
        return [np.concatenate(own) for own in zip(*found, strict=True)]

    def tile(self, cell: Values) -> Values:
        """Repeat a cell ``(n1, n2, ...)`` over the whole net."""
        return np.tile(cell, (*self.cells, *(1,) * (cell.ndim - 2)))

    @cached_property
    def _others(self) -> dict[Shape, LatticeNet]:
        return {}

    def over(self, shape: Shape) -> LatticeNet:
        """Return the net over another picture, all of which counts; the last one is kept with its points for the next.

        Most outputs of a texture have one shape.
        """
        if shape not in self._others:
            self._others.clear()
            self._others[shape] = replace(self, shape=shape, known=None)
        return self._others[shape]

    def stretch(self, drift: Points | float) -> LatticeNet:
        """Return the net stretched and turned by a drift, ``(2, 2)``, with as many samples of each cell as before."""
        net = replace(self, vectors=self.vectors @ (np.eye(2) + drift))
        vars(net)["samples"] = self.samples
        return net

    def bands(self, beyond: int = 0) -> list[tuple[int, int]]:
        """Return the first and the last cell, less ``beyond``, of bands of the net along the first vector.

        A net of up to half a million points has one band, so that little is held of a large picture at a time.
        """
        last, points = max(int(self.cells[0]) - beyond, 1), int(self.cells.prod() * self.samples.prod())
        step = last if points <= _BAND else max(_BAND * int(self.cells[0]) // points, 1)
        return [(first, min(first + step, last)) for first in range(0, last, step)]

    def cut(self, first: int, last: int) -> LatticeNet:
        """Return the part of the net from one cell to another along the first vector."""
        if last - first == self.cells[0]:
            return self
        net, (low, high) = replace(self), self._range
        ends = np.array([low[0] + first, low[1]]), np.array([low[0] + last, high[1]])
        vars(net).update(samples=self.samples, _range=ends)
        return net

    def parts(self) -> Iterator[LatticeNet]:
        """Yield the nets of all bands."""
        return (self.cut(*band) for band in self.bands())

    def sample(self, planes: Values, known: Mask, scale: float = 1.0, into: Values | None = None) -> Values:
        """Return the values of planes ``(H, W, C)`` at known points, times a scale; ``into`` is filled with them."""
        planes, first = np.ascontiguousarray(planes), 0
        found = np.empty((*self.cells * self.samples, planes.shape[-1]), np.float32) if into is None else into
        for part in self.parts():
            last = first + int(part.cells[0] * self.samples[0])
            found[first:last], first = sample_planes(planes, part.points * scale, known[first:last]), last
        return found

    def spread(self, cells: NDArray[Any]) -> NDArray[Any]:
        """Return the values of cells, ``(N1, N2)``, at all of their points."""
        return cells.repeat(self.samples[0], 0).repeat(self.samples[1], 1)

    def half_cells(self, planes: Values, known: Mask) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the means of planes over half cells, where a point is unknown as 0, and the known share of each."""
        return average_blocks(planes, known, *self.samples // 2)


def find_inside(points: Points, shape: Shape) -> Mask:
    """Return which points lie inside a picture of ``shape``."""
    x, y = points[..., 0], points[..., 1]
    return np.asarray((x >= 0) & (x <= shape[1] - 1) & (y >= 0) & (y <= shape[0] - 1))


def sample_planes(planes: Values, points: Points, known: Mask | None = None) -> Values:
    """Return the values of planes ``(H, W, C)`` at points (x, y), interpolated linearly; 0 where they are not known."""
    places = np.ascontiguousarray(points, np.float64).reshape(-1, 2)
    counted = np.ones(len(places), np.bool_) if known is None else known.ravel()
    found = interpolate_pixels(np.ascontiguousarray(planes), places, counted)
    return found.reshape(*points.shape[:-1], planes.shape[-1])


def split_cells(a: NDArray[Any], samples: NDArray[np.intp] | tuple[int, int]) -> NDArray[Any]:
    """Return an array in the order of a net, ``(N1 n1, N2 n2, ...)``, cell by cell: ``(N1, N2, n1, n2, ...)``."""
    n1, n2 = samples
    return a.reshape(a.shape[0] // n1, n1, a.shape[1] // n2, n2, *a.shape[2:]).swapaxes(1, 2)


def fold_cells(planes: Values, known: Mask, samples: NDArray[np.intp]) -> Values:
    """Return the mean of all cells, ``(n1, n2, C)``, over the known points."""
    cells, weights = split_cells(planes, samples), split_cells(known, samples)[..., np.newaxis]
    total = np.where(weights, cells, 0).sum((0, 1), dtype=np.float64)
    return np.asarray(total / np.maximum(weights.sum((0, 1)), 1), np.float32)


def sum_boxes(a: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return the sums of ``size`` x ``size`` neighbors along the first two axes."""
    rows, columns = a.shape[0] - size + 1, a.shape[1] - size + 1
    down = sum((a[k : k + rows] for k in range(1, size)), a[:rows])
    return sum((down[:, k : k + columns] for k in range(1, size)), down[:, :columns])
