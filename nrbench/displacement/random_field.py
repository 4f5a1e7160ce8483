"""The displacements of the vertices of an output, drawn as they are in a bent sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Geometry

from .deformation_field import Deformation
from .growth import PARTS
from .vertex_kernels import move_vertices

Array = NDArray[np.float64]
WAVES: Final = 128
"""Number of plane waves along each axis of a drawn field."""
MOST_VERTICES: Final = 512
"""Vertices of the sample, those nearest to its middle, from which the covariance is estimated."""
SWEEPS: Final = 20
"""Rounds in which every vertex is moved. The report gives no number; the amplitude no longer changes."""
MOVES: Final = 9
"""Possible moves of a vertex along each axis."""
LEAST_AREA: Final = 0.5
"""Share of its area that content keeps at least where a drawn field presses it together."""
_SHORTEST = 2.0
"""Shortest wave length of a field, in s: shorter ones cannot be followed."""
_LENGTHS = 24
_BIN = 0.5
"""Width, in s, of the bins of distances."""
_BORDER = 3.0
"""Breadth, in s, of the frame of vertices around the output."""
_NEIGHBORS = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]


def output_field(
    deformation: Deformation, shape: tuple[int, int], geometry: Geometry, rng: np.random.Generator
) -> tuple[Points, Points, float]:
    """Return the places of vertices around an output, their displacements, and the distance of the nearest two.

    Parameters
    ----------
    deformation
        That of the sample.
    shape
        Height and width of the output, px.
    geometry
        ``"bent"``: displacements are drawn at once from a normal distribution (:class:`WaveSpectrum`), also between the
        vertices. ``"argmax"``: :func:`neighbor_field`.
    rng
        The randomness.
    """
    lattice, s = deformation.mesh, deformation.lattice.s
    if geometry == "bent":
        lattice = Lattice.from_basis(lattice.matrix / PARTS, lattice.origin)
    border = _BORDER * s + 3 * deformation.amplitude * s
    low, high = (-border, -border), (shape[1] - 1 + border, shape[0] - 1 + border)
    numbers = lattice.cell_numbers(low, high)
    places = lattice.from_cell(numbers)
    if geometry == "bent":
        return places, WaveSpectrum.of(deformation).draw(places, rng), lattice.s
    first = numbers.min(0)
    columns, rows = numbers.max(0) - first + 1
    u, v = (numbers - first).T
    return places, neighbor_field(deformation, (int(rows), int(columns)), rng)[v, u], lattice.s


@dataclass(frozen=True, eq=False)
class WaveSpectrum:
    """An isotropic spectrum of displacements: the limit of large neighborhoods of equations 1 and 2.

    The product over eight neighbors counts the same evidence eight times, and it knows slopes alone. Fields drawn from
    it are too small and too rough (``benchmarks/geometry.py``). Here each vertex depends on all others: displacements
    are jointly normal, with the covariance of the sample's. Drawing them all at once is what Gibbs sampling, in which
    each vertex is drawn given the others, would reach after infinitely many rounds.

    Parameters
    ----------
    lengths
        ``(k,)`` px: wave lengths.
    powers
        ``(k,)`` px^2: variance along one axis of the waves of each length.
    """

    lengths: Array
    powers: Array

    @classmethod
    def of(cls, deformation: Deformation) -> WaveSpectrum:
        """Fit the spectrum to the sample's vertices.

        The covariance of waves of one length, over all directions, is a Bessel function of the distance. A few periods
        of a sample show no displacement, but what is left of it after an affine fit. The same fit is therefore taken
        out of the covariances (:class:`~.AffineRest`). Powers that are not negative are fitted by least squares to the
        correlogram; the error of measurement is one more unknown, at distance 0. Last, all powers are multiplied so
        that the amplitude is the sample's.
        """
        s, rest = deformation.lattice.s, AffineRest.of(deformation)
        longest = max(2 * float(np.ptp(rest.places, axis=0).max()), 2 * _SHORTEST * s)
        lengths = np.geomspace(_SHORTEST * s, longest, _LENGTHS)
        columns = [rest.correlogram(scipy.special.j0(2 * math.pi * rest.distances / length)) for length in lengths]
        columns.append(rest.correlogram(np.eye(len(rest.places))))
        products = np.mean([rest.correlogram(np.outer(axis, axis), clear=True) for axis in rest.displacements.T], 0)
        table, importance = np.column_stack(columns), np.sqrt(rest.pairs)
        powers, _ = scipy.optimize.nnls(table * importance[:, np.newaxis], products * importance)
        signal = float(table[0] @ powers)
        powers *= float(products[0]) / signal if signal > 0 else 0.0
        return cls(lengths, powers[:-1])

    def draw(self, places: Points, rng: np.random.Generator) -> Points:
        """Return displacements at places ``(n, 2)`` px: sums of plane waves of random length, direction and phase.

        A field may fold the plane, or press content to less than :data:`LEAST_AREA`. Its waves are then lengthened,
        the shortest first, because these bend most and are known least. If that is not enough, the field is weakened.
        """
        total = float(self.powers.sum())
        if not total:
            return np.zeros_like(places)
        ratio = self.lengths[1] / self.lengths[0]
        drawn = [
            (
                rng.choice(len(self.lengths), WAVES, p=self.powers / total),
                ratio ** (rng.random(WAVES) - 0.5),
                2 * math.pi * rng.random((2, WAVES)),
            )
            for _ in range(2)
        ]
        strength = math.sqrt(2 * total / WAVES)
        for shortest in range(0, len(self.lengths), 3):
            moved, slopes = np.zeros_like(places), np.zeros((len(places), 2, 2))
            for axis, (chosen, factor, (angle, phase)) in enumerate(drawn):
                number = 2 * math.pi / (self.lengths[np.maximum(chosen, shortest)] * factor)
                waves = number * np.array([np.cos(angle), np.sin(angle)])
                for wave, start in zip(waves.T, phase, strict=True):
                    angles = places @ wave + start
                    moved[:, axis] += np.cos(angles)
                    slopes[:, axis] -= np.multiply.outer(np.sin(angles), wave)
            if _least_area(strength * slopes) >= LEAST_AREA:
                break
        while _least_area(strength * slopes) < LEAST_AREA:
            strength *= 0.95
        return moved * strength


def _least_area(slopes: Array) -> float:
    """Return the least factor by which displacements of slopes ``(n, 2, 2)`` change an area; below 0 is a fold."""
    return float(np.linalg.det(np.eye(2) + slopes).min())


@dataclass(frozen=True, eq=False)
class AffineRest:
    """Displacements of vertices without their affine part, and the correlogram of what is left.

    Parameters
    ----------
    places
        ``(n, 2)`` px.
    displacements
        ``(n, 2)`` px: without the affine part.
    affine
        ``(n, 3)``: orthonormal columns that span all affine displacements along one axis.
    unit
        Width of the bins of distances, px.
    """

    places: Points
    displacements: Points
    affine: Array
    unit: float

    @classmethod
    def of(cls, deformation: Deformation) -> AffineRest:
        """Return the rest of the vertices nearest to the middle."""
        numbers, moved = (each[:MOST_VERTICES] for each in deformation.vertices)
        places = deformation.mesh.from_cell(numbers)
        affine, _ = np.linalg.qr(np.column_stack([places - places.mean(0), np.ones(len(places))]))
        return cls(places, moved - affine @ (affine.T @ moved), affine, _BIN * deformation.lattice.s)

    @cached_property
    def distances(self) -> Array:
        """``(n, n)`` px."""
        return np.asarray(np.hypot(*np.moveaxis(self.places[:, np.newaxis] - self.places, -1, 0)))

    @cached_property
    def _bins(self) -> NDArray[np.intp]:
        return np.ceil(self.distances / self.unit).astype(np.intp)

    @cached_property
    def pairs(self) -> Array:
        """``(b,)``: number of pairs in each bin of distances; the first holds each vertex with itself."""
        return np.maximum(np.bincount(self._bins.ravel()), 1).astype(np.float64)

    def correlogram(self, covariance: Array, clear: bool = False) -> Array:
        """Return the mean of a covariance over the pairs of each bin, ``(b,)``, the affine part taken out.

        Parameters
        ----------
        covariance
            ``(n, n)``.
        clear
            Whether it is clear of the affine part already.
        """
        if not clear:
            part = self.affine.T @ covariance
            covariance = covariance - self.affine @ part
            covariance = covariance - (covariance @ self.affine) @ self.affine.T
        return np.asarray(np.bincount(self._bins.ravel(), covariance.ravel()) / self.pairs)


def neighbor_field(deformation: Deformation, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Return displacements (x, y) px of ``shape`` rows and columns of vertices, by appendix A, equations 1 to 3.

    As printed, equation 1 is the same decreasing function of the distance between two vertices for every neighbor, so
    that equation 3 would draw all vertices together. It is read as what the text calls it, a density map of each
    neighbor: the Parzen density of that neighbor's offset over all vertices of the sample. Its sigma is the standard
    deviation of the offsets times n^(-1/6) (Scott's rule). The window of the moves is as wide as the standard deviation
    of the offsets.

    Parameters
    ----------
    deformation
        That of the sample.
    shape
        Rows and columns of vertices along the second and the first vector.
    rng
        The randomness.
    """
    offsets = _neighbor_offsets(deformation)
    spread = np.std(np.concatenate(offsets), axis=0) + 1e-9
    half, widest = float(spread.max()), max(float(np.abs(offset).max(initial=0.0)) for offset in offsets)
    step = half / 4
    count = math.ceil((widest + 4 * half) / step)
    grid = np.asarray(np.arange(-count, count + 1) * step, np.float64)
    maps = np.stack([_log_density(offset, grid) for offset in offsets])
    side = np.linspace(-1, 1, MOVES)
    moves = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) * spread
    start = rng.uniform(-spread, spread, (*shape, 2))
    return move_vertices(start, maps, step, np.ascontiguousarray(moves), SWEEPS)


