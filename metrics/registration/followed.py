"""Follow the lattice through a picture: where each cell lies, which are in place, and the straightened picture.

The judge of the perils follows outputs by this registration and not by :mod:`nrbench.displacement`, by which methods
straighten their samples and bend their outputs: no contestant judges. Its windows are compared with cells of the
references alone, so that an error of the methods' code is not repeated where their outputs are judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
import scipy.signal
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.lattice.geometry import Points

from ..perception import limits
from ..perception.visible import Lab
from .lattice_net import LatticeNet, Mask, Values, find_inside, fold_cells, sample_planes, split_cells
from .net_kernels import measure_lengths

Field = NDArray[np.float64]
"""``(R, C, 2)``: displacements of windows, in cell coordinates."""
_REACH = 2
"""Half width, in nodes (half cells), of the surroundings that predict the displacement of a node."""
_SIDE, _ALONG = 4, 2
"""Depth and half length, in nodes, of the two sides of a line whose displacements are compared."""
_MOST_ROUNDS = 300


@dataclass(frozen=True)
class CellModel:
    """The mean cell of a texture and the variance of its points from cell to cell.

    Parameters
    ----------
    mean, variance
        ``(n1, n2, 3)`` each, in L*, a*, b*.
    """

    mean: Values
    variance: Values

    @classmethod
    def fold(cls, planes: Sequence[Values], known: Sequence[Mask], net: LatticeNet, pooled: bool) -> CellModel:
        """Estimate the model from straightened pictures in the order of one net.

        Parameters
        ----------
        planes, known
            The pictures, and their known points.
        net
            The net.
        pooled
            Whether variances are averaged over 3 x 3 points, because the cells are few.
        """
        mean = np.mean([fold_cells(p, k, net.samples) for p, k in zip(planes, known, strict=True)], 0)
        rest = [(p - net.tile(mean)) ** 2 for p in planes]
        counts = [max(float(k.sum()) / float(net.samples.prod()), 1.5) for k in known]
        variances = [fold_cells(r, k, net.samples) * c / (c - 1) for r, k, c in zip(rest, known, counts, strict=True)]
        variance = np.mean(variances, 0)
        return cls(mean, ndimage.uniform_filter(variance, (3, 3, 1), mode="wrap") if pooled else variance)


@dataclass(frozen=True)
class Strips:
    """Parallel strips of a picture, each with a model of its own.

    Parameters
    ----------
    axis
        0: the strips divide x, 1: they divide y.
    edges
        ``(k + 1,)`` px.
    """

    axis: int
    edges: Points

    def number(self, points: Points) -> NDArray[np.intp]:
        """Return the number of the strip in which each point lies."""
        found = np.searchsorted(self.edges, points[..., self.axis]) - 1
        return np.clip(found, 0, len(self.edges) - 2)


@dataclass(frozen=True)
class FollowedPicture:
    """A picture through which the lattice is followed.

    Windows of ``size`` x ``size`` cells at every half cell are averaged to one cell and compared with the model at all
    displacements, modulo the lattice: the misfit is the mean of (window - mean)^2 / (variance / size^2 + JND^2). Points
    that vary from cell to cell count little, joints count much. The displacement of a window (a node) is the one with
    the smallest misfit.

    Nodes are *in place* if they lie where the nodes around them that are in place put them, to within ``limit``. The
    set grows from the place where most neighbors agree, so smooth bending and drift leave all nodes in place, while
    what is beyond a slip is not reached.

    Parameters
    ----------
    lab
        The picture.
    net
        Its net.
    models
        The model of the cell, or one for each strip.
    limit
        Largest departure of a node in its place, in s.
    size
        Side of the windows in cells.
    strips
        The strips, if there are several models.
    offset
        (3,): added to the picture before the comparison, so that its mean color is that of the texture.
    """

    lab: Lab
    net: LatticeNet
    models: Sequence[CellModel]
    limit: float
    size: int
    strips: Strips | None = None
    offset: Values | float = 0.0

    @cached_property
    def plane(self) -> Values:
        """The picture on the points of the net, where it is not straightened."""
        return np.asarray(sample_planes(self.lab[..., :3], self.net.points) + self.offset, np.float32)

    @cached_property
    def _fit(self) -> tuple[Field, Values, Mask]:
        return self._fit_windows(self.size)

    @property
    def valid(self) -> Mask:
        """``(R, C)``: the nodes whose windows lie inside the picture."""
        return self._fit[2]

    @cached_property
    def contrast(self) -> Values:
        """How much worse each node's window fits at the worst displacement than at the best; 0 in a flat window."""
        return np.asarray(np.ptp(self._fit[1], axis=(2, 3)))

    @property
    def displacement(self) -> Field:
        """Displacement of each node, modulo the lattice."""
        return self._fit[0]

    @cached_property
    def _growth(self) -> tuple[Mask, Field]:
        return _grow(self.displacement, self.valid, self.net.vectors, self.limit * self.net.s)

    @property
    def in_place(self) -> Mask:
        """The nodes in their places."""
        return self._growth[0]

    @property
    def expected(self) -> Field:
        """Displacement that the nodes in place predict for each node; continuous, not modulo the lattice."""
        return self._growth[1]

    @cached_property
    def away(self) -> Values:
        """Distance in s of each node from where it is expected."""
        return np.asarray(_length(self.displacement - self.expected, self.net.vectors) / self.net.s)

    @cached_property
    def misfit(self) -> Values:
        """Misfit of the single cell in the middle of each node's window, at the expected displacement."""
        costs = self._fit_windows(1)[1] if self.size > 1 else self._fit[1]
        wide = self.size - 1
        costs = costs[wide : costs.shape[0] - wide, wide : costs.shape[1] - wide]
        rows, columns = np.indices(self.valid.shape)
        i, j = np.moveaxis(np.rint(self.expected * self.net.samples).astype(int) % self.net.samples, -1, 0)
        return np.asarray(costs[rows, columns, i, j])

    @cached_property
    def slip(self) -> NDArray[np.float64]:
        """Largest difference in s of the mean displacements on both sides of each node, over four directions."""
        return _compare_sides(self) / self.net.s

    @cached_property
    def centers(self) -> Points:
        """``(R, C, 2)``: (x, y) px of the middles of the nodes' windows."""
        return self._centers(self.size)

    def _centers(self, size: int) -> Points:
        numbers = np.moveaxis(np.indices(_node_shape(self.net, size)), 0, -1) / 2 + size / 2 + self.net.first
        return np.asarray(numbers @ self.net.vectors + self.net.origin)

    @cached_property
    def drift(self) -> Points:
        """2 x 2 matrix: the affine part of the displacement of the nodes in place, px a px."""
        points, moved = self.centers[self.in_place], (self.expected @ self.net.vectors)[self.in_place]
        if len(points) < 4:
            return np.zeros((2, 2))
        design = np.column_stack([points - points.mean(0), np.ones(len(points))])
        return np.asarray(np.linalg.lstsq(design, moved, rcond=None)[0][:2])

    @cached_property
    def bending(self) -> float:
        """Root mean square displacement in s of the nodes in place, less its affine part."""
        if self.in_place.sum() < 4:
            return 0.0
        moved = (self.expected @ self.net.vectors)[self.in_place] - self.centers[self.in_place] @ self.drift
        return float(np.sqrt(((moved - moved.mean(0)) ** 2).sum(1).mean()) / self.net.s)

    @cached_property
    def straightened(self) -> tuple[Values, Mask]:
        """The picture with each point at its expected place, and the points that are known and in place."""
        sides = self.plane.shape[:2]
        rows, columns = (
            _spread_matrix(side, n, self.size, nodes)
            for side, n, nodes in zip(sides, self.net.samples, self.valid.shape, strict=True)
        )
        planes = np.concatenate([self.expected, self.in_place[..., np.newaxis]], -1)
        spread = np.stack([rows @ plane @ columns.T for plane in np.moveaxis(planes, -1, 0)], -1)
        moved, known = spread[..., :2] @ self.net.vectors, spread[..., 2] > 0.5
        points = self.net.points + moved
        shape = (self.lab.shape[0], self.lab.shape[1])
        return sample_planes(self.lab[..., :3], points), known & find_inside(points, shape)

    @cached_property
    def residual(self) -> tuple[Values, Mask]:
        """The straightened picture less the model's mean cell, and its known points."""
        plane, known = self.straightened
        means = [self.net.tile(model.mean) for model in self.models]
        if self.strips is None:
            return plane - means[0], known
        return plane - np.choose(self.strips.number(self.net.points)[..., np.newaxis], means), known

    def _fit_windows(self, size: int) -> tuple[Field, Values, Mask]:
        """Return displacements, misfits at all displacements ``(R, C, n1, n2)``, and the nodes inside the picture."""
        windows, cover = _average_windows(self.plane, self.net, size)
        found = [_compare(windows, model, size) for model in self.models]
        if self.strips is None:
            places, costs = found[0]
        else:
            number = self.strips.number(self._centers(size))
            places = np.choose(number[..., np.newaxis], [f[0] for f in found])
            costs = np.choose(number[..., np.newaxis, np.newaxis], [f[1] for f in found])
        return places, costs, cover > 0.97


