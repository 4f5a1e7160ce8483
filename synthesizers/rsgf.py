"""Random sampling and gap filling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.blocks import BlockGrid, Wedges, compose, wedges
from nrbench.imaging.matching import FrameMatcher, Match
from nrbench.imaging.sampling import Positions, Room, around, equivalent_positions, nearest_pixels
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.gncc import Gncc
from nrbench.synthesis import Refused, Synthesis, Task, find_lattice

from .room import check_border, room_with_border


@dataclass(frozen=True)
class Rsgf:
    """Random sampling and gap filling (RSGF, section 4): random patches on the lattice, and patches that join them.

    The output is divided into blocks. Every second one, as on a chess-board, takes a patch drawn uniformly from the
    places of the sample that the lattice calls equal to its own and that show it whole, borders included (section 4.1).
    Each gap left takes the patch that agrees best with the border that its neighbours' patches, continued into the gap,
    compose of their wedges (section 4.2, figure 4). The paper leaves open whether that border lies inside the gap or
    around it; here it lies inside, so that it is also what is blended, linearly, and the sample needs no more room.
    Lattice places are computed from the real-valued vectors and rounded to whole pixels once, so that nothing drifts.

    With no lattice given the method finds one by ``gncc``; where there is none it goes on in the paper's mode for
    irregular textures, in which every position is a candidate, and says so in the note.

    Parameters
    ----------
    block
        Side of a block in px (the paper: 40).
    border
        Width of the border in px (the paper: 10), at most half a block.
    match
        How the border of a gap is compared: ``"color"``, by squared color differences (eq. 10), or ``"ncc"``, by the
        generalized normalized cross-correlation (eq. 4, channels combined by eq. 6). Equally good patches are drawn
        from at random.
    search
        Where a gap's patch may come from: ``"lattice"``, near the places that the lattice calls equal, or
        ``"everywhere"``.
    tolerance
        How near, in px along x and along y, at least half a pixel; without meaning where every place is searched. None
        takes 3 px (the paper's), but not more than a tenth of the shortest lattice
        vector.
    """

    block: int = 40
    border: int = 10
    match: Match = "color"
    search: Literal["lattice", "everywhere"] = "lattice"
    tolerance: float | None = None

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    version: ClassVar[str] = "1"
    paper: ClassVar[str] = Gncc.paper

    def __post_init__(self) -> None:
        check_border(self.block, self.border)
        if self.tolerance is not None and not self.tolerance >= 0:
            raise BadInput(f"tolerance {self.tolerance}; choose 0 px or more, or leave it out")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`Rsgf`.

        Raises
        ------
        Refused
            When the sample does not hold a block with its borders, or no such patch equal to one of the output's.
        """
        room = room_with_border(task.sample.shape, self.block, self.border)
        found = find_lattice(task, Gncc())
        filling = _Filling(self, task, found.lattice)
        filling.sample_placed(room)
        filling.fill_gaps()
        image, source = compose(task.sample, filling.grid, filling.places)
        task.progress(1.0)
        note = (
            "" if found.lattice else f"stochastic mode, every position a candidate: no lattice found ({found.reason})"
        )
        return Synthesis(image, found.lattice, source, detection_seconds=found.seconds, note=note)


class _Filling:
    """The places found so far: ``(rows, columns, 2)``, the (x, y) in the sample of every block's first pixel."""

    def __init__(self, method: Rsgf, task: Task, lattice: Lattice | None) -> None:
        self.method, self.task, self.lattice = method, task, lattice
        self.grid = BlockGrid(task.shape, method.block, method.border)
        self.places = np.zeros((*self.grid.counts, 2), np.int64)
        self.matcher = FrameMatcher(task.sample, method.block, method.match)

    def sample_placed(self, room: Room) -> None:
        """Section 4.1: fill every second block with a patch drawn from those equal to it."""
        for row, column in self.grid.placed():
            self.places[row, column] = self._drawn(row, column, room) + self.method.border

    def fill_gaps(self) -> None:
        """Section 4.2: fill the rest with the patches that agree best with the borders around."""
        gaps = list(self.grid.gaps())
        for done, (row, column) in enumerate(gaps):
            self.places[row, column] = self._best(row, column)
            self.task.progress((done + 1) / len(gaps))

    def _drawn(self, row: int, column: int, room: Room) -> Positions:
        """Draw the (x, y) of a block with its borders; without a lattice v1 = (1, 0), v2 = (0, 1): from anywhere."""
        if self.lattice is None:
            return self.task.rng.integers(room[::-1])
        border, block = self.method.border, self.method.block
        corner = (column * block - border, row * block - border)
        candidates = nearest_pixels(equivalent_positions(self.lattice, corner, room), room)
        self._require(candidates, row, column, block + 2 * border)
        return self._any_of(candidates)

    def _best(self, row: int, column: int) -> Positions:
        """Return the (x, y) of the patch that agrees best with the border around a gap."""
        border = wedges(self.method.block, self.method.border, self.grid.sides(row, column))
        template = self._full_border(border, row, column)
        if self.lattice is None or self.method.search == "everywhere":
            ratings = self.matcher.everywhere(template, border.hole)
            return self._any_of(np.argwhere(ratings == ratings.max())[:, ::-1])
        candidates = self._near_equal(self.lattice, row, column)
        ratings = self.matcher.at(template, border.hole, candidates)
        return self._any_of(candidates[ratings == ratings.max()])

    def _full_border(self, border: Wedges, row: int, column: int) -> NDArray[np.float32]:
        """Compose the neighbours' wedges, around a hole of zeros."""
        x, y = (self.grid.origins(self.places, row, column)[border.owner] + border.pixels).T
        template = np.zeros((self.method.block, self.method.block, self.task.sample.shape[2]), np.float32)
        template[border.pixels[:, 1], border.pixels[:, 0]] = self.matcher.values[y, x]
        return template

    def _near_equal(self, lattice: Lattice, row: int, column: int) -> Positions:
        """Return the places near those that the lattice calls equal to a gap's."""
        tolerance = min(3.0, 0.1 * lattice.s) if self.method.tolerance is None else self.method.tolerance
        room, corner = self.matcher.room, (column * self.method.block, row * self.method.block)
        reach = min(max(tolerance, 0.5), math.hypot(*lattice.reduced().t2))
        candidates = around(equivalent_positions(lattice, corner, room, reach), reach, room)
        self._require(candidates, row, column, self.method.block)
        return candidates

    def _any_of(self, candidates: Positions) -> Positions:
        return np.asarray(candidates[self.task.rng.integers(len(candidates))])

    def _require(self, candidates: Positions, row: int, column: int, side: int) -> None:
        if len(candidates):
            return
        height, width, _ = self.task.sample.shape
        raise Refused(
            f"no whole patch of {side}x{side} px in the {width}x{height} px sample is equal, by the lattice, to the "
            f"output's at ({column * self.method.block}, {row * self.method.block}): the tile is too large for the "
            "sample; choose a smaller block"
        )
