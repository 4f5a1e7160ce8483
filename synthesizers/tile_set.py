"""Tile sets: the tiles of a sample, laid at random over one another on its lattice."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.consensus import Consensus
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Synthesis, Task, find_lattice

from .sampling.subpixel import fractions
from .sampling.two_periods import require_two_periods
from .tile_laying.anchor import By, anchored
from .tile_laying.canvas import Canvas, Stitch
from .tile_laying.frame import Frame, Tile, frame_of
from .tile_laying.stock import Cuts, Difference, Stock, complete
from .tile_laying.symmetry import pictures, upright

FINE: Final = 4
"""Parts of a pixel to which tiles are placed where whole pixels are too coarse."""
COARSE: Final = 10.0
"""px; with s at least this long rounding to whole pixels misplaces a tile by at most 0.05 s along x and along y."""

LEAST_SIDE: Final = 16.0
"""px; where s is shorter tiles are of several cells: seams find no room around elements there, and tiles are many."""
MARGIN: Final = 2.0
"""px; by so much tiles are larger at each end where exact cuts look for a way around the elements inside."""
FEATHER: Final = 3.0
"""px; the ramp where seams conflict, and what registration and feather may reach where s is less."""


@dataclass(frozen=True)
class TileSet:
    """Tile set (Liu, Tsin and Lin 2005, section 3.1): tiles drawn at random, laid over one another on the lattice.

    Two sets of maximum tiles are cut from the sample: T around the points of the lattice, Th around the points half-way
    between. (Tiles of shape ``cell`` have four sets: half-way along either vector, and along both; tiles of an even
    number of ``cells`` have T alone.) The output is laid with them in scan-line order, in half steps, the sets in turn,
    from a random tile of T at its top left, or at most a step before it: the sample's phase is kept. Each tile overlaps
    by half to three quarters with what stands. At every place the tiles of its set that differ there by no more than a
    threshold are candidates; one is drawn, or the one that differs least is taken where there is none. It is registered
    by correlation and stitched. Places are real-valued lattice points, so that nothing drifts.

    The paper stitches by dynamic programming along both directions and blends where these conflict
    (``stitch=dynamic``). A step is half an element or less: such seams, and any that may keep to the border of what
    stands, run through most elements and leave them in two tones. Here an exact minimum cut leads around them: seams by
    differences over gradients (Kwatra et al. 2003, section 5), the border of what stands as dear as the dearest of
    them, what old seams cost won back where they are covered, tiles a little larger for room.

    What the paper does by hand is automatic. The lattice is anchored in the middle of what differs from tile to tile,
    so that tiles show elements whole. The threshold comes from the differences between the tiles of the sample itself,
    over what a tile usually overlaps with: it is the least at which every tile, however odd, accepts the share
    ``quantile`` of the others of its set.

    With no lattice given it finds one by ``consensus``. The paper's own settings are ``tile=upright, cells=1,
    stitch=dynamic, slope=1, difference=sum, parts=1, registration=1, anchor=given`` and a ``threshold`` set by hand for
    the texture.

    Parameters
    ----------
    tile
        Shape of the maximum tiles. ``"upright"``: the smallest upright rectangle around the minimum tile (the paper).
        ``"lattice"``: sides along t1 + t2 and t2 - t1, the lattice's own coordinates (the paper's suggestion; on an
        upright rhombic lattice the same). ``"rectangle"``: sides 2 t1 and t2, t1 the shorter, laid along them.
        ``"cell"``: sides t1 and t2, the minimum tile, laid along them. ``"auto"``: the cell for rectangular and square
        lattices, where it is the smallest rectangle around the minimum tile, and where the sample holds nothing larger;
        else the lattice's.
    cells
        Times that a tile's sides are lengthened, 1 to 64 (the paper: 1). A larger piece of the sample breaks fewer
        elements and takes less time, but the sample is copied on for longer; any tile of the lattice may be laid.
        None: 1, or as many as make s 16 px or more where the sample holds such tiles. Cells one brick wide and several
        courses high show no brick of every second course whole: there 2 leaves fewer bricks in two tones.
    margin
        By how many px, at most s, tiles are longer at both ends of each side, steps staying what they are. None: 2 for
        exact cuts where the sample holds such tiles, else 0 (the paper).
    quantile
        Share of the others that the oddest tile of the sample accepts, in [0, 1]; more draws more freely, less joins
        better.
    threshold
        A threshold of one's own instead (the paper's), in gray levels of 255, channels added.
    difference
        What is compared with it: ``"mean"`` over the pixels of the overlap, or their ``"sum"`` (the paper's).
    registration
        How far, px, at most s, a tile may be moved from its place; 0 does not register. None: 0.025 s, at most 1 px:
        where stripes fit at any shift along themselves, tiles that each follow the one before would shift whole
        courses. Less than half a part of a pixel moves nothing: so it is by default where s is 10 to 20 px, and nothing
        is missed there (four walls and weaves of ``core``, s 18 px: with 1 px as many elements are broken, to 0.02).
        It follows what is irregular: where the sample is perfectly periodic it costs up to 10 dB.
    parts
        Tiles are placed to whole pixels (1), or to halves, thirds, ... 16ths, interpolated by splines of order 5. None:
        quarters where s is under 10 px; else whole pixels, so that all is copied and no noise is smoothed (quarters
        take 0.07 of the variation on ``core``). A smooth periodic texture whose vectors are no whole pixels, s 18 to
        21 px, then comes back with a PSNR of 31 to 34 dB; of 43 to 46 dB with ``parts=4, registration=0``.
        Without meaning where both vectors are whole pixels.
    stitch
        ``"graphcut"``: the exact minimum cut, as above; neither slope nor feather count then. ``"dynamic"``: two seams
        by dynamic programming, blended where they conflict (the paper).
    slope
        How far, px, a seam may move aside from one row to the next, 1 to 64 (Efros and Freeman: 1). More lets it follow
        joints. Of ``stitch=dynamic`` alone.
    feather
        Width in px, at most s, of the ramp where the two seams conflict; 0 cuts. Of ``stitch=dynamic`` alone.
    anchor
        ``"elements"``: where tiles differ most, so that a tile shows an element whole and seams can pass along joints;
        ``"quiet"``: where the gradient energy of the mean tile, summed along the borders of all minimum tiles, is least
        (the paper's low-frequency regions); ``"given"``: at the lattice's origin. Of the places that leave each set
        enough tiles.
    symmetry
        Also take the tiles of the sample mirrored or turned, where that leaves its mean tile what it is (section 4.4).
    """

    tile: Tile | Literal["auto"] = "auto"
    cells: int | None = None
    margin: float | None = None
    quantile: float = 0.75
    threshold: float | None = None
    difference: Difference = "mean"
    registration: float | None = None
    parts: int | None = None
    stitch: Stitch = "graphcut"
    slope: int = 4
    feather: float = FEATHER
    anchor: By | Literal["given"] = "elements"
    symmetry: bool = False

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    version: ClassVar[str] = "2"
    paper: ClassVar[str] = """@article{liu2005promise,
  author = {Liu, Yanxi and Tsin, Yanghai and Lin, Wen-Chieh},
  title = {The Promise and Perils of Near-Regular Texture},
  journal = {International Journal of Computer Vision},
  volume = {62},
  number = {1-2},
  pages = {145--159},
  year = {2005}
}"""

    def __post_init__(self) -> None:
        if not 0 <= self.quantile <= 1:
            raise BadInput(f"quantile {self.quantile}; choose from 0 to 1")
        if self.threshold is not None and not self.threshold >= 0:
            raise BadInput(f"threshold {self.threshold}; choose 0 or more")
        for name in ("registration", "feather", "margin"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < np.inf:
                raise BadInput(f"{name} {value}; choose 0 or more px, at most s")
        for name, most in (("cells", 64), ("parts", 16), ("slope", 64)):
            value = getattr(self, name)
            if value is not None and not 1 <= value <= most:
                raise BadInput(f"{name} {value}; choose from 1 to {most}")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`TileSet`.

        Raises
        ------
        Refused
            When no lattice is found, when the sample does not show two periods, or not a complete tile of each set and
            two of one, or when registration, feather or margin is larger than s.
        """
        found = find_lattice(task, Consensus())
        if found.lattice is None:
            raise Refused(f"no lattice found ({found.reason}): there are no tiles")
        self._require_within_s(found.lattice.s)
        laying = _Laying(self, task, found.lattice)
        laying.lay_all()
        image, source = laying.canvas.picture()
        return Synthesis(image, found.lattice, source, detection_seconds=found.seconds)

    def _require_within_s(self, s: float) -> None:
        most = max(s, FEATHER)
        for name in ("registration", "feather", "margin"):
            value = getattr(self, name) or 0.0
            if value > most:
                raise Refused(f"{name} {value:g} px reaches farther than s, {s:.1f} px; choose at most {most:.1f}")


class _Laying:
    """One synthesis: the tiles, what they are laid on, and how far that is."""

    def __init__(self, method: TileSet, task: Task, lattice: Lattice) -> None:
        self.method, self.task = method, task
        self.frame, self.lattice = _framed(method, task, lattice)
        parts = method.parts or (1 if lattice.s >= COARSE else FINE)
        turned = pictures if method.symmetry else lambda sample, one: [upright(sample, one)]
        self.pictures = turned(task.sample, self.lattice)
        source = fractions([picture.image for picture in self.pictures], 1 if _whole(lattice) else parts)
        self.stock = Stock(self.frame, source, tuple(picture.lattice for picture in self.pictures))
        self.sets = {(i, j): self.stock.middles(i, j) for i in (0, 1) for j in (0, 1)}
        self.canvas = Canvas(task.shape, self.stock, self.pictures, method.slope, method.feather, method.stitch)
        self.radius = min(1.0, 0.025 * lattice.s) if method.registration is None else method.registration

    def lay_all(self) -> None:
        """Lay every tile that touches the output, row by row (step 2)."""
        threshold = self.method.threshold
        if threshold is None:
            threshold = self.stock.threshold(self.method.quantile, self.method.difference)
        numbers = self.numbers()
        places = self.lattice.origin + numbers @ self.frame.steps
        for done, ((i, j), place) in enumerate(zip(numbers.tolist(), places, strict=True)):
            self._lay(i, j, place, threshold)
            if done % 64 == 0:
                self.task.progress(done / len(numbers))
        self.task.progress(1.0)

    def numbers(self) -> NDArray[np.int64]:
        """Return (i, j) of every tile that touches the output, ``(n, 2)``: step in the row and row; in laying order."""
        height, width = self.task.shape
        steps = Lattice.from_basis(self.frame.steps, self.lattice.origin)
        x, y = self.frame.reach.tolist()
        low, high = (-x - 1, -y - 1), (width + x, height + y)
        numbers = steps.cell_numbers(low, high)
        places = steps.from_cell(numbers)
        numbers = numbers[((places > low) & (places < high)).all(1)]
        numbers = numbers[np.lexsort(numbers.T)]
        return np.concatenate([self._before(numbers[:1]), numbers])

    def _before(self, number: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return a tile of T at most a step before one, ``(1, 2)``; none, ``(0, 2)``, where that is of T itself."""
        for back in np.ndindex(2, 2):
            place = (number - back) @ self.frame.steps
            if np.abs(self.lattice.wrap(place)).max() < 1e-6:
                return number[: any(back)] - back
        raise AssertionError("twice a step is a lattice vector")

    def _lay(self, i: int, j: int, place: Points, threshold: float) -> None:
        """Draw a tile and lay it (steps 3 to 6)."""
        pixel = np.floor(place + 0.5)
        turned, middles = self.sets[i % 2, j % 2]
        cuts = self.stock.cut(turned, middles + (pixel - place))
        left, top = (pixel.astype(int) + self.canvas.margin).tolist()
        overlap = self.canvas.overlap(left, top)
        if not len(overlap.values):
            self.canvas.lay(left, top, self._drawn(cuts, np.arange(len(cuts.copy))))
            return
        differences = self.stock.differences(overlap, cuts)
        size = len(overlap.values) if self.method.difference == "mean" else 1
        good = differences <= max(threshold * size, int(differences.min()))
        cut = self._drawn(cuts, np.flatnonzero(good))
        self.canvas.lay(left, top, self.stock.registered(overlap, cut, self.radius) if self.radius else cut)

    def _drawn(self, cuts: Cuts, among: NDArray[np.int64]) -> Cuts:
        return cuts.take(among[self.task.rng.integers(len(among)), np.newaxis])


def _framed(method: TileSet, task: Task, lattice: Lattice) -> tuple[Frame, Lattice]:
    """Return the tiles' frame, and the lattice anchored for it."""
    require_two_periods(lattice, task.sample.shape)
    for frame in _frames(method, lattice):
        at = lattice if method.anchor == "given" else anchored(task.sample, lattice, frame, method.anchor)
        offsets = np.array(frame.distinct(lattice)) @ frame.steps
        tiles = [len(complete(at.shifted((x, y)), frame, task.sample.shape)) for x, y in offsets.tolist()]
        if all(tiles) and max(tiles) > 1:
            return frame, at
    height, width, _ = task.sample.shape
    across, down = 2 * frame.reach
    raise Refused(
        f"a tile takes {across:.0f}x{down:.0f} px, the sample is {width}x{height} px: it does not hold "
        "a complete tile of each set and two of one"
    )


def _frames(method: TileSet, lattice: Lattice) -> Iterator[Frame]:
    """Yield the frames of tiles in the order in which they are tried, until the sample holds one's tiles."""
    tiles = _tiles(lattice) if method.tile == "auto" else [method.tile]
    many = [max(1, math.ceil(LEAST_SIDE / lattice.s)), 1] if method.cells is None else [method.cells]
    wide = [MARGIN, 0.0] if method.stitch == "graphcut" else [0.0]
    for cells in many:
        for tile in tiles:
            for margin in wide if method.margin is None else [method.margin]:
                yield frame_of(lattice, tile, cells, margin)


def _tiles(lattice: Lattice) -> list[Tile]:
    return ["cell"] if lattice.kind in ("rectangular", "square") else ["lattice", "cell"]


def _whole(lattice: Lattice) -> bool:
    return bool(np.abs(lattice.matrix - np.rint(lattice.matrix)).max() < 1e-6)
