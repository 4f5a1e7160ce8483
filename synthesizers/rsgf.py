"""Random sampling and gap filling."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.gncc import Gncc
from nrbench.errors import require, require_ranges
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import FoundLattice, Geometry, Refused, Synthesis, Task, find_lattice
from nrbench.plugins.registry import NamedDetector

from .gap_filling.blocks import Block, BlockGrid, BlockPlacer, SeamMethod, check_border
from .gap_filling.holes import TOLERANCE, fill_task, leaves_out
from .lattice_places.equal_places import (
    EqualPlaces,
    Pixels,
    SearchShape,
    nearby_pixels,
    nearest_pixels,
    warn_of_no_lattice,
)
from .matching.frame_matching import FrameMatcher, Match, align_patch
from .sample_reading.patches import Patches, round_places

Search = Literal["lattice", "everywhere", "stochastic"]
Finder = Literal["consensus", "gncc", "gncc:preset=paper"]
REMEMBERED: Final = 64
"""Number of the latest patches that :class:`PlaceSampler` avoids. A draw costs the same however large the output is."""
_BLOCKS, _BORDER = (40, 32, 24, 20, 16, 12, 8), 10
"""px: automatic sizes of blocks, the first one that fits, and the largest automatic border."""
_STOCHASTIC_TRIALS = 16
"""Random places compared in stochastic mode, where there are too many places to compare all."""
_OVERLAP_SLACK: Final = 0.05
"""A place is as good as the least used one if its overlap count exceeds that one's by no more than this."""