def _spread_matrix(side: int, samples: int, size: int, nodes: int) -> NDArray[np.float64]:
    """Return the weights of nodes in each sample along a vector, ``(side, nodes)``: linear, and constant beyond."""
    at = np.clip(np.arange(side) / samples * 2 - size, 0, nodes - 1)
    return np.asarray(np.maximum(1 - np.abs(at[:, np.newaxis] - np.arange(nodes)), 0))


def _node_shape(net: LatticeNet, size: int) -> tuple[int, int]:
    """Return the number of windows along each vector."""
    rows, columns = 2 * (net.cells - size) + 1
    return int(rows), int(columns)


def _average_windows(plane: Values, net: LatticeNet, size: int) -> tuple[Values, Values]:
    """Average the cells of each window, ``(R, C, n1, n2, 3)``, and return which share of it lies inside the picture.

    A point that lies outside in all cells has the value at the nearest border.
    """
    half = net.samples // 2
    shape = _node_shape(net, size)
    windows, cover = np.zeros((*shape, *net.samples, 3), np.float32), np.zeros(shape, np.float32)
    for a, b in np.ndindex(2, 2):
        y, x = a * half[0], b * half[1]
        part = np.s_[y : plane.shape[0] - y, x : plane.shape[1] - x]
        known = split_cells(np.where(net.inside[part], np.float32(1), np.float32(1e-3)), net.samples)
        cells = split_cells(plane[part], net.samples) * known[..., np.newaxis]
        sums, counts = (_sum_windows(a, size) for a in (cells, known))
        if counts.size:
            windows[a::2, b::2] = np.roll(sums / counts[..., np.newaxis], (y, x), (2, 3))
            cover[a::2, b::2] = counts.mean((2, 3)) / size**2
    return windows, cover


