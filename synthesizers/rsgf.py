"""Random sampling and gap filling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from nrbench.detectors.consensus import Consensus
from nrbench.detectors.gncc import Gncc
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Detector, FoundLattice, Synthesis, Task, find_lattice

from .gap_filling.blocks import BlockGrid
from .gap_filling.canvas import Canvas, Seam
from .gap_filling.gap_filling import Filling, Rules, Search
from .gap_filling.matching import Match
from .gap_filling.size_checks import check_border, room_with_border
from .sampling.patches import Patches

Finder = Literal["consensus", "gncc"]
NEAR = 0.07
"""Share of s, along x and along y, that a gap's patch may be off its place: together less than a tenth."""
FARTHEST_DEFORM = 3.0
"""px; a patch deformed more would show other elements than those that were matched."""
_BETTER_HALF = 0.5


@dataclass(frozen=True)
class Rsgf:
    """Random sampling and gap filling (RSGF, section 4): random patches on the lattice, and patches that join them.

    The output is divided into blocks. Every second one, as on a chess-board, takes a patch drawn from the places of the
    sample that the lattice calls equal to its own and that show it whole, borders included (section 4.1; uniformly, but
    for what ``spread`` prefers). Each gap left takes the patch that agrees best with the border that its neighbours'
    patches, continued into the gap, compose of their wedges (section 4.2, figure 4). The paper leaves open whether that
    border lies inside the gap or around it; here it lies inside, so that it is also what is blended, and the sample
    needs no more room. Places on the lattice are computed from its real-valued vectors, so that nothing drifts.

    The paper's own choice is ``rsgf:seam=blend,subpixel=false,tolerance=3,among=0,spread=false,finder=gncc``: places
    rounded to whole pixels, linear blending, a gap's patch the best from 3 px around. What it leaves to future work
    (section 6) is the default where it proved better: places to fractions of a pixel, and seams by graph cut, which run
    along the outlines of what the texture is made of (bricks in one color, not two).

    One thing the paper does not speak of: the best match is too often a patch near the mean of all, or one that lies
    there already, so that the output varies less than the sample. Here a gap's patch is one of the better half, and of
    these one that the output shows least of; where seams are cut it keeps a border's width from the sample's edge, so
    that they have room.

    With no lattice given, be it that a detector of the lattice axis found none, the method finds one itself; where
    there is none it goes on in the paper's mode for irregular textures, in which every position is a candidate, and
    says so in the note.

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
        Where patches come from: ``"lattice"``, a gap's from near the places that the lattice calls equal;
        ``"everywhere"``, a gap's from anywhere; ``"stochastic"``, all from anywhere, as if v1 = (1, 0), v2 = (0, 1)
        (section 5): no lattice is looked for or used.
    tolerance
        How near the lattice's places a gap's patch lies, px along x and along y; only where the search is by the
        lattice. None takes 3 px (the paper's), but not more than 0.07 of the shortest lattice vector.
    subpixel
        Patches at real-valued places, interpolated by splines of order 5; a gap's is moved to where it meets its border
        best, within the tolerance. False: at whole pixels, half a pixel off at most.
    seam
        How a gap's patch is joined: ``"graphcut"``, along the least visible seam of all, which may run half a block
        inside its neighbours, too; ``"dynamic"``, in the same room along the least seam of each side by itself;
        ``"blend"``, by linear blending over the border.
    deform
        How far, px, a gap's patch may be deformed so that lines meet: by a smooth field, fitted to what it overlaps,
        that fades to nothing inside. 0 (none) to 3.
    among
        Share of the equal places, best first, from which a gap's patch is drawn; only where the search is by the
        lattice. 0: the best alone (the paper's); 1: all, and only where near them is left to the match. None takes
        one half.
    spread
        Whether patches are drawn from those places that patches laid of late overlap least. False: all are equally
        likely (the paper's).
    finder
        By what the method finds a lattice itself: ``"consensus"``, or the paper's own ``"gncc"``, which takes half or
        twice the period of some walls and carpets.
    """

    block: int = 40
    border: int = 10
    match: Match = "color"
    search: Search = "lattice"
    tolerance: float | None = None
    subpixel: bool = True
    seam: Seam = "graphcut"
    deform: float = 0.0
    among: float | None = None
    spread: bool = True
    finder: Finder = "consensus"

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "4"
    paper: ClassVar[str] = Gncc.paper

    def __post_init__(self) -> None:
        check_border(self.block, self.border)
        if self.tolerance is not None and not self.tolerance >= 0:
            raise BadInput(f"tolerance {self.tolerance}; choose 0 px or more, or leave it out")
        if self.among is not None and not 0 <= self.among <= 1:
            raise BadInput(f"among {self.among}; choose from 0 to 1, or leave it out")
        for name, value in (("tolerance", self.tolerance), ("among", self.among)):
            if value is not None and self.search != "lattice":
                raise BadInput(
                    f"{name} {value} with search {self.search!r}, which looks at every place; "
                    f"choose search 'lattice', or leave {name} out"
                )
        if not 0 <= self.deform <= FARTHEST_DEFORM:
            raise BadInput(f"deform {self.deform}; choose from 0 to {FARTHEST_DEFORM:g} px")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`Rsgf`.

        Raises
        ------
        Refused
            When the sample does not hold a block with its borders, or no such patch equal to one of the output's.
        """
        room = room_with_border(task.sample.shape, self.block, self.border)
        found = FoundLattice(None) if self.search == "stochastic" else find_lattice(task, self._finder())
        canvas = Canvas(Patches(task.sample), BlockGrid(task.shape, self.block, self.border), self.seam)
        filling = Filling(task, found.lattice, canvas, self._rules(found.lattice))
        filling.sample_placed(room)
        filling.fill_gaps()
        image, source = canvas.finished()
        task.progress(1.0)
        return Synthesis(image, found.lattice, source, detection_seconds=found.seconds, note=self._note(found))

    def _finder(self) -> Detector:
        return Consensus() if self.finder == "consensus" else Gncc()

    def _rules(self, lattice: Lattice | None) -> Rules:
        reach = 0.0
        if lattice is not None:
            tolerance = min(3.0, NEAR * lattice.s) if self.tolerance is None else self.tolerance
            reach = min(tolerance, math.hypot(*lattice.reduced().t2))
        among = _BETTER_HALF if self.among is None else self.among
        return Rules(self.match, self.search, reach, self.subpixel, self.deform, among, self.spread)

    def _note(self, found: FoundLattice) -> str:
        if found.lattice or self.search == "stochastic":
            return ""
        return f"stochastic mode, every position a candidate: no lattice found ({found.reason})"
