"""Planted defects: fresh draws with one known fault, on which scores are tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.convert import MIN_SIDE
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.plugins.parameters import nearest

from .defects import faults_of_appearance as appearance
from .defects import faults_of_place as place
from .defects import faults_of_variety as variety
from .defects.planting import FIRST_DRAW, Fault, Planting, Plot


@dataclass(frozen=True)
class Planted:
    """A fresh draw of the texture with a known defect.

    Size 0 is the fresh draw untouched, whatever the kind. The truth is in the extras: ``displacement``
    (``float32 (H, W, 2)``: how far, (x, y) px, the content at each pixel has moved from its place in the draw, which is
    a vector of the lattice in whole pixels where content is repeated), and ``covered`` (``float32 (H, W)``, 1 where the
    defect lies). The note says what came about. Content moves by whole pixels, so that nothing but its place tells it
    from the rest; only ``warp`` and ``stretch`` read between pixels, by cubic splines, which smooths a little.

    Parameters
    ----------
    kind
        One of :data:`FAULTS`. With s the length of the shortest lattice vector, "1/2" meaning that larger sizes either
        count as 1/2 (said so below) or approach another lattice point, and are no worse:

        =============== ============================================================== ===========================
        kind            defect                                                         size; where it saturates
        =============== ============================================================== ===========================
        none            none                                                           has no meaning
        phase-step      everything beyond a line through the middle is moved           distance, in s; 1/2
        slipped-course  one course of lattice points along t1 slides along t1          distance, in s; the distance
                                                                                       counts as half of t1 at most
        dropped-row     a part of a course is gone, all beyond closes up               share of its height; counts
                                                                                       as 1/2 at most, since without
                                                                                       a whole course a lattice may
                                                                                       be whole again
        doubled-row     a part of a course is there twice, all beyond makes room       as dropped-row
        displaced-tile  the content of one cell is moved                               distance, in s; 1/2
        missing-tile    one cell is covered by its mean color                          opacity of the cover; none
        doubled-tile    a copy of one cell lies over it and its neighbors              the copy's distance, in s;
                                                                                       counts as 1/2 at most
        warp            content moves smoothly, over a correlation length (to 1/e)     largest distance, in s; 1/2
                        of 2 s
        stretch         the draw is stretched along a random axis about the middle     lengthening (0.02: 2 %); where
                                                                                       the ends have moved by half a
                                                                                       tile; needs no lattice
        off-lattice     patches two tiles wide, each moved in a direction of its own   distance, in s; 1/2
        blurred-band    a band across, a quarter of the output wide, is blurred        standard deviation of the
                                                                                       Gaussian, in 8 px; where it
                                                                                       spans a tile; needs no lattice
        seam            one side of a line is brighter, the other darker, by half of   step of values at the line;
                        the step each, fading linearly to nothing 16 px away           where values are clipped;
                                                                                       needs no lattice
        color-mean      one color is added everywhere, towards the middle of values    its Euclidean length, in values;
                                                                                       where values are clipped, some
                                                                                       0.5; needs no lattice
        two-tone        tiles cut in half across t1, one half joined to the other      share of tiles; none
                        half of another draw's tile
        over-regular    the draw mixed with the repetition of one of its tiles         weight of the repetition (1: all
                                                                                       tiles are identical); none
        verbatim        patches up to two tiles wide are exact copies of places that   share of the output's area that
                        the lattice calls equal to theirs                              is copied; counts as 1/2 at
                                                                                       most: the other half is what
                                                                                       they are copies of
        =============== ============================================================== ===========================
    size
        In [0, 1], in the kind's unit.
    """

    reference: ClassVar[bool] = True
    always_shown: ClassVar[tuple[str, ...]] = ("kind", "size")
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "3"

    kind: str = "phase-step"
    size: float = 0.25

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise BadInput(f"planted: kind {self.kind!r} is unknown{nearest(self.kind, FAULTS)}")
        if not 0 <= self.size <= 1:
            raise BadInput(f"planted: size {self.size} is outside [0, 1]; give it in the unit of {self.kind}")

    def synthesize(self, task: Task) -> Synthesis:
        """Return a fresh draw with the defect in it.

        Raises
        ------
        Refused
            Where the texture has no further draws, or no lattice and the kind needs one, or where a defect of a size
            above 0 comes to nothing: less than a pixel, or no room for it in the output.
        """
        plot = self._plot(task)
        planting = self._planted(plot)
        extras = {
            "displacement": planting.displacement.astype(np.float32),
            "covered": planting.where.astype(np.float32),
        }
        return Synthesis(planting.image, extras=extras, note=f"planted {self.kind}{_amount(plot, planting)}")

    def _plot(self, task: Task) -> Plot:
        """Return the plot; the smallest draw there is tells the lattice, which all draws share."""
        first = task.again((MIN_SIDE, MIN_SIDE), FIRST_DRAW) if task.again is not None else None
        if task.again is None or first is None:
            raise Refused("planted: this texture has no fresh draws")
        return Plot(task.shape, first.lattice, self.size, task.rng, task.again)

    def _planted(self, plot: Plot) -> Planting:
        planting = FAULTS[self.kind](plot)
        if self.size > 0 and self.kind != "none" and not planting.where.any():
            height, width = plot.shape
            what = f"planted: {self.kind} of size {self.size:g} covers no pixel of an output of {width}x{height} px"
            raise Refused(f"{what}: it is less than a pixel, or has no room; give a larger size or output")
        return planting


def _amount(plot: Plot, planting: Planting) -> str:
    """Return what came about: what the fault says of itself, else the largest displacement."""
    if planting.amount or plot.known is None:
        return f" of {planting.amount}" if planting.amount else ""
    distance = float(np.sqrt((planting.displacement**2).sum(-1)).max())
    return f" of {distance / plot.lattice.s:.3f} s ({distance:.1f} px)"


FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        "none": place.none,
        "phase-step": place.phase_step,
        "slipped-course": place.slipped_course,
        "dropped-row": place.dropped_row,
        "doubled-row": place.doubled_row,
        "displaced-tile": place.displaced_tile,
        "missing-tile": appearance.missing_tile,
        "doubled-tile": place.doubled_tile,
        "warp": place.warp,
        "stretch": place.stretch,
        "off-lattice": place.off_lattice,
        "blurred-band": appearance.blurred_band,
        "seam": appearance.seam,
        "color-mean": appearance.color_mean,
        "two-tone": variety.two_tone,
        "over-regular": variety.over_regular,
        "verbatim": variety.verbatim,
    }
)
"""The defects by name; a new one is one more entry."""
