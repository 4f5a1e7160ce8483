"""Regularized patch-based synthesis: texels of the sample, pasted on its lattice."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Final, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Values, fold, sample_tile
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Geometry, Refused, Shape, SourceMap, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .canvas.canvas import FURTHER
from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import CellTorus, pixel_grid, require_two_periods
from .sample_reading.patches import Patches, round_places

TexelKind = Literal["quadrilateral", "hexagon"]
STEPS: Final = 16
"""Number of places of the cell, along each vector, at which a corner is tried."""
ALONG: Final = 12
"""Number of points along each side at which a border is rated."""
REFINEMENTS: Final = 3
"""How often the steps are halved around the best corner and link."""
LINKS: Final = 8
"""Number of steps along each side of the triangle in which the links between corners are tried."""
BLUR: Final = 1 / 12
"""Standard deviation, in s, of a blur of the departures from the mean tile. Where an outline is off by a fraction of a
pixel, departures of both signs lie side by side; they would make joints look like places where texels differ."""
Corners = tuple[Lattice, Points]
"""The lattice of the middles of texels, and the corners of a texel from its middle, in order, ``(2 k, 2)`` px."""
Step = tuple[int, int]
"""A lattice vector, in steps along the first and the second vector, from a texel to another one."""
NEIGHBORS: Final[tuple[Step, ...]] = tuple((u, v) for u in (-1, 0, 1) for v in (-1, 0, 1) if u or v)
_CHUNK = 1 << 16
"""Number of points of the sample that are read at a time."""
_KEPT = 1 << 22
"""Number of differences that are kept, 32 MiB."""
Grid = NDArray[np.int64]
"""``(columns, rows)``: number of the texel at each place of the output."""
ZONE: Final = (3.0, 8.0)
"""px: the least and the greatest default breadth of the zone; between them it is a sixth of s."""
_BAND = 1 << 16
"""Number of output pixels that are computed at a time."""


@leaves_out
@dataclass(frozen=True)
class RegularizedPatch:
    """Regularized patch-based synthesis (Lin et al. 2004, section 2.4 and appendix A): texels pasted on the lattice.

    Where the sample is bent, its lattice is tracked, where the report lets a user move its vertices. Multilevel
    free-form deformation, from the regular vertices to the tracked ones, straightens the sample, and the output is bent
    by a synthesized deformation (parameter ``geometry``). The texels of the straight sample, each a cell of the
    lattice with a zone around it, are the only candidates. They are pasted at the points of the lattice, in the order
    in which the lattice grows from its middle: the earlier the corners of a texel are found, the earlier it is pasted.
    Each is drawn at random from the texels that differ from their neighbors in the shared zones by at most d_max; if
    there is none, the one that differs least is taken, as in patch-based synthesis (Liang et al. 2001). Zones are
    feathered.

    Places are real-valued, so that nothing drifts, and the output keeps the sample's phase. If no lattice is given,
    ``consensus`` finds one.

    The report leaves to the user what is automatic here: the vectors and the corners of texels. It leaves open the
    order of vertices found at the same time (rows), the breadth of the zone, and d_max, for which Liang et al. take
    ``tolerance=0.2``. As printed, equation 1 makes the lattice collapse;
    :func:`~nrbench.displacement.random_field.neighbor_field` says how it is read. With that reading, equation 3
    shrinks the deformation to about 0.15 of the sample's amplitude. The settings of the report are
    ``texel=given,tolerance=0.2,geometry=argmax``.

    Parameters
    ----------
    texel
        Shape of the texels. ``"hexagon"`` and ``"quadrilateral"``: where the texels of the sample differ least along
        their borders; hexagons include bricks in running bond. ``"given"``: the parallelogram of the lattice's own two
        vectors, with its middle at the origin.
    zone
        Breadth in px of the zone that two texels share; at most the breadth of a texel. None: a sixth of s, from 3 to
        8 px.
    tolerance
        d_max over the root mean square of the texels' values along their borders, 0 to 1000. 0: always the texel that
        differs least.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``;
        ``"waves"``: bent if the sample waves, straight if it is in perspective, round or distorted by a lens.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself.

    References
    ----------
    .. [1] Wen-Chieh Lin, James H. Hays, Chenyu Wu, Vivek Kwatra, Yanxi Liu. "A Comparison Study of Four Texture
           Synthesis Algorithms on Regular and Near-regular Textures." CMU-RI-TR-04-01, Robotics Institute, Carnegie
           Mellon University, 2004.
    """

    texel: TexelKind | Literal["given"] = "hexagon"
    zone: float | None = None
    tolerance: float = 0.05
    geometry: Geometry = "waves"

    wraps: ClassVar[bool] = True
    finder: ClassVar[str] = "consensus"
    family: ClassVar[str] = "tiles and patches on the lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "1"
    patch_shape: ClassVar[str] = "user identified lattice, quadrilateral patch"
    patch_placement: ClassVar[str] = "lattice points"
    patch_stitching: ClassVar[str] = "image-feathering"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"texel": "given", "tolerance": 0.2, "geometry": "argmax"}
    }
    paper: ClassVar[str] = """@techreport{lin2004comparison,
  author = {Lin, Wen-Chieh and Hays, James H. and Wu, Chenyu and Kwatra, Vivek and Liu, Yanxi},
  title = {A Comparison Study of Four Texture Synthesis Algorithms on Regular and Near-regular Textures},
  institution = {Robotics Institute, Carnegie Mellon University},
  number = {CMU-RI-TR-04-01},
  year = {2004}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, zone=(0, np.inf), tolerance=(0, 1000))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`RegularizedPatch`.

        Raises
        ------
        Refused
            If no lattice is found, or if the sample does not show two periods or two whole texels.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there are no texels; give a lattice")
        require_two_periods(lattice, task.sample.shape)
        reader = TexelReader(task.sample)
        shape = self._texel_shape(task.sample, lattice)
        stock = TexelStock.of(shape, reader)
        if len(stock.middles) < 2:
            height, width = task.sample.shape[:2]
            across, down = np.ptp(shape.pixels, axis=0)
            raise Refused(
                f"a texel with its zone takes {across:.0f}x{down:.0f} px, the sample is {width}x{height} px: it does "
                "not hold two of them; choose a larger sample or a narrower zone"
            )
        d_max = self.tolerance * math.sqrt(stock.power)
        extent = np.zeros(2), np.array(task.shape[::-1]) - 1.0
        torus = CellTorus.closing(shape.lattice, task.shape) if task.tileable else None
        mosaic = TexelMosaic.grow(stock, extent, d_max, task.rng, task.progress, torus)
        image, source = mosaic.paint(task.shape)
        task.progress(1.0)
        return Synthesis(image, lattice, source[:, :, 0], detection_seconds=seconds, blended=source[:, :, 1:])

    def _texel_shape(self, sample: Image, lattice: Lattice) -> TexelShape:
        if self.texel == "given":
            middles, corners = parallelogram(lattice)
        else:
            middles, corners = quiet_texels(sample, lattice, self.texel)
        least, most = ZONE
        zone = min(max(lattice.s / 6, least), most) if self.zone is None else self.zone
        return TexelShape.of(middles, corners, zone)


