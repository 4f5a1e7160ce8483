"""Find the elements of a texture (bricks, threads, cans), and cut windows around them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Values, interpolate
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import Shape

from ..verdict.measurements import Measurements

Bends = tuple[Points, Points]
"""Matrices ``(k, 2, 2)`` and shifts ``(k, 2)`` px."""
Correlations = NDArray[np.float64]

_SAMPLES, _FEWEST, _MOST = 36, 3, 12
"""Number of samples of a window, and the least and largest number along each of its sides."""
_GRID_SAMPLES, _GRID_STEP = 144, 1.5
"""Largest number of samples of a cell, and their least distance in px, where covariances are measured."""
_COARSE = 2
"""Factor by which the distance of these samples grows where grain hides the elements."""
_ENOUGH_CELLS = 200
"""Number of cells from which no further image is used."""
_HIGH = 0.5
"""Correlation with the middle of an element, above the background, from which a sample belongs to the element."""
_CHANCE = 4.0
"""Correlations below this many standard errors are chance."""
_VARIANCE_FLOOR = 0.05
"""Share of the mean variance that is added to the variance of every sample."""
_RESOLVED_SIDE, _RESOLVED_STEPS = 5.0, 1.9
"""Least side of a square of the same area as an element: in px, and in distances of the samples."""
_TRIM = 0.03
"""Share of an element's samples that may lie outside its box, on each side."""
_LEAST_ENERGY, _MOST_ELEMENTS = 0.1, 8
"""A further element explains at least this share of the energy that the first one explains; largest number of elements
in a cell."""
_COLOR_GRID, _COLOR_IMAGES, _LEAST_COLOR = (6, 6), 2, 0.003
"""Samples of a cell, and number of images, from which the axes of color are found; least share of the variance along an
axis."""
_ALIKE = 1.3
"""Boxes whose sides differ by less than this factor have one shape."""


@dataclass(frozen=True)
class Box:
    """The shape of a window around an element: a rectangle in any direction.

    Parameters
    ----------
    sides
        2 x 2: the vectors (x, y) px along its two sides, as rows.
    samples
        Number of samples along each of the two.
    """

    sides: Points
    samples: tuple[int, int]

    @property
    def reach(self) -> Points:
        """Half the width and half the height (x, y) px of the upright box around it."""
        return np.asarray(np.abs(self.sides).sum(0) / 2)

    @property
    def area(self) -> float:
        """Area, px^2."""
        return float(abs(np.linalg.det(self.sides)))

    @property
    def step(self) -> float:
        """Distance of the samples, px: the geometric mean over both sides."""
        return float(np.sqrt(self.area / (self.samples[0] * self.samples[1])))

    def offsets(self, margin: int = 0) -> Points:
        """Return the samples (x, y) px relative to the middle, ``(samples[1], samples[0], 2)``.

        Parameters
        ----------
        margin
            Number of samples beyond the window on each side.
        """
        u, v = ((np.arange(n + 2 * margin) - margin + 0.5) / n - 0.5 for n in self.samples)
        return np.asarray(np.stack(np.meshgrid(u, v), -1) @ self.sides)

    def coordinates(self, xy: Points) -> Points:
        """Return vectors (x, y) px in units of the two sides."""
        return np.asarray(xy @ np.linalg.inv(self.sides))


@dataclass(frozen=True)
class Element:
    """A kind of element: one in each cell.

    Parameters
    ----------
    place
        Cell coordinates of its middle.
    box
        The shape of the windows around it.
    """

    place: Points
    box: Box

    def numbers(self, middles: Points, lattice: Lattice) -> NDArray[np.int64]:
        """Return the numbers ``(n, 2)`` of the cells to which elements with middles ``(n, 2)`` px belong."""
        return np.rint(lattice.to_cell(middles) - self.place).astype(np.int64)


@dataclass(frozen=True)
class Windows:
    """Windows of one shape around elements.

    Parameters
    ----------
    middles
        ``(n, 2)``: their middles (x, y) px.
    values
        ``(n, samples, samples, C)``: their pixels, smoothed to the distance of the samples.
    """

    middles: Points
    values: Values

    def take(self, part: slice | NDArray[np.bool_]) -> Windows:
        """Return some of the windows."""
        return Windows(self.middles[part], self.values[part])


