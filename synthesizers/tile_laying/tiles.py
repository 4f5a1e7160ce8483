"""The tiles of a tile set: shape, steps and anchor, and the tiles that a sample holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, depth_of, to_bytes
from nrbench.imaging.mean_tile import fold
from nrbench.imaging.wallpaper_group import find_wallpaper_group
from nrbench.lattice.geometry import Lattice, Points

from ..canvas.canvas import ExactPatch, Mask, Pixels, Source
from ..lattice_places.equal_places import pixel_grid
from ..sample_reading.patches import Patches, point_source
from .tile_kernels import Overlap, best_move, compare_tiles, nearest_places

TileKind = Literal["upright", "lattice", "rectangle", "cell"]
AnchorKind = Literal["quiet", "elements"]
OverlapMeasure = Literal["mean", "sum"]
Array = NDArray[np.float64]
Isometry = tuple[Points, Points]
"""Matrix and offset: points (x, y) px go to ``(x, y) @ matrix + offset``."""
TILE_SHARE: Final[dict[AnchorKind, float]] = {"quiet": 0.8, "elements": 0.5}
"""Share of the largest possible number of tiles that an anchor must leave in each set. It is lower for elements: a tile
anchored a few px beside an element cuts it, and half of the tiles are better than all of them cut."""
ELEMENT: Final = 6.0
"""The elements of a texture are at least about this part of s wide. On walls and hexagons, 6 and 8 put the anchor
equally near to the middle of an element; with grain of 0.1 and color of 0.1 or less, 6 is nearer."""
LEAST_WEIGHT: Final = 0.1
"""Weight of a seam where elements do not vary, added everywhere. It hardly matters: on 40 mild walls (color 0.05 to
0.3), powers and floors of 2 and 0.1, 4 and 0.05, 8 and 0.02 leave at most 0.0004 of the bricks two-toned."""
FINE: Final = 4
"""Parts of a pixel between anchors of elements: half a pixel decides on which side of a joint a seam runs."""
MAX_COMPARED: Final = 48
"""Number of tiles of a set, evenly spread, that are compared with one another for the threshold."""
SPARE: Final = 2
"""px around a tile in a copy that must be in the sample, too: for its registration."""
MAX_ANCHORS: Final = 100
"""Number of anchors compared, evenly spread from the lowest cost to the highest."""


@dataclass(frozen=True, eq=False)
class TileShape:
    """A maximum tile and the steps between tiles.

    Parameters
    ----------
    steps
        ``(2, 2)``: the step to the next tile of a row, and the step to the next row; rows are (x, y) px. Twice a step
        is a lattice vector.
    sides
        ``(2, 2)``: the two sides of the maximum tile, a parallelogram around its middle.
    """

    steps: Points
    sides: Points

    def set_offsets(self, lattice: Lattice) -> list[tuple[int, int]]:
        """Return, for each set of tiles, the steps (in the row, to the next row) from a lattice point to its middles.

        Two tiles are of one set if a lattice vector leads from one to the other. Tiles along diagonals of the cell have
        two sets, T and Th; tiles along the lattice vectors up to four; tiles twice as large one, T.
        """
        numbers = list(np.ndindex(2, 2))
        halves = np.rint(2 * np.array(numbers) @ self.steps @ np.linalg.inv(lattice.matrix)).astype(int) % 2
        _, first = np.unique(halves, axis=0, return_index=True)
        return [numbers[n] for n in sorted(first.tolist())]

    @cached_property
    def reach(self) -> Points:
        """Half the extent of the tile along x and y, px."""
        return np.asarray(np.abs(self.sides).sum(0) / 2)

    @cached_property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells, at most a pixel wide, that divide the tile along its sides."""
        columns, rows = np.ceil(np.hypot(*self.sides.T) - 1e-9).astype(int)
        return max(int(rows), 1), max(int(columns), 1)

    def _along_sides(self, offsets: NDArray[np.int64]) -> Points:
        """Return points (x, y) px from the middle, ``(h, w, 2)``, in shares of the two sides."""
        return (offsets.reshape(-1, 2) @ np.linalg.inv(self.sides)).reshape(offsets.shape)

    @cached_property
    def _offsets(self) -> NDArray[np.int64]:
        """``(h, w, 2)``: (x, y) from the tile's middle of the whole-pixel points of the least box that holds it."""
        x, y = np.floor(self.reach + 1e-9).astype(int)
        offsets = pixel_grid(2 * int(x) + 1, 2 * int(y) + 1, -int(x), -int(y))
        inside = np.asarray((np.abs(self._along_sides(offsets)) <= 0.5 + 1e-9).all(-1))
        return np.ascontiguousarray(offsets[inside.any(1)][:, inside.any(0)])

    @cached_property
    def box(self) -> NDArray[np.int64]:
        """``(2, 2)``: the least and the greatest (x, y) of the tile's pixels, from its middle."""
        return self._offsets[[0, -1], [0, -1]]

    @cached_property
    def pixel_cells(self) -> NDArray[np.int64]:
        """``(h, w, 3)``: for each pixel of the box its row and column in the grid, and its border; -1 outside the tile.

        The border is the number of cells between it and the border of the tile.
        """
        ab = self._along_sides(self._offsets)
        rows, columns = self.grid
        column = np.clip(np.floor((ab[..., 0] + 0.5) * columns), 0, columns - 1)
        row = np.clip(np.floor((ab[..., 1] + 0.5) * rows), 0, rows - 1)
        border = np.minimum.reduce([column, row, columns - 1 - column, rows - 1 - row])
        cells = np.stack([row, column, border], -1).astype(np.int64)
        cells[(np.abs(ab) > 0.5 + 1e-9).any(-1)] = -1
        return cells

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """``(h, w)``: which pixels of the box belong to the tile."""
        return self.pixel_cells[..., 2] >= 0

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """``(rows, columns, 2)``: the whole-pixel (x, y), in the box, nearest to each cell of the grid."""
        rows, columns = self.grid
        a, b = (np.arange(columns) + 0.5) / columns - 0.5, (np.arange(rows) + 0.5) / rows - 0.5
        at = np.stack(np.meshgrid(a, b), -1) @ self.sides
        return np.asarray(np.clip(np.floor(at + 0.5).astype(np.int64), *self.box) - self.box[0])

    def middle_range(self, image_shape: tuple[int, ...]) -> tuple[Points, Points]:
        """Return the least and the greatest middle (x, y) of a tile inside the area of an image's pixels."""
        last = np.array([image_shape[1], image_shape[0]]) - 0.5
        return self.reach - 0.5 - 1e-6, last + 1e-6 - self.reach

    def complete_middles(self, lattice: Lattice, image_shape: tuple[int, ...]) -> Points:
        """Return the lattice points (x, y) around which a tile lies inside the area of an image's pixels."""
        low, high = self.middle_range(image_shape)
        points = lattice.points((image_shape[0], image_shape[1]))
        return np.asarray(points[((points >= low) & (points <= high)).all(1)])


