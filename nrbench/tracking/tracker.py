"""Track a lattice through a deformed image, tile by tile, however far smooth displacements add up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, subtract_color, sum_channels
from nrbench.imaging.mean_tile import Values, interpolate
from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking.unwrapping_kernels import grow

__all__ = ["MeanTile", "Track", "track_tiles"]

LABELS = 16
"""Displacements tried along each vector of a cell."""
STIFFNESS = 1.5
"""Cost, in correlation, of a step of s between neighbors: a step of 0.15 s costs 0.03, one of 0.5 s costs 0.4."""
_SWEEPS = 2
"""How often every node is revised after the field has grown over all nodes."""
_FIRST_WIDTH = 1.5
"""Width in tiles of the windows that are unwrapped."""
_REFINED_WIDTHS = (1.5, 1.2, 1.0, 1.0)
"""Width in tiles of the windows of each refinement."""
_ORDERS = 7
"""Highest order of a harmonic along each reciprocal vector."""
_HIGHEST = 0.4
"""Cycles/px above which harmonics are left out, because rounding and interpolation distort them."""
_STRONGEST = 32
"""Harmonics of the mean tile that are compared."""
_COLOR_SHARE = 0.98
"""Share of the mean tile's color variance that the compared color directions hold."""
_FLAT = 1e-7
"""Variance of a mean tile, of values in [0, 1], below which there is nothing to track: less than a gray step."""
_FIRST_STEPS, _NEXT_STEPS = 4, 2
"""Newton steps after unwrapping, and in each refinement."""
_LONGEST_STEP = 0.12
"""Longest Newton step, in units of s."""
_REACH = 3.0
"""Width of the padding of the image, in standard deviations of a window."""
_NODES_PER_TILE = 2.0
"""Nodes per tile along each axis."""

Field = NDArray[np.float64]
"""A displacement (x, y) px at each node, ``(rows, columns, 2)``, or a number at each node, ``(rows, columns)``."""
Coefficients = NDArray[np.complex64]
"""``(K, C, rows, columns)``: K harmonics of C channels at the nodes."""
Surfaces = NDArray[np.float32]
"""``(rows, columns, LABELS, LABELS)``: correlation of each node at displacement (i t1 + j t2) / LABELS."""


@dataclass(frozen=True)
class Harmonics:
    """Some of the frequencies of a lattice-periodic image, one of each pair +-f.

    Parameters
    ----------
    lattice
        Reduced.
    numbers
        ``(K, 2)``: the integers m of each frequency f, f . t_i = m_i.
    """

    lattice: Lattice
    numbers: NDArray[np.int64]

    @classmethod
    def of(cls, lattice: Lattice) -> Harmonics:
        """Return the harmonics of low order, up to 0.4 cycles/px."""
        side = np.arange(-_ORDERS, _ORDERS + 1)
        numbers = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
        numbers = numbers[(numbers[:, 0] > 0) | ((numbers[:, 0] == 0) & (numbers[:, 1] > 0))]
        every = cls(lattice, numbers)
        return cls(lattice, numbers[np.hypot(*every.frequencies.T) <= _HIGHEST])

    @property
    def frequencies(self) -> Points:
        """``(K, 2)``: (f_x, f_y) in cycles/px."""
        return np.asarray(self.numbers @ np.linalg.inv(self.lattice.matrix).T)