def _neighbor_offsets(deformation: Deformation) -> list[Points]:
    """Return for each of the eight neighbors its displacements less those of the vertices, ``(n, 2)`` px each."""
    numbers, moved = deformation.vertices
    at = numbers - numbers.min(0) + 1
    table = np.full((*(at.max(0) + 2), 2), np.nan)
    table[*at.T] = moved
    found = []
    for down, right in _NEIGHBORS:
        offset = table[at[:, 0] + right, at[:, 1] + down] - moved
        found.append(offset[np.isfinite(offset).all(1)])
    return found


def _log_density(offsets: Points, grid: Array) -> Array:
    """Return the logarithm of the Parzen density of offsets, up to a constant, by y and x of a grid."""
    if not len(offsets):
        return np.zeros((len(grid), len(grid)))
    sigma = np.maximum(offsets.std(0), 1e-9) * len(offsets) ** (-1 / 6)
    squares = ((grid[:, np.newaxis, np.newaxis] - offsets) / sigma) ** 2 / 2
    x, y = squares[..., 0], squares[..., 1]
    least_x, least_y = x.min(1), y.min(1)
    # Products of two one-dimensional kernels; each is divided by its largest value, so that none vanishes.
    sums = np.exp(least_y[:, np.newaxis] - y) @ np.exp(least_x[:, np.newaxis] - x).T
    return np.asarray(np.log(np.maximum(sums, 1e-300)) - least_y[:, np.newaxis] - least_x)