def tile_shape(lattice: Lattice, kind: TileKind, cells: int = 1, margin: float = 0.0) -> TileShape:
    """Return the shape of tiles and the steps between them.

    Parameters
    ----------
    lattice
        Its two shortest vectors t1 and t2 span the minimum tile.
    kind
        ``"upright"``: the smallest upright rectangle around the minimum tile, in steps of (t1 + t2) / 2 along a row and
        (t2 - t1) / 2 to the next row (the paper). ``"lattice"``: the same steps, with sides t1 + t2 and t2 - t1 (the
        paper's suggestion), which is a rectangle if t1 and t2 are equally long. ``"rectangle"``: sides t2 and 2 t1, t1
        the shorter vector, in half steps along them. ``"cell"``: sides t1 and t2, in half steps along them.
    cells
        Factor of the sides and the steps. A tile of k x k cells still tiles the texture.
    margin
        px by which the tile is longer at both ends of each side. The steps do not change.
    """
    t1, t2 = _shortest_vectors(lattice)
    if kind == "cell":
        steps = _across_and_down(t1, t2) / 2
    elif kind == "rectangle":
        steps = _across_and_down(2 * t1, t2) / 2
    else:
        steps = _across_and_down(t1 + t2, t2 - t1) / 2
    sides = cells * (np.diag(np.abs([t1, t2]).sum(0)) if kind == "upright" else 2 * steps)
    sides = sides * (1 + 2 * margin / np.hypot(*sides.T))[:, np.newaxis]
    if kind == "upright":
        sides = np.diag(_whole_pixels(np.diag(sides)))
    return TileShape(cells * steps, sides)


