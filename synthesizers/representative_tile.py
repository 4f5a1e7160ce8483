"""Representative tile: the tile whose repetition best reconstructs the sample."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.ssdn import Ssdn
from nrbench.errors import require, require_ranges
from nrbench.imaging.convert import Image, box_sums
from nrbench.lattice.geometry import Integers, Lattice, Points, integers_within
from nrbench.plugins.forms import Geometry, Refused, Shape, SourceMap, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import PERIOD_SLACK, pixel_grid, require_two_periods
from .sample_reading.patches import Patches, resample
from .wang_tiling.wang_tiles import WangTiles

Values = NDArray[np.float32]
"""``float32 (H, W, C)``, any range."""
Costs = NDArray[np.float64]
"""``float64 (H - h + 1, W - w + 1)``: one for each place (row, column) of a tile's first pixel."""
Mask = NDArray[np.bool_]
"""``bool (H, W)``."""
Size = tuple[int, int]
"""(h, w): rows and columns of a tile."""

_SEARCH_SHARE: Final = 0.4
"""Progress when the tile is chosen."""
MAX_WEIGHT: Final = 1e6
"""Largest weight: beyond it the other term has no effect."""
MOST_COLORS: Final = 3
"""Largest number of colors of edges: a set then has 81 tiles."""
MOST_BEST: Final = 99
"""Largest number of best tiles, whose names have two digits."""
EXACT = 1e-6
"""Share of s that a rectangle may miss a period by, whatever the tolerance: the effect of rounding."""
_LEVELS = (0.0, 0.5, 1.0)
"""Shares of the tolerance, tried in order: the first at which a rectangle fits the sample is used."""
_TURNED = 4
"""A turned rectangle is used if the upright one holds more than this many times its cells, or if there is none."""
_WHOLE = 1e-3
"""Largest distance of a number of tiles from a whole number."""
_LEAST_SIDE = 2