class TexelReader:
    """Reads a sample at points of its plane, rounded to 1/64 px.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    """

    def __init__(self, sample: Image) -> None:
        self.sample, self.patches = sample, Patches(sample)

    def holds(self, points: Points) -> NDArray[np.bool_]:
        """Return which points ``(..., 2)`` the sample shows."""
        at, size = round_places(points), np.array(self.sample.shape[1::-1])
        return np.asarray(((at >= -0.5) & (at <= size - 0.5)).all(-1))

    def read(self, points: Points) -> Image:
        """Return the values at points ``(..., 2)``, as ``(..., C)``."""
        return self.patches.read_points(round_places(points))

    def trace(self, points: Points, weight: NDArray[np.float64]) -> tuple[Image, SourceMap]:
        """Return the values at points ``(n, 2)`` that are shown with a weight, and where they come from."""
        image, source = self.patches.read_with_source(round_places(points)[np.newaxis])
        source[..., 2] *= weight
        return image[0], source[0]


@dataclass(frozen=True, eq=False)
class TexelShape:
    """A convex texel, symmetric about its middle, that tiles the plane when a lattice repeats it.

    Parameters
    ----------
    lattice
        Its points are the middles of the texels. All texels that meet are one step along either or both vectors apart.
    normals
        ``(k, 2)``: unit vectors across the pairs of parallel sides, two or three.
    halves
        ``(k,)`` px: distance of each side from the middle.
    zone
        Breadth, px, of the zone that two neighbors share: each reaches half of it beyond its sides.
    """

    lattice: Lattice
    normals: Points
    halves: NDArray[np.float64]
    zone: float

    @classmethod
    def of(cls, lattice: Lattice, corners: Points, zone: float) -> TexelShape:
        """Return the texel with some corners.

        Parameters
        ----------
        lattice
            Its points are the middles.
        corners
            ``(2 k, 2)`` px: the corners from the middle, in order around it; two may coincide.
        zone
            As in the class. It is made no broader than the texel.
        """
        sides = np.roll(corners, -1, 0)[: len(corners) // 2] - corners[: len(corners) // 2]
        lengths = np.hypot(*sides.T)
        kept = lengths > 1e-6
        normals = np.column_stack([-sides[:, 1], sides[:, 0]])[kept] / lengths[kept, np.newaxis]
        halves = np.abs((normals * corners[: len(corners) // 2][kept]).sum(1))
        return cls(lattice, normals, halves, min(zone, 2 * float(halves.min())))

    def ramp(self, points: Points) -> NDArray[np.float64]:
        """Return how far points ``(..., 2)`` px from the middle are inside: 0 to 1 across the zone, 1/2 on a side."""
        inside = (self.halves - np.abs(points @ self.normals.T)).min(-1)
        return np.asarray(np.clip(0.5 + inside / max(self.zone, 1e-9), 0, 1))

    def weights(self, points: Points) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield cell coordinates of texels near points ``(n, 2)`` px, ``(n, 2)``, and their weights there, ``(n,)``.

        The weights of all texels at a point add up to 1. They fall linearly across the zone of two neighbors. If each
        new texel were feathered onto those pasted before, the weights would be the same, but for the corners where
        three meet.
        """
        near = np.rint(self.lattice.to_cell(points)).astype(np.int64)
        numbers = [near + step for step in ((0, 0), *NEIGHBORS)]
        ramps = [self.ramp(points - self.lattice.from_cell(number)) for number in numbers]
        total = np.sum(ramps, 0)
        for number, ramp in zip(numbers, ramps, strict=True):
            yield number, ramp / total

    @cached_property
    def pixels(self) -> Points:
        """``(n, 2)``: the whole-pixel points from the middle that the texel and its zone hold."""
        reach = int(np.ceil(2 * np.hypot(*self.lattice.matrix.T).max() + self.zone))
        side = np.arange(-reach, reach + 1.0)
        points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
        return points[self.ramp(points) > 0]

    @cached_property
    def rim(self) -> Points:
        """``(n, 2)`` px: the outermost of :attr:`pixels`."""
        steps = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
        return np.asarray(self.pixels[(self.ramp(self.pixels[:, np.newaxis] + steps) == 0).any(1)])

    def shared_zone(self, step: Step) -> Points:
        """Return the :attr:`pixels` of the zone that a texel shares with the one at a step, ``(n, 2)``."""
        return np.asarray(self.pixels[self.ramp(self.pixels - np.array(step) @ self.lattice.matrix) > 0])


@dataclass(frozen=True, eq=False)
class TexelStock:
    """The texels that a sample holds with their zones.

    Parameters
    ----------
    shape
        Their shape, and the lattice of their middles.
    middles
        ``(n, 2)``: the middle (x, y) px of each texel.
    reader
        The sample.
    """

    shape: TexelShape
    middles: Points
    reader: TexelReader

    @classmethod
    def of(cls, shape: TexelShape, reader: TexelReader) -> TexelStock:
        """Return all texels of a shape that a sample holds."""
        last = np.array(reader.sample.shape[1::-1]) - 0.5
        middles = shape.lattice.from_cell(shape.lattice.cell_numbers(-last, 2 * last))
        middles = middles[reader.holds(middles[:, np.newaxis] + shape.rim).all(1)]
        return cls(shape, middles, reader)

    def zone_size(self, step: Step) -> int:
        """Return the number of points of the zone that a texel shares with the one at a step."""
        return len(self._zones[min(step, _opposite(step))][0])

    @cached_property
    def differences(self) -> Callable[[Step, int], NDArray[np.float64]]:
        """How each texel differs from one beside it, in their zone: a function of the step to it and its number.

        It returns ``(n,)``: squared differences are summed over the points of the zone and averaged over channels. All
        texels lie on the lattice, so that these numbers hold wherever the two meet. The first call for a step and a
        texel takes O(n zone). At most :data:`_KEPT` numbers are kept for later calls; n x n tables would take hundreds
        of MiB where the sample holds thousands of texels.
        """
        return lru_cache(max(1, _KEPT // max(len(self.middles), 1)))(self._compute_differences)

    def _compute_differences(self, step: Step, there: int) -> NDArray[np.float64]:
        """Compute :meth:`differences`; a step and its opposite share a zone, so that they agree on every pair."""
        forward = min(step, _opposite(step))
        points, own, other = self._zones[forward]
        if not len(points):
            return np.zeros(len(self.middles))
        here, beside = (own, other) if step == forward else (other, own)
        squares = scipy.spatial.distance.cdist(beside[there : there + 1], here, "sqeuclidean")[0]
        return np.asarray(squares / (here.shape[1] // len(points)))

    @cached_property
    def _zones(self) -> dict[Step, tuple[Points, NDArray[np.float64], NDArray[np.float64]]]:
        """For each forward step: points of the shared zone, their values in each texel, and in each as the other."""
        zones = {}
        for step in NEIGHBORS:
            if step < _opposite(step):
                points = self.shape.shared_zone(step)
                beside = points - np.array(step) @ self.shape.lattice.matrix
                zones[step] = points, self._values(points), self._values(beside)
        return zones

    def _values(self, offsets: Points) -> NDArray[np.float64]:
        """Return the values of each texel at offsets ``(m, 2)`` from its middle, as ``(n, m C)``."""
        if not len(offsets):
            return np.zeros((len(self.middles), 0))
        step = max(1, _CHUNK // len(offsets))
        parts = [
            self.reader.read(self.middles[first : first + step, np.newaxis] + offsets)
            for first in range(0, len(self.middles), step)
        ]
        values = np.concatenate(parts).astype(np.float64)
        return values.reshape(len(values), -1)

    @cached_property
    def power(self) -> float:
        """Mean square of the values on the rims."""
        values = self._values(self.shape.rim)
        return float((values**2).mean())


def _opposite(step: Step) -> Step:
    return -step[0], -step[1]


@dataclass(frozen=True, eq=False)
class TexelMosaic:
    """Texels side by side.

    Parameters
    ----------
    stock
        The texels.
    first
        (u, v): cell coordinates of the first texel of ``chosen``.
    chosen
        The texel at each place.
    torus
        The places of a mosaic that repeats, all of which ``chosen`` holds. None: it does not repeat.
    """

    stock: TexelStock
    first: NDArray[np.int64]
    chosen: Grid
    torus: CellTorus | None = None

    @classmethod
    def grow(
        cls,
        stock: TexelStock,
        box: tuple[Points, Points],
        largest: float,
        rng: np.random.Generator,
        progress: Callable[[float], None],
        torus: CellTorus | None = None,
    ) -> TexelMosaic:
        """Choose a texel for each place in a box, in the order in which the lattice is constructed.

        The lattice grows from the texel in the middle: each vertex leads to the four beside it. The earlier the
        vertices of a texel are found, the earlier it is pasted (report, appendix A). Of the texels that differ from
        those around it by at most ``largest``, one is drawn; if there is none, the one that differs least is taken.

        Parameters
        ----------
        stock
            The texels.
        box
            Least and greatest (x, y) px that must be covered.
        largest
            d_max: largest root mean square difference in the zones shared with texels that stand already.
        rng
            The randomness.
        progress
            Is called with the fraction that is done.
        torus
            The places of a mosaic that repeats. None: it does not.
        """
        first, size = _cover(stock.shape.lattice, box)
        if torus is not None:
            first, size = np.zeros(2, np.int64), np.array([torus.columns, torus.rows])
        mosaic = cls(stock, first, np.full((size[0], size[1]), -1), torus)
        order = list(growth_order((int(size[0]), int(size[1]))))
        draws = rng.random(len(order))
        count = len(stock.middles)
        for done, ((column, row), draw) in enumerate(zip(order, draws, strict=True)):
            squares, points = np.zeros(count), 0
            for step in NEIGHBORS:
                there = mosaic.texel_at(column + step[0], row + step[1])
                if there >= 0:
                    squares += stock.differences(step, there)
                    points += stock.zone_size(step)
            limit = max(largest**2 * points, float(squares.min())) * (1 + 1e-9)
            able = np.flatnonzero(squares <= limit)
            mosaic.chosen[column, row] = able[int(draw * len(able))]
            if done % 256 == 0:
                progress(done / len(order))
        return mosaic

    def texel_at(self, column: int, row: int) -> int:
        """Return the texel at a place of the grid, -1 if it is empty or outside."""
        if self.torus is not None:
            column, row = self.torus.wrap(np.array([column, row])).tolist()
        elif not (0 <= column < self.chosen.shape[0] and 0 <= row < self.chosen.shape[1]):
            return -1
        return int(self.chosen[column, row])

    def contributions(self, points: Points) -> Iterator[tuple[NDArray[np.intp], Points, NDArray[np.float64]]]:
        """Yield which points, ``(n, 2)`` px, show a texel, where in the sample it shows them, and its weight.

        The weights at a point add up to 1, see :meth:`~.TexelShape.weights`.
        """
        shape = self.stock.shape
        for numbers, weights in shape.weights(points):
            seen = np.flatnonzero(weights > 1e-6)
            number = numbers[seen]
            column, row = (number - self.first if self.torus is None else self.torus.wrap(number)).T
            middles = self.stock.middles[self.chosen[column, row]]
            yield seen, points[seen] + (middles - shape.lattice.from_cell(number)), weights[seen]

    def paint(self, size: Shape) -> tuple[Image, SourceMap]:
        """Return the output, ``(H, W, C)``, the weighted sum of the texels at each pixel, and the four main sources.

        Those are ``(H, W, 4, 3)``, in the order of their weights.
        """
        (height, width), channels = size, self.stock.reader.sample.shape[2]
        image, source = (
            np.zeros((height, width, channels), np.float32),
            np.zeros((height, width, FURTHER + 1, 3), np.float32),
        )
        rows = max(1, _BAND // width)
        for top in range(0, height, rows):
            pixels = pixel_grid(width, min(rows, height - top), top=top).astype(np.float64)
            values = image[top : top + rows].reshape(-1, channels)
            traced = source[top : top + rows].reshape(-1, FURTHER + 1, 3)
            for seen, places, weight in self.contributions(pixels.reshape(-1, 2)):
                shown, origin = self.stock.reader.trace(places, weight)
                values[seen] += weight[:, np.newaxis].astype(np.float32) * shown
                for rank in range(FURTHER + 1):
                    old = traced[seen, rank]
                    larger = origin[:, 2:] > old[:, 2:]
                    traced[seen, rank], origin = np.where(larger, origin, old), np.where(larger, old, origin)
        return np.clip(image, 0, 1), source


def _cover(lattice: Lattice, box: tuple[Points, Points]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first place (u, v) of the texels that cover a box with their zones, and their numbers along u, v."""
    (left, top), (right, bottom) = box
    uv = lattice.to_cell([(left, top), (right, top), (left, bottom), (right, bottom)])
    first = np.floor(uv.min(0)).astype(np.int64) - 2
    return first, np.ceil(uv.max(0)).astype(np.int64) + 3 - first


def growth_order(size: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield the (column, row) of every texel in the order in which the lattice's vertices are found.

    Vertices are found in rings: those of the texel in the middle, then those one step along a vector from them, and so
    on; in a ring, in the order of rows. A texel follows its last vertex.
    """
    columns, rows = size
    u, v = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij")
    middle = (columns - 1) // 2, (rows - 1) // 2
    # Steps from the nearest of the four vertices of the texel in the middle.
    found = np.maximum(np.maximum(middle[0] - u, u - middle[0] - 1), 0)
    found = found + np.maximum(np.maximum(middle[1] - v, v - middle[1] - 1), 0)
    last = np.maximum(np.maximum(found[:-1, :-1], found[1:, :-1]), np.maximum(found[:-1, 1:], found[1:, 1:]))
    column, row = (part.ravel() for part in np.indices(size))
    for n in np.lexsort((column, row, last.ravel())):
        yield int(column[n]), int(row[n])


def quiet_texels(image: Image, lattice: Lattice, kind: TexelKind) -> Corners:
    """Return the texels of the least visible borders.

    In the report a user draws them. Two texels that are pasted side by side differ, at each point of their common
    border, by twice the variance over all texels there. The border with the least sum of variances is taken.

    Parameters
    ----------
    image
        ``(H, W, C)``, straight.
    lattice
        Its lattice.
    kind
        ``"quadrilateral"``: parallelograms whose sides are two of the two shortest vectors, their sum and their
        difference. ``"hexagon"``: hexagons with parallel sides, and parallelograms, which are hexagons two of whose
        sides have no length. A brick of a wall in running bond is such a hexagon too.
    """
    lattice = lattice.reduced()
    mean = fold(image, lattice)
    sigma = BLUR * lattice.s
    departures = scipy.ndimage.gaussian_filter(image - mean.unfold(image.shape[:2]), (sigma, sigma, 0))
    departures = (departures**2).sum(-1, keepdims=True)
    variance = fold(departures, lattice).values
    grid = np.arange(STEPS) / STEPS
    places = lattice.from_cell(np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2))
    best, least = (np.array(lattice.origin), np.zeros(2), *lattice.matrix), np.inf
    for first, second in (lattice.matrix, lattice.matrix * [(1.0,), (-1.0,)]):
        links = _links(kind) @ np.stack([first, second])
        for link, costs in zip(links, _costs(variance, lattice, places, links, first, second), strict=True):
            if costs.min() < least * (1 - 1e-9):
                least = float(costs.min())
                best = places[costs.argmin()], link, first, second
    corner, link, first, second = best
    for halvings in range(1, REFINEMENTS + 1):
        step = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 0), (0, 1), (1, -1), (1, 0), (1, 1)]) / 2**halvings
        near = corner + step @ lattice.matrix / STEPS
        links = link + (step @ np.stack([first, second]) / LINKS if kind == "hexagon" else np.zeros((1, 2)))
        links = np.stack([each for each in links if _is_convex(each, first, second)])
        costs = _costs(variance, lattice, near, links, first, second)
        row, column = np.unravel_index(costs.argmin(), costs.shape)
        corner, link = near[column], links[row]
    return _texel(corner, link, first, second)


def parallelogram(lattice: Lattice) -> Corners:
    """Return the texels whose sides are the vectors of the lattice and whose middles are its points."""
    first, second = lattice.matrix
    return _texel(np.array(lattice.origin) - (first + second) / 2, np.zeros(2), first, second)


def _links(kind: TexelKind) -> NDArray[np.float64]:
    """Return the links from a corner to the next one that are tried, ``(n, 2)``, in steps along two vectors.

    The links to the three corners around a corner are d, d - u and d - v for two vectors u and v that span the lattice.
    The hexagon is convex if d lies in the triangle of 0, u and v; at a corner of the triangle it is a parallelogram.
    """
    if kind == "quadrilateral":
        return np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    grid = np.stack(np.meshgrid(np.arange(LINKS + 1), np.arange(LINKS + 1)), -1).reshape(-1, 2)
    return np.asarray(grid[grid.sum(1) <= LINKS] / LINKS)


def _is_convex(link: Points, first: Points, second: Points) -> bool:
    """Return whether a link lies in the triangle of 0 and two vectors, up to rounding."""
    along = link @ np.linalg.inv(np.stack([first, second]))
    return bool((along >= -1e-9).all() and along.sum() <= 1 + 1e-9)


def _costs(
    variance: Values, lattice: Lattice, places: Points, links: Points, first: Points, second: Points
) -> NDArray[np.float64]:
    """Return the sums of variances along the sides that start at a corner.

    For links ``(k, 2)`` and corners at ``(n, 2)`` px: ``(k, n)``.
    """
    sides = np.stack([links, links - first, links - second], 1)
    along = (np.arange(ALONG)[:, np.newaxis] + 0.5) / ALONG
    points = (sides[:, :, np.newaxis] * along).reshape(len(links), 1, -1, 2) @ np.linalg.inv(lattice.matrix)
    values = sample_tile(variance, lattice.to_cell(places)[:, np.newaxis] + points)[..., 0]
    lengths = np.repeat(np.hypot(sides[..., 0], sides[..., 1]) / ALONG, ALONG, 1)
    return np.stack([each @ length for each, length in zip(values, lengths, strict=True)])


def _texel(corner: Points, link: Points, first: Points, second: Points) -> Corners:
    """Return the texel with a corner, the link from it to the next one, and the vectors that span the lattice."""
    path = np.cumsum([link, first - link, link - second, -link, link - first], 0)
    corners = np.concatenate([np.zeros((1, 2)), path])
    middle = corners[3] / 2
    return Lattice.from_basis((first, second), corner + middle), corners - middle