def _whole_pixels(lengths: Points) -> Points:
    """Return lengths of sides, rounded up to odd numbers, so that the pixels of tiles that far apart meet.

    A tile has an odd number of pixels around its middle, all of which seams can follow: a joint at its border is one or
    two pixels wide. On a rectangular lattice an upright tile is the minimum tile itself, and gaps would cross at its
    border.
    """
    return 2 * np.ceil((lengths - 1) / 2 - 1e-9) + 1


def _across_and_down(first: Points, second: Points) -> Points:
    """Return both vectors, first the one nearer to the x axis, pointing right, then the other, pointing down."""
    across, down = sorted((first, second), key=_slope)
    return np.stack([across * (1 if across[0] >= 0 else -1), down * (1 if down[1] >= 0 else -1)])


def _shortest_vectors(lattice: Lattice) -> Points:
    """Return the two shortest vectors; of equally short pairs the one with a diagonal nearest to the x axis."""
    a, b = lattice.reduced().matrix
    pairs: list[tuple[Points, Points]] = [(a, b), (a, b - a), (b, b - a)]
    lengths = [max(float(p @ p), float(q @ q)) for p, q in pairs]
    shortest = [pair for pair, length in zip(pairs, lengths, strict=True) if length <= min(lengths) * (1 + 1e-6)]
    best: tuple[Points, Points] = min(shortest, key=_diagonal_slope)
    return np.stack(best)


def _diagonal_slope(pair: tuple[Points, Points]) -> float:
    """Return the smaller angle between a diagonal of two vectors and the x axis."""
    first, second = pair
    return min(_slope(first + second), _slope(second - first))


def _slope(vector: Points) -> float:
    """Return the angle between a vector's line and the x axis."""
    return math.atan2(abs(vector[1]), abs(vector[0]))


def anchor_lattice(sample: Image, lattice: Lattice, tile: TileShape, kind: AnchorKind) -> Lattice:
    """Return the lattice with its origin at the best anchor of a tile (section 3.1, stage 1).

    This is the anchor of least cost among those that leave enough complete tiles.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        The lattice of the sample.
    tile
        The shape of the tiles.
    kind
        The cost of an anchor: :func:`border_costs` (``"quiet"``) or :func:`element_costs` (``"elements"``).
    """
    costs, anchors = border_costs(sample, lattice, tile) if kind == "quiet" else element_costs(sample, lattice)
    order = np.argsort(costs, kind="stable")
    order = order[np.unique(np.linspace(0, len(order) - 1, MAX_ANCHORS).astype(np.int64))]
    offsets = np.array(tile.set_offsets(lattice)) @ tile.steps
    counts = np.min([_tile_counts(lattice, anchors[order] + offset, tile, sample) for offset in offsets], 0)
    return Lattice.from_basis(lattice.matrix, anchors[order[np.argmax(counts >= TILE_SHARE[kind] * counts.max())]])


def border_costs(sample: Image, lattice: Lattice, tile: TileShape) -> tuple[Array, Points]:
    """Return the mean variance from tile to tile along the borders of tiles for each anchor, ``(n,)``, and the anchors.

    Liu, Tsin and Lin 2005, section 3.1, stage 1: the anchor can "make the boundary of the tiles align with low
    frequency regions for the benefit of better blending results". What blending shows is how two tiles differ, so that
    these regions are those of least :func:`element_variance`, joints and gaps: in the mean tile, the inside of a brick
    is as smooth as a joint. The borders are those of the maximum tiles of every set, because these are joined. The
    costs of all anchors are one circular correlation with the borders: O(n log n) for a tile of n px.
    """
    lattice = lattice.reduced()
    variance = element_variance(sample, lattice)
    rows, columns = variance.shape
    uv = _border_points(tile, 4 * max(rows, columns)) @ np.linalg.inv(lattice.matrix)
    at = np.floor(uv * (columns, rows) + 0.5).astype(np.int64) % (columns, rows)
    borders = np.bincount(at[:, 1] * columns + at[:, 0], minlength=variance.size).reshape(variance.shape)
    spectrum = scipy.fft.rfft2(variance) * np.conj(scipy.fft.rfft2(borders / len(uv)))
    return scipy.fft.irfft2(spectrum, variance.shape).ravel(), _anchors(variance.shape, lattice)


