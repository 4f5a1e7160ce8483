"""Fresh draws with one known defect, on which scores are tested."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.convert import MIN_SIDE
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.plugins.parameters import nearest

from .defects.plant import DEFECTS, FIRST_DRAW, PlantedImage, Site


@dataclass(frozen=True)
class Planted:
    """A fresh draw of the texture with one known defect: validates scores.

    Size 0 is the unchanged fresh draw, for every kind. The extras hold the truth: ``displacement`` (``float32 (H, W,
    2)``: how far, (x, y) px, the content at each pixel has moved from its place in the draw; where content is repeated,
    a lattice vector in whole pixels), and ``covered`` (``float32 (H, W)``, 1 at the pixels of the defect). The note
    gives the actual size. Content moves by whole pixels, so that only its place differs from the rest; ``warp`` and
    ``stretch`` interpolate by cubic splines, which smooths a little.

    Parameters
    ----------
    kind
        One of :data:`DEFECTS`. s is the length of the shortest lattice vector. Where a kind saturates at 1/2, larger
        sizes either count as 1/2 (where the table says so) or approach another lattice point, and are no worse:

        =============== ============================================================== ===========================
        kind            defect                                                         size; where it saturates
        =============== ============================================================== ===========================
        none            none                                                           has no meaning
        phase-step      everything beyond a line through the middle is moved           distance, in s; 1/2
        slipped-course  one course of lattice points along t1 slides along t1          distance, in s; counts as
                                                                                       half of t1 at most
        dropped-row     a part of a course is missing, and the gap is closed           share of its height; counts
                                                                                       as 1/2 at most, since a
                                                                                       lattice can be whole again
                                                                                       without a whole course
        doubled-row     a part of a course is there twice, and everything beyond is    as dropped-row
                        moved
        displaced-tile  the content of one cell is moved                               distance, in s; 1/2
        missing-tile    one cell is covered by its mean color                          opacity of the cover; none
        doubled-tile    a copy of one cell covers it and its neighbors                 the copy's distance, in s;
                                                                                       counts as 1/2 at most
        warp            content moves smoothly, over a correlation length (to 1/e) of  largest distance, in s; 1/2
                        2 s
        stretch         the draw is stretched along a random axis about the middle     lengthening (0.02: 2 %);
                                                                                       where the ends have moved
                                                                                       by half a tile; needs no
                                                                                       lattice
        off-lattice     patches two tiles wide, each moved in a random direction       distance, in s; 1/2
        blurred-band    a band across, a quarter of the output wide, is blurred        standard deviation of the
                                                                                       Gaussian, in 8 px; where it
                                                                                       spans a tile; needs no
                                                                                       lattice
        blur            the whole draw is blurred                                      standard deviation of the
                                                                                       Gaussian, in px; needs no
                                                                                       lattice
        contrast        all values are moved toward their mean                         share of the contrast that is
                                                                                       lost; needs no lattice
        noise           white noise replaces the texture inside elements (less than    share of its variance; needs
                        about 4 px wide), with equal variance                          a geometry that is constant
        seam            one side of a line is brighter and the other darker, by half   step of values at the line;
                        of the step each, fading linearly to nothing 16 px away        where values are clipped;
                                                                                       needs no lattice
        color-mean      one color is added to all pixels, towards the middle of values its Euclidean length, in
                                                                                       values; where values are
                                                                                       clipped, about 0.5; needs
                                                                                       no lattice
        two-tone        tiles cut in half across t1, one half replaced by that of      share of tiles; none
                        another draw
        over-regular    the draw mixed with the repetition of one of its tiles         weight of the repetition
                                                                                       (1: all tiles are
                                                                                       identical); none
        verbatim        patches up to two tiles wide are exact copies of equivalent    share of the output's area
                        places                                                         that is copied; counts as
                                                                                       1/2 at most: the other half
                                                                                       is what they are copies of
        =============== ============================================================== ===========================
    size
        Size in [0, 1], in the unit of the kind.
    """

    reference: ClassVar[bool] = True
    always_shown: ClassVar[tuple[str, ...]] = ("kind", "size")
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "3"

    kind: str = "phase-step"
    size: float = 0.25

    def __post_init__(self) -> None:
        if self.kind not in DEFECTS:
            raise BadInput(f"planted: kind {self.kind!r} is unknown{nearest(self.kind, DEFECTS)}")
        if not 0 <= self.size <= 1:
            raise BadInput(f"planted: size {self.size} is outside [0, 1]; give it in the unit of {self.kind}")

    def synthesize(self, task: Task) -> Synthesis:
        """Return a fresh draw with the defect in it.

        Raises
        ------
        Refused
            When the texture has no fresh draws, when the kind needs a lattice and there is none, or when a defect of a
            size above 0 covers no pixel: it is less than a pixel, or has no room in the output.
        """
        # All draws share one lattice: the smallest draw gives it.
        first = task.again((MIN_SIDE, MIN_SIDE), FIRST_DRAW) if task.again is not None else None
        if task.again is None or first is None:
            raise Refused("planted: this texture has no fresh draws")
        site = Site(task.shape, first.lattice, self.size, task.rng, task.again)
        planted = DEFECTS[self.kind](site)
        if self.size > 0 and self.kind != "none" and not planted.mask.any():
            height, width = task.shape
            what = f"planted: {self.kind} of size {self.size:g} covers no pixel of an output of {width}x{height} px"
            raise Refused(f"{what}: it is less than a pixel, or has no room; give a larger size or output")
        extras = {
            "displacement": planted.displacement.astype(np.float32),
            "covered": planted.mask.astype(np.float32),
        }
        return Synthesis(planted.image, extras=extras, note=f"planted {self.kind}{_amount(site, planted)}")


def _amount(site: Site, planted: PlantedImage) -> str:
    """Return the actual size of the defect, for the note: its own words, or the largest displacement."""
    if planted.amount or site.known is None:
        return f" of {planted.amount}" if planted.amount else ""
    distance = float(np.sqrt((planted.displacement**2).sum(-1)).max())
    return f" of {distance / site.lattice.s:.3f} s ({distance:.1f} px)"
