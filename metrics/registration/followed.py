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
from numpy.typing import NDArray
from scipy import ndimage

from ..perception import limits
from ..perception.visible import Lab
from .lattice_net import LatticeNet, Mask, Values, find_inside, fold_cells, sample_planes, split_cells
from .lattice_nodes import Field, LatticeNodes, Strips, find_least, node_shape
from .net_kernels import measure_misfits


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

    @cached_property
    def _fit(self) -> tuple[Field, Values, Mask]:
        """Displacements, misfits at all displacements ``(R, C, n1, n2)``, and the nodes inside the picture."""
        windows, cover = _average_windows(self.plane, self.net, self.size)
        if self.strips is None:
            costs = _compare(windows, self.models[0], self.size)
        else:
            number, costs = self.strips.number(self.centers), np.empty((*cover.shape, *self.net.samples), np.float32)
            for k, model in enumerate(self.models):
                costs[number == k] = _compare(windows[number == k], model, self.size)
        return find_least(costs), costs, cover > 0.97

    @cached_property
    def contrast(self) -> Values:
        """How much worse each node's window fits at the worst displacement than at the best; 0 in a flat window."""
        return np.asarray(np.ptp(self._fit[1], axis=(2, 3)))

    @cached_property
    def misfit(self) -> Values:
        """Misfit of the single cell in the middle of each node's window, at the expected displacement."""
        weights = np.stack([_weigh_points(model, 1) for model in self.models])
        number = np.zeros(self.valid.shape, np.intp) if self.strips is None else self.strips.number(self.centers)
        moves = np.rint(self.expected * self.net.samples).astype(np.intp)
        means, first = np.stack([model.mean for model in self.models]), self.size - 1
        return measure_misfits(self.plane, means.astype(np.float32), weights, number, moves, first)

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
        return sample_planes(self.lab[..., :3], points), known & self.net.contains(points)

    @cached_property
    def residual(self) -> tuple[Values, Mask]:
        """The straightened picture less the model's mean cell, and its known points."""
        plane, known = self.straightened
        means = [self.net.tile(model.mean) for model in self.models]
        if self.strips is None:
            return plane - means[0], known
        return plane - np.choose(self.strips.number(self.net.points)[..., np.newaxis], means), known


def _spread_matrix(side: int, samples: int, size: int, nodes: int) -> NDArray[np.float64]:
    """Return the weights of nodes in each sample along a vector, ``(side, nodes)``: linear, and constant beyond."""
    at = np.clip(np.arange(side) / samples * 2 - size, 0, nodes - 1)
    return np.asarray(np.maximum(1 - np.abs(at[:, np.newaxis] - np.arange(nodes)), 0))


def _average_windows(plane: Values, net: LatticeNet, size: int) -> tuple[Values, Values]:
    """Average the cells of each window, ``(R, C, 3, n1, n2)``, and return which share of it lies inside the picture.

    A point that lies outside in all cells has the value at the nearest border.
    """
    half, shape = net.samples // 2, node_shape(net, size)
    # What does not count is filled, as it repeats.
    known = np.where(find_inside(net.points, net.shape), np.float32(1), np.float32(1e-3))
    counts = _sum_windows(known, net.samples, size)
    means = _sum_windows(np.moveaxis(plane, -1, 0) * known, net.samples, size) / counts
    windows = np.empty((*shape, 3, *net.samples), np.float32)
    cells = np.moveaxis(split_cells(np.moveaxis(means, 0, -1), net.samples), -1, 2)
    # A window that begins in the middle of a cell shows the first half of the next one.
    for a, b, i, j in np.ndindex(2, 2, 2, 2):
        y, x = (slice(k * n, (k + 1) * n) for k, n in zip((i, j), half, strict=True))
        down, right = a * (1 - i), b * (1 - j)
        rows, columns = windows[a::2, b::2].shape[:2]
        windows[a::2, b::2, :, y, x] = cells[down : down + rows, right : right + columns, :, y, x]
    share = split_cells(counts, half).mean((2, 3)) / size**2
    return windows, (share[1:, 1:] + share[1:, :-1] + share[:-1, 1:] + share[:-1, :-1]) / 4


def _sum_windows(a: Values, samples: NDArray[np.intp], size: int) -> Values:
    """Return the sums over ``size`` x ``size`` cells that begin at each point, in the order of a net."""
    (height, width), (n1, n2) = a.shape[-2:], samples
    rows, columns = height - (size - 1) * n1, width - (size - 1) * n2
    total = np.zeros((*a.shape[:-2], rows, columns), np.float32)
    for i, j in np.ndindex(size, size):
        total += a[..., i * n1 : i * n1 + rows, j * n2 : j * n2 + columns]
    return total


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