def _sum_windows(a: Values, size: int) -> Values:
    rows, columns = a.shape[0] - size + 1, a.shape[1] - size + 1
    total = np.zeros((rows, columns, *a.shape[2:]), np.float32)
    for i, j in np.ndindex(size, size):
        total += a[i : i + rows, j : j + columns]
    return total


def _compare(windows: Values, model: CellModel, size: int) -> tuple[Field, Values]:
    """Return the displacement of each window with the smallest misfit, to fractions of a sample, and all misfits.

    With w = 1 / (variance / size^2 + JND^2) the misfit at a displacement is sum w x^2 - 2 sum w m x + sum w m^2, mean
    over the points of the cell: two cyclic correlations, by FFT.
    """
    samples = model.mean.shape[:2]
    weights = np.asarray(1 / (model.variance / size**2 + limits.JND**2) / model.mean.size, np.float32)
    powers, products = (np.conj(scipy.fft.rfft2(a, axes=(0, 1))) for a in (weights, weights * model.mean))
    spectra = (scipy.fft.rfft2(a, axes=(2, 3)) for a in (windows * windows, windows))
    total = sum(
        np.einsum("rcijk,ijk->rcij", spectrum, factor)
        for spectrum, factor in zip(spectra, (powers, -2 * products), strict=True)
    )
    costs = scipy.fft.irfft2(total, s=samples, axes=(2, 3)) + (weights * model.mean**2).sum()
    best = costs.reshape(*costs.shape[:2], -1).argmin(-1)
    i, j = np.unravel_index(best, samples)
    rows, columns = np.indices(best.shape)

    def at(di: int, dj: int) -> Values:
        return np.asarray(costs[rows, columns, (i + di) % samples[0], (j + dj) % samples[1]])

    def refine(before: Values, after: Values) -> Values:
        bend = before - 2 * at(0, 0) + after
        return np.where(bend > 1e-9, np.clip((before - after) / (2 * np.maximum(bend, 1e-9)), -0.5, 0.5), 0)

    place = np.stack(
        [(i + refine(at(-1, 0), at(1, 0))) / samples[0], (j + refine(at(0, -1), at(0, 1))) / samples[1]], -1
    )
    return np.asarray(place - np.rint(place), np.float64), costs


