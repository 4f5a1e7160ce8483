"""Follow the lattice through a picture: where each cell lies, which are in place, and the straightened picture.

The judge of the perils follows outputs by this registration and not by :mod:`nrbench.displacement`, by which methods
straighten their samples and bend their outputs: no contestant judges. Its windows are compared with cells of the
references alone, so that an error of the methods' code is not repeated where their outputs are judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from ..perception import limits
from ..perception.visible import Lab
from .coarse_plane import CoarsePlane
from .lattice_net import LatticeNet, Mask, Values, find_inside, fold_cells, sample_planes, split_cells
from .lattice_nodes import Field, LatticeNodes, Strips, find_least, node_shape
from .net_kernels import measure_misfits
from .node_kernels import spread_nodes


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
class FollowedPicture(LatticeNodes):
    """A picture through which the lattice is followed by its mean cell.

    Windows of ``size`` x ``size`` cells at every half cell are averaged to one cell and compared with the model at all
    displacements, modulo the lattice: the misfit is the mean of (window - mean)^2 / (variance / size^2 + JND^2). Points
    that vary from cell to cell count little, joints count much. The displacement of a window (a node) is the one with
    the smallest misfit.

    Parameters
    ----------
    lab
        The picture.
    models
        The model of the cell, or one for each strip.
    strips
        The strips, if there are several models.
    offset
        (3,): added to the picture before the comparison, so that its mean color is that of the texture.
    """

    lab: Lab
    models: Sequence[CellModel]
    strips: Strips | None = None
    offset: Values | float = 0.0

    @cached_property
    def plane(self) -> Values:
        """The picture on the points of the net, where it is not straightened."""
        return np.asarray(sample_planes(self.lab[..., :3], self.net.points) + self.offset, np.float32)

    def _cut(self, beyond: int) -> Iterator[tuple[int, FollowedPicture]]:
        """Yield the first cell of each band of the net, and the picture on the band and on ``beyond`` cells more."""
        bands = self.net.bands(beyond)
        if len(bands) == 1:
            yield 0, self
            return
        lab = np.ascontiguousarray(self.lab[..., :3])
        for first, last in bands:
            yield first, replace(self, net=self.net.cut(first, last + beyond), lab=lab)

    @cached_property
    def _fit(self) -> tuple[Field, Values, Mask]:
        """Displacements, contrasts, and the nodes inside the picture."""
        found = zip(*(part._fit_windows() for _, part in self._cut(self.size)), strict=True)
        displacement, contrast, valid = (_join_bands(parts) for parts in found)
        return displacement, contrast, valid

    def _fit_windows(self) -> tuple[Field, Values, Mask]:
        valid, costs = self._compare_windows()
        displacement, contrast = np.zeros((*valid.shape, 2)), np.zeros(valid.shape, np.float32)
        displacement[valid], contrast[valid] = find_least(costs), np.ptp(costs, axis=(1, 2))
        return displacement, contrast, valid

    def _compare_windows(self) -> tuple[Mask, Values]:
        """Return the windows inside the picture, and the misfits of these at all displacements, ``(K, n1, n2)``."""
        valid, windows = _average_windows(self.plane, self.net, self.size)
        number, costs = self._number_models()[valid], np.empty((len(windows), *self.net.samples), np.float32)
        for k, model in enumerate(self.models):
            costs[number == k] = _compare(windows[number == k], model, self.size)
        return valid, costs

    def _number_models(self) -> NDArray[np.intp]:
        """Return the number of the model of each node."""
        shape = node_shape(self.net, self.size)
        return np.zeros(shape, np.intp) if self.strips is None else self.strips.number(self.centers)

    @property
    def contrast(self) -> Values:
        """How much worse each node's window fits at the worst displacement than at the best; 0 in a flat window."""
        return self._fit[1]

    @cached_property
    def misfit(self) -> Values:
        """Misfit of the single cell in the middle of each node's window, at the expected displacement."""
        moves = np.rint(self.expected * self.net.samples).astype(np.intp)
        return _join_bands([part._measure_misfits(moves[2 * first :]) for first, part in self._cut(self.size)])

    def _measure_misfits(self, moves: NDArray[np.intp]) -> Values:
        weights = np.stack([_weigh_points(model, 1) for model in self.models])
        shape = node_shape(self.net, self.size)
        means = np.stack([model.mean for model in self.models]).astype(np.float32)
        return measure_misfits(self.plane, means, weights, self._number_models(), moves[: shape[0]], self.size - 1)

    @cached_property
    def straightened(self) -> tuple[Values, Mask]:
        """The picture with each point at its expected place, and the points that are known and in place."""
        rows, columns = (
            np.clip(np.arange(cells * n) / n * 2 - self.size, 0, nodes - 1)
            for cells, n, nodes in zip(self.net.cells, self.net.samples, self.valid.shape, strict=True)
        )
        nodes = np.concatenate([self.expected @ self.net.vectors, self.in_place[..., np.newaxis]], -1)
        plane, known = np.empty((len(rows), len(columns), 3), np.float32), np.empty((len(rows), len(columns)), np.bool_)
        for first, part in self._cut(0):
            band = slice(first * int(self.net.samples[0]), (first + int(part.net.cells[0])) * int(self.net.samples[0]))
            spread = spread_nodes(nodes, rows[band], columns)
            points = part.net.points + spread[..., :2]
            plane[band] = sample_planes(part.lab[..., :3], points)
            known[band] = (spread[..., 2] > 0.5) & part.net.contains(points)
        return plane, known

    @cached_property
    def residual(self) -> tuple[Values, Mask]:
        """The straightened picture less the model's mean cell, and its known points."""
        plane, known = self.straightened
        if self.strips is not None:
            means = [self.net.tile(model.mean) for model in self.models]
            return plane - np.choose(self.strips.number(self.net.points)[..., np.newaxis], means), known
        if len(self.net.bands()) == 1:
            return plane - self.net.tile(self.models[0].mean), known
        vars(self).pop("straightened")  # a large picture is held once
        cells = split_cells(plane, self.net.samples)
        cells -= self.models[0].mean
        return plane, known

    @cached_property
    def coarse(self) -> CoarsePlane:
        """The residual on few places of each cell."""
        return CoarsePlane(*self.residual, self.net.samples)


