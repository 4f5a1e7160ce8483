"""Tile sets: the tiles of a sample, laid at random over one another on its lattice."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require, require_ranges
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Geometry, Refused, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .canvas.canvas import Canvas, Window, find_paths
from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import require_two_periods
from .tile_laying.tile_kernels import FEATHER, Under, blend_weights, error_surface, join_tile
from .tile_laying.tiles import (
    AnchorKind,
    ElementWeights,
    OverlapMeasure,
    ShiftedImages,
    TileKind,
    TilePlaces,
    TileShape,
    TileStock,
    anchor_lattice,
    symmetric_copies,
    tile_shape,
)

FINE_PARTS: Final = 4
"""Default parts of a pixel at which tiles are placed if whole pixels are too coarse."""
COARSE: Final = 10.0
"""px; if s is at least this long, rounding to whole pixels misplaces a tile by at most 0.05 s along x and along y."""
LEAST_SIDE: Final = 16.0
"""px; if s is shorter, tiles consist of several cells: small tiles are many, and seams find no way around elements."""
ELONGATED: Final = 2.0
"""If a rectangular cell is this many times as long as wide, automatic tiles are two cells wide."""
MARGIN: Final = 2.0
"""px by which tiles are longer at each end for exact cuts, so that seams can run around elements."""


@leaves_out
@dataclass(frozen=True)
class TileSet:
    """Tile set (Liu, Tsin and Lin 2005, section 3.1): tiles drawn at random, laid over one another on the lattice.

    Two sets of maximum tiles are cut from the sample: T around the points of the lattice, and Th around the points
    half-way between. (Tiles of shape ``cell`` have four sets: half-way along either vector, and along both; tiles of an
    even number of ``cells`` have only T.) The sets are laid in turn, in half steps and scan-line order, starting with a
    random tile of T at the top left of the output, or at most a step before it, so that the output keeps the sample's
    phase. Each tile overlaps by half to three quarters with earlier tiles. At every place, the candidates are the tiles
    of its set that differ from the overlap by at most a threshold. One of them is drawn; without a candidate, the tile
    that differs least is taken. The tile is registered by correlation and stitched. Places are real-valued lattice
    points, so that nothing drifts.

    The paper stitches by dynamic programming along both directions, in a similar manner as Efros and Freeman, whose two
    seams meet where the sum of errors over both is least, and blends where these seams conflict (``stitch=dynamic``).
    A tile overlaps the whole row above it, which goes on at its right: where the upper seam ends above the last row of
    this overlap, the right border of the tile is part of the cut, and its errors count. The text says only that all
    pixels of the boundary are results of dynamic programming or blending. In grain, these seams lose the joint between
    elements of like color. The default is an exact minimum cut that leads around elements: seams cost differences over
    gradients (Kwatra et al. 2003, section 5), the border of the filled region costs double, covering an old seam
    regains its cost, and tiles are slightly larger.

    What the paper does by hand is automatic. The lattice is anchored in the middle of what differs from tile to tile,
    so that tiles show elements whole. The threshold is computed from the differences between the tiles of the sample
    over the usual overlap: the least threshold at which the share ``accepting`` of the tiles accepts the share
    ``quantile`` of the others of its set.

    ``preset=paper`` is the method of the paper. Four of its values are readings:

    - *Anchor*: most lattices were located by hand, so that "the boundary of the tiles" lies in "low frequency regions".
      The preset looks for these (``anchor=quiet``); ``anchor=given`` takes a place from you.
    - *Threshold*: none is printed. Odd tiles, such as those with holes in a rug, "may not appear in the output" of the
      authors. The preset takes the tightest threshold at which half of the tiles accept another one; at the one that
      the oddest tile needs (``accepting=1``), up to twice as many elements are joined of two.
    - *Margin*: blending takes "a padded region around the boundary" of a tile. The preset pads tiles by 2 px, so that a
      joint on their border is whole.
    - *Registration* makes "small movements", here up to 1 px, and blending takes 3 px.

    On eight draws each of the models brick, hexagon and weave at ``color=0.2``, 18 %, 38 % and 11 % of the bricks,
    tiles and crossings are joined of two or more of the sample (``color=0.6``: 12 %, 15 %, 4 %), against 0 to 2 % with
    the default. On turned walls, more than half: upright rectangles around slanted tiles cut elements
    (``tile=lattice``, the paper's own suggestion, halves it). On photographs, whose bricks vary as much inside as from
    one to the next, this hardly shows.

    Parameters
    ----------
    tile
        Shape of the maximum tiles. ``"upright"``: the smallest upright rectangle around the minimum tile (the paper).
        ``"lattice"``: sides along t1 + t2 and t2 - t1, the lattice's own coordinates (the paper's suggestion; on an
        upright rhombic lattice the same). ``"rectangle"``: sides 2 t1 and t2, t1 the shorter. ``"cell"``: sides t1 and
        t2, the minimum tile. ``"auto"``: the cell on rectangular and square lattices, where it is the smallest
        rectangle around the minimum tile, and where the sample holds nothing larger; else the lattice's.
    cells
        Factor of a tile's sides, 1 to 64 (the paper: 1). Larger tiles break fewer elements and take less time, but copy
        longer stretches of the sample. None: 1, or as many as make s at least 16 px if the sample holds such tiles. If
        a cell is one brick wide and several courses high, no brick of every second course is whole in it; 2 then leaves
        fewer bricks two-toned.
    margin
        px, at most s, by which tiles are longer at both ends of each side; the steps do not change. None: 2 for exact
        cuts if the sample holds such tiles, else 0.
    quantile
        Share of the other tiles that a tile of the sample accepts, in [0, 1]. More draws more freely, less joins
        better.
    accepting
        Share of the tiles of the sample that accept that many, in [0, 1]. 1: all, even the oddest.
    threshold
        A fixed threshold instead (the paper), in gray levels of 255, channels added.
    overlap_measure
        What is compared with the threshold: the ``"mean"`` over the pixels of the overlap, or their ``"sum"`` (the
        paper).
    registration
        Largest distance, px, at most s, by which a tile may be moved from its place; 0 does not register. None:
        0.025 s, at most 1 px: where stripes fit at any shift along themselves, larger moves would add up and shift
        whole courses. Moves of less than half a part of a pixel have no effect, which is the default where s is 10 to
        20 px; no more elements are broken there (four walls and weaves of ``core`` with s 18 px: equal to 1 px within
        0.02). Registration follows irregularities: on a perfectly periodic sample it costs up to 10 dB.
    parts
        Tiles are placed at whole pixels (1), or at halves, thirds, ... 16ths of a pixel, interpolated by splines of
        order 5. None: quarters if s is under 10 px, else whole pixels, so that all pixels are copies and no noise is
        smoothed (quarters take 0.07 of the variation on ``core``). A smooth periodic texture with fractional vectors, s
        18 to 21 px, then has a PSNR of 31 to 34 dB, and of 43 to 46 dB with ``parts=4, registration=0``. Without effect
        if both vectors are whole pixels.
    stitch
        ``"graphcut"``: the exact minimum cut. The cost of a seam is multiplied by how much the elements of the sample
        vary from tile to tile at this place of the cell, which leads seams along joints: differences alone do not show
        the joint between two elements of like color. ``"dynamic"``: two seams by dynamic programming, blended where
        they conflict (the paper).
    anchor
        ``"elements"``: where tiles differ most, so that a tile shows an element whole and seams can follow joints.
        ``"quiet"``: where tiles differ least along the borders of all maximum tiles (the paper's low-frequency
        regions). ``"given"``: at the lattice's origin, the middle of a tile. It should lie midway between two rows of
        elements, above the middle of an element; either way of stitching then breaks few. If the lattice was detected
        or its origin is (0, 0), none is known, and the anchor is the quiet one, which the note says. The first two
        choose among the places that leave each set enough tiles.
    symmetry
        ``"own"``: tiles are also cut from copies of the sample that are turned, mirrored or glided by the symmetries
        of its texture, as far as :func:`~nrbench.imaging.wallpaper_group.find_wallpaper_group` is sure of them: the
        "much larger sample set" of section 4.4. Copies turned by other than quarter turns are interpolated. Light from
        one side is turned, too. ``"none"``: the sample as it is.
    finder
        Detector that finds the lattice if none is given: ``"consensus"``, or ``"dominance"``, that of the paper.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``;
        ``"waves"``: bent if the sample waves, straight if it is in perspective, round or distorted by a lens.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself, as in the paper.

    References
    ----------
    .. [1] Yanxi Liu, Yanghai Tsin, Wen-Chieh Lin. "The Promise and Perils of Near-Regular Texture." International
           Journal of Computer Vision 62(1-2):145-159, 2005.
    """

    tile: TileKind | Literal["auto"] = "auto"
    cells: int | None = None
    margin: float | None = None
    quantile: float = 0.75
    accepting: float = 1.0
    threshold: float | None = None
    overlap_measure: OverlapMeasure = "mean"
    registration: float | None = None
    parts: int | None = None
    stitch: Literal["dynamic", "graphcut"] = "graphcut"
    anchor: AnchorKind | Literal["given"] = "elements"
    symmetry: Literal["none", "own"] = "none"
    finder: Literal["consensus", "dominance"] = "consensus"
    geometry: Geometry = "waves"

    wraps: ClassVar[bool] = True
    family: ClassVar[str] = "tiles and patches on the lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "5"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "tile": "upright",
            "cells": 1,
            "margin": 2.0,
            "quantile": 0.0,
            "accepting": 0.5,
            "overlap_measure": "sum",
            "registration": 1.0,
            "parts": 1,
            "stitch": "dynamic",
            "anchor": "quiet",
            "finder": "dominance",
            "geometry": "as-is",
        }
    }
    patch_shape: ClassVar[str] = "tile shape/size from translational symmetry analysis"
    patch_placement: ClassVar[str] = "lattice points"
    patch_stitching: ClassVar[str] = "seams, stitch={stitch}"
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
        require_ranges(self, quantile=(0, 1), accepting=(0, 1), registration=(0, np.inf), margin=(0, np.inf))
        require(self.threshold is None or self.threshold >= 0, f"threshold {self.threshold}; choose 0 or more")
        require_ranges(self, cells=(1, 64), parts=(1, 16))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`TileSet`.

        Raises
        ------
        Refused
            If no lattice is found, if the sample does not show two periods, or not a complete tile of each set and two
            of one, or if registration or margin is larger than s.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there are no tiles; give a lattice")
        self._require_within_s(lattice.s)
        unanchored = self.anchor == "given" and (task.lattice is None or lattice.origin == (0.0, 0.0))
        laying = TileLaying(replace(self, anchor="quiet") if unanchored else self, task, lattice)
        across, down = np.ptp(laying.tile.box, axis=0) + 1
        if task.tileable and (across > task.shape[1] or down > task.shape[0]):
            raise Refused(f"a tile takes {across}x{down} px; choose a tileable output that is at least as large")
        laying.lay_tiles()
        image, source = laying.canvas.output()
        notes = ["the lattice has no origin: tiles are anchored where their borders are quiet"] if unanchored else []
        if self.symmetry == "own" and not laying.stock.images.copies:
            notes.append("no symmetry of the texture is certain: the sample is used as it is")
        return Synthesis(
            image, lattice, source, detection_seconds=seconds, note="; ".join(notes), blended=laying.canvas.blended()
        )

    def _require_within_s(self, s: float) -> None:
        most = max(s, FEATHER)
        for name in ("registration", "margin"):
            value = getattr(self, name) or 0.0
            if value > most:
                raise Refused(f"{name} {value:g} px reaches farther than s, {s:.1f} px; choose at most {most:.1f}")


class TileLaying:
    """One synthesis by :class:`TileSet`: chooses a tile for every place and lays it on a canvas.

    Parameters
    ----------
    method
        The parameters.
    task
        The sample, the shape of the output, and the randomness.
    lattice
        The lattice of the sample.
    """

    def __init__(self, method: TileSet, task: Task, lattice: Lattice) -> None:
        self.method, self.task = method, task
        self.tile, self.lattice = _fit_tile(method, task, lattice)
        parts = method.parts or (1 if lattice.s >= COARSE else FINE_PARTS)
        if np.abs(lattice.matrix - np.rint(lattice.matrix)).max() < 1e-6:
            parts = 1
        self.radius = min(1.0, 0.025 * lattice.s) if method.registration is None else method.registration
        copies = symmetric_copies(task.sample, self.lattice, parts == 1) if method.symmetry == "own" else []
        self.stock = TileStock(self.tile, ShiftedImages.of(task.sample, parts, copies), self.lattice)
        self.sets = {(i, j): self.stock.middles(i, j) for i in (0, 1) for j in (0, 1)}
        self.margin = np.ceil(3 * self.tile.reach).astype(int) + 2
        down, across = int(self.margin[1]), int(self.margin[0])
        exact = self.stock.images.exact is not None
        self.canvas = Canvas(task.shape, task.sample.shape[2], np.uint8, (down, across), task.tileable, exact=exact)
        if method.stitch == "graphcut":
            weights = ElementWeights.of(task.sample, self.lattice)
            self._weights = weights.table, weights.numbers_from(-self.margin)

    def lay_tiles(self) -> None:
        """Lay every tile that touches the output, row by row (step 2)."""
        threshold = self.method.threshold
        if threshold is None:
            threshold = self.stock.estimate_threshold(
                self.method.quantile, self.method.accepting, self.method.overlap_measure
            )
        numbers = self.tile_numbers()
        places = self.lattice.origin + numbers @ self.tile.steps
        for done, ((i, j), place) in enumerate(zip(numbers.tolist(), places, strict=True)):
            self.lay_tile(i, j, place, threshold)
            if done % 64 == 0:
                self.task.progress(done / len(numbers))
        self.task.progress(1.0)

    def tile_numbers(self) -> NDArray[np.int64]:
        """Return step in the row and row of every tile that touches the output, ``(n, 2)``, in the order of laying."""
        height, width = self.task.shape
        steps = Lattice.from_basis(self.tile.steps, self.lattice.origin)
        x, y = self.tile.reach.tolist()
        low, high = (-x - 1, -y - 1), (width + x, height + y)
        numbers = steps.cell_numbers(low, high)
        places = steps.from_cell(numbers)
        numbers = numbers[((places > low) & (places < high)).all(1)]
        numbers = numbers[np.lexsort(numbers.T)]
        return np.concatenate([self._preceding_t(numbers[:1]), numbers])

    def _preceding_t(self, number: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return a tile of T at most a step before a tile, ``(1, 2)``, or none, ``(0, 2)``, if the tile is of T."""
        for back in np.ndindex(2, 2):
            place = (number - back) @ self.tile.steps
            if np.abs(self.lattice.wrap(place)).max() < 1e-6:
                return number[: any(back)] - back
        raise AssertionError("twice a step is a lattice vector")

    def lay_tile(self, i: int, j: int, place: Points, threshold: float) -> None:
        """Draw a tile of the set at step i in the row and row j, and lay it at a place (steps 3 to 6)."""
        pixel = np.floor(place + 0.5)
        tiles = self.stock.find_places(self.sets[i % 2, j % 2] + (pixel - place))
        (x0, y0), (x1, y1) = (self.tile.box + pixel.astype(int)).tolist()
        window = y0, y1 + 1, x0, x1 + 1
        pixels = self.canvas.pixels(window)
        canvas = self.canvas
        under = canvas.image[pixels], canvas.source[pixels], canvas.known[pixels], canvas.seams[:, *pixels]
        overlap, differences = self.stock.compare(under[0], under[2], tiles)
        size = len(overlap[0]) // self.task.sample.shape[2]
        if self.task.tileable and size == self._size and not self._is_inside(pixel):
            return  # It repeats others on the opposite side.
        if not size:
            drawn = self.draw(tiles, np.arange(len(tiles.place)))
        else:
            limit = threshold * (size if self.method.overlap_measure == "mean" else 1)
            drawn = self.draw(tiles, (differences <= max(limit, int(differences.min()))).nonzero()[0])
            if self.radius:
                drawn = self.stock.register(overlap, drawn, self.radius)
        self.join(window, drawn, under)

    def _is_inside(self, pixel: Points) -> bool:
        return bool(((pixel >= 0) & (pixel < self.task.shape[::-1])).all())

    def join(self, window: Window, drawn: TilePlaces, under: Under) -> None:
        """Lay one tile into a window of the canvas, and join it to what is known under it (steps 5 and 6)."""
        patch = self.stock.cut(drawn)
        if self.method.stitch == "graphcut":
            corner = window[2] + int(self.margin[0]), window[0] + int(self.margin[1])
            shown = join_tile(under, patch[0], patch[1], self._border, self._weights, corner)
            if self.canvas.exact is not None or under[0].base is not self.canvas.image:  # copies across an edge
                self.canvas.place(window, patch, shown)
                self.canvas.seams[:, *self.canvas.pixels(window)] = under[3]
            return
        surface, bands = error_surface(under[0], under[2], patch[0], self.tile.cells)
        across, down, row, column = find_paths(surface, *bands)
        weights = blend_weights(under[2], self.tile.pixel_cells, across, down, (row, column), bands)
        self.canvas.blend(window, patch, weights)

    @cached_property
    def _border(self) -> NDArray[np.int64]:
        return np.ascontiguousarray(self.tile.pixel_cells[..., 2])

    @cached_property
    def _size(self) -> int:
        """Number of pixels of a tile."""
        return int(self.tile.mask.sum())

    def draw(self, tiles: TilePlaces, candidates: NDArray[np.int64]) -> TilePlaces:
        """Return one of the candidates at random."""
        return tiles.take(candidates[self.task.rng.integers(len(candidates)), np.newaxis])


