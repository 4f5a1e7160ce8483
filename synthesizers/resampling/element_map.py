"""Segments the cell of a texture into elements: what varies together is one element."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from skimage.segmentation import watershed

from nrbench.imaging.mean_tile import Values, cell_coordinates, fold, sample_tile
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Shape

Numbers = NDArray[np.int64]
Lag = tuple[int, int]
Pair = tuple[int, int, Lag]
"""Regions a and b and a lag in cells: b's instance of cell c + lag belongs to a's instance of cell c."""

FEWEST = 3
"""Whole instances of each element that the sample must show."""
WHOLE = 0.97
"""Share of an element that the sample shows if it shows the element whole."""
GRID = 1.5
"""Places of the map per px."""
_SAME = 0.7
"""Neighbors whose colors correlate at least this much are parts of one element."""
_SALIENT = 0.8
"""The relief along the border of two elements is at least this share of the 90 % quantile inside them."""
_DOUBT = 3.0
"""Correlation that a border is worth that stands out by 1 less than :data:`_SALIENT`."""
_GROUND = 0.2
"""Regions whose color varies less than this share of the largest variance are ground between elements."""
_SMALL = 0.15
"""Regions smaller than this share of the largest one are ground."""
_STILL = 0.05
"""The largest region is looked for among those whose color varies at least this share of the largest variance."""
_SHOWN = 0.5
"""Least share of an element that the sample must show, for its color to count."""
_LEAST_SHARE = 0.02
"""Smaller shares of an element in a place count as 0."""


@dataclass(frozen=True)
class InstanceColors:
    """The mean residual colors of the instances of one element.

    Parameters
    ----------
    values
        ``(I, J, C)``, one for each cell.
    shown
        ``(I, J)``: share of each instance that the sample shows.
    """

    values: NDArray[np.float64]
    shown: NDArray[np.float64]

    @property
    def known(self) -> NDArray[np.bool_]:
        """The instances of which the sample shows enough, ``(I, J)``."""
        return self.shown >= _SHOWN

    def energy(self) -> float:
        """Return the variance of the color, summed over the channels."""
        return float(self.values[self.known].var(0).sum()) if self.known.any() else 0.0

    def correlation(self, other: InstanceColors, lag: Lag) -> tuple[float, int]:
        """Return the correlation with the colors of another element ``lag`` cells on, and the number of pairs.

        The channels are added; with fewer than four pairs it is 0.
        """
        both = np.logical_and(*overlap(self.known, other.known, lag))
        return correlate(*(part[both] for part in overlap(self.values, other.values, lag)))


def correlate(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, int]:
    """Return the correlation of pairs of colors, ``(n, C)``, and n; the channels are added; 0 for fewer than four."""
    if len(a) < 4:
        return 0.0, len(a)
    a, b = a - a.mean(0), b - b.mean(0)
    size = np.sqrt((a * a).sum() * (b * b).sum())
    return (float((a * b).sum() / size) if size > 1e-12 else 0.0), len(a)


def overlap(a: NDArray[Any], b: NDArray[Any], lag: Lag) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the parts of two arrays of cells that lie ``lag`` apart."""
    steps = list(zip(lag, a.shape, strict=False))
    here = tuple(slice(max(0, -d), max(0, n - max(0, d))) for d, n in steps)
    there = tuple(slice(max(0, d), max(0, n - max(0, -d))) for d, n in steps)
    return a[here], b[there]