def element_costs(sample: Image, lattice: Lattice) -> tuple[Array, Points]:
    """Return minus the variance of the elements around each anchor, ``(n,)``, and the anchors.

    :func:`element_variance` is weighted by a periodic Gaussian of s / 2, wide enough to reach both ends of a long
    brick, so that the middle of a brick costs least and a joint most. The tiles of T then show elements whole, and
    seams can follow the joints, where tiles differ least.
    """
    lattice = lattice.reduced()
    variance = element_variance(sample, lattice)
    rows, columns = variance.shape
    numbers = np.meshgrid(scipy.fft.rfftfreq(columns, 1 / columns), scipy.fft.fftfreq(rows, 1 / rows))
    frequencies = np.stack(numbers, -1) @ np.linalg.inv(lattice.matrix).T
    gaussian = np.exp(-((math.pi * lattice.s) ** 2) / 2 * (frequencies**2).sum(-1))
    costs = -scipy.fft.irfft2(scipy.fft.rfft2(variance) * gaussian, variance.shape)
    for axis, length in enumerate(variance.shape):
        costs = _refine(costs, FINE * length, axis)
    return costs.ravel(), _anchors(costs.shape, lattice)


def _refine(values: Array, count: int, axis: int) -> Array:
    """Return periodic values at more places along an axis, by their Fourier series.

    ``scipy.signal.resample`` gives the same values, but its import takes longer than a small synthesis.
    """
    length = values.shape[axis]
    series = scipy.fft.rfft(np.moveaxis(values, axis, -1))
    if length % 2 == 0:
        series[..., length // 2] *= 0.5
    return np.moveaxis(scipy.fft.irfft(series / (length / count), count), -1, axis)


def element_variance(sample: Image, lattice: Lattice) -> Array:
    """Return how much the elements at each place of the cell vary from tile to tile, ``(rows, columns)``.

    An element departs as a whole: a brick has a color of its own. The sample without its mean tile is smoothed by a
    Gaussian of s / 6, which removes grain and the residues of edges, mixes the colors of neighbors at a joint, and
    keeps that of a brick in its middle. The variance of the result over the tiles shows the elements down to slight
    departures.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        The lattice of the sample, reduced; the result is sampled along its vectors, from its origin.
    """
    residual = sample - fold(sample, lattice).unfold((sample.shape[0], sample.shape[1]))
    smooth = scipy.ndimage.gaussian_filter(residual, (lattice.s / ELEMENT, lattice.s / ELEMENT, 0), mode="nearest")
    power = (smooth**2).sum(-1, keepdims=True)
    return fold(power, lattice).values[..., 0].astype(np.float64)


@dataclass(frozen=True, eq=False)
class ElementWeights:
    """How much a seam counts at each place of the cell: most inside elements, least at joints.

    Parameters
    ----------
    table
        ``float32 (rows, columns)``: the weights along the vectors of the lattice, from its origin.
    lattice
        The lattice.
    """

    table: NDArray[np.float32]
    lattice: Lattice

    @classmethod
    def of(cls, sample: Image, lattice: Lattice) -> ElementWeights:
        """Return the weights of a sample ``(H, W, C)``: the square of its :func:`element_variance`, plus a floor.

        The largest is 1 + :data:`LEAST_WEIGHT`. The smoothing halves the variance at a joint between two elements and
        divides it by more where three meet; the square deepens these valleys.
        """
        lattice = lattice.reduced()
        variance = element_variance(sample, lattice)
        share = variance / max(float(variance.max()), 1e-12)
        return cls(np.ascontiguousarray(share**2 + LEAST_WEIGHT, np.float32), lattice)

    def numbers_from(self, first: Points) -> NDArray[np.float64]:
        """Return ``(2, 3)``: cell coordinates u and v of pixel (x, y) are ``row @ (x, y, 1)``, first at (0, 0)."""
        inverse = np.linalg.inv(self.lattice.matrix)
        return np.ascontiguousarray(np.column_stack([inverse.T, (first - self.lattice.origin) @ inverse]))


def _anchors(shape: tuple[int, ...], lattice: Lattice) -> Points:
    """Return the places of the pixels of a mean tile, ``(n, 2)``."""
    v, u = np.indices(shape)
    return lattice.from_cell(np.stack([u / shape[1], v / shape[0]], -1)).reshape(-1, 2)


def _border_points(tile: TileShape, count: int) -> Points:
    """Return points along the borders of a maximum tile around (0, 0) and of the next ones in the row and below."""
    along, half = np.linspace(-0.5, 0.5, count, endpoint=False), np.full(count, 0.5)
    sides = np.concatenate([np.stack([along, half], -1), np.stack([half, along], -1)])
    border = np.concatenate([sides, -sides]) @ tile.sides
    return np.concatenate([border + np.array(shift) @ tile.steps for shift in np.ndindex(2, 2)])


def _tile_counts(lattice: Lattice, anchors: Points, tile: TileShape, sample: Image) -> NDArray[np.int64]:
    """Return the number of complete tiles around the points of the lattice at each anchor, ``(n,)``."""
    low, high = tile.middle_range(sample.shape)
    first, last = low - anchors.max(0), high - anchors.min(0)
    steps = Lattice(lattice.t1, lattice.t2).cell_numbers(
        (float(first[0]), float(first[1])), (float(last[0]), float(last[1]))
    )
    places = anchors[:, np.newaxis] + steps @ lattice.matrix
    return np.asarray(((places >= low) & (places <= high)).all(-1).sum(1))


@dataclass(frozen=True, eq=False)
class ShiftedImages:
    """A sample and its symmetric copies, shifted by the fractions 0, 1/n, ... of a pixel along x and y.

    Parameters
    ----------
    values
        ``uint8 (k * n * n, H * W * C)``: row ``fy * n + fx`` shows at pixel (x, y) what the sample shows at
        (x + fx / n, y + fy / n). The same rows of each copy follow.
    shape
        (H, W, C) of the sample.
    parts
        n; 1 if tiles are placed at whole pixels.
    copies
        The k - 1 copies, see :func:`symmetric_copies`.
    exact
        The values in [0, 1] before they were rounded, if the sample has 16 bits.
    """

    values: NDArray[np.uint8]
    shape: tuple[int, int, int]
    parts: int
    copies: Sequence[Isometry] = ()
    exact: Image | None = None

    @classmethod
    def of(cls, sample: Image, parts: int, copies: Sequence[Isometry] = ()) -> ShiftedImages:
        """Shift a sample by splines of order 5, mirrored at the edges. With 1 part its only row is an exact copy."""
        height, width, channels = sample.shape
        patches, pixels = Patches(sample), pixel_grid(width, height)
        fractions = [np.array([fx, fy]) / parts for fy, fx in np.ndindex(parts, parts)]
        rows = [patches.cut_patch(fraction, (height, width))[0] for fraction in fractions]
        for matrix, offset in copies:
            rows += [patches.read_with_source((pixels + fraction) @ matrix + offset)[0] for fraction in fractions]
        values = np.stack([to_bytes(row) for row in rows]).reshape(len(rows), -1)
        exact = np.stack(rows).astype(np.float32) if depth_of(sample) == 16 else None
        return cls(values, (height, width, channels), parts, copies, exact)

    @cached_property
    def record(self) -> tuple[NDArray[np.uint8], int, int, int, int]:
        """The images as kernels take them, see :data:`~nrbench.synthesizers.tile_laying.tile_kernels.Images`."""
        return self.values, *self.shape, self.parts


def symmetric_copies(sample: Image, lattice: Lattice, whole: bool) -> list[Isometry]:
    """Return the isometries of a sample's copies turned, mirrored or glided by the symmetries of the texture.

    Liu, Tsin and Lin 2005, section 4.4. A copy shows at (x, y) what the sample shows at ``(x, y) @ matrix + offset``,
    and has the sample's lattice. Of the places that differ by a lattice vector, it lies where it shows most.

    Parameters
    ----------
    sample, lattice
        The sample and its lattice.
    whole
        Whether copies that nearly map pixels to pixels do so exactly, so that none is interpolated.
    """
    middle, copies = (np.array(sample.shape[1::-1]) - 1) / 2, list[Isometry]()
    for each in find_wallpaper_group(sample, lattice).symmetries:
        isometries: list[Isometry] = [(each.matrix, each.offset)]
        if each.order > 2:
            inverse = np.asarray(np.linalg.inv(each.matrix), np.float64)
            isometries.append((inverse, -each.offset @ inverse))
        for matrix, offset in isometries:
            at, near = middle + lattice.wrap(middle @ matrix + offset - middle), np.rint(matrix).astype(np.float64)
            exact = whole and np.abs(matrix - near).max() * middle.max() <= 0.5
            copies.append((near, np.round(at - middle @ near)) if exact else (matrix, at - middle @ matrix))
    return copies


class TilePlaces(NamedTuple):
    """Tiles around whole pixels.

    Parameters
    ----------
    place
        ``(n, 3)``: the row of the shifted images, and the pixel (x, y).
    middle
        ``(n, 2)``: the real middle (x, y).
    """

    place: NDArray[np.int64]
    middle: Points

    @property
    def pixel(self) -> NDArray[np.int64]:
        """The pixel (x, y) of each tile, ``(n, 2)``."""
        return self.place[:, 1:]

    def take(self, indices: NDArray[np.int64]) -> TilePlaces:
        """Return some of the tiles."""
        return TilePlaces(self.place.take(indices, 0), self.middle.take(indices, 0))


@dataclass(frozen=True, eq=False)
class TileStock:
    """The complete maximum tiles of a sample.

    Parameters
    ----------
    tile
        The shape of the tiles.
    images
        The shifted copies of the sample that tiles are cut from.
    lattice
        The lattice of the sample, anchored at a tile's middle.
    """

    tile: TileShape
    images: ShiftedImages
    lattice: Lattice

    def middles(self, i: int, j: int) -> Points:
        """Return the middle (x, y) of every complete tile of the set at step i in the row and row j.

        With i and j even this is the set T. For the others see :meth:`TileShape.set_offsets`.
        """
        offset = np.array([i % 2, j % 2]) @ self.tile.steps
        return self.tile.complete_middles(self.lattice.shifted(offset), self.images.shape)

    def find_places(self, middles: Points) -> TilePlaces:
        """Return the tiles around the nearest places that the shifted images have, if they lie inside.

        If rounding leaves none inside, return all of them, moved inward by less than a pixel.
        """
        height, width, _ = self.images.shape
        places, inside = nearest_places(np.ascontiguousarray(middles), self.images.record, self.tile.box)
        found = TilePlaces(places, middles).take(inside.nonzero()[0])
        if not len(found.place):
            (left, top), (right, bottom) = self.tile.box
            pixel = np.clip(places[:, 1:], (-left, -top), (width - 1 - right, height - 1 - bottom))
            found = TilePlaces(np.pad(pixel, ((0, 0), (1, 0))), middles)
        if not self.images.copies:
            return found
        sets = [found, *(self._find_in_copy(found, n) for n in range(len(self.images.copies)))]
        return TilePlaces(*(np.concatenate(part) for part in zip(*sets, strict=True)))

    def _find_in_copy(self, places: TilePlaces, copy: int) -> TilePlaces:
        """Return the places at which a copy shows a complete tile of the sample, and :data:`SPARE` px around it."""
        matrix, offset = self.images.copies[copy]
        (left, top), (right, bottom) = self.tile.box + np.array([[-SPARE], [SPARE]])
        corners = np.array([(left, top), (right, top), (left, bottom), (right, bottom)])
        at = (places.pixel[:, np.newaxis] + corners) @ matrix + offset
        shown = ((at >= 0) & (at <= np.array(self.images.shape[1::-1]) - 1)).all((1, 2))
        row = np.array([(copy + 1) * self.images.parts**2, 0, 0])
        return places._replace(place=places.place + row).take(np.flatnonzero(shown))

    def cut(self, drawn: TilePlaces) -> ExactPatch:
        """Return the patch of one tile over its box, and its source map."""
        (row, x, y), parts = drawn.place[0].tolist(), self.images.parts
        (left, top), (right, bottom) = self.tile.box.tolist()
        rows, columns = slice(y + top, y + bottom + 1), slice(x + left, x + right + 1)
        copy, part = divmod(row, parts**2)
        fy, fx = part // parts / parts, part % parts / parts
        pixels = self.images.values[row].reshape(self.images.shape)[rows, columns]
        exact = () if self.images.exact is None else (self.images.exact[row].reshape(self.images.shape)[rows, columns],)
        if copy:
            matrix, offset = self.images.copies[copy - 1]
            points = (self._steps[..., :2] + np.array([x + fx, y + fy])) @ matrix + offset
            return pixels, point_source(points, self.images.shape), *exact
        return pixels, self._steps + np.array((x + fx, y + fy, 1), np.float32), *exact

    @cached_property
    def _steps(self) -> Source:
        """(x, y) of the pixels of a tile's box from its middle, and 0, ``(h, w, 3)``."""
        (left, top), (right, bottom) = self.tile.box.tolist()
        steps = pixel_grid(right - left + 1, bottom - top + 1, left, top)
        return np.pad(steps, ((0, 0), (0, 0), (0, 1))).astype(np.float32)

    def compare(self, image: Pixels, covered: Mask, tiles: TilePlaces) -> tuple[Overlap, NDArray[np.int64]]:
        """Return what is covered under a tile's box, and how each tile differs from it (step 3).

        Parameters
        ----------
        image, covered
            ``uint8 (h, w, C)`` and ``bool (h, w)``: the pixels under the box, and which of them are covered.
        tiles
            n tiles.

        Returns
        -------
        tuple
            The covered pixels, and ``(n,)``: the sums of absolute differences, channels added.
        """
        return compare_tiles(image, covered, self.tile.mask, self._offsets, self.images.record, tiles.place)

    @cached_property
    def _offsets(self) -> NDArray[np.int64]:
        """The offset of each pixel of a tile's box from its middle in a flat image."""
        _, width, channels = self.images.shape
        x, y, _ = np.moveaxis(self._steps.astype(np.int64), -1, 0)
        return np.ascontiguousarray((y * width + x) * channels)

    def register(self, overlap: Overlap, drawn: TilePlaces, radius: float) -> TilePlaces:
        """Return one tile moved to where it correlates best, by at most ``radius`` px from its real middle (step 4).

        The correlation is normalized over the overlap, without the mean of each channel.
        """
        best = best_move(overlap, self.images.record, self.tile.box, drawn.place[0], drawn.middle[0], radius)
        return TilePlaces(best[np.newaxis], drawn.middle)

    def estimate_threshold(self, quantile: float, accepting: float, measure: OverlapMeasure) -> float:
        """Return the least threshold at which enough tiles of the sample accept enough of the others.

        Two tiles of a set (unmoved) are compared over the usual overlap: the left and the upper half of a tile. For
        each tile the quantile of its differences from the others is taken, and the quantile ``accepting`` of these is
        the threshold. A single quantile over all pairs would leave the oddest tile no successor but its own, so that
        the sample would be copied on and on. Infinite if no set holds two tiles.
        """
        rows, columns = self.tile.grid
        row, column, _ = np.moveaxis(self.tile.pixel_cells, -1, 0)
        usual = (row < rows / 2) | (column < columns / 2)
        quantiles: list[float] = []
        for number in self.tile.set_offsets(self.lattice):
            tiles = self.find_places(self.middles(*number))
            tiles = tiles.take(np.unique(np.linspace(0, len(tiles.place) - 1, MAX_COMPARED).astype(np.int64)))
            numbers = range(len(tiles.place) if len(tiles.place) > 1 else 0)
            cuts = (self.cut(tiles.take(np.array([n])))[0] for n in numbers)
            others = [np.delete(self.compare(cut, usual, tiles)[1], n) for n, cut in zip(numbers, cuts, strict=True)]
            quantiles += np.quantile(others, quantile, 1).tolist() if others else []
        threshold = float(np.quantile(quantiles, accepting)) if quantiles else np.inf
        return threshold / (int((usual & self.tile.mask).sum()) if measure == "mean" else 1)
