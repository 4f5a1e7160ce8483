"""The lattice of a sample as it lies in the sample, and the displacements of the vertices of an output."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Geometry
from nrbench.tracking.bent_lattice import Deformation
from nrbench.tracking.tracker import MeanTile, Track, track_tiles

from .vertex_kernels import move_vertices

PARTS: Final = 2
"""Parts into which each step of about s is divided; twice as many knots halve the error of the straightened sample."""
LEAST_CORRELATION: Final = 0.5
"""Correlation with the mean tile from which a tile counts as found."""
LEAST_FOUND: Final = 0.5
"""Share of the tiles that must be found."""
LEAST_POINTS: Final = 9
"""Whole tiles that the sample must hold."""
Array = NDArray[np.float64]
Locate = Callable[[Points], Points]
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
"""Shortest wave length of a field, in s: the tracker cannot follow shorter ones."""
_LENGTHS = 24
_BIN = 0.5
"""Width, in s, of the bins of distances."""
_BORDER = 3.0
"""Breadth, in s, of the frame of vertices around the output."""
_NEIGHBORS = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]


@dataclass(frozen=True, eq=False)
class DeformedLattice:
    """Where the vertices of a lattice, and points between them, lie in a sample.

    Parameters
    ----------
    lattice
        The regular lattice, reduced, in pixels of the sample.
    knots
        A finer lattice, on which the displacements are known.
    numbers
        ``(n, 2)``: cell coordinates on ``knots`` of the points whose content was found inside the sample. Where both
        are multiples of :data:`PARTS` they are vertices.
    displacements
        ``(n, 2)`` px: how far the content that belongs at each point lies from it, less the mean.
    amplitude
        Root mean square displacement of whole tiles without its affine part, px; 0 if there is an obstacle.
    obstacle
        Why the displacements cannot be relied on; empty if they can.
    """

    lattice: Lattice
    knots: Lattice
    numbers: NDArray[np.int64]
    displacements: Points
    amplitude: float
    obstacle: str = ""

    @classmethod
    def read(cls, lattice: Lattice, size: Points, locate: Locate, amplitude: float, obstacle: str) -> DeformedLattice:
        """Return a reduced lattice whose points lie where ``locate`` says, NaN: unknown, in a sample of ``size`` px."""
        knots, last = knot_lattice(lattice), size - 1.0
        numbers = knots.cell_numbers(-last, 2 * last)
        places = knots.from_cell(numbers)
        found = locate(places)
        inside = ((found >= 0) & (found <= last)).all(1)
        moved = (found - places)[inside]
        return cls(lattice, knots, numbers[inside], moved - moved.mean(0), amplitude, obstacle)

    @cached_property
    def places(self) -> Points:
        """``(n, 2)``: places (x, y) px of the points before they are displaced."""
        return self.knots.from_cell(self.numbers)

    @cached_property
    def mesh(self) -> Lattice:
        """The lattice of the vertices: steps of about s along both vectors."""
        return Lattice.from_basis(PARTS * self.knots.matrix, self.knots.origin)

    @cached_property
    def is_vertex(self) -> NDArray[np.bool_]:
        """``(n,)``: which points are vertices."""
        return np.asarray((self.numbers % PARTS == 0).all(1))


def knot_lattice(lattice: Lattice) -> Lattice:
    """Return a lattice whose vectors are those of ``lattice``, reduced, divided into parts about s / 2 long."""
    lattice = lattice.reduced()
    parts = PARTS * np.maximum(np.rint(np.hypot(*lattice.matrix.T) / lattice.s), 1)
    return Lattice.from_basis(lattice.matrix / parts[:, np.newaxis], lattice.origin)


def find_deformed_lattice(sample: Image, lattice: Lattice) -> DeformedLattice:
    """Track the lattice through the sample, in place of the user who moves its vertices by hand (report, appendix A).

    The report uses vertices alone. The tracker also measures between them.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        The regular lattice. Its phase need not fit.
    """
    lattice, size = lattice.reduced(), np.array(sample.shape[1::-1], np.float64)
    tile = MeanTile.of(sample, lattice)
    if tile.flat:
        return DeformedLattice.read(lattice, size, np.copy, 0.0, "the mean tile is flat")
    track = track_tiles(sample, lattice, tile)
    obstacle = _obstacle(track)
    amplitude = 0.0 if obstacle else _amplitude(track)

    def locate(points: Points) -> Points:
        return np.asarray(points + track.nodes.interpolate(track.field, points))

    return DeformedLattice.read(lattice, size, locate, amplitude, obstacle)


def read_deformation(deformation: Deformation, origin: Points) -> DeformedLattice | None:
    """Return the lattice of a deformation that was followed from knot to knot; None if it was not followed.

    Parameters
    ----------
    deformation
        A mean lattice as it lies in the sample.
    origin
        The origin (x, y) px of the regular lattice that is returned, whose vectors are those of the mean lattice.
    """
    if deformation.knots is None:
        return None
    lattice = Lattice.from_basis(deformation.lattice.matrix, origin)

    def locate(points: Points) -> Points:
        return np.where(deformation.covers(points)[:, np.newaxis], deformation.locate(points), np.nan)

    size = np.array(deformation.image.shape[1::-1], np.float64)
    return DeformedLattice.read(lattice, size, locate, deformation.amplitude * lattice.s, "")


def _obstacle(track: Track) -> str:
    found, share = len(track.numbers), track.tracked_share(LEAST_CORRELATION)
    if found < LEAST_POINTS:
        return f"the sample holds {found} whole tiles, at least {LEAST_POINTS} are needed"
    if share < LEAST_FOUND:
        return f"the mean tile was found at only {share:.0%} of the places"
    return ""


def _amplitude(track: Track) -> float:
    """Return the unbiased root mean square distance of the whole tiles from their best affine fit, px."""
    places = track.locate(track.numbers)
    design = np.column_stack([track.numbers, np.ones(len(places))])
    rest = places - design @ np.linalg.lstsq(design, places, rcond=None)[0]
    return math.sqrt(float((rest**2).sum() / (len(rest) - design.shape[1])))


def output_field(
    deformed: DeformedLattice, shape: tuple[int, int], geometry: Geometry, rng: np.random.Generator
) -> tuple[Points, Points, float]:
    """Return the places of vertices around an output, their displacements, and the distance of the nearest two.

    Parameters
    ----------
    deformed
        The lattice as it lies in the sample.
    shape
        Height and width of the output, px.
    geometry
        ``"bent"``: displacements are drawn at once from a normal distribution (:class:`WaveSpectrum`). ``"argmax"``:
        :func:`neighbor_field`.
    rng
        The randomness.
    """
    lattice = deformed.mesh if geometry == "argmax" else deformed.knots
    border = _BORDER * deformed.lattice.s + 3 * deformed.amplitude
    low, high = (-border, -border), (shape[1] - 1 + border, shape[0] - 1 + border)
    numbers = lattice.cell_numbers(low, high)
    places = lattice.from_cell(numbers)
    if geometry == "bent":
        return places, WaveSpectrum.of(deformed).draw(places, rng), lattice.s
    first = numbers.min(0)
    columns, rows = numbers.max(0) - first + 1
    u, v = (numbers - first).T
    return places, neighbor_field(deformed, (int(rows), int(columns)), rng)[v, u], lattice.s


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
    def of(cls, deformed: DeformedLattice) -> WaveSpectrum:
        """Fit the spectrum to the sample's vertices.

        The covariance of waves of one length, over all directions, is a Bessel function of the distance. A few periods
        of a sample show no displacement, but what is left of it after an affine fit. The same fit is therefore taken
        out of the covariances (:class:`~.AffineRest`). Powers that are not negative are fitted by least squares to the
        correlogram; the error of the tracker is one more unknown, at distance 0. Last, all powers are multiplied so
        that the amplitude is the sample's.
        """
        s, rest = deformed.lattice.s, AffineRest.of(deformed)
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
    def of(cls, deformed: DeformedLattice) -> AffineRest:
        """Return the rest of the vertices nearest to the middle."""
        places, moved = deformed.places[deformed.is_vertex], deformed.displacements[deformed.is_vertex]
        middle = (places.min(0) + places.max(0)) / 2
        near = np.argsort(np.abs(places - middle).max(1), kind="stable")[:MOST_VERTICES]
        places, moved = places[near], moved[near]
        affine, _ = np.linalg.qr(np.column_stack([places - middle, np.ones(len(places))]))
        return cls(places, moved - affine @ (affine.T @ moved), affine, _BIN * deformed.lattice.s)

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


def neighbor_field(deformed: DeformedLattice, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Return displacements (x, y) px of ``shape`` rows and columns of vertices, by appendix A, equations 1 to 3.

    As printed, equation 1 is the same decreasing function of the distance between two vertices for every neighbor, so
    that equation 3 would draw all vertices together. It is read as what the text calls it, a density map of each
    neighbor: the Parzen density of that neighbor's offset over all vertices of the sample. Its sigma is the standard
    deviation of the offsets times n^(-1/6) (Scott's rule). The window of the moves is as wide as the standard deviation
    of the offsets.

    Parameters
    ----------
    deformed
        The lattice as it lies in the sample.
    shape
        Rows and columns of vertices along the second and the first vector.
    rng
        The randomness.
    """
    offsets = _neighbor_offsets(deformed)
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


def _neighbor_offsets(deformed: DeformedLattice) -> list[Points]:
    """Return for each of the eight neighbors its displacements less those of the vertices, ``(n, 2)`` px each."""
    numbers = deformed.numbers[deformed.is_vertex] // PARTS
    moved = deformed.displacements[deformed.is_vertex]
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