class Cutter:
    """Cuts windows out of an image.

    Parameters
    ----------
    image
        The image.
    lattice
        The lattice of its tiles, in the basis of the references: places of elements are cell coordinates. A canonical
        basis would not do. Where two vectors are nearly equal, a small error of the lattice makes it another one.
    """

    def __init__(self, image: Image, lattice: Lattice) -> None:
        self.lattice, self.shape, self._image = lattice, (image.shape[0], image.shape[1]), image
        self._smooth: dict[int, Image] = {}
        self._tracked: tuple[cKDTree, Points] | None = None

    @classmethod
    def from_measurements(cls, measurements: Measurements, middles: Points) -> Cutter:
        """Return a cutter that follows the displacements of an image's tiles.

        Parameters
        ----------
        measurements
            The tiles of an image.
        middles
            ``(n, 2)``: middles (x, y) px of the content of its whole tiles.
        """
        tiles = measurements.tiles
        cutter, whole = cls(measurements.image, tiles.lattice), tiles.centers[tiles.whole]
        cutter._tracked = cKDTree(whole), middles - whole
        return cutter

    def project_colors(self, axes: Points) -> Cutter:
        """Return the same cutter for the image with other channels: ``axes`` is ``(C, k)``."""
        other = Cutter(np.asarray(self._image @ axes.astype(np.float32)), self.lattice)
        other._tracked = self._tracked
        return other

    def cut(self, element: Element) -> Windows:
        """Return all windows around an element that lie inside the image."""
        middles = self.places((float(element.place[0]), float(element.place[1])))
        reach = element.box.reach
        inside = (middles >= reach - 0.5).all(1) & (middles <= np.array(self.shape[::-1]) - 0.5 - reach).all(1)
        return Windows(middles[inside], self.cut_around(middles[inside], element.box))

    def places(self, place: Vector) -> Points:
        """Return the points (x, y) px of the image at a place of the cell, displaced like the content."""
        points = _points(self.lattice, self.shape, place)
        return points + self._displacements(points)

    def cut_around(self, middles: Points, box: Box, margin: int = 0, bends: Bends | None = None) -> Values:
        """Return windows around middles, ``(n, samples[1], samples[0], C)``; beyond the image its border is repeated.

        Parameters
        ----------
        middles
            ``(n, 2)``: (x, y) px.
        box
            Their shape.
        margin
            Number of samples beyond the window on each side.
        bends
            Affine maps that bend the content of the windows, one for each window in turn; None: no bending.
        """
        steps = box.offsets(margin)
        if bends is None:
            xy = middles[:, np.newaxis, np.newaxis] + steps
        else:
            turn = np.arange(len(middles)) % len(bends[0])
            xy = np.einsum("ijk,nkl->nijl", steps, bends[0][turn]) + (middles + bends[1][turn])[:, None, None]
        return self._read(xy, box.step)

    def cut_cells(self, grid: tuple[int, int]) -> tuple[NDArray[np.int64], Values]:
        """Return the numbers ``(n, 2)`` and the samples ``(n, rows, columns, C)`` of all cells inside the image.

        Parameters
        ----------
        grid
            Rows and columns: samples along the second and along the first vector of the lattice.
        """
        points = _points(self.lattice, self.shape, (0.0, 0.0))
        matrix = self.lattice.matrix
        box = Box(matrix, (grid[1], grid[0]))
        middles = points + self._displacements(points)
        inside = (middles >= box.reach - 0.5).all(1)
        inside &= (middles <= np.array(self.shape[::-1]) - 0.5 - box.reach).all(1)
        numbers = np.rint(self.lattice.to_cell(points[inside])).astype(np.int64)
        return numbers, self.cut_around(middles[inside], box)

    def _displacements(self, points: Points) -> Points:
        if self._tracked is None:
            return np.zeros_like(points)
        tree, displacements = self._tracked
        return np.asarray(displacements[tree.query(points)[1]])

    def _read(self, xy: Points, step: float) -> Values:
        """Return the image, smoothed by a box of about ``step`` px, at places (x, y) px."""
        size = max(round(step), 1)
        if size not in self._smooth:
            smooth = ndimage.uniform_filter(self._image, (size, size, 0), mode="reflect") if size > 1 else self._image
            self._smooth[size] = np.asarray(smooth, np.float32)
        return interpolate(self._smooth[size], xy)