@leaves_out
@dataclass(frozen=True)
class RepresentativeTile:
    """The tile whose repetition best reconstructs the sample and whose borders match: periodic output, small and fast.

    The period gives the tile's size in whole pixels, to which the sample is scaled down (section 3). The tile is the
    one with the least S = alpha h + SSDN over all places in the scaled sample (equation 6 with beta = 1, as in all
    figures of the paper): h, the continuity, compares its first row and column with its last (equation 5); SSDN, the
    resemblance, compares the sample with the repetition of the tile (section 4.2). The paper rates only a share p of
    the places, those with the least h; here integral images rate every place exactly.

    The tile is the paper's, of whole pixels (``extras["tile"]``, a PNG beside a picture). The paper repeats these
    pixels, so that a period of 21.37 px becomes 21. Here every output pixel shows the point of the tile that is
    equivalent to it by the real-valued period, interpolated once from the sample: nothing drifts or blurs, and where
    periods are whole pixels are copied (``rescale=false``: as in the paper).

    If the lattice is not rectangular, the tile is the smallest rectangle that is a period of it, turned or of several
    cells if necessary; its sides may miss lattice vectors by ``tolerance``. Without a given lattice the detector
    ``ssdn`` finds the period along the sample's axes, as in the paper.

    The output is periodic: it keeps regularity and loses randomness, as the paper says. ``edge_colors`` keeps some of
    it by Wang tiles, the future work of section 6: a complete set of tiles, each of 2 x 2 representative tiles of the
    sample, that are laid at random so that the colors of their edges agree
    (:class:`~nrbench.synthesizers.wang_tiling.wang_tiles.WangTiles`).

    ``preset=paper`` is the setting of figure 5: the period x_n / n, scaled down to whole pixels (section 3), and the
    output repeats the pixels of the tile. In the paper a user may choose one of the m best tiles; here the output shows
    the best one, and the others with their tilings are extras.

    Extras: ``tile``; ``frame``, ``(3, 2)``: the tile's first pixel (x, y) in the sample, and the steps (x, y) in the
    sample of one pixel along its rows and columns, of lengths r (equation 4); ``best``, ``(m, 5)``: x, y in the scaled
    sample, h, SSDN and S of the m best tiles; if m > 1, ``best-01``, ``tiling-01`` and so on: the tiles, and the scaled
    sample as each reconstructs it. With Wang tiles ``atlas``, all tiles of the set in whole pixels, and the file
    ``atlas.json``, which has their colors.

    Parameters
    ----------
    continuity_weight
        alpha, the weight of continuity beside that of resemblance, which is 1: 0 to 1e6. The paper uses 1, 30 or 0.
        With 1, small tiles of strongly varying elements often show a line at the junction.
    rated_share
        p, the share in (0, 1] of the places, those of least h, that are rated (the paper: 0.0001 to 0.02). None: all.
    rescale
        True: the output has the sample's period. False: it repeats the tile's pixels, with the tile's period of whole
        pixels; the lattice that is returned is then that of the output.
    finder
        Detector that finds the period where no lattice is given. ``"ssdn:primitive=false"``: fitted to all minima,
        sub-pixel, and refused if it may be due to chance. ``"ssdn:preset=paper"``: x_n / n, the last minimum over its
        number (equation 3), never refused.
    tolerance
        Largest distance of a side of the tile from a lattice vector, in shares of s, in [0, 0.5).
    edge_colors
        Number of colors of the horizontal and of the vertical edges of Wang tiles, 1 to 3: a set has 16 or 81 tiles.
        1: one tile, without colors.
    best_tiles
        m, the number of best tiles that are extras, 1 to 99.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself, as in the paper.

    References
    ----------
    .. [1] K. Djado, R. Egli, F. Deschênes, "Extraction of a Representative Tile from a Near-Periodic Texture." GRAPHITE
           2005. Unverified: the text that was implemented names only the Université de Sherbrooke, Québec, Canada.
    """

    continuity_weight: float = 30.0
    rated_share: float | None = None
    rescale: bool = True
    finder: Literal["ssdn:primitive=false", "ssdn:preset=paper"] = "ssdn:primitive=false"
    tolerance: float = 0.1
    edge_colors: int = 1
    best_tiles: int = 1
    geometry: Geometry = "straight"

    wraps: ClassVar[bool] = True
    family: ClassVar[str] = "tiles and patches on the lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "continuity_weight": 30.0,
            "rated_share": 0.01,
            "rescale": False,
            "finder": "ssdn:preset=paper",
            "geometry": "as-is",
        },
    }
    patch_shape: ClassVar[str] = "rectangular tile from the period"
    patch_placement: ClassVar[str] = "side by side, edge_colors={edge_colors}"
    patch_stitching: ClassVar[str] = "none; graph cut inside Wang tiles"
    paper: ClassVar[str] = Ssdn.paper

    def __post_init__(self) -> None:
        require_ranges(self, continuity_weight=(0, MAX_WEIGHT))
        share, tolerance = self.rated_share, self.tolerance
        require(share is None or 0 < share <= 1, f"rated_share {share}; choose above 0, at most 1, or leave it out")
        require(0 <= tolerance < 0.5, f"tolerance {tolerance}; choose a share of s from 0 to below 0.5")
        require_ranges(self, edge_colors=(1, MOST_COLORS), best_tiles=(1, MOST_BEST))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`RepresentativeTile`.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest one.

        Raises
        ------
        Refused
            When no lattice is found, or the sample shows less than two periods or holds no rectangular tile, or if a
            tileable output is not a whole number of tiles.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no period to cut a tile by")
        frame = find_tile_frame(lattice, task.sample.shape, self.tolerance)
        if task.tileable:
            self._require_whole_tiles(frame, task.shape)
        patches = Patches(task.sample)
        image, known = frame.scale_sample(task.sample, patches)
        rating, best = self._rate(image, known, frame)
        place = (int(best[0, 0]), int(best[0, 1]))
        task.progress(_SEARCH_SHARE)
        rest = replace(task, progress=lambda done: task.progress(_SEARCH_SHARE + (1 - _SEARCH_SHARE) * done))
        corner = frame.to_sample(np.array(place, np.float64))
        extras = {"tile": _cut(image, frame, place), "frame": np.vstack([corner, frame.steps]), "best": best}
        for number, (x, y) in enumerate(best[:, :2].astype(int).tolist() if len(best) > 1 else [], 1):
            extras[f"best-{number:02d}"] = tile = _cut(image, frame, (x, y))
            extras[f"tiling-{number:02d}"] = _repeat(tile, (x, y), image.shape)
        if self.edge_colors > 1:
            tiles = self._cut_wang_tiles(frame, lattice, place, rating, patches)
            extras["atlas"] = tiles.atlas
        else:
            shown = np.concatenate([extras["tile"], pixel_grid(*frame.size[::-1], *place)], -1, dtype=np.float32)
            tiles = WangTiles(1, shown[np.newaxis, np.newaxis])
        output, source = lay_tiles(rest, frame, tiles, place, self.rescale, patches)
        note = f"a tile holds {frame.cells * self._periods**2} cells" if frame.cells * self._periods > 1 else ""
        laid = lattice if self.rescale else frame.lay_lattice(lattice, place)
        files = {"atlas.json": tiles.describe} if self.edge_colors > 1 else {}
        return Synthesis(output, laid, source, extras, seconds, note, files)

    @property
    def _periods(self) -> int:
        """Number of periods along each side of what is laid."""
        return 1 if self.edge_colors == 1 else 2

    def _cut_wang_tiles(
        self, frame: TileFrame, lattice: Lattice, place: tuple[int, int], rating: Costs, patches: Patches
    ) -> WangTiles:
        """Return the Wang tiles of blocks of 2 x 2 tiles, those of the least S first.

        With two periods, elements that cross an edge, and the joints around them, have room on either side of it.
        """
        size = np.array(frame.size)[::-1]
        places = frame.lay_lattice(lattice, place).reduced()
        equal = replace(places, origin=(float(place[0]), float(place[1]))).points(frame.shape)
        ends = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * (2 * size - 1)
        equal = equal[frame.holds(equal[:, np.newaxis] + ends, patches.sample.shape).all(1)]
        if len(equal) <= self.edge_colors:
            wide, tall = (2 * size).tolist()
            raise Refused(
                f"the sample holds {len(equal)} blocks of 2x2 tiles, {wide}x{tall} px, and {self.edge_colors} colors "
                "of edges need more; choose a larger sample, or edge_colors=1"
            )
        x, y = np.minimum(np.rint(np.maximum(equal, 0)).astype(int), np.array(rating.shape[::-1]) - 1).T
        equal = equal[np.argsort(rating[y, x], kind="stable")]
        points = equal[:, np.newaxis, np.newaxis] + pixel_grid(*(2 * size))
        blocks = np.concatenate([patches.read_points(frame.to_sample(points)), points], -1, dtype=np.float32)
        return WangTiles.cut(list(blocks), self.edge_colors)

    def _require_whole_tiles(self, frame: TileFrame, shape: Shape) -> None:
        height, width = (self._periods * side for side in frame.size)
        periods = frame.periods * self._periods if self.rescale else np.diag([float(width), float(height)])
        counts = np.diag(shape[::-1]) @ np.linalg.inv(periods)
        if np.abs(frame.periods[[0, 1], [1, 0]]).max() > self.tolerance * min(frame.size):
            raise Refused("the tile of this lattice is turned, so no upright output repeats; choose another method")
        if np.abs(counts - np.rint(counts)).max() > _WHOLE:
            tall, wide = (max(round(side / part), 1) * part for side, part in zip(shape, (height, width), strict=True))
            raise Refused(
                f"a tile takes {width}x{height} px, and {shape[1]}x{shape[0]} px hold no whole number of them; use "
                f"rescale=false and --size {wide}x{tall}"
            )

    def _rate(self, image: Image, known: NDArray[np.bool_] | None, frame: TileFrame) -> tuple[Costs, Points]:
        """Return S at all places, and the m best ones, ``(m, 5)``: x, y, h, SSDN, S (section 4); of equals the first.

        Next to the best place lie others of nearly the same tile, among which nobody would choose. Within half a tile
        of a better place, none is taken.
        """
        smooth, alike = continuity(image, frame.size), resemblance(image, frame.size, known)
        allowed = np.isfinite(alike)
        if not allowed.any():
            size = f"{frame.size[1]}x{frame.size[0]} px"
            raise Refused(f"turned as the lattice is, a tile of {size} is larger than the sample")
        total = np.round(self.continuity_weight * smooth + alike, 12)
        if self.rated_share is not None:
            allowed = preselect(np.where(allowed, smooth, np.inf), self.rated_share * float(allowed.sum()))
        rating, best = np.where(allowed, total, np.inf), list[list[float]]()
        while len(best) < self.best_tiles and np.isfinite(rating.min()):
            y, x = np.unravel_index(rating.argmin(), rating.shape)
            best.append([float(each) for each in (x, y, smooth[y, x], alike[y, x], rating[y, x])])
            rows, columns = (max(side // 2, 1) for side in frame.size)
            rating[max(y - rows, 0) : y + rows + 1, max(x - columns, 0) : x + columns + 1] = np.inf
        return total, np.array(best, np.float64)


def preselect(smooth: Costs, number: float) -> NDArray[np.bool_]:
    """Return S1: the ``number`` places, at least one, of least continuity cost (section 4.1)."""
    chosen = np.zeros(smooth.shape, np.bool_)
    chosen.flat[np.argsort(np.round(smooth, 12).ravel(), kind="stable")[: max(round(number), 1)]] = True
    return chosen


def _cut(image: Image, frame: TileFrame, place: tuple[int, int]) -> Image:
    """Return the tile at a place (x, y) of the scaled sample."""
    x, y = place
    return image[y : y + frame.size[0], x : x + frame.size[1]]


def _repeat(tile: Image, place: tuple[int, int], shape: tuple[int, ...]) -> Image:
    """Return a picture of ``shape`` that repeats a tile around the place (x, y) where it lies (figure 4)."""
    rows, columns = ((np.arange(shape[axis]) - place[1 - axis]) % tile.shape[axis] for axis in (0, 1))
    return tile[np.ix_(rows, columns)]


def resemblance(image: Values, size: Size, known: Mask | None = None) -> Costs:
    """Return the mean squared difference between the image and each of its tiles repeated over it.

    Every tile stays where it lies, so that pixel q is compared with the tile's pixel of its residue class, modulo the
    tile's sides. A tile holds one pixel p of each class r. It contributes D(p), the sum over the class of (I - I(p))^2,
    which is Q_r - 2 I(p) S_r + n_r I(p)^2 with the class's sum of squares Q_r, sum S_r and number n_r. The cost of a
    tile is the sum of D over its box: one integral image serves all tiles.

    Parameters
    ----------
    image
        The squares are summed over channels.
    size
        Size of the tile, at most that of the image.
    known
        The pixels that count; None: all. Tiles that hold other pixels cost infinity.

    Returns
    -------
    Costs
        SSDN(I, I_T) of representative tile, section 4.2. O(H W C), whatever the number of tiles; trying each of n tiles
        is O(n H W C).
    """
    shape, mask = image.shape[:2], np.ones(image.shape[:2], np.bool_) if known is None else known
    weight = mask.astype(np.float64)
    number, cost = _spread(_classes(weight, size), shape), np.zeros(shape)
    for channel in np.moveaxis(image, -1, 0):
        plane = (channel - channel[mask].mean(dtype=np.float64)) * weight
        cost += _spread(_classes(plane**2, size), shape)
        cost += plane * (number * plane - 2 * _spread(_classes(plane, size), shape))
    total = np.maximum(box_sums(cost, size), 0) / max(weight.sum(), 1)
    if known is not None:
        total[box_sums(weight, size) < size[0] * size[1] - 0.5] = np.inf
    return np.asarray(total)


def continuity(image: Values, size: Size) -> Costs:
    """Return how much each tile's first row and column differ from its last, which meet when the tile is repeated.

    The cost is the sum of the squared differences over channels and the h + w pairs of pixels, over 2 (w + h - 1).

    Notes
    -----
    Representative tile, section 4.1, equation 5: h(T). The sums along each border come from cumulative sums, O(H W C).
    The paper calls h a mean, but divides by about twice the number of pairs. This is kept, since its alpha weighs it.
    """
    rows, columns = size
    height, width = image.shape[:2]
    across = _squares(image[:, columns - 1 :], image[:, : width - columns + 1])
    down = _squares(image[rows - 1 :], image[: height - rows + 1])
    total = box_sums(across, (rows, 1)) + box_sums(down, (1, columns))
    return np.asarray(np.maximum(total, 0) / (2 * (columns + rows - 1)))


def _squares(first: Values, last: Values) -> NDArray[np.float64]:
    difference = np.subtract(first, last, dtype=np.float64)
    return np.asarray(np.einsum("ijk,ijk->ij", difference, difference))


def _classes(plane: NDArray[np.float64], size: Size) -> NDArray[np.float64]:
    """Return the sum over each residue class, ``(h, w)``."""
    (height, width), (rows, columns) = plane.shape, size
    padded = np.pad(plane, ((0, -height % rows), (0, -width % columns)))
    return np.asarray(padded.reshape(-1, rows, padded.shape[1]).sum(0).reshape(rows, -1, columns).sum(1))


def _spread(classes: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the value of each pixel's class."""
    wide = classes[:, np.arange(shape[1]) % classes.shape[1]]
    return np.asarray(wide[np.arange(shape[0]) % classes.shape[0]])


def lay_tiles(
    task: Task, frame: TileFrame, tiles: WangTiles, place: tuple[int, int], rescale: bool, patches: Patches
) -> tuple[Image, SourceMap]:
    """Return the output, tiles side by side, and its source map.

    The output continues the sample's phase: the place in the sample where the tile's first pixel lies shows a tile's
    first pixel in the output.

    Parameters
    ----------
    task
        The sample, the output's shape, and the stream that draws the colors of edges.
    frame
        Where the pixels of a tile lie in the sample.
    tiles
        One tile, or a set.
    place
        (x, y) of the first pixel of a tile in the scaled sample.
    rescale
        True: the output has the sample's periods. False: it has those of the tile in whole pixels.
    patches
        Of the sample.
    """
    size = np.array(tiles.shape[::-1])
    corner, steps = np.array(place, np.float64), np.eye(2)
    if rescale:
        corner, steps = frame.to_sample(corner), frame.periods / np.array(frame.size[::-1])[:, np.newaxis]
    inverse = np.linalg.inv(steps)
    ends = (np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * task.shape[::-1] - corner) @ inverse / size
    columns, rows = np.rint(np.ptp(ends, axis=0)) if task.tileable else np.ceil(np.ptp(ends, axis=0)) + 1
    row, column = tiles.lay((int(rows), int(columns)), task.rng)

    def points(pixels: Points) -> Points:
        at = (pixels - corner) @ inverse
        nearest = np.floor(at + 0.5)
        number, inside = np.divmod(nearest.astype(np.intp), size)
        x, y = np.moveaxis(number % row.shape[::-1], -1, 0)
        shown = tiles.layers[row[y, x], column[y, x], inside[..., 1], inside[..., 0], -2:]
        return frame.to_sample(shown + (at - nearest))

    return resample(task, points, patches)


@dataclass(frozen=True)
class TileFrame:
    """Where the pixels of a tile, and of the image that all tiles are cut from, lie in the sample.

    Parameters
    ----------
    periods
        ``(2, 2)``: the lattice vectors (x, y), px of the sample, along the tile's columns' and rows' directions.
    size
        (rows, columns) of the tile in whole px: the floor of the periods' lengths (representative tile, section 3).
    steps
        ``(2, 2)``: the vectors (x, y), px of the sample, of one tile pixel along columns and rows.
    first
        (x, y): position of the scaled image's first pixel, in steps from the sample's first pixel.
    shape
        Shape (height, width) of the scaled image, which covers the sample.
    cells
        Number of cells of the lattice in a tile.
    """

    periods: Points
    size: tuple[int, int]
    steps: Points
    first: tuple[int, int]
    shape: Shape
    cells: int

    def to_sample(self, pixels: Points) -> Points:
        """Return the points (x, y) of the sample under points of the scaled image, ``(..., 2)``."""
        return np.asarray((pixels + np.array(self.first)) @ self.steps)

    def lay_lattice(self, lattice: Lattice, place: tuple[int, int]) -> Lattice:
        """Return the lattice of an output that repeats the pixels of the tile at a place (x, y)."""
        laid = np.linalg.inv(self.periods) * self.size[::-1]
        origin = (np.array(lattice.origin) - self.to_sample(np.array(place, np.float64))) @ np.linalg.inv(self.steps)
        return Lattice.from_basis(lattice.matrix @ laid, place + origin)

    def scale_sample(self, sample: Image, patches: Patches) -> tuple[Image, NDArray[np.bool_] | None]:
        """Return the sample scaled down (and turned upright), and which of its pixels lie inside; None: all."""
        if np.abs(self.steps - np.eye(2)).max() < 1e-9:
            return sample, None
        pixels = pixel_grid(*self.shape[::-1]).astype(np.float64)
        inside = self.holds(pixels, sample.shape)
        return patches.read_points(self.to_sample(pixels)), None if inside.all() else inside

    def holds(self, pixels: Points, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return which points of the scaled image lie inside a sample of ``shape``."""
        at = self.to_sample(pixels)
        return np.asarray(((at >= -1e-6) & (at <= np.array(shape[1::-1]) - 1 + 1e-6)).all(-1))


def find_tile_frame(lattice: Lattice, shape: tuple[int, ...], tolerance: float) -> TileFrame:
    """Return the frame of the smallest rectangular tile of a lattice for a sample of ``shape``.

    Among rectangles that are exact periods the smallest upright one is used, as in the paper, unless a turned one holds
    a quarter of its cells or less. If none fits the sample, rectangles within half of the tolerance are searched, then
    those within all of it. The steps of the frame absorb what the sides of the rectangle lack of lattice vectors: the
    tile is deformed by no more than the tolerance, and the periods stay those of the lattice.

    Parameters
    ----------
    lattice, shape
        The lattice of the sample, and the sample's shape.
    tolerance
        How far, in shares of s, a side may be from a lattice vector.

    Raises
    ------
    Refused
        Where the sample shows less than two periods, or holds no rectangle that repeats.
    """
    require_two_periods(lattice, shape)
    lattice = lattice.canonical()
    rectangle = _find_rectangle(lattice, shape, tolerance)
    if rectangle is None:
        raise Refused(
            f"no rectangle inside the {shape[1]}x{shape[0]} px sample repeats within {tolerance:g} s of this "
            f"{lattice.kind} lattice: the tile would be larger than the sample"
        )
    periods = _orient(rectangle @ lattice.matrix)
    lengths = np.hypot(*periods.T)
    columns, rows = (int(length + PERIOD_SLACK) for length in lengths)
    if min(rows, columns) < _LEAST_SIDE:
        raise Refused(f"the lattice repeats every {lengths.min():.2f} px: a tile of less than 2 px shows nothing")
    steps = periods / np.array([[columns], [rows]])  # equation 4: the periods shrink to whole pixels
    first, covered = _cover(steps, shape)
    return TileFrame(periods, (rows, columns), steps, first, covered, count_rectangle_cells(rectangle))


def count_rectangle_cells(rectangle: Integers) -> int:
    """Return the number of cells of the lattice in a rectangle."""
    (p, q), (r, s) = rectangle
    return abs(int(p) * int(s) - int(q) * int(r))


def _find_rectangle(lattice: Lattice, shape: tuple[int, ...], tolerance: float) -> Integers | None:
    """Return the upright rectangle, or a turned one that is much smaller, at the first level at which one fits."""
    limit = math.hypot(*shape[:2])
    room = np.array(shape[1::-1]) + PERIOD_SLACK
    for level in _LEVELS:
        reach = level * tolerance * lattice.s
        candidates = (
            (find_upright_rectangle(lattice, reach, limit), 1),
            (find_free_rectangle(lattice, reach, limit), _TURNED),
        )
        fitting = [
            (count_rectangle_cells(rectangle) * weight, rectangle)
            for rectangle, weight in candidates
            if rectangle is not None and bool((np.abs(rectangle @ lattice.matrix).sum(0) <= room).all())
        ]
        if fitting:
            return min(fitting, key=lambda rated: rated[0])[1]
    return None


def _orient(vectors: Points) -> Points:
    """Return the sides of a rectangle as (across, down) with the least rotation; at 45 degrees across points down."""
    a, b = vectors
    slope = a[1] / a[0] if abs(a[0]) > 1e-9 * abs(a[1]) else np.inf
    if abs(slope) > 1 + 1e-9 or slope < 1e-9 - 1:
        a, b = b, a
    return np.stack([a if a[0] > 0 else -a, b if b[1] > 0 else -b])


def _cover(steps: Points, shape: tuple[int, ...]) -> tuple[tuple[int, int], Shape]:
    """Return the first pixel and the shape of the grid of ``steps`` that covers a sample of ``shape``."""
    ends = np.array([[x, y] for x in (0, shape[1] - 1) for y in (0, shape[0] - 1)], np.float64)
    corners = ends @ np.linalg.inv(steps)
    low, high = np.ceil(corners.min(0) - 1e-6).astype(int), np.floor(corners.max(0) + 1e-6).astype(int)
    return (int(low[0]), int(low[1])), (int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1)


def find_upright_rectangle(lattice: Lattice, tolerance: float, limit: float) -> Integers | None:
    """Return the smallest upright rectangle that is a period of the lattice.

    The sides (w, 0) and (0, h) are each the shortest within ``tolerance`` of a lattice vector.

    Parameters
    ----------
    lattice
        Its origin has no effect, and its basis none on the rectangle.
    tolerance
        Largest distance, px, of a side from a lattice vector; less than half of s. 0: exact up to rounding.
    limit
        Longest side, px.

    Returns
    -------
    Integers or None
        None if there is none, as for most lattices at a tolerance of 0.
    """
    reach, basis = max(tolerance, EXACT * lattice.s), lattice.reduced().matrix
    across, down = (_side_along_x(turned, reach, limit) for turned in (basis, basis[:, ::-1]))
    if across is None or down is None:
        return None
    return _count_vectors(lattice, np.array([across[1] @ basis, down[1] @ basis]))


def find_free_rectangle(lattice: Lattice, tolerance: float, limit: float) -> Integers | None:
    """Return the rectangle of least area, in any direction, that is a period of the lattice.

    One side is a lattice vector; the other, at a right angle, is within ``tolerance`` of one. Sides are tried from the
    shortest on, until they are too long to be the shorter side of a smaller rectangle. Parameters and results are those
    of :func:`find_upright_rectangle`. Time grows with the number of lattice vectors tried: those shorter than the
    square root of the area of the result, or than ``limit`` if there is none (about 2 ``limit``^2 over the cell's
    area).
    """
    reach, basis = max(tolerance, EXACT * lattice.s), lattice.reduced().matrix
    least, rectangle = math.inf, None
    for side in _half_plane(integers_within(basis, (-limit, -limit), (limit, limit)), basis, limit):
        vector = side @ basis
        length = float(np.hypot(*vector))
        if length * length >= least * (1 - 1e-9):
            break
        x, y = vector / length
        other = _side_along_x(basis @ np.array([[-y, x], [x, y]]), reach, limit)
        if other is not None and length * other[0] < least * (1 - 1e-9):
            least = length * other[0]
            rectangle = _count_vectors(lattice, np.array([vector, other[1] @ basis]))
    return rectangle


def _side_along_x(basis: Points, reach: float, limit: float) -> tuple[float, Integers] | None:
    """Return the least x with (x, 0) within ``reach`` of a vector of the basis, and that vector's integers."""
    numbers = integers_within(basis, (reach, -reach), (limit + reach, reach))
    vectors = numbers @ basis
    lengths = vectors[:, 0]
    chosen = (np.abs(vectors[:, 1]) <= reach * (1 + 1e-9)) & (lengths > reach) & (lengths <= limit * (1 + 1e-9))
    if not chosen.any():
        return None
    best = np.argmin(np.where(chosen, lengths, np.inf))
    return float(lengths[best]), numbers[best]


def _half_plane(numbers: Integers, basis: Points, limit: float) -> Integers:
    """Return one of each pair +-(i, j), shortest first, none longer than ``limit``."""
    numbers = numbers[(numbers[:, 0] > 0) | ((numbers[:, 0] == 0) & (numbers[:, 1] > 0))]
    lengths = np.hypot(*(numbers @ basis).T)
    return numbers[np.argsort(lengths, kind="stable")][: int((lengths <= limit).sum())]


def _count_vectors(lattice: Lattice, vectors: Points) -> Integers:
    """Return the multiples of the lattice's vectors that add up to some lattice vectors."""
    return np.rint(vectors @ np.linalg.inv(lattice.matrix)).astype(np.int64)