@dataclass(frozen=True)
class Nodes:
    """The coarse grid on which local harmonics are measured, and the Gaussian window around each node.

    Parameters
    ----------
    shape
        Height and width of the image, px.
    covariance
        2 x 2, px^2: covariance of the window.
    counts
        Rows and columns of nodes on the padded image.
    padded
        Its height and width, px, such that no window wraps around onto the image.
    width
        Width of the window in tiles.
    """

    shape: tuple[int, int]
    covariance: Points
    counts: tuple[int, int]
    padded: tuple[int, int]
    width: float

    @classmethod
    def of(cls, lattice: Lattice, shape: tuple[int, int], width: float) -> Nodes:
        """Return nodes half a tile apart; each window is as broad as a flat window of ``width`` tiles."""
        cell = cell_covariance(lattice)
        covariance = width**2 * cell
        spread, box = np.sqrt(np.diag(covariance))[::-1], np.sqrt(12 * np.diag(cell))[::-1]
        padded = [scipy.fft.next_fast_len(math.ceil(n + _REACH * sd)) for n, sd in zip(shape, spread, strict=True)]
        step = np.minimum(box / _NODES_PER_TILE, np.array(shape) / 3)
        rows, columns = (scipy.fft.next_fast_len(math.ceil(n / px)) for n, px in zip(padded, step, strict=True))
        return cls(shape, covariance, (rows, columns), (padded[0], padded[1]), width)

    def narrowed(self, width: float) -> Nodes:
        """Return the same nodes with windows of another width, no broader than before."""
        return replace(self, covariance=self.covariance * (width / self.width) ** 2, width=width)

    @property
    def y(self) -> NDArray[np.float64]:
        """Rows, px, of the nodes inside the image."""
        return self._along(0)

    @property
    def x(self) -> NDArray[np.float64]:
        """Columns, px, of the nodes inside the image."""
        return self._along(1)

    @property
    def places(self) -> Points:
        """``(rows, columns, 2)``: (x, y) px of the nodes inside the image."""
        x, y = np.meshgrid(self.x, self.y)
        return np.stack([x, y], -1)

    def _along(self, axis: int) -> NDArray[np.float64]:
        at = np.arange(self.counts[axis]) * (self.padded[axis] / self.counts[axis])
        return np.asarray(at[at <= self.shape[axis] - 1])

    def coefficients(self, planes: Values, frequencies: Points) -> Coefficients:
        """Return the mean of each plane times exp(-2 pi i f . (x, y)) under the window around each node.

        The planes are transformed once. For each frequency only the band that the window passes is transformed back, on
        the coarse grid, so time grows with pixels and with frequencies, not with their product.

        Parameters
        ----------
        planes
            ``(H, W, C)``, taken as 0 outside the image.
        frequencies
            ``(K, 2)``: (f_x, f_y) cycles/px.
        """
        spectrum = scipy.fft.fft2(np.moveaxis(planes, -1, 0), self.padded)
        bins = frequencies[:, ::-1] * self.padded
        nearest = np.rint(bins).astype(np.int64)
        offsets = [np.rint(scipy.fft.fftfreq(n, 1 / n)).astype(np.int64) for n in self.counts]
        rows, columns = (nearest[:, [axis]] + offsets[axis] for axis in (0, 1))
        dy = (rows - bins[:, :1]) / self.padded[0]
        dx = (columns - bins[:, 1:]) / self.padded[1]
        (xx, xy), (_, yy) = self.covariance
        power = xx * dx[:, np.newaxis] ** 2 + 2 * xy * dx[:, np.newaxis] * dy[..., np.newaxis]
        power = power + yy * dy[..., np.newaxis] ** 2
        gain = (math.prod(self.counts) / math.prod(self.padded) * np.exp(-2 * math.pi**2 * power)).astype(np.float32)
        at = rows[..., np.newaxis] % self.padded[0], columns[:, np.newaxis] % self.padded[1]
        bands = scipy.fft.ifft2(np.moveaxis(spectrum[:, *at], 0, 1) * gain[:, np.newaxis])
        bands = bands[..., : len(self.y), : len(self.x)]
        rest = 2j * math.pi * (nearest - bins) / self.padded
        turn = np.exp(rest[:, :1] * self.y)[..., np.newaxis] * np.exp(rest[:, 1:] * self.x)[:, np.newaxis]
        return np.asarray(bands * turn[:, np.newaxis].astype(np.complex64))

    def interpolate(self, field: Field, points: Points) -> Field:
        """Return the field at points (x, y) px by cubic splines; beyond the last node it is constant."""
        down, across = (n / count for n, count in zip(self.padded, self.counts, strict=True))
        at = [points[..., 1] / down, points[..., 0] / across]
        planes = np.moveaxis(field, -1, 0)
        return np.stack([scipy.ndimage.map_coordinates(plane, at, order=3, mode="nearest") for plane in planes], -1)


def cell_covariance(lattice: Lattice) -> Points:
    """Return the covariance, 2 x 2 px^2, of points spread evenly over the lattice's Voronoi cell.

    Unlike that of the parallelogram it does not depend on the basis.
    """
    side = (np.arange(24) + 0.5) / 24
    uv = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    points = lattice.wrap(uv @ lattice.matrix)
    return np.asarray(points.T @ points / len(points))