@lru_cache(maxsize=32)
def _points(lattice: Lattice, shape: Shape, place: Vector) -> Points:
    """Return the points at a place of the cell; cached, because draws of one shape share them."""
    origin = lattice.from_cell(place)
    return Lattice(lattice.t1, lattice.t2, (float(origin[0]), float(origin[1]))).points(shape)


def subtract_mean(values: Values) -> NDArray[np.float64]:
    """Return windows ``(n, samples, samples, C)`` less their mean, ``(n, p)``."""
    flat = values.reshape(len(values), -1).astype(np.float64)
    return flat - flat.mean(0) if len(flat) else flat


def find_color_axes(cutters: list[Cutter]) -> Points:
    """Return the axes of color along which cells differ from each other, ``(C, k)``, orthonormal.

    Axes with less than a small share of the variance are left out, so that a gray texture has one.
    """
    covariance: NDArray[np.float64] | None = None
    for cutter in cutters[:_COLOR_IMAGES]:
        _, values = cutter.cut_cells(_COLOR_GRID)
        departures = (values - values.mean(0)).reshape(-1, values.shape[-1]) if len(values) else values.reshape(-1, 1)
        if len(departures):
            own = departures.T.astype(np.float64) @ departures
            covariance = own if covariance is None else covariance + own
    if covariance is None:
        return np.eye(1)
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes[:, variances >= _LEAST_COLOR * max(float(variances.sum()), 1e-12)])


def tile_element(lattice: Lattice) -> Element:
    """Return a whole tile as an element: a rectangle along the first vector, as large as a cell."""
    t1 = lattice.matrix[0]
    length = float(np.hypot(*t1))
    sides = np.array([t1, lattice.area / length**2 * np.array([-t1[1], t1[0]])])
    return Element(np.zeros(2), Box(sides, _count_samples(sides)))


def find_elements(cutters: list[Cutter], least_area: float = 0.0, grain: bool = False) -> list[list[Element]]:
    """Return the elements of a cell, in groups whose windows have one shape; none if no image contains a whole cell.

    An element is a region whose samples vary together from cell to cell: a brick, or a thread with its pieces on both
    sides of a crossing. The covariance of every two samples less than a cell apart is measured over the cells. The
    first element belongs to the sample that explains most of the variance around it (the region where its correlation
    is high, and the variance there). The next one explains most of the rest, and so on. The window around an
    element is the smallest rectangle along a vector of the lattice, or along a diagonal of the cell, that contains
    the region. It does not depend on the lattice's origin.

    Parameters
    ----------
    cutters
        Images without defects.
    least_area
        Least area of an element, over that of a cell.
    grain
        Whether the correlations are those beneath the grain. Grain that is stronger than the tones of the elements
        hides them: no two samples correlate by more than a half. The samples are then twice as far apart, each the mean
        of four times as many pixels, and their variances are taken without what they do not share with any neighbor.
    """
    if not any(len(cutter.cut_cells((1, 1))[0]) for cutter in cutters):
        return []
    field = _CellCovariance.measure(cutters, grain)
    free, first, elements = np.ones(len(field.variance)), 0.0, []
    for _ in range(_MOST_ELEMENTS):
        energy = field.explained @ (free * field.variance)[field.index] * free
        best = int(np.argmax(energy))
        first = max(first, float(energy[best]))
        if not energy[best] > _LEAST_ENERGY * first:
            break
        element = field.enclose(best)
        if element.box.area >= max(least_area * field.lattice.area, field.least_resolved_area):
            elements.append(element)
        free[field.index[field.explained[best] > 0]] = 0
    return _group(elements)


