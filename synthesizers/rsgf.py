"""Random sampling and gap filling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.blocks import BlockGrid, compose, wedges
from nrbench.imaging.jit import load_kernels
from nrbench.imaging.matching import FrameMatcher, Match
from nrbench.imaging.sampling import Positions, Room, around, equivalent_positions, nearest_pixels
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.gncc import Gncc
from nrbench.synthesis import Refused, Synthesis, Task, find_lattice

from .room import check_border, room_with_border

STOCHASTIC = Lattice((1.0, 0.0), (0.0, 1.0))
"""The lattice that makes every position a candidate (section 5, irregular textures)."""


@dataclass(frozen=True)
class Rsgf:
    """Random sampling and gap filling (RSGF, section 4): random patches on the lattice, and patches that join them.

    The output is divided into blocks. Every second one, as on a chess-board, takes a patch drawn uniformly from the
    places of the sample that the lattice calls equal to its own and that show it whole, borders included (section 4.1).
    Each gap left takes the patch that agrees best with the border that its neighbours' patches, continued into the gap,
    compose of their wedges (section 4.2, figure 4). Over that border the patches are blended linearly. Lattice places
    are computed from the real-valued vectors and rounded to whole pixels once, so that nothing drifts.

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
        How near, in px along x and y; None takes 3 px (the paper's), but not more than a tenth of the shortest lattice
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
    paper: ClassVar[str] = """@inproceedings{recas2011rsgf,
  author    = {Lopez Recas, Diego and Hilsmann, Anna and Eisert, Peter},
  title     = {Near-Regular Texture Synthesis by Random Sampling and Gap Filling},
  booktitle = {Vision, Modeling, and Visualization (VMV 2011)},
  editor    = {Eisert, Peter and Polthier, Konrad and Hornegger, Joachim},
  publisher = {The Eurographics Association},
  year      = {2011},
}"""

    def __post_init__(self) -> None:
        check_border(self.block, self.border)
        if self.tolerance is not None and not self.tolerance >= 0:
            raise BadInput(f"tolerance {self.tolerance}; choose 0 px or more, or leave it out")

    @staticmethod
    def warm() -> None:
        """Load the compiled kernels."""
        load_kernels()

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
        note = (
            "" if found.lattice else f"no lattice found ({found.reason}); stochastic mode: every position a candidate"
        )
        return Synthesis(image, found.lattice, source, detection_seconds=found.seconds, note=note)


class _Filling:
    """The places found so far: ``(rows, columns, 2)``, the (x, y) in the sample of every block's first pixel."""

    def __init__(self, method: Rsgf, task: Task, lattice: Lattice | None) -> None:
        self.method, self.task = method, task
        self.lattice = lattice or STOCHASTIC
        self.free = lattice is None or method.search == "everywhere"
        self.tolerance = min(3.0, 0.1 * self.lattice.s) if method.tolerance is None else method.tolerance
        self.grid = BlockGrid(task.shape, method.block, method.border)
        self.places = np.zeros((*self.grid.counts, 2), np.int64)
        self.matcher = FrameMatcher(task.sample, method.block, method.match)

    def sample_placed(self, room: Room) -> None:
        """Section 4.1: fill every second block with a patch drawn from those equal to it."""
        border = self.method.border
        for row, column in self.grid.placed():
            candidates = nearest_pixels(self._equivalent(row, column, -border, room, 0.0), room)
            self._require(len(candidates), row, column, self.method.block + 2 * border)
            self.places[row, column] = candidates[self.task.rng.integers(len(candidates))] + border

    def fill_gaps(self) -> None:
        """Section 4.2: fill the rest with the patches that agree best with the borders around."""
        gaps = list(self.grid.gaps())
        for done, (row, column) in enumerate(gaps):
            self.places[row, column] = self._best_patch(row, column)
            self.task.progress((done + 1) / len(gaps))

    def _best_patch(self, row: int, column: int) -> Positions:
        """Return the (x, y) of the best patch for a gap."""
        border = wedges(self.method.block, self.method.border, self.grid.sides(row, column))
        origins = self.grid.origins(self.places, row, column)[border.owner]
        template = np.zeros((self.method.block, self.method.block, self.task.sample.shape[2]), np.float32)
        x, y = origins[:, 0] + border.columns, origins[:, 1] + border.rows
        template[border.rows, border.columns] = self.matcher.values[y, x]
        if self.free:
            ratings = self.matcher.everywhere(template, border.hole)
            ties = np.argwhere(ratings == ratings.max())[:, ::-1]
        else:
            positions = self._near_equivalent(row, column)
            ratings = self.matcher.at(template, border.hole, positions)
            ties = positions[ratings == ratings.max()]
        return np.asarray(ties[self.task.rng.integers(len(ties))])

    def _near_equivalent(self, row: int, column: int) -> Positions:
        room = self.matcher.room
        margin = max(self.tolerance, 0.5)
        positions = around(self._equivalent(row, column, 0, room, margin), self.tolerance, room)
        self._require(len(positions), row, column, self.method.block)
        return positions

    def _equivalent(self, row: int, column: int, shift: int, room: Room, margin: float) -> NDArray[np.float64]:
        x, y = column * self.method.block + shift, row * self.method.block + shift
        return equivalent_positions(self.lattice, (float(x), float(y)), room, margin)

    def _require(self, candidates: int, row: int, column: int, side: int) -> None:
        if candidates:
            return
        height, width, _ = self.task.sample.shape
        raise Refused(
            f"no whole patch of {side}x{side} px in the {width}x{height} px sample is equal, by the lattice, to the "
            f"output's at ({column * self.method.block}, {row * self.method.block}): the tile is too large for the "
            "sample; choose a smaller block"
        )