@dataclass(frozen=True)
class MeanTile:
    """The mean tile of a texture, given by its strongest harmonics.

    Parameters
    ----------
    harmonics
        Their frequencies.
    colors
        ``(C, c)``: the orthonormal color directions that hold 98 % of the mean tile's variance. Others are ignored.
    values
        ``complex64 (K, c)``: the Fourier coefficients.
    weights
        ``(K,)``: weight of each harmonic in the correlation.
    """

    harmonics: Harmonics
    colors: Values
    values: NDArray[np.complex64]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, image: Values, lattice: Lattice) -> MeanTile:
        """Return the mean tile of an image whose content lies on the lattice, at least roughly."""
        every = Harmonics.of(lattice)
        nodes = Nodes.of(lattice, image.shape[:2], _FIRST_WIDTH)
        values = nodes.coefficients(_centered(image), every.frequencies).mean((2, 3))
        order = np.argsort(-(np.abs(values) ** 2).sum(1), kind="stable")[:_STRONGEST]
        colors = _main_colors(values[order])
        harmonics = Harmonics(lattice, every.numbers[order])
        return cls(harmonics, colors, values[order] @ colors, np.ones(len(order), np.float32))

    @property
    def power(self) -> float:
        """Variance of the mean tile."""
        return 2 * float((np.abs(self.values) ** 2).sum())

    @property
    def flat(self) -> bool:
        """Whether the mean tile varies too little to be tracked."""
        return not self.power > _FLAT

    def unweighted(self) -> MeanTile:
        """Return the same mean tile with equal weights."""
        return replace(self, weights=np.ones_like(self.weights))

    def product(self, coefficients: Coefficients) -> NDArray[np.complex64]:
        """Return the weighted product of local harmonics with the mean tile's, summed over channels: ``(K, ...)``."""
        return np.asarray(np.einsum("kcij,kc->kij", coefficients, np.conj(self.values) * self.weights[:, np.newaxis]))


def _main_colors(values: NDArray[np.complex64]) -> Values:
    parts = np.concatenate([values.real, values.imag])
    _, sizes, directions = np.linalg.svd(parts, full_matrices=False)
    shares = np.cumsum(sizes**2) / max((sizes**2).sum(), 1e-30)
    return np.asarray(directions[: int((shares < _COLOR_SHARE).sum()) + 1].T, np.float32)


@dataclass(frozen=True)
class Track:
    """A lattice tracked through an image.

    Parameters
    ----------
    image
        The image.
    lattice
        The undisturbed lattice.
    nodes
        A grid of positions on the plane of the undisturbed lattice.
    field
        ``(rows, columns, 2)``: displacement (x, y) px of the content that belongs at each node, unwrapped.
    correlation
        ``(rows, columns)``: correlation of that content with the mean tile, in [-1, 1].
    tile
        The mean tile that was tracked.
    """

    image: Image
    lattice: Lattice
    nodes: Nodes
    field: Field
    correlation: Field
    tile: MeanTile

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """``(n, 2)``: cell coordinates of the lattice points that were found at least half a tile inside the image."""
        reach = np.sqrt(3 * np.diag(cell_covariance(self.lattice)))
        low, high = -reach, np.array(self.image.shape[1::-1]) + reach
        numbers = self.lattice.cell_numbers(low, high)
        at = self.locate(numbers)
        inside = ((at >= reach - 0.5) & (at <= np.array(self.image.shape[1::-1]) - 0.5 - reach)).all(1)
        return np.asarray(numbers[inside])

    def locate(self, uv: Points | NDArray[np.int64]) -> Points:
        """Return the places (x, y) px in the image where the content of cell coordinates ``(..., 2)`` was found."""
        points = self.lattice.from_cell(uv)
        return np.asarray(points + self.nodes.interpolate(self.field, points))

    def tracked_share(self, least: float) -> float:
        """Return the share of nodes in the image whose content correlates with the mean tile by at least ``least``."""
        at = self.nodes.places + self.field
        seen = ((at >= 0) & (at <= np.array(self.image.shape[1::-1]) - 1)).all(-1)
        return float((self.correlation[seen] >= least).mean()) if seen.any() else 0.0


