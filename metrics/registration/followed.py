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
        return self._fit_windows(self.size)

    @cached_property
    def contrast(self) -> Values:
        """How much worse each node's window fits at the worst displacement than at the best; 0 in a flat window."""
        return np.asarray(np.ptp(self._fit[1], axis=(2, 3)))

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


def _average_windows(plane: Values, net: LatticeNet, size: int) -> tuple[Values, Values]:
    """Average the cells of each window, ``(R, C, n1, n2, 3)``, and return which share of it lies inside the picture.

    A point that lies outside in all cells has the value at the nearest border.
    """
    half, inside = net.samples // 2, find_inside(net.points, net.shape)  # what does not count is filled, as it repeats
    shape = node_shape(net, size)
    windows, cover = np.zeros((*shape, *net.samples, 3), np.float32), np.zeros(shape, np.float32)
    for a, b in np.ndindex(2, 2):
        y, x = a * half[0], b * half[1]
        part = np.s_[y : plane.shape[0] - y, x : plane.shape[1] - x]
        known = split_cells(np.where(inside[part], np.float32(1), np.float32(1e-3)), net.samples)
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
    return find_least(costs), costs
