"""Where the windows of a picture lie on its lattice: which of them are in place, and which have slipped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.signal
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Shape

from ..perception import limits
from . import node_kernels
from .lattice_net import LatticeNet, Mask, Values

Field = NDArray[np.float64]
"""``(R, C, 2)``: displacements of windows, in cell coordinates."""
_REACH = 2
"""Half width, in nodes (half cells), of the surroundings that predict the displacement of a node."""
_SIDE, _ALONG = 4, 2
"""Depth and half length, in nodes, of the two sides of a line whose displacements are compared."""
_MOST_ROUNDS = 300
STRIPS = 4
"""Number of strips of a sample, each of which is judged by the others."""
WIDEST = 3
"""Largest side of the windows that are followed, in cells."""
Nodes = TypeVar("Nodes", bound="LatticeNodes")


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

    @classmethod
    def across(cls, shape: Shape, count: int) -> Strips:
        """Cut a picture of ``shape`` into ``count`` strips of equal width, across its longer side."""
        axis = int(shape[0] > shape[1])
        return cls(axis, np.linspace(0, shape[1 - axis], count + 1))

    def number(self, points: Points) -> NDArray[np.intp]:
        """Return the number of the strip in which each point lies."""
        found = np.searchsorted(self.edges, points[..., self.axis]) - 1
        return np.clip(found, 0, len(self.edges) - 2)

    def share_out(self, bad: NDArray[np.float64], nodes: LatticeNodes) -> NDArray[np.float64]:
        """Return the mean of ``bad``, a number of each node, over the nodes of each strip."""
        number = self.number(nodes.centers)
        parts = [bad[nodes.valid & (number == k)] for k in range(len(self.edges) - 1)]
        return np.array([part.mean() for part in parts if part.size])


@dataclass(frozen=True)
class LatticeNodes:
    """The windows of a picture, of ``size`` x ``size`` cells at every half cell, and where they lie on the lattice.

    How the displacement of a window (a node) is measured is left to the subclasses. Nodes are *in place* if they lie
    where the nodes around them that are in place put them, to within ``limit``. The set grows from the place where most
    neighbors agree, so smooth bending and drift leave all nodes in place, while what is beyond a slip is not reached.

    Parameters
    ----------
    net
        The net of the picture.
    limit
        Largest departure of a node in its place, in s.
    size
        Side of the windows in cells.
    """

    net: LatticeNet
    limit: float
    size: int

    @cached_property
    def _fit(self) -> tuple[Any, ...]:
        """The displacements first, and the valid nodes last."""
        raise NotImplementedError

    @property
    def displacement(self) -> Field:
        """Displacement of each node, modulo the lattice."""
        return np.asarray(self._fit[0])

    @property
    def valid(self) -> Mask:
        """``(R, C)``: the nodes whose windows lie inside the picture."""
        return np.asarray(self._fit[-1])

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
        return np.asarray(find_lengths(self.displacement - self.expected, self.net.vectors) / self.net.s)

    @cached_property
    def slip(self) -> NDArray[np.float64]:
        """Largest difference in s of the mean displacements on both sides of each node, over four directions."""
        return _compare_sides(self) / self.net.s

    @cached_property
    def centers(self) -> Points:
        """``(R, C, 2)``: (x, y) px of the middles of the nodes' windows."""
        size, shape = self.size, node_shape(self.net, self.size)
        numbers = np.moveaxis(np.indices(shape), 0, -1) / 2 + size / 2 + self.net.first
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

    def misplacement(self, slip_limit: float) -> NDArray[np.float64]:
        """Return how far each node is out of place, ``(R, C)``: 0 in place, 1 wholly out of place.

        It rises from 0 at the limit to 1 at a quarter of s. All nodes beyond a slip, a line whose sides differ by more
        than ``slip_limit`` s, on the smaller side, are out of place by the slip.
        """
        bad = np.clip((self.away - self.limit) / max(limits.MOST_STEP - self.limit, 0.05), 0, 1)
        slipped = self.slip > slip_limit
        label, count = ndimage.label(self.valid & ~slipped, np.ones((3, 3)))
        if slipped.any() and count > 1:
            main = 1 + np.bincount(label.ravel())[1:].argmax()
            amount = min(float(np.median(self.slip[slipped])) / limits.MOST_STEP, 1)
            bad = np.where(_fill(label, label == 0) != main, np.maximum(bad, amount), bad)
        return np.asarray(bad)


def choose_windows(follow: Callable[[int], Sequence[Nodes]], sides: Sequence[int], by_sample: bool) -> list[Nodes]:
    """Follow references with the smallest windows that lie in their places to within ``SURE``, and set their limit.

    Parameters
    ----------
    follow
        Returns the references, followed with windows of the given side.
    sides
        Sides of the windows that are tried, in cells.
    by_sample
        Whether the reference is one sample, whose windows show less.

    Returns
    -------
    list
        The references; empty if no window lies inside them.
    """
    chosen: list[Nodes] = []
    noise = 0.0
    for size in sides:
        followed = follow(size)
        if not all(picture.valid.any() for picture in followed):
            break
        away = np.concatenate([picture.away[picture.valid] for picture in followed])
        chosen, noise = list(followed), float(np.quantile(away, limits.TOP_OF_SAMPLE if by_sample else limits.TOP))
        if noise < limits.SURE:
            break
    least = limits.LEAST_STEP * (limits.LOOSE if by_sample else 1)
    limit = float(np.clip(limits.OF_NOISE * noise, least, limits.MOST_STEP))
    return [replace(picture, limit=limit) for picture in chosen]