@dataclass(frozen=True)
class _CellCovariance:
    """Covariances of the samples of a cell with all samples less than a cell away.

    Parameters
    ----------
    lattice
        The lattice.
    uv
        ``(p, 2)``: cell coordinates of the samples of a cell.
    around
        ``(q, 2)``: cell coordinates of the samples of 3 x 3 cells.
    index
        ``(q,)``: number in the cell of each of these.
    variance
        ``(p,)``: variance of the samples of the cell.
    explained
        ``(p, q)``: squared correlation where the correlation is high, else 0.
    """

    lattice: Lattice
    uv: Points
    around: Points
    index: NDArray[np.intp]
    variance: NDArray[np.float64]
    explained: Correlations

    @classmethod
    def measure(cls, cutters: list[Cutter], grain: bool = False) -> _CellCovariance:
        """Measure the covariances over all cells of some images; with ``grain``, the correlations beneath the grain."""
        lattice = cutters[0].lattice
        grid = _cell_grid(lattice, _COARSE if grain else 1)
        cells: list[tuple[NDArray[np.int64], Values]] = []
        for cutter in cutters:
            if sum(len(numbers) for numbers, _ in cells) < _ENOUGH_CELLS:
                cells.append(cutter.cut_cells(grid))
        mean = np.concatenate([values for _, values in cells]).mean(0)
        samples = grid[0] * grid[1]
        sums, counts = np.zeros((3, 3, samples, samples)), np.zeros((3, 3))
        for numbers, values in cells:
            if not len(values):
                continue
            rows = (values - mean).reshape(len(values), samples, -1)
            flat = np.ascontiguousarray(np.moveaxis(rows, 1, -1))
            for i, j in ((0, 0), (1, 0), (0, 1), (1, 1), (-1, 1)):
                one, other = _pairs(numbers, (i, j))
                pair = np.tensordot(flat[one], flat[other], ((0, 1), (0, 1)))
                sums[1 + j, 1 + i] += pair
                counts[1 + j, 1 + i] += len(one)
                if (i, j) != (0, 0):
                    sums[1 - j, 1 - i] += pair.T
                    counts[1 - j, 1 - i] += len(one)
        u, v = ((np.arange(n) + 0.5) / n - 0.5 for n in grid[::-1])
        uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
        shifts = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), -1)
        around = (shifts[:, :, np.newaxis] + uv).reshape(-1, 2)
        covariance = (sums / np.maximum(counts, 1)[..., np.newaxis, np.newaxis]).transpose(2, 0, 1, 3)
        total = np.diagonal(covariance[:, 1, 1]).copy()
        variance = _shared_variance(covariance, total, grid) if grain else total
        covariance = covariance.reshape(samples, -1)
        covariance[:, np.repeat(counts.ravel() < 2, samples)] = 0
        near = (np.abs(around - uv[:, np.newaxis]) <= 1).all(-1)
        rho, least = _correlations(covariance, variance)
        chance = min(_CHANCE / float(np.sqrt(max(counts.max(), 1))), 0.8)
        if not grain:
            high = near & (rho >= least + np.maximum(_HIGH * (1 - least), chance))
        else:
            raw, background = _correlations(covariance, total)
            high = near & (rho >= least + _HIGH * (1 - least)) & (raw >= background + chance)
        rho = np.minimum(rho, 1)
        return cls(lattice, uv, around, np.tile(np.arange(samples), 9), variance, np.where(high, rho**2, 0.0))

    @property
    def least_resolved_area(self) -> float:
        """Area, px^2, below which a region that varies together may be grain that the samples have in common."""
        return max(_RESOLVED_SIDE, _RESOLVED_STEPS * float(np.sqrt(self.lattice.area / len(self.uv)))) ** 2

    def enclose(self, sample: int) -> Element:
        """Return the element of a sample: the smallest box around the samples that it explains."""
        t1, t2 = self.lattice.matrix
        own = (self.around[self.explained[sample] > 0] - self.uv[sample]) @ self.lattice.matrix
        step = np.sqrt(self.lattice.area / len(self.uv))
        boxes = []
        for direction in (t1, t2, t1 + t2, t1 - t2):
            along = direction / np.hypot(*direction)
            axes = np.array([along, (-along[1], along[0])])
            low, high = np.quantile(own @ axes.T, (_TRIM, 1 - _TRIM), axis=0)
            lengths = np.maximum(high - low + step, _FEWEST * 1.0)
            boxes.append((float(lengths.prod()), lengths[:, np.newaxis] * axes, (low + high) / 2 @ axes))
        _, sides, middle = min(boxes, key=lambda box: box[0])
        place = self.uv[sample] + self.lattice.to_cell(middle + np.array(self.lattice.origin))
        return Element(place, Box(sides, _count_samples(sides)))


