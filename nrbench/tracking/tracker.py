"""The tracker: follows a lattice through an image, tile by tile, however far smooth displacements add up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import make_interp_spline

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking.local_phase import Coefficients, Harmonics, Nodes, cell_covariance
from nrbench.tracking.unwrapping import LABELS, Surfaces, unwrap

FIRST_TILES = 1.5
"""Width of the windows that are followed, in tiles."""
REFINED_TILES = (1.5, 1.2, 1.0, 1.0)
"""Width of the windows by which places are refined, in turn."""
_COLORS = 0.98
FLAT = 1e-7
"""Variance of a mean tile, of values in [0, 1], below which there is nothing to follow: less than a gray step."""
STRONGEST = 32
"""Harmonics of the mean tile that are compared."""
_FIRST_STEPS, _NEXT_STEPS = 4, 2
"""Steps of Newton's method after unwrapping, and each time that places are refined."""
_LONGEST_STEP = 0.12
Field = NDArray[np.float64]


@dataclass(frozen=True)
class MeanTile:
    """The mean tile, as its strongest harmonics.

    Parameters
    ----------
    harmonics
        Which.
    colors
        ``(C, c)``: the directions in color, orthonormal, that hold 98 % of its variance; nothing else is compared.
    values
        ``complex64 (K, c)``.
    weights
        ``(K,)``: what each counts for.
    """

    harmonics: Harmonics
    colors: Values
    values: NDArray[np.complex64]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, image: Values, lattice: Lattice) -> MeanTile:
        """Return the mean tile of an image whose content lies on the lattice, more or less."""
        every = Harmonics.of(lattice)
        nodes = Nodes.of(lattice, image.shape[:2], FIRST_TILES)
        values = nodes.coefficients(_centered(image), every.frequencies).mean((2, 3))
        order = np.argsort(-(np.abs(values) ** 2).sum(1), kind="stable")[:STRONGEST]
        colors = _main_colors(values[order])
        return cls(every.take(order), colors, values[order] @ colors, np.ones(len(order), np.float32))

    @property
    def power(self) -> float:
        """Variance of the mean tile."""
        return 2 * float((np.abs(self.values) ** 2).sum())

    def unweighted(self) -> MeanTile:
        """Return the same mean tile, all harmonics counting alike."""
        return replace(self, weights=np.ones_like(self.weights))

    def product(self, found: Coefficients) -> NDArray[np.complex64]:
        """Return the weighted product of local harmonics with the mean tile's, over channels, ``(K, ...)``."""
        return np.asarray(np.einsum("kcij,kc->kij", found, np.conj(self.values) * self.weights[:, np.newaxis]))


@dataclass(frozen=True)
class Track:
    """A lattice followed through an image.

    Parameters
    ----------
    image
        The image.
    lattice
        Where the content should be.
    nodes
        Places on the plane of the undisturbed lattice.
    field
        ``(rows, columns, 2)``: how far, (x, y) px, the content that belongs at each node has moved, unwrapped.
    correlation
        ``(rows, columns)``: of the content found there with the mean tile, in [-1, 1].
    tile
        The mean tile that was followed.
    """

    image: Image
    lattice: Lattice
    nodes: Nodes
    field: Field
    correlation: Field
    tile: MeanTile

    def moved(self, points: Points) -> Points:
        """Return how far the content that belongs at points (x, y) has moved, ``(..., 2)`` px, by cubic splines."""
        return _between(self.nodes, self.field, points)

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """``(n, 2)``: cell coordinates of the lattice points that were found at least half a tile within the image."""
        reach = np.sqrt(3 * np.diag(cell_covariance(self.lattice)))
        low, high = -reach, np.array(self.image.shape[1::-1]) + reach
        numbers = self.lattice.cell_numbers(low, high)
        at = self.found(numbers)
        inside = ((at >= reach - 0.5) & (at <= np.array(self.image.shape[1::-1]) - 0.5 - reach)).all(1)
        return np.asarray(numbers[inside])

    def tracked(self, least: float) -> float:
        """Return the share of nodes, on the image, where the content correlates by ``least`` with the mean tile."""
        at = self.nodes.places + self.field
        seen = ((at >= 0) & (at <= np.array(self.image.shape[1::-1]) - 1)).all(-1)
        return float((self.correlation[seen] >= least).mean()) if seen.any() else 0.0

    def found(self, uv: Points | NDArray[np.int64]) -> Points:
        """Return where in the image, (x, y) px, the content of cell coordinates ``(..., 2)`` was found."""
        points = self.lattice.from_cell(uv)
        return np.asarray(points + self.moved(points))