def track_tiles(image: Image, lattice: Lattice, tile: MeanTile) -> Track:
    """Track a lattice through an image.

    At each node of a grid with spacing half a tile the image is correlated with the mean tile, under a Gaussian window
    as broad as 1.5 tiles, at all displacements within a cell. In the lattice's harmonics this is a small Fourier sum.
    The displacements are unwrapped by continuity, refined to fractions of a pixel, and removed from the image. Narrower
    windows measure the remaining displacements, which are added; this is done four times. Each time the mean tile is
    computed again from the straightened image. A harmonic that varies from node to node receives less weight. Time is
    linear in the number of pixels.

    Parameters
    ----------
    image
        The image.
    lattice
        Reduced. Its phase need not fit the image.
    tile
        The mean tile to track, see :meth:`MeanTile.of`.

    Examples
    --------
    >>> import nrbench
    >>> from nrbench.tracking.tracker import MeanTile, track_tiles
    >>> texture = nrbench.texture("weave", shape=(128, 128), seed=0)
    >>> lattice = texture.lattice.reduced()
    >>> track = track_tiles(texture.image, lattice, MeanTile.of(texture.image, lattice))
    >>> track.tracked_share(0.5)
    1.0
    """
    planes = _centered(image) @ tile.colors
    nodes = Nodes.of(lattice, image.shape[:2], _FIRST_WIDTH)
    field = _find_displacements(planes, nodes, tile)
    for width in _REFINED_WIDTHS:
        nodes = nodes.narrowed(width)
        straight = _straighten(planes, nodes, field)
        coefficients = nodes.coefficients(straight, tile.harmonics.frequencies)
        tile = _update_mean_tile(tile, coefficients)
        rest = _refine(tile.product(coefficients), tile.harmonics, np.zeros_like(field), _NEXT_STEPS)
        field = rest + nodes.interpolate(field, nodes.places + rest)
    heights = 2 * _shift(tile.unweighted().product(coefficients), tile.harmonics, rest).real.sum(0)
    correlation = heights / np.sqrt(max(tile.power, _FLAT) * _window_variance(nodes, straight))
    return Track(image, lattice, nodes, field, correlation, tile)


def _find_displacements(planes: Values, nodes: Nodes, tile: MeanTile) -> Field:
    """Return the unwrapped displacements at the nodes."""
    product = tile.product(nodes.coefficients(planes, tile.harmonics.frequencies))
    strength = np.sqrt(max(tile.power, _FLAT) * _window_variance(nodes, planes))[..., np.newaxis, np.newaxis]
    surfaces = np.asarray(correlation_surfaces(product, tile.harmonics) / strength, np.float32)
    wrapped = unwrap(surfaces, tile.harmonics.lattice)
    return _invert_field(nodes, _refine(product, tile.harmonics, wrapped, _FIRST_STEPS))


def unwrap(surfaces: Surfaces, lattice: Lattice) -> Field:
    """Return a continuous displacement of each node, (x, y) px, from correlations that are known modulo the lattice.

    The field grows from the node with the highest peak; of the nodes next to the field, the one with the highest peak
    is added first. Each node takes the displacement that maximizes its own correlation minus the cost of departing from
    the mean of its neighbors in the field (:data:`STIFFNESS`). Then every node is revised twice, with all its neighbors
    known. Libraries unwrap a phase modulo 2 pi, not a displacement modulo a two-dimensional lattice.

    Parameters
    ----------
    surfaces
        Correlations by displacement.
    lattice
        Reduced.
    """
    steps = label_displacements(lattice)
    costs = STIFFNESS * (steps**2).sum(-1) / lattice.s**2
    trust = np.maximum(surfaces.max((2, 3)), 1e-3).astype(np.float64) ** 2
    return grow(np.ascontiguousarray(surfaces, np.float32), trust, steps, costs, lattice.matrix, _SWEEPS)


def label_displacements(lattice: Lattice) -> Points:
    """Return the shortest representative of each displacement (i t1 + j t2) / LABELS, ``(LABELS, LABELS, 2)`` px."""
    side = np.arange(LABELS) / LABELS
    return lattice.wrap(np.stack(np.meshgrid(side, side, indexing="ij"), -1) @ lattice.matrix)


def _update_mean_tile(tile: MeanTile, coefficients: Coefficients) -> MeanTile:
    """Return the mean tile of a straightened image. The weight of a harmonic is its inverse variance over the nodes."""
    values = coefficients.mean((2, 3))
    scatter = (np.abs(coefficients - values[..., np.newaxis, np.newaxis]) ** 2).mean((1, 2, 3))
    floor = 0.05 * (np.abs(values) ** 2).mean() + 1e-12
    return MeanTile(tile.harmonics, tile.colors, values, np.asarray(1 / (scatter + floor), np.float32))


def correlation_surfaces(product: NDArray[np.complex64], harmonics: Harmonics) -> Surfaces:
    """Return the correlation, not normalized, at all displacements (i t1 + j t2) / LABELS of a cell."""
    table = np.zeros((*product.shape[1:], LABELS, LABELS), np.complex64)
    m, n = harmonics.numbers.T % LABELS
    table[..., m, n] = np.moveaxis(product, 0, -1)
    return np.asarray(2 * LABELS**2 * np.fft.ifft2(table).real, np.float32)