def _fit_tile(method: TileSet, task: Task, lattice: Lattice) -> tuple[TileShape, Lattice]:
    """Return the first tile shape of which the sample holds enough tiles, and the lattice anchored for it."""
    require_two_periods(lattice, task.sample.shape)
    for tile in _tile_shapes(method, lattice):
        at = lattice if method.anchor == "given" else anchor_lattice(task.sample, lattice, tile, method.anchor)
        offsets = np.array(tile.set_offsets(lattice)) @ tile.steps
        counts = [len(tile.complete_middles(at.shifted((x, y)), task.sample.shape)) for x, y in offsets.tolist()]
        if all(counts) and max(counts) > 1:
            return tile, at
    height, width, _ = task.sample.shape
    across, down = 2 * tile.reach
    raise Refused(
        f"a tile takes {across:.0f}x{down:.0f} px, the sample is {width}x{height} px: it does not hold "
        "a complete tile of each set and two of one; choose a larger sample or fewer cells"
    )


def _tile_shapes(method: TileSet, lattice: Lattice) -> Iterator[TileShape]:
    """Yield tile shapes in the order in which they are tried."""
    if method.tile != "auto":
        kinds: list[TileKind] = [method.tile]
    else:
        kinds = ["cell"] if lattice.kind in ("rectangular", "square") else ["lattice", "cell"]
        if kinds == ["cell"] and _elongation(lattice) >= ELONGATED:
            kinds = ["rectangle", "cell"]
    factors = [max(1, math.ceil(LEAST_SIDE / lattice.s)), 1] if method.cells is None else [method.cells]
    margins = [MARGIN, 0.0] if method.stitch == "graphcut" else [0.0]
    for cells in factors:
        for kind in kinds:
            for margin in margins if method.margin is None else [method.margin]:
                yield tile_shape(lattice, kind, cells, margin)


def _elongation(lattice: Lattice) -> float:
    """Return the length of the second reduced vector over that of the first."""
    first, second = np.hypot(*lattice.reduced().matrix.T)
    return float(max(first, second) / min(first, second))