def track(image: Image, lattice: Lattice, tile: MeanTile) -> Track:
    """Follow a lattice through an image.

    At each node of a grid half a tile apart the image is correlated with the mean tile under a Gaussian window as broad
    as 1.5 tiles, at all displacements of a cell: of the lattice's harmonics that is one small Fourier sum.
    Displacements are unwrapped by continuity, refined between pixels, and taken out of the image; what is left is
    measured by narrower windows and added, four times. Each time the mean tile is taken anew from where tiles were
    found, and harmonics that scatter count less. Time grows with the pixels.

    Parameters
    ----------
    image
        The image.
    lattice
        Reduced: where content should be; its phase is free.
    tile
        What is looked for.
    """
    planes = _centered(image) @ tile.colors
    nodes = Nodes.of(lattice, image.shape[:2], FIRST_TILES)
    product = tile.product(nodes.coefficients(planes, tile.harmonics.frequencies))
    strength = np.sqrt(max(tile.power, FLAT) * _energy(nodes, planes))[..., np.newaxis, np.newaxis]
    wrapped = unwrap(np.asarray(_surfaces(product, tile.harmonics) / strength, np.float32), lattice)
    field = _undone(nodes, _refined(product, tile.harmonics, wrapped, _FIRST_STEPS))
    for tiles in REFINED_TILES:
        nodes = nodes.narrowed(tiles)
        still = straightened(planes, nodes, field)
        found = nodes.coefficients(still, tile.harmonics.frequencies)
        tile = _relearned(tile, found)
        rest = _refined(tile.product(found), tile.harmonics, np.zeros_like(field), _NEXT_STEPS)
        field = rest + _between(nodes, field, nodes.places + rest)
    heights = _heights(tile.unweighted().product(found), tile.harmonics, rest)
    return Track(image, lattice, nodes, field, heights / np.sqrt(max(tile.power, FLAT) * _energy(nodes, still)), tile)


def _relearned(tile: MeanTile, found: Coefficients) -> MeanTile:
    """Return the mean tile of where tiles were found; each harmonic weighs as the inverse of its scatter."""
    values = found.mean((2, 3))
    scatter = (np.abs(found - values[..., np.newaxis, np.newaxis]) ** 2).mean((1, 2, 3))
    floor = 0.05 * (np.abs(values) ** 2).mean() + 1e-12
    return MeanTile(tile.harmonics, tile.colors, values, np.asarray(1 / (scatter + floor), np.float32))


def _main_colors(values: NDArray[np.complex64]) -> Values:
    parts = np.concatenate([values.real, values.imag])
    _, sizes, directions = np.linalg.svd(parts, full_matrices=False)
    shares = np.cumsum(sizes**2) / max((sizes**2).sum(), 1e-30)
    return np.asarray(directions[: int((shares < _COLORS).sum()) + 1].T, np.float32)


def _surfaces(product: NDArray[np.complex64], harmonics: Harmonics) -> Surfaces:
    """Return the correlation at all displacements (i t1 + j t2) / LABELS of a cell, not normalized."""
    table = np.zeros((*product.shape[1:], LABELS, LABELS), np.complex64)
    m, n = harmonics.numbers.T % LABELS
    table[..., m, n] = np.moveaxis(product, 0, -1)
    return np.asarray(2 * LABELS**2 * np.fft.ifft2(table).real, np.float32)


def _heights(product: NDArray[np.complex64], harmonics: Harmonics, displacement: Field) -> Field:
    turned = _turned(product, harmonics, displacement)
    return np.asarray(2 * turned.real.sum(0))