def _shift(product: NDArray[np.complex64], harmonics: Harmonics, displacement: Field) -> NDArray[np.complex64]:
    """Return the product ``(K, rows, columns)`` for content that is moved back by the displacement of its node."""
    phase = np.tensordot(2 * math.pi * harmonics.frequencies, displacement, (1, 2)).astype(np.float32)
    # Sine and cosine of single precision take a fraction of the time of a complex exponential.
    turn = np.empty(phase.shape, np.complex64)
    turn.real, turn.imag = np.cos(phase), np.sin(phase)
    return np.asarray(product * turn)


def _refine(product: NDArray[np.complex64], harmonics: Harmonics, start: Field, steps: int) -> Field:
    """Return the displacements that maximize the correlation near ``start``, by Newton's method."""
    waves = 2 * math.pi * harmonics.frequencies
    pairs = (waves[:, :, np.newaxis] * waves[:, np.newaxis]).reshape(-1, 4)
    longest = _LONGEST_STEP * harmonics.lattice.s
    field = start
    for _ in range(steps):
        shifted = _shift(product, harmonics, field)
        slope = -np.tensordot(shifted.imag, waves, (0, 0))
        bend = np.tensordot(shifted.real, pairs, (0, 0)).reshape(*field.shape[:2], 2, 2)
        field = field + _newton_step(slope, bend, longest)
    return field


def _newton_step(slope: Field, bend: Field, longest: float) -> Field:
    """Return Newton's step uphill, at most ``longest`` px; along the slope where the surface is not concave."""
    trace, gap = np.trace(bend, axis1=-2, axis2=-1) / 2, (bend[..., 0, 0] - bend[..., 1, 1]) / 2
    least = trace - np.hypot(gap, bend[..., 0, 1])
    lift = np.maximum(0.05 * np.abs(trace) + 1e-12 - least, 0)
    lifted = bend + lift[..., np.newaxis, np.newaxis] * np.eye(2)
    step = np.linalg.solve(lifted, slope[..., np.newaxis])[..., 0]
    length = np.hypot(step[..., 0], step[..., 1])
    return np.asarray(step * np.minimum(1, longest / np.maximum(length, 1e-12))[..., np.newaxis])


def _invert_field(nodes: Nodes, displaced: Field) -> Field:
    """Return the displacements at undisturbed positions, from the displacements at positions in the image."""
    field = displaced
    for _ in range(8):
        field = (field + nodes.interpolate(displaced, nodes.places + field)) / 2
    return field


def _straighten(planes: Values, nodes: Nodes, field: Field) -> Values:
    """Return the planes without the displacements; content from outside the image is 0."""
    height, width = planes.shape[:2]
    down, along = (_spline_weights(at, n) for at, n in ((nodes.y, height), (nodes.x, width)))
    moved = np.einsum("yr,rcd,xc->dyx", down, field, along, optimize=True)
    places = np.moveaxis(moved, 0, -1) + np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    straight = interpolate(planes, places)
    straight[((places < 0) | (places > (width - 1, height - 1))).any(-1)] = 0
    return straight


def _spline_weights(at: Field, count: int) -> Field:
    """Return the matrix ``(count, n)`` of cubic splines from nodes to pixels, constant beyond the last node.

    The nodes are equally far apart, the first one at 0. At the second node and the last but one no derivative jumps.
    ``scipy.interpolate`` gives the same values, but its import takes longer than a small synthesis.
    """
    n = len(at)
    knots = np.arange(-1.0, n + 1)

    def splines(places: Field) -> Field:
        far = np.abs(places[:, np.newaxis] - knots)
        return np.asarray((np.maximum(2 - far, 0) ** 3 - 4 * np.maximum(1 - far, 0) ** 3) / 6)

    ends = np.diff(np.eye(n + 2), min(n, 4), axis=0)[[0, -1]]
    controls = np.linalg.inv(np.concatenate([splines(knots[1:-1]), ends]))[:, :n]
    return splines(np.minimum(np.arange(count), at[-1]) / max(at[-1], 1) * (n - 1)) @ controls


def _window_variance(nodes: Nodes, planes: Values) -> Field:
    """Return the variance under each window, summed over channels."""
    power = sum_channels(planes**2)[..., np.newaxis]
    moments = nodes.coefficients(np.concatenate([planes, power], -1), np.zeros((1, 2)))[0].real
    return np.asarray(np.maximum(moments[-1] - (moments[:-1] ** 2).sum(0), 1e-6), np.float64)


def _centered(image: Values) -> Values:
    return subtract_color(image, image.mean((0, 1), dtype=np.float64).astype(np.float32))