def _length(difference: Field, vectors: Points) -> Values:
    """Return the length px of displacements in cell coordinates, modulo the lattice of reduced vectors."""
    lengths = measure_lengths(np.ascontiguousarray(difference).reshape(-1, 2), np.ascontiguousarray(vectors))
    return np.asarray(lengths.reshape(difference.shape[:-1]))


def _grow(displacement: Field, valid: Mask, vectors: Points, limit: float) -> tuple[Mask, Field]:
    """Return the nodes in place and the displacement that they predict everywhere."""
    width = 2 * _REACH + 1

    def box(a: NDArray[np.float64]) -> NDArray[np.float64]:
        size = (width, width) + (1,) * (a.ndim - 2)
        return np.asarray(ndimage.uniform_filter(a, size, mode="constant") * width**2)

    largest, expected = np.zeros_like(valid), np.zeros_like(displacement)
    rating = np.where(valid, _count_agreeing(displacement, valid, vectors, limit), -1)
    for _ in range(3):
        if rating.max() < 3:
            break
        grown = np.zeros_like(valid)
        grown[np.unravel_index(rating.argmax(), rating.shape)] = True
        rating[grown] = -1
        unwrapped = displacement
        for turn in range(_MOST_ROUNDS):
            count = np.rint(box(grown.astype(np.float64)))
            mean = box(unwrapped * grown[..., np.newaxis]) / np.maximum(count, 1)[..., np.newaxis]
            near = displacement - mean
            unwrapped = np.where(count[..., np.newaxis] > 0, mean + near - np.rint(near), unwrapped)
            wider = valid & (count >= (1 if turn < 2 else 3)) & (_length(near, vectors) <= limit)
            if turn > 2 and (wider == grown).all():
                break
            grown = wider
        rating[grown] = -1
        if grown.sum() > largest.sum():
            largest, expected = grown, _fill(mean, count < 3)
        if 2 * largest.sum() > valid.sum():
            break
    return largest, expected


def _count_agreeing(displacement: Field, valid: Mask, vectors: Points, limit: float) -> NDArray[np.intp]:
    """Return how many nodes around each node have its displacement, to within the limit px."""
    reach, (rows, columns) = _REACH, valid.shape
    wide, known = np.pad(displacement, ((reach, reach), (reach, reach), (0, 0))), np.pad(valid, reach)
    total = np.zeros(valid.shape, np.intp)
    for i, j in np.ndindex(2 * reach + 1, 2 * reach + 1):
        part = np.s_[i : i + rows, j : j + columns]
        total += known[part] & (_length(displacement - wide[part], vectors) < limit)
    return total


def _fill(field: Field, unknown: Mask) -> Field:
    """Return a field with unknown nodes replaced by the nearest known one."""
    if unknown.all() or not unknown.any():
        return field
    rows, columns = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(field[rows, columns])


def _compare_sides(picture: FollowedPicture) -> NDArray[np.float64]:
    """Return the largest difference px between the mean displacements of the two sides of each node."""
    near = picture.displacement - picture.expected
    known = picture.valid & (picture.away < 0.3)
    moved = np.where(known[..., np.newaxis], (picture.expected + near - np.rint(near)) @ picture.net.vectors, 0)
    y, x = np.mgrid[-_SIDE : _SIDE + 1, -_SIDE : _SIDE + 1]
    planes = np.stack([known.astype(float), *np.moveaxis(moved, -1, 0)])
    planes = np.broadcast_to(planes, (2, *planes.shape))
    largest = np.zeros(known.shape)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        across, along = (y * down + x * right) / np.hypot(down, right), (y * right - x * down) / np.hypot(down, right)
        side = ((across > 0.6) & (across <= _SIDE) & (np.abs(along) <= _ALONG)).astype(np.float64)
        kernels = np.stack([side, side[::-1, ::-1]])[:, np.newaxis]
        sums = scipy.signal.fftconvolve(planes, kernels, mode="same", axes=(2, 3))
        means = sums[:, 1:] / np.maximum(sums[:, :1], 1)
        enough = (sums[:, 0] > 0.45 * side.sum()).all(0)
        largest = np.maximum(largest, np.where(enough, np.linalg.norm(means[0] - means[1], axis=0), 0))
    return largest