@leaves_out
@dataclass(frozen=True)
class Rsgf:
    """Random sampling and gap filling (RSGF, section 4): random patches on the lattice, and patches that join them.

    The output is divided into blocks like a chess-board. Every second block takes a random patch from the places of the
    sample that the lattice makes equal to its own and that show it completely with its borders (section 4.1). Each gap
    left takes the patch that agrees best with the border which the patches around it form inside the gap (section 4.2,
    figure 4). The paper leaves open whether this border lies inside or around the gap. Inside, it is also the region
    that is blended, and a smaller sample suffices. Places are computed from the real-valued vectors of the lattice, so
    that nothing drifts.

    ``preset=paper`` is the method of the paper: its detector, which finds vectors of whole pixels, linear blending, and
    for a gap the best patch within 3 px. Of the two matches and the two searches that the paper offers, the preset
    takes color differences, which cost less, and the search near the lattice, which keeps the structure. A place that
    a given lattice puts between pixels is rounded. The defaults include what the paper leaves to future work (section
    6) where it proved better: a sub-pixel lattice, places between pixels, and seams by graph cut, which follow the
    outlines of elements, so that fewer bricks have two colors.

    The defaults also avoid a fault that the paper does not discuss. The best match is too often a patch near the mean
    of all patches, or one that the output shows already, so that the output varies less than the sample. By default a
    gap takes one of the better half of the patches, and of these one that the output has used least. Where seams are
    cut, this patch keeps a border's width from the sample's edge, so that seams can run around elements.

    If no lattice is given, or the chosen detector found none, the method detects one. If there is none, it uses the
    paper's mode for irregular textures, in which every position is a candidate, and reports this in the note.

    Parameters
    ----------
    block
        Side of a block in px (the paper: 40). 0: 40, or the largest of a few smaller sizes that the sample and its
        lattice allow; the note says so.
    border
        Width of the border in px (the paper: 10), at most half a block. 0: 10, or a quarter of a smaller block.
    match
        How the border of a gap is compared with patches: ``"color"`` by squared color differences (eq. 10), ``"ncc"``
        by the generalized normalized cross-correlation (eq. 4, channels combined by eq. 6). Ties are broken at random.
    search
        Where patches come from. ``"lattice"``: patches of gaps come from near the places that the lattice makes equal.
        ``"everywhere"``: they come from anywhere. ``"stochastic"``: all patches come from anywhere, as if v1 = (1, 0)
        and v2 = (0, 1) (section 5), and no lattice is used.
    tolerance
        Largest distance, px along x and along y, between a gap's patch and an equal place, for ``search="lattice"``.
        None: 3 px (the paper), but not more than 0.07 of the shortest lattice vector.
    subpixel
        Read patches at real-valued places, interpolated by splines of order 5. The patch of a gap is moved, within the
        tolerance, to where it agrees best with its border. False: whole pixels, off by at most half a pixel.
    seam
        How the patch of a gap is joined. ``"graphcut"``: along the least visible closed seam, which may run up to half
        a block inside the neighbors. ``"quilting"``: in the same region along the path of least squared difference of
        each side, as in image quilting. ``"blend"``: by linear blending over the border.
    deform
        Largest displacement in px, at most ``border``, by which the patch of a gap is deformed to agree with what it
        overlaps: smooth displacements, fitted to the border and continued inward. 0: none (the paper).
    candidate_fraction
        Fraction of the equal places, best first, from which a gap's patch is drawn, for ``search="lattice"``. 0: only
        the best place (the paper). 1: all places, each with its best match nearby. None: one half.
    prefer_unused
        Draw patches from the places that the latest patches overlap least. False: all are equally likely (the paper).
    finder
        Detector that finds the lattice if none is given: ``"consensus"``; ``"gncc"``, an improved form of the paper's,
        which reports half or twice the period of some walls and carpets; or the paper's own, ``"gncc:preset=paper"``,
        which is right only where the periods are nearly whole pixels.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``;
        ``"waves"``: bent if the sample waves, straight if it is in perspective, round or distorted by a lens.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself, as in the paper.

    References
    ----------
    .. [1] Diego Lopez Recas, Anna Hilsmann, Peter Eisert. "Near-Regular Texture Synthesis by Random Sampling and Gap
           Filling." Vision, Modeling, and Visualization (VMV 2011), The Eurographics Association, 2011.
    """

    block: int = 0
    border: int = 0
    match: Match = "color"
    search: Search = "lattice"
    tolerance: float | None = None
    subpixel: bool = True
    seam: SeamMethod = "graphcut"
    deform: float = 0.0
    candidate_fraction: float | None = None
    prefer_unused: bool = True
    finder: Finder = "consensus"
    geometry: Geometry = "waves"

    wraps: ClassVar[bool] = True
    fills: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "tiles and patches on the lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "4"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "block": 40,
            "border": 10,
            "match": "color",
            "search": "lattice",
            "tolerance": 3.0,
            "subpixel": False,
            "seam": "blend",
            "deform": 0.0,
            "candidate_fraction": 0.0,
            "prefer_unused": False,
            "finder": "gncc:preset=paper",
            "geometry": "as-is",
        }
    }
    patch_shape: ClassVar[str] = "user-defined, square patch"
    patch_placement: ClassVar[str] = "lattice points at random, gaps by best match, search={search}"
    patch_stitching: ClassVar[str] = "borders, seam={seam}"
    paper: ClassVar[str] = Gncc.paper

    def __post_init__(self) -> None:
        check_border(self.block or _BLOCKS[0], self.border or 1)
        require_ranges(self, candidate_fraction=(0, 1), deform=(0, self.border or _BORDER))
        require(self.tolerance is None or self.tolerance >= 0, f"tolerance {self.tolerance}; choose 0 px or more")
        for name in ("tolerance", "candidate_fraction"):
            effective = getattr(self, name) is None or self.search == "lattice"
            require(effective, f"{name} has no effect with search {self.search!r}; choose search 'lattice'")

    @property
    def uses_lattice(self) -> bool:
        """Whether it uses a lattice: the stochastic mode uses none."""
        return self.search != "stochastic"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`Rsgf`.

        Raises
        ------
        Refused
            If the sample does not hold a block with its borders, or no patch equal to one of the output's.
        """
        found = FoundLattice(None) if self.search == "stochastic" else find_lattice(task, NamedDetector(self.finder))
        notes = []
        if self.uses_lattice and found.lattice is None:
            warn_of_no_lattice("rsgf", found.reason)
            notes.append(f"stochastic mode, every position is a candidate: no lattice found ({found.reason})")
        for block, border in (sizes := self._sizes()):
            method = replace(self, block=block, border=border, deform=min(self.deform, border))
            try:
                filler = GapFiller(method, replace(task, rng=deepcopy(task.rng)), found.lattice)
                filler.place_blocks()
                filler.fill_gaps()
                break
            except Refused:
                if (block, border) == sizes[-1]:
                    raise
        image, source = filler.placer.canvas.output()
        task.progress(1.0)
        if (block, border) != sizes[0]:
            notes.append(f"block={block},border={border}: the sample allows no larger ones")
        note, blended = "; ".join(notes), filler.placer.canvas.blended()
        return Synthesis(image, found.lattice, source, detection_seconds=found.seconds, note=note, blended=blended)

    def _sizes(self) -> list[tuple[int, int]]:
        """Return the sizes of blocks and borders that are tried, the largest first."""
        blocks = [self.block] if self.block else _BLOCKS
        sizes = [
            (block, self.border or border) for block in blocks for border in (min(_BORDER, block // 2), block // 4)
        ]
        return [(block, border) for block, border in dict.fromkeys(sizes) if 1 <= border <= block // 2]

    def fill(self, task: Task) -> Synthesis:
        """Return the sample with its holes filled (:class:`~.gap_filling.holes.HoleFiller`).

        The size of patches follows the lattice. Where there is none, it is ``block``.

        Raises
        ------
        Refused
            If no pixel that counts is equal to one that does not.
        """
        found = find_lattice(task, NamedDetector(self.finder))
        if found.lattice is None:
            warn_of_no_lattice("rsgf", found.reason)
        return fill_task(task, found, self.block or _BLOCKS[0])

    def block_grid(self, task: Task) -> BlockGrid:
        """Return the blocks of the output. Those of a tileable one are as large as its sides require."""
        if not task.tileable:
            grid = BlockGrid(task.shape, self.block, self.border)
            grid.search_shape(task.sample.shape)
            return grid
        return BlockGrid.closing(task.shape, self.block, self.border, task.sample.shape)


class GapFiller:
    """One synthesis by :class:`Rsgf`: chooses the patch of each block and puts it on a canvas.

    Parameters
    ----------
    method
        The parameters.
    task
        The sample, the shape of the output, and the randomness.
    lattice
        Makes places equal. None: all places are equal.
    """

    def __init__(self, method: Rsgf, task: Task, lattice: Lattice | None) -> None:
        self.method, self.task, self.lattice = method, task, lattice
        self.grid = method.block_grid(task)
        self.placer = BlockPlacer(Patches(task.sample), self.grid, method.seam, method.deform)
        self.matcher = FrameMatcher(task.sample, self.grid.size, method.match)
        self.sampler = PlaceSampler(task.rng, self.grid.size, method.prefer_unused)

    @cached_property
    def tolerance(self) -> float:
        """How far a gap's patch may lie from an equal place, px along x and along y."""
        if self.lattice is None:
            return 0.0
        default = min(3.0, TOLERANCE * self.lattice.s)
        tolerance = default if self.method.tolerance is None else self.method.tolerance
        return min(tolerance, math.hypot(*self._reduced.t2))

    def place_blocks(self) -> None:
        """Section 4.1: fill every second block with a random patch from the places equal to it."""
        for block in self.grid.placed():
            self.placer.place_block(block, self._draw_place(block) + self.grid.border)
        self.placer.extend_placed()

    def fill_gaps(self) -> None:
        """Section 4.2: fill the gaps with the patches that agree best with the borders around."""
        gaps = list(self.grid.gaps())
        for done, gap in enumerate(gaps):
            place, equal = self._match_border(gap)
            if self.method.subpixel:
                place = self._refine_place(gap, place, equal)
            self.placer.fill_gap(gap, place)
            self.task.progress((done + 1) / len(gaps))

    def _draw_place(self, block: Block) -> Points:
        """Draw the (x, y) of a block with its borders; without a lattice from anywhere."""
        shape = self.grid.search_shape(self.task.sample.shape)
        if self.lattice is None:
            trials = _STOCHASTIC_TRIALS if self.method.prefer_unused else 1
            return self.sampler.draw(self.task.rng.integers(shape[::-1], size=(trials, 2)))
        border = self.grid.border
        equal = self._block_places.find_places(block.corner - border)
        candidates: NDArray[Any] = (
            _places_inside(round_places(equal), shape) if self.method.subpixel else nearest_pixels(equal, shape)
        )
        self._require_candidates(candidates, block, self.grid.size + 2 * border)
        return self.sampler.draw(candidates + border) - border

    def _match_border(self, gap: Block) -> tuple[Points, Points | None]:
        """Return the whole-pixel (x, y) of a patch that agrees well with the border of a gap.

        Also return the nearest place that the lattice makes equal to the gap's, if the search uses the lattice.
        """
        hole = gap.border.hole
        template = np.rint(self._pixels(gap) * 255).astype(np.float32)
        if self.lattice is None or self.method.search != "lattice":
            ratings = self.matcher.rate_everywhere(template, hole)
            return self.sampler.draw(np.argwhere(ratings == ratings.max())[:, ::-1]), None
        equal = self._keep_off_edge(self._gap_places.find_places(gap.corner))
        candidates = nearby_pixels(equal, self._gap_places.margin, self.matcher.search_shape)
        self._require_candidates(candidates, gap, self.grid.size)
        ratings = self.matcher.rate(template, hole, candidates)
        best = self.sampler.draw(self._best_candidates(candidates, ratings, equal))
        return best, np.asarray(equal[np.abs(equal - best).max(1).argmin()])

    def _pixels(self, gap: Block) -> Image:
        """Return what the output shows in a gap."""
        return np.asarray(self.placer.canvas.image[self.placer.canvas.pixels(gap.window())])

    def _best_candidates(self, candidates: Pixels, ratings: NDArray[np.float64], equal: Points) -> Pixels:
        fraction = 0.5 if self.method.candidate_fraction is None else self.method.candidate_fraction
        if not fraction:
            return np.asarray(candidates[ratings == ratings.max()])
        return best_places(candidates, ratings, self._reduced, equal[0], fraction)

    def _keep_off_edge(self, equal: Points) -> Points:
        """Return the places a border's width inside the sample, if seams are cut and two such places exist.

        There a gap's patch reaches beyond the gap on all sides, so that seams can run around elements.
        """
        border = self.grid.border
        low, high = border, np.array(self.matcher.search_shape[::-1]) - 1 - border
        inner = equal[((equal >= low) & (equal <= high)).all(1)]
        return inner if len(inner) > 1 and self.method.seam != "blend" else equal

    def _refine_place(self, gap: Block, best: Points, equal: Points | None) -> Points:
        """Return the real-valued place nearby at which the patch agrees best with the border, within the tolerance.

        The search starts from the equal place if that is less than a pixel away.
        """
        last = np.array(self.matcher.search_shape[::-1]) - 0.5
        weight = self.placer.border_mask(gap, gap.box).astype(np.float64)

        def cut(place: Points) -> Image:
            return self.placer.cut_patch(np.clip(place, -0.5, last), gap.box)[0]

        start = equal if equal is not None and np.abs(equal - best).max() < 1 else best
        place = align_patch(cut, start, self._pixels(gap), weight)
        if equal is not None:
            place = equal + np.clip(place - equal, -self.tolerance, self.tolerance)
        return np.asarray(np.clip(round_places(place), -0.5, last))

    @cached_property
    def _reduced(self) -> Lattice:
        assert self.lattice is not None
        return self.lattice.reduced()

    @cached_property
    def _block_places(self) -> EqualPlaces:
        assert self.lattice is not None
        return EqualPlaces(self.lattice, self.grid.search_shape(self.task.sample.shape))

    @cached_property
    def _gap_places(self) -> EqualPlaces:
        assert self.lattice is not None
        return EqualPlaces(self.lattice, self.matcher.search_shape, max(self.tolerance, 0.5))

    def _require_candidates(self, candidates: NDArray[Any], block: Block, side: int) -> None:
        if len(candidates):
            return
        height, width, _ = self.task.sample.shape
        x, y = (int(value) for value in block.corner)
        raise Refused(
            f"the {width}x{height} px sample has no complete patch of {side}x{side} px that the lattice makes equal to "
            f"the output's at ({x}, {y}): the tile is too large for the sample; choose a smaller block"
        )