def _correlations(covariance: Correlations, variance: NDArray[np.float64]) -> tuple[Correlations, Correlations]:
    """Return the correlations ``(p, 9 p)`` of samples with those of 3 x 3 cells, and the median of each, ``(p, 1)``."""
    floored = variance + _VARIANCE_FLOOR * variance.mean() + 1e-9
    rho = covariance / np.sqrt(floored[:, np.newaxis] * np.tile(floored, 9))
    return rho, np.median(rho, 1, keepdims=True)


def _shared_variance(
    covariance: Correlations, variance: NDArray[np.float64], grid: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the variance of each sample of a cell without its grain, ``(p,)``.

    Grain is what a sample shares with none of its neighbors. The rest of its variance is the largest of its covariances
    with the four neighbors, one of which belongs to the same element.

    Parameters
    ----------
    covariance
        ``(p, 3, 3, p)``: covariances with the samples of 3 x 3 cells.
    variance
        ``(p,)``: variance of the samples, grain included.
    grid
        Rows and columns of samples.
    """
    rows, columns = grid
    sheet = covariance.reshape(-1, 3, 3, rows, columns).transpose(0, 1, 3, 2, 4).reshape(-1, 3 * rows, 3 * columns)
    sample = np.arange(rows * columns)
    y, x = rows + sample // columns, columns + sample % columns
    beside = [sheet[sample, y + down, x + along] for down, along in ((-1, 0), (1, 0), (0, -1), (0, 1))]
    return np.asarray(np.clip(np.max(beside, 0), 0, variance))


def _cell_grid(lattice: Lattice, coarse: int) -> tuple[int, int]:
    """Return the rows and columns of samples of a cell, evenly spaced."""
    lengths = np.hypot(*lattice.matrix.T)[::-1]
    step = coarse * max(float(np.sqrt(lengths.prod() / _GRID_SAMPLES)), _GRID_STEP)
    rows, columns = np.maximum(np.floor(lengths / step + 1e-9), 2).astype(int)
    return int(rows), int(columns)


def _pairs(numbers: NDArray[np.int64], shift: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of all pairs of cells of which the second lies ``shift`` cells beyond the first."""
    if not len(numbers):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    low = numbers.min(0) - 1
    table = np.full(numbers.max(0) - low + 2, -1, np.intp)
    at = numbers - low
    table[at[:, 0], at[:, 1]] = np.arange(len(numbers))
    other = table[at[:, 0] + shift[0], at[:, 1] + shift[1]]
    return np.flatnonzero(other >= 0), other[other >= 0]


def _count_samples(sides: Points) -> tuple[int, int]:
    lengths = np.hypot(*sides.T)
    step = np.sqrt(lengths.prod() / _SAMPLES)
    first = int(np.clip(round(float(lengths[0] / step)), _FEWEST, _MOST))
    return first, int(np.clip(round(float(lengths[1] / step)), _FEWEST, _MOST))


def _group(elements: list[Element]) -> list[list[Element]]:
    """Return the elements in groups of nearly equal boxes, each with the box of its first element."""
    groups: list[list[Element]] = []
    for element in elements:
        for group in groups:
            ratio = np.linalg.inv(group[0].box.sides) @ element.box.sides
            turned = np.abs(ratio - np.diag(np.diag(ratio))).max()
            if turned < 0.1 and (np.abs(np.log(np.abs(np.diag(ratio)))) < np.log(_ALIKE)).all():
                group.append(Element(element.place, group[0].box))
                break
        else:
            groups.append([element])
    return groups