def explain_share(shares: NDArray[np.float64], by_sample: bool) -> float:
    """Return the share out of place that chance explains, from the shares of pictures or of strips of a sample."""
    spread = float(shares.std(ddof=1)) if len(shares) > 1 else 0.0
    spread /= np.sqrt(len(shares)) if by_sample else 1.0
    return float(shares.mean()) + limits.DEVIATIONS * spread + limits.SURE_SHARE


def node_shape(net: LatticeNet, size: int) -> tuple[int, int]:
    """Return the number of windows along each vector."""
    rows, columns = 2 * (net.cells - size) + 1
    return int(rows), int(columns)


def find_least(costs: NDArray[Any]) -> Field:
    """Return the displacement of the least cost of each window, from costs ``(..., n1, n2)`` at displacements i / n.

    It lies between the samples by a parabola, in cell coordinates modulo the lattice.
    """
    samples = np.array(costs.shape[-2:])
    flat = costs.reshape(-1, *samples)
    least = np.stack(np.unravel_index(flat.reshape(len(flat), samples.prod()).argmin(-1), samples), -1)
    place, windows = least.astype(np.float64), np.arange(len(flat))
    for axis, step in enumerate(np.eye(2, dtype=np.intp)):
        before, here, after = (flat[windows, *((least + k * step) % samples).T] for k in (-1, 0, 1))
        bend = before - 2 * here + after
        away = np.clip((before - after) / (2 * np.maximum(bend, 1e-9)), -0.5, 0.5)
        place[..., axis] += np.where(bend > 1e-9, away, 0)
    place /= samples
    return (place - np.rint(place)).reshape(*costs.shape[:-2], 2)


def find_lengths(difference: Field, vectors: Points) -> Values:
    """Return the length px of displacements in cell coordinates, modulo the lattice of reduced vectors."""
    flat = np.ascontiguousarray(difference).reshape(-1, 2)
    lengths = node_kernels.measure_lengths(flat, np.ascontiguousarray(vectors))
    return np.asarray(lengths.reshape(difference.shape[:-1]))


def _grow(displacement: Field, valid: Mask, vectors: Points, limit: float) -> tuple[Mask, Field]:
    """Return the nodes in place and the displacement that they predict everywhere."""
    largest, expected = np.zeros_like(valid), np.zeros_like(displacement)
    field = (np.ascontiguousarray(displacement), np.ascontiguousarray(valid), np.ascontiguousarray(vectors), limit)
    rating = np.where(valid, node_kernels.count_agreeing(*field, _REACH), -1)
    for _ in range(3):
        if rating.max() < 3:
            break
        seed = int(rating.argmax())
        grown, mean, count = node_kernels.grow_nodes(*field, _REACH, seed, _MOST_ROUNDS)
        rating[grown] = rating.flat[seed] = -1
        if grown.sum() > largest.sum():
            largest, expected = grown, _fill(mean, count < 3)
        if 2 * largest.sum() > valid.sum():
            break
    return largest, expected


def _fill(field: NDArray[Any], unknown: Mask) -> NDArray[Any]:
    """Return a field with unknown nodes replaced by the nearest known one."""
    if unknown.all() or not unknown.any():
        return field
    rows, columns = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(field[rows, columns])


def _compare_sides(picture: LatticeNodes) -> NDArray[np.float64]:
    """Return the largest difference px between the mean displacements of the two sides of each node."""
    near = picture.displacement - picture.expected
    known = picture.valid & (picture.away < 0.3)
    moved = np.where(known[..., np.newaxis], (picture.expected + near - np.rint(near)) @ picture.net.vectors, 0)
    kernels = _cut_sides()
    planes = np.stack([known.astype(float), *np.moveaxis(moved, -1, 0)])[np.newaxis, np.newaxis]
    sums = scipy.signal.fftconvolve(planes, kernels, axes=(3, 4))[..., _SIDE:-_SIDE, _SIDE:-_SIDE]
    means = sums[:, :, 1:] / np.maximum(sums[:, :, :1], 1)
    enough = (sums[:, :, 0] > 0.45 * kernels[:, :, 0].sum((2, 3), keepdims=True)).all(1)
    return np.asarray(np.where(enough, np.linalg.norm(means[:, 0] - means[:, 1], axis=1), 0).max(0))


@cache
def _cut_sides() -> NDArray[np.float64]:
    """Return the nodes on the two sides of a line in four directions, ``(4, 2, 1, 9, 9)``."""
    y, x = np.mgrid[-_SIDE : _SIDE + 1, -_SIDE : _SIDE + 1]
    down, right = np.array(((0, 1), (1, 0), (1, 1), (1, -1))).T[..., np.newaxis, np.newaxis]
    across, along = (y * down + x * right) / np.hypot(down, right), (y * right - x * down) / np.hypot(down, right)
    side = ((across > 0.6) & (across <= _SIDE) & (np.abs(along) <= _ALONG)).astype(np.float64)
    return np.stack([side, side[:, ::-1, ::-1]], 1)[:, :, np.newaxis]