def _places_inside(places: Points, shape: SearchShape) -> Points:
    """Return the places inside the search shape; if there are none, all places, moved to its edge."""
    last = np.array(shape[::-1]) - 1
    inside = ((places >= 0) & (places <= last)).all(1)
    return places[inside] if inside.any() else np.clip(places, 0, last)


class PlaceSampler:
    """Draws places in a sample for square patches.

    Parameters
    ----------
    rng
        The randomness.
    block
        Side of the patches in px.
    prefer_unused
        Prefer the places that the latest patches overlap least. The first draw is uniform in any case.
    """

    def __init__(self, rng: np.random.Generator, block: int, prefer_unused: bool) -> None:
        self.rng, self.block, self.prefer_unused = rng, block, prefer_unused
        self._latest: deque[Points] = deque(maxlen=REMEMBERED)

    def draw(self, candidates: NDArray[Any]) -> Points:
        """Return one of the candidates ``(n, 2)``, n at least 1, and remember it: O(n)."""
        if self.prefer_unused and self._latest:
            counts = self.overlap_counts(candidates)
            candidates = candidates[counts <= counts.min() + _OVERLAP_SLACK]
        place = np.asarray(candidates[self.rng.integers(len(candidates))], np.float64)
        self._latest.append(place)
        return place

    def overlap_counts(self, places: NDArray[Any]) -> NDArray[np.float64]:
        """Return for each place the overlap of its patch with the latest ones, in patch areas, summed."""
        distances = np.abs(places[:, np.newaxis] - np.array(self._latest).reshape(-1, 2))
        return np.asarray(np.maximum(1 - distances / self.block, 0).prod(-1).sum(-1))


def best_places(
    candidates: Pixels, ratings: NDArray[np.float64], lattice: Lattice, equal: Points, fraction: float
) -> Pixels:
    """Return the best candidate near each of the best equal places.

    Parameters
    ----------
    candidates, ratings
        ``(n, 2)`` and ``(n,)``: several places around each equal place, and how good each is; higher is better.
    lattice, equal
        The lattice, its basis reduced, and (x, y) of one of the equal places. Candidates belong to the same equal place
        if they round to the same lattice point.
    fraction
        Fraction of the equal places to keep, in [0, 1], at least one, and all that tie with the last one.
    """
    cells = np.rint(lattice.to_cell(candidates) - lattice.to_cell(equal)).astype(np.int64)
    cells -= cells.min(0)
    place = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)[1]
    top = np.full(place.max() + 1, -np.inf)
    np.maximum.at(top, place, ratings)
    last = np.sort(top)[::-1][max(int(np.ceil(fraction * len(top))) - 1, 0)]
    return np.asarray(candidates[(ratings == top[place]) & (ratings >= last)])