@dataclass(frozen=True)
class ElementMap:
    """The regions of one cell, on a grid of places in cell coordinates.

    Parameters
    ----------
    lattice
        Its reduced basis spans the cells.
    label
        ``int (V, U)``: number of the region that each place belongs to.
    offset
        ``int (V, U, 2)``: cell of the region's instance, relative to the cell of the place. An element may reach over
        the borders of cells.
    """

    lattice: Lattice
    label: Numbers
    offset: Numbers

    @property
    def count(self) -> int:
        """Number of regions."""
        return int(self.label.max()) + 1

    def places(self, shape: Shape, corner: tuple[int, int] = (0, 0)) -> tuple[Numbers, Numbers, Numbers]:
        """Return row and column in the grid, ``(H, W)``, and cell, ``(H, W, 2)``, of pixels from a corner (x, y) on."""
        uv = cell_coordinates(self.lattice.shifted((-corner[0], -corner[1])), shape)
        cell = np.floor(uv).astype(np.int64)
        grid = np.array(self.label.shape[::-1])
        at = np.minimum(((uv - cell) * grid).astype(np.int64), grid - 1)
        return at[..., 1], at[..., 0], cell

    def instances(self, shape: Shape) -> tuple[Numbers, Numbers]:
        """Return the region of each pixel of a picture, ``(H, W)``, and the cell of its instance, ``(H, W, 2)``."""
        row, column, cell = self.places(shape)
        return self.label[row, column], cell + self.offset[row, column]

    def cells(self, shape: Shape) -> Numbers:
        """Return the cells of all instances that a picture can show, ``(I, J, 2)``: a box of cells."""
        height, width = shape
        corners = self.lattice.to_cell(np.array([(0, 0), (width, 0), (0, height), (width, height)], float))
        reach = int(np.abs(self.offset).max()) + 2
        low, high = np.floor(corners.min(0)).astype(int) - reach, np.ceil(corners.max(0)).astype(int) + reach
        return np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), -1)

    def sum_pixels(self, values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return the sums of values ``(H, W, C)`` over instances, ``(E, I, J, C)``, on the box of :meth:`cells`."""
        label, instance = self.instances(values.shape[:2])
        cells = self.cells(values.shape[:2])
        box = (self.count, *cells.shape[:2])
        index = np.ravel_multi_index((label, *np.moveaxis(instance - cells[0, 0], -1, 0)), box).ravel()
        sums = [np.bincount(index, plane.ravel(), int(np.prod(box))) for plane in np.moveaxis(values, -1, 0)]
        return np.stack(sums, -1).astype(np.float64).reshape(*box, -1)

    def mean_colors(self, residual: NDArray[np.floating[Any]]) -> list[InstanceColors]:
        """Return the mean residual colors of each region's instances, on the box of :meth:`cells`."""
        sums = self.sum_pixels(np.concatenate([residual, np.ones_like(residual[..., :1])], -1))
        values, pixels = sums[..., :-1] / np.maximum(sums[..., -1:], 1), sums[..., -1]
        whole = np.bincount(self.label.ravel()) / self.label.size * self.lattice.area
        return [InstanceColors(*pair) for pair in zip(values, pixels / whole[:, None, None], strict=True)]

    def joined(self, a: int, b: int, lag: Lag) -> ElementMap:
        """Return the map in which region b, ``lag`` cells on, is a part of region a."""
        label, offset = self.label.copy(), self.offset.copy()
        there = label == b
        offset[there] -= lag
        label[there] = a
        label[label > b] -= 1
        return ElementMap(self.lattice, label, offset)

    def borders(self, relief: NDArray[np.float64]) -> dict[Pair, float]:
        """Return the mean relief along the border of each pair of regions that touch."""
        found: dict[Pair, list[float]] = {}
        for axis in (0, 1):
            label, offset = np.roll(self.label, -1, axis), np.roll(self.offset, -1, axis)
            np.moveaxis(offset, axis, 0)[-1] += (1, 0) if axis == 1 else (0, 1)
            differ = self.label != label
            height = np.maximum(relief, np.roll(relief, -1, axis))[differ]
            lags = (offset - self.offset)[differ]
            for a, b, (i, j), high in zip(self.label[differ], label[differ], lags, height, strict=True):
                pair = (int(a), int(b), (int(i), int(j))) if a < b else (int(b), int(a), (-int(i), -int(j)))
                found.setdefault(pair, []).append(float(high))
        return {pair: float(np.mean(heights)) for pair, heights in found.items()}


def map_grid(lattice: Lattice) -> tuple[int, int]:
    """Return the numbers of places along v and u, finer than pixels: the mean tile keeps the edges of joints."""
    v, u = (max(6, round(GRID * math.hypot(*t))) for t in (lattice.t2, lattice.t1))
    return v, u


def segment(sample: Values, residual: Values, lattice: Lattice, whole_cells: bool = False) -> ElementMap:
    """Return the elements of a texture.

    The mean squared gradient of the cells is a relief, high where the mean tile or the colors of the cells step. Its
    watersheds cut the cell into regions. Neighbors are joined, the most alike first: those whose colors go together
    from cell to cell, and those whose border does not stand out of the relief inside them. What hardly varies, and what
    is small, is the ground. Each of its places is given to the nearest element.

    Parameters
    ----------
    sample, residual
        The sample, and the sample without its mean tile.
    lattice
        Reduced.
    whole_cells
        Join all regions: the only element is the cell, whose border follows borders of regions.
    """
    regions, relief = _watersheds(sample, lattice)
    while regions.count > 1:
        likeness, pair = _most_alike(regions, relief, residual)
        if likeness < _SAME and not whole_cells:
            break
        regions = regions.joined(*pair)
    size = np.bincount(regions.label.ravel())
    owner, _ = regions.instances(residual.shape[:2])
    pixels, power = np.bincount(owner.ravel()), (sample.astype(float) ** 2).sum(-1)
    level = np.bincount(owner.ravel(), power.ravel()) / np.maximum(pixels, 1)
    energy = np.array([colors.energy() for colors in regions.mean_colors(residual)]) / (level + 1e-4)
    large = size >= _SMALL * size[energy >= _STILL * energy.max()].max()
    elements = _without_ground(regions, ~large | (energy < _GROUND * energy[large].max()))
    if whole_cells:
        return elements
    return _without_few(elements, residual.shape[:2])


def _watersheds(sample: Values, lattice: Lattice) -> tuple[ElementMap, NDArray[np.float64]]:
    """Return the watersheds of the relief, and the relief."""
    steps = [scipy.ndimage.gaussian_filter(sample, (0.8, 0.8, 0), order=order) for order in ((1, 0, 0), (0, 1, 0))]
    power = np.square(steps, dtype=np.float64).sum(0).sum(-1, keepdims=True)
    v, u = map_grid(lattice)
    uv = np.stack(np.meshgrid((np.arange(u) + 0.5) / u, (np.arange(v) + 0.5) / v), -1)
    relief = np.sqrt(sample_tile(fold(power.astype(np.float32), lattice).values, uv)[..., 0].astype(np.float64))
    relief = scipy.ndimage.gaussian_filter(relief, max(1.0, 0.04 * GRID * lattice.s), mode="wrap")
    plateaus, _ = scipy.ndimage.label(scipy.ndimage.minimum_filter(relief, 5, mode="wrap") == relief)
    minima = np.stack(np.unravel_index(np.unique(plateaus, return_index=True)[1][1:], relief.shape), -1)
    if not len(minima):  # the relief is flat
        minima = np.zeros((1, 2), np.int64)
    # Three by three copies of the cell: the copy of a minimum whose basin holds a place tells the cell of its instance.
    markers = np.zeros((3 * v, 3 * u), np.int64)
    for j, i in np.ndindex(3, 3):
        markers[minima[:, 0] + j * v, minima[:, 1] + i * u] = np.arange(len(minima)) * 9 + 3 * j + i + 1
    basins: Numbers = watershed(np.tile(relief, (3, 3)), markers)  # type: ignore[no-untyped-call]
    basin = basins[v : 2 * v, u : 2 * u].astype(np.int64) - 1
    offset = np.stack([basin % 3 - 1, basin // 3 % 3 - 1], -1)
    return ElementMap(lattice, _renumbered(basin // 9), offset), relief


def _renumbered(label: Numbers) -> Numbers:
    """Return labels without gaps."""
    return np.unique(label, return_inverse=True)[1].reshape(label.shape).astype(np.int64)


def _most_alike(regions: ElementMap, relief: NDArray[np.float64], residual: Values) -> tuple[float, Pair]:
    """Return how alike the two neighbors are that are most alike, and the pair."""
    colors = regions.mean_colors(residual)
    energy = [color.energy() for color in colors]
    inside = [float(np.quantile(relief[regions.label == k], 0.9)) for k in range(regions.count)]

    def likeness(pair: Pair, height: float) -> float:
        a, b, lag = pair
        salience = height / max(inside[a], inside[b], 1e-12)
        comparable = _GROUND * energy[a] < energy[b] < energy[a] / _GROUND
        together = colors[a].correlation(colors[b], lag)[0] if comparable else 0.0
        return together + _DOUBT * max(0.0, _SALIENT - salience)

    return max((likeness(pair, height), pair) for pair, height in regions.borders(relief).items())


def _without_ground(regions: ElementMap, ground: NDArray[np.bool_]) -> ElementMap:
    """Return the map in which the places on the ground are given to the nearest element."""
    v, u = regions.label.shape
    off = np.tile(ground[regions.label], (3, 3))
    nearest = scipy.ndimage.distance_transform_edt(off, return_distances=False, return_indices=True)
    rows, columns = nearest[:, v : 2 * v, u : 2 * u]
    offset = regions.offset[rows % v, columns % u] + np.stack([columns // u - 1, rows // v - 1], -1)
    return ElementMap(regions.lattice, _renumbered(regions.label[rows % v, columns % u]), offset)


def _without_few(elements: ElementMap, shape: Shape) -> ElementMap:
    """Return the map in which elements that the sample shows whole too seldom are given to the nearest other ones."""
    while True:
        shown = elements.mean_colors(np.zeros((*shape, 1)))
        few = np.array([(element.shown >= WHOLE).sum() < FEWEST for element in shown])
        if few.all() or not few.any():
            return elements
        elements = _without_ground(elements, few)


@dataclass(frozen=True)
class ElementShares:
    """The shares that the elements around it have in each place of the cell.

    Parameters
    ----------
    elements
        The elements, without shares.
    label, offset
        ``int (R, V, U)`` and ``(R, V, U, 2)``: element and cell of the instance, the largest share first.
    share
        ``(R, V, U)``; the sum over R is 1.
    """

    elements: ElementMap
    label: Numbers
    offset: Numbers
    share: NDArray[np.float64]

    @classmethod
    def of(cls, elements: ElementMap, width: float, ranks: int = 3) -> ElementShares:
        """Return the shares after a Gaussian of ``width`` px, those of the ``ranks`` largest."""
        v, u = elements.label.shape
        pad = math.ceil(4 * width * GRID)
        row, column = np.ix_(np.arange(-pad, v + pad), np.arange(-pad, u + pad))
        label, offset = elements.label[row % v, column % u], elements.offset[row % v, column % u].copy()
        offset += np.stack(np.broadcast_arrays(column // u, row // v), -1)
        both = np.concatenate([label[..., np.newaxis], offset], -1).reshape(-1, 3)
        instances, number = np.unique(both, axis=0, return_inverse=True)
        number = number.reshape(label.shape)
        planes = (np.arange(len(instances))[:, np.newaxis, np.newaxis] == number).astype(np.float32)
        blurred = scipy.ndimage.gaussian_filter(planes, (0, width * GRID, width * GRID))[:, pad:-pad, pad:-pad]
        order = np.argsort(-blurred, 0, kind="stable")[:ranks]
        share = np.take_along_axis(blurred, order, 0).astype(np.float64)
        share[share < _LEAST_SHARE] = 0
        return cls(elements, instances[order][..., 0], instances[order][..., 1:], share / share.sum(0))

    def within(
        self, shape: Shape, corner: tuple[int, int] = (0, 0)
    ) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.float64], Numbers, Numbers]]:
        """Yield for each rank the pixels where it has a share, and there its share, elements and cells."""
        row, column, cell = self.elements.places(shape, corner)
        for label, offset, share in zip(self.label, self.offset, self.share, strict=True):
            at = share[row, column] > 0
            place = row[at], column[at]
            yield at, share[place], label[place], cell[at] + offset[place]