def _turned(product: NDArray[np.complex64], harmonics: Harmonics, displacement: Field) -> NDArray[np.complex64]:
    phase = np.tensordot(2 * math.pi * harmonics.frequencies, displacement, (1, 2))
    return np.asarray(product * np.exp(1j * phase.astype(np.float32)))


def _refined(product: NDArray[np.complex64], harmonics: Harmonics, start: Field, steps: int) -> Field:
    """Return the displacements where the correlation is highest near ``start``, by Newton's method."""
    waves = 2 * math.pi * harmonics.frequencies
    pairs = (waves[:, :, np.newaxis] * waves[:, np.newaxis]).reshape(-1, 4)
    longest = _LONGEST_STEP * harmonics.lattice.s
    field = start
    for _ in range(steps):
        turned = _turned(product, harmonics, field)
        slope = -np.tensordot(turned.imag, waves, (0, 0))
        bend = np.tensordot(turned.real, pairs, (0, 0)).reshape(*field.shape[:2], 2, 2)
        field = field + _step(slope, bend, longest)
    return field


def _step(slope: Field, bend: Field, longest: float) -> Field:
    """Return Newton's step uphill, shortened to ``longest`` px; along the slope where the surface is no hill."""
    trace, gap = np.trace(bend, axis1=-2, axis2=-1) / 2, (bend[..., 0, 0] - bend[..., 1, 1]) / 2
    least = trace - np.hypot(gap, bend[..., 0, 1])
    lift = np.maximum(0.05 * np.abs(trace) + 1e-12 - least, 0)
    lifted = bend + lift[..., np.newaxis, np.newaxis] * np.eye(2)
    step = np.linalg.solve(lifted, slope[..., np.newaxis])[..., 0]
    length = np.hypot(step[..., 0], step[..., 1])
    return np.asarray(step * np.minimum(1, longest / np.maximum(length, 1e-12))[..., np.newaxis])


def _undone(nodes: Nodes, seen: Field) -> Field:
    """Return how far content has moved by where it belongs, from how far it has moved by where it is seen."""
    field = seen
    for _ in range(8):
        field = (field + _between(nodes, seen, nodes.places + field)) / 2
    return field


def straightened(planes: Values, nodes: Nodes, field: Field) -> Values:
    """Return the planes with a displacement taken out of them; 0 for content from outside."""
    height, width = planes.shape[:2]
    down, along = (_weave(at, n) for at, n in ((nodes.y, height), (nodes.x, width)))
    moved = np.einsum("yr,rcd,xc->dyx", down, field, along, optimize=True)
    at = moved[::-1] + np.indices((height, width))
    return np.stack([ndimage.map_coordinates(plane, at, np.float32, 1) for plane in np.moveaxis(planes, -1, 0)], -1)


def _weave(at: Field, count: int) -> Field:
    """Return the matrix ``(count, n)`` of cubic splines from nodes to pixels; beyond the last node as at it."""
    if len(at) == 1:
        return np.ones((count, 1))
    spline = make_interp_spline(at, np.eye(len(at)), k=min(3, len(at) - 1))
    return np.asarray(spline(np.clip(np.arange(count), at[0], at[-1])))


def _between(nodes: Nodes, field: Field, points: Points) -> Field:
    """Return the field at points (x, y) px; beyond the last node as at it."""
    step = [n / count for n, count in zip(nodes.padded, nodes.counts, strict=True)]
    at = [points[..., 1] / step[0], points[..., 0] / step[1]]
    return np.stack(
        [ndimage.map_coordinates(axis, at, order=3, mode="nearest") for axis in np.moveaxis(field, -1, 0)], -1
    )


def _energy(nodes: Nodes, planes: Values) -> Field:
    """Return the variance under each window, summed over channels."""
    power = (planes**2).sum(-1, keepdims=True)
    moments = nodes.coefficients(np.concatenate([planes, power], -1), np.zeros((1, 2)))[0].real
    return np.asarray(np.maximum(moments[-1] - (moments[:-1] ** 2).sum(0), 1e-6), np.float64)


def _centered(image: Values) -> Values:
    return np.asarray(image - image.mean((0, 1), dtype=np.float64).astype(np.float32), np.float32)