def _join_bands(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return the nodes of all bands: the last row of one is the first of the next."""
    return np.concatenate([*(part[:-1] for part in parts[:-1]), parts[-1]])


def _average_windows(plane: Values, net: LatticeNet, size: int) -> tuple[Mask, Values]:
    """Return the windows that lie inside the picture, ``(R, C)``, and the mean cell of each, ``(K, 3, n1, n2)``.

    A point that lies outside in all cells has the value at the nearest border.
    """
    half = net.samples // 2
    # What does not count is filled, as it repeats.
    known = np.where(find_inside(net.points, net.shape), np.float32(1), np.float32(1e-3))
    counts = _sum_windows(known, net.samples, size)
    means = _sum_windows(np.moveaxis(plane, -1, 0) * known, net.samples, size) / counts
    share = split_cells(counts, half).mean((2, 3)) / size**2
    valid = (share[1:, 1:] + share[1:, :-1] + share[:-1, 1:] + share[:-1, :-1]) / 4 > limits.WHOLE_WINDOW
    halves = np.moveaxis(split_cells(np.moveaxis(means, 0, -1), half), -1, 2)
    row, column = np.nonzero(valid)
    windows = np.empty((len(row), 3, *net.samples), np.float32)
    # A window that begins in the middle of a cell shows the first half of the next one.
    for i, j in np.ndindex(2, 2):
        y, x = (slice(k * n, (k + 1) * n) for k, n in zip((i, j), half, strict=True))
        windows[..., y, x] = halves[row + (row + i) % 2, column + (column + j) % 2]
    return valid, windows


def _sum_windows(a: Values, samples: NDArray[np.intp], size: int) -> Values:
    """Return the sums over ``size`` x ``size`` cells that begin at each point, in the order of a net."""
    (height, width), (n1, n2) = a.shape[-2:], samples
    rows, columns = height - (size - 1) * n1, width - (size - 1) * n2
    cells = (a[..., i * n1 : i * n1 + rows, j * n2 : j * n2 + columns] for i, j in np.ndindex(size, size))
    return reduce(np.add, cells)


def _weigh_points(model: CellModel, size: int) -> Values:
    """Return the weight of each point of the cell in the misfit of windows of ``size`` x ``size`` cells."""
    return np.asarray(1 / (model.variance / size**2 + limits.JND**2) / model.mean.size, np.float32)


def _compare(windows: Values, model: CellModel, size: int) -> Values:
    """Return the misfits of windows ``(..., 3, n1, n2)`` at all displacements, ``(..., n1, n2)``.

    With w = 1 / (variance / size^2 + JND^2) the misfit at a displacement is sum w x^2 - 2 sum w m x + sum w m^2, mean
    over the points of the cell: two cyclic correlations, by FFT.
    """
    weights = _weigh_points(model, size)
    planes = (np.ascontiguousarray(np.moveaxis(a, -1, 0)) for a in (weights, weights * model.mean))
    powers, products = (np.conj(scipy.fft.rfft2(plane)) for plane in planes)
    total = sum(
        np.einsum("...kij,kij->...ij", scipy.fft.rfft2(a), factor)
        for a, factor in ((windows * windows, powers), (windows, -2 * products))
    )
    return np.asarray(scipy.fft.irfft2(total, s=windows.shape[-2:]) + (weights * model.mean**2).sum())
