"""Random sampling and gap filling, block by block: which patch goes where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Task

from ..sampling.equal_places import EqualPlaces, Positions, Room, around, nearest_pixels
from ..sampling.patches import snapped
from ..seams.minimum_cut import Mask
from .alignment import field_to_meet, moved_to_meet
from .blocks import wedges
from .canvas import Canvas, Map
from .matching import FrameMatcher, Match
from .patch_sampling import Drawing, best_places

Search = Literal["lattice", "everywhere", "stochastic"]
_TRIED = 16
"""Places drawn in stochastic mode, where there are too many to look at all, of which that shown least is taken."""


class Rules(NamedTuple):
    """How patches are chosen: RSGF's parameters, see :class:`~nrbench.synthesizers.rsgf.Rsgf`."""

    match: Match
    search: Search
    reach: float
    subpixel: bool
    deform: float
    among: float = 0.0
    spread: bool = False


@dataclass(frozen=True, eq=False)
class Filling:
    """An output in the making.

    Parameters
    ----------
    task
        What is asked.
    lattice
        Which places are equal; None: all are.
    canvas
        Where the blocks are laid.
    rules
        How patches are chosen.
    """

    task: Task
    lattice: Lattice | None
    canvas: Canvas
    rules: Rules

    @cached_property
    def matcher(self) -> FrameMatcher:
        """Rates places for gaps."""
        return FrameMatcher(self.task.sample, self.canvas.grid.block, self.rules.match)

    def sample_placed(self, room: Room) -> None:
        """Section 4.1: fill every second block with a patch drawn from those equal to it.

        ``room`` is that of a block with its borders.
        """
        for row, column in self.canvas.grid.placed():
            self.canvas.lay(row, column, self._drawn(row, column, room) + self.canvas.grid.border)
        self.canvas.continue_placed()

    def fill_gaps(self) -> None:
        """Section 4.2: fill the rest with the patches that agree best with the borders around."""
        gaps = list(self.canvas.grid.gaps())
        for done, (row, column) in enumerate(gaps):
            place, equal = self._best(row, column)
            if self.rules.subpixel:
                place = self._met(row, column, place, equal)
            self.canvas.fill(row, column, place, self._field(row, column, place))
            self.task.progress((done + 1) / len(gaps))

    def _drawn(self, row: int, column: int, room: Room) -> Points:
        """Draw the (x, y) of a block with its borders; without a lattice v1 = (1, 0), v2 = (0, 1): from anywhere."""
        if self.lattice is None:
            tried = self.task.rng.integers(room[::-1], size=(_TRIED if self.rules.spread else 1, 2))
            return self._one_of(tried)
        border = self.canvas.grid.border
        equal = self._equal(room, 0.0).of(self._corner(row, column) - border)
        candidates: NDArray[Any] = _within(snapped(equal), room) if self.rules.subpixel else nearest_pixels(equal, room)
        self._require(candidates, row, column, self.canvas.grid.block + 2 * border)
        return self._one_of(candidates + border) - border

    def _best(self, row: int, column: int) -> tuple[Points, Points | None]:
        """Return the whole-pixel (x, y) of the patch that agrees best with the border around a gap.

        And the place next to it that the lattice calls equal to the gap's, where the search is by the lattice.
        """
        grid = self.canvas.grid
        hole = wedges(grid.block, grid.border, grid.sides(row, column)).hole
        template = np.rint(self.canvas.image[self.canvas.window(row, column)] * 255).astype(np.float32)
        if self.lattice is None or self.rules.search != "lattice":
            everywhere = self.matcher.everywhere(template, hole)
            return self._one_of(np.argwhere(everywhere == everywhere.max())[:, ::-1]), None
        reach, room = max(self.rules.reach, 0.5), self.matcher.room
        equal = self._roomy(self._equal(room, reach).of(self._corner(row, column)))
        candidates = around(equal, reach, room)
        self._require(candidates, row, column, grid.block)
        ratings = self.matcher.at(template, hole, candidates)
        best = self._one_of(self._good(candidates, ratings, equal))
        return best, np.asarray(equal[np.abs(equal - best).max(1).argmin()])

    def _good(self, candidates: Positions, ratings: NDArray[np.float64], equal: Points) -> Positions:
        """Return the candidates that rate best, or a share of the equal places: the best near each of them."""
        if not self.rules.among:
            return np.asarray(candidates[ratings == ratings.max()])
        return best_places(candidates, ratings, self._reduced, equal[0], self.rules.among)

    def _roomy(self, equal: Points) -> Points:
        """Return the places a border's width or more inside the sample, where seams are cut and two are left.

        There a gap's patch reaches beyond the gap on all sides, so that seams have room.
        """
        border = self.canvas.grid.border
        low, high = border, np.array(self.matcher.room[::-1]) - 1 - border
        roomy = equal[((equal >= low) & (equal <= high)).all(1)]
        return roomy if len(roomy) > 1 and self.canvas.seam != "blend" else equal

    def _met(self, row: int, column: int, best: Points, equal: Points | None) -> Points:
        """Return the real-valued place nearby at which the patch meets the border, within what the search allows.

        It starts from the place that the lattice calls equal, where that is less than a pixel away.
        """
        block, beyond = self.canvas.grid.block, np.array(self.matcher.room[::-1]) - 0.5
        box, reach = (0, block, 0, block), self.rules.reach
        near = equal is not None and np.abs(equal - best).max() < 1
        weight = self.canvas.overlap(row, column, box).astype(np.float64)
        old = self.canvas.image[self.canvas.window(row, column)]

        def shown(place: Points) -> Image:
            return self.canvas.patch(np.clip(place, -0.5, beyond), box)[0]

        place = moved_to_meet(shown, equal if equal is not None and near else best, old, weight, steps=1)
        if equal is not None:
            place = equal + np.clip(place - equal, -reach, reach)
        return np.asarray(np.clip(snapped(place), -0.5, beyond))

    def _field(self, row: int, column: int, place: Points) -> Map | None:
        """Return how a gap's patch is deformed, if at all."""
        if not self.rules.deform:
            return None
        canvas = self.canvas
        box = canvas.extent(row, column, place)
        overlap = canvas.overlap(row, column, box)
        return field_to_meet(
            lambda field: canvas.patch(place, box, field)[0],
            canvas.image[canvas.window(row, column, box)],
            overlap.astype(np.float64),
            _fade(overlap, canvas.grid.border),
            self.rules.deform,
        )

    @cached_property
    def _drawing(self) -> Drawing:
        return Drawing(self.task.rng, self.canvas.grid.block, self.rules.spread)

    def _one_of(self, candidates: NDArray[Any]) -> Points:
        return self._drawing.one_of(candidates)

    @cached_property
    def _reduced(self) -> Lattice:
        assert self.lattice is not None
        return self.lattice.reduced()

    def _equal(self, room: Room, margin: float) -> EqualPlaces:
        assert self.lattice is not None
        if (room, margin) not in self._known:
            self._known[room, margin] = EqualPlaces(self.lattice, room, margin)
        return self._known[room, margin]

    @cached_property
    def _known(self) -> dict[tuple[Room, float], EqualPlaces]:
        return {}

    def _corner(self, row: int, column: int) -> Points:
        return np.array([column, row], np.float64) * self.canvas.grid.block

    def _require(self, candidates: NDArray[Any], row: int, column: int, side: int) -> None:
        if len(candidates):
            return
        height, width, _ = self.task.sample.shape
        x, y = (int(value) for value in self._corner(row, column))
        raise Refused(
            f"no whole patch of {side}x{side} px in the {width}x{height} px sample is equal, by the lattice, to the "
            f"output's at ({x}, {y}): the tile is too large for the sample; choose a smaller block"
        )


def _within(places: Points, room: Room) -> Points:
    """Return the places inside the room; those that round into it, moved inside, where there is no other."""
    last = np.array(room[::-1]) - 1
    inside = ((places >= 0) & (places <= last)).all(1)
    return places[inside] if inside.any() else np.clip(places, 0, last)


def _fade(overlap: Mask, border: int) -> Map:
    """Return the share of a displacement that a pixel takes: 0 in the hole, all at a border's width from it."""
    return np.asarray(np.minimum(ndimage.distance_transform_edt(overlap) / border, 1.0))
