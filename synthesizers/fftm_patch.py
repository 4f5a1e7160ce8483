"""Fractional Fourier texture masks, patch by patch."""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nrbench.detectors.frdft import Frdft
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task
from nrbench.spectra.harmonics import Channels, Harmonic, Signal

from .masks.texture_mask import MaskParameters, TextureMask, tileable_mask
from .patchwork.patchwork import PatchPlacer, Patchwork, SeamHeat, scan_lines
from .patchwork.translations import Features

Judged = Literal["color", "mask"]
LEAST_PATCH = 24
"""px a side of an automatic patch, where the sample is large enough: smaller tiles are taken several at a time."""
NO_TILE = 40
"""px a side of an automatic patch where no upright rectangle is a tile (the paper's example of a size, section 5)."""
LARGEST_WEIGHT = 10.0
HALF_PIXEL = 0.5
"""px: how far from a period of the mask whole-pixel sides may be."""


@dataclass(frozen=True)
class FftmPatch:
    """Patches that follow the sample's regular part, cut into the output along the least visible seams (section 4.2).

    The regular part, a sum of waves that is known everywhere, is drawn at the size of the output: the mask. Each pixel
    is compared by its color and, scaled by the weight, its mask value. Windows of the output are covered line by line,
    each by a part of the sample: of all translations that cover it, one that matches the colors that are there already
    and, everywhere, the mask (sub-patch matching, Kwatra et al. 2003, section 4); where nothing is synthesized yet only
    the mask counts. A minimum cut finds which of the window's pixels it gives. Afterwards the windows whose seams cost
    most are covered anew, again and again; no such step makes all seams together cost more.

    The paper prints the sum as d_MM + c d_TT, with the weight on the texture, against its own section 4.1; here c
    scales the mask (and so, squared, its part of the sum), which has no effect at 0. Two things keep elements whole
    that the paper's patches cut: seams run where the texture is busy, and a patch may reach beyond the window that it
    matches. ``reach=0, normalized=false`` is the paper's. Where Kwatra et al. force some pixel of each new patch into
    the output, here a patch that makes nothing better is left out. More reach and more refinements join patches into
    larger ones: fewer tiles are broken, and more are repeated.

    With a lattice given, tied waves start from it.

    Parameters
    ----------
    weight
        c, the mask's weight beside the colors (the paper: about 1; no effect under 0.1, too large over 5); 0 to 10.
    patch
        Side of a patch, px; 0: automatic, from the mask's smallest upright tile: the least number of tiles of 24 px or
        more a side, 40 px where there is none, and never more than half the sample.
    overlap
        Share of a patch, along each side, that lies over patches there already; 0 to 0.9.
    reach
        How far, as a share of a patch's shorter side, it may give pixels beyond its window as well, where something is
        known and seams are better there; 0 to 2. (In Kwatra et al. the whole sample is laid, wherever its match is.)
    randomness
        k: a translation is drawn with a probability proportional to exp(-cost / (k sigma^2)) (Kwatra et al., section 4:
        0.001 to 1), cost being the mean squared difference, sigma^2 the variance of the sample; 0: one of the best.
    refinements
        How many times as many windows are covered anew as were covered first.
    seam
        What seams are judged by: ``"mask"``, color and weighted mask (the paper's six dimensions), or ``"color"``.
    normalized
        Whether seams prefer to run where the texture is busy: squared differences over gradients (after section 5 of
        Kwatra et al.), or, False, by differences alone (their equation 1, the paper's).
    tileable
        Whether the output's edges continue at their opposites (section 4.3): the mask is fitted to its size, which must
        be a period of the mask up to a tenth of s; another is refused with the nearest ones that are.
    threshold
        Least amplitude of a wave of the mask, units of 1/255; 0: automatic.
    harmonics
        ``"tied"``: waves are whole combinations of common fundamentals; ``"free"``: each by itself (the paper's), which
        cannot tile.
    signal
        How waves are searched: ``"real"``, or ``"analytic"`` (the paper's).
    channels
        Whether a wave has one frequency in all channels, ``"joint"``, or every channel is analyzed by itself,
        ``"each"`` (the paper's).
    """

    weight: float = 2.0
    patch: int = 0
    overlap: float = 0.15
    reach: float = 1.0
    randomness: float = 0.1
    refinements: int = 1
    seam: Judged = "mask"
    normalized: bool = True
    tileable: bool = False
    threshold: float = 0.0
    harmonics: Harmonic = "tied"
    signal: Signal = "real"
    channels: Channels = "joint"

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"
    paper: ClassVar[str] = Frdft.paper

    def __post_init__(self) -> None:
        self._analysis()
        if not 0 <= self.weight <= LARGEST_WEIGHT:
            raise BadInput(f"weight {self.weight}; choose from 0 (no mask) to {LARGEST_WEIGHT:g}")
        if self.patch < 0 or self.patch in (1, 2):
            raise BadInput(f"patch {self.patch}; choose 0 (automatic), or 3 px or more")
        if not 0 <= self.overlap <= 0.9:
            raise BadInput(f"overlap {self.overlap}; choose a share of the patch from 0 to 0.9")
        if not 0 <= self.reach <= 2:
            raise BadInput(f"reach {self.reach}; choose a share of the patch from 0 to 2")
        if not 0 <= self.randomness < math.inf:
            raise BadInput(f"randomness {self.randomness}; choose 0 (one of the best) or more")
        if self.refinements < 0:
            raise BadInput(f"refinements {self.refinements}; choose 0 or more passes")
        if self.tileable and self.harmonics == "free":
            raise BadInput("tileable with harmonics 'free', which have no common period; choose harmonics 'tied'")

    def _analysis(self) -> MaskParameters:
        return MaskParameters(self.threshold, self.harmonics, self.signal, self.channels)

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`FftmPatch`. The mask is kept as the extra picture ``mask``.

        Raises
        ------
        Refused
            When the sample has no regular part or is smaller than the patch, or the output cannot be tiled.
        """
        start = time.perf_counter()
        mask = self._analysis().of(task.sample, task.lattice)
        seconds = 0.0 if task.lattice else time.perf_counter() - start
        return dataclasses.replace(self.follow(task, mask), detection_seconds=seconds)

    def follow(self, task: Task, mask: TextureMask) -> Synthesis:
        """Return the synthesis that a mask of the task's sample guides, and raise as :meth:`synthesize` does."""
        drawn = (tileable_mask(mask, task.shape) if self.tileable else mask).picture(task.shape)
        image, source = self.patchwork(task, mask, drawn).finished()
        task.progress(1.0)
        return Synthesis(image, mask.lattice, source, {"mask": drawn})

    def patchwork(self, task: Task, mask: TextureMask, drawn: Image) -> Patchwork:
        """Return the output, covered window by window, then improved; raise as :meth:`synthesize` does.

        Parameters
        ----------
        task
            What is asked.
        mask
            Of the sample.
        drawn
            The mask of the output, ``(H, W, C)``.
        """
        size = self._size(mask, task)
        colors = whole(task.sample)
        guide = whole(drawn, self.weight), whole(mask.picture(_shape(task.sample)), self.weight)
        features = colors if self.seam == "color" else np.concatenate([colors, guide[1]], -1)
        reach = round(self.reach * min(size))
        work = Patchwork(task.sample, features, task.shape, self.normalized, self.tileable)
        self._fill(task, PatchPlacer(work, colors, self.randomness, task.rng, guide, reach), size)
        return work

    def _fill(self, task: Task, placement: PatchPlacer, size: Shape) -> None:
        rows, columns = (max(1, round(side * (1 - self.overlap))) for side in size)
        windows = list(scan_lines(task.shape, size, (rows, columns), self.tileable))
        steps = len(windows) * (1 + self.refinements)
        for done, window in enumerate(windows):
            placement.cover(window)
            task.progress(done / steps)
        heat = SeamHeat(placement.work, size)
        for done in range(len(windows), steps):
            placement.improve(heat)
            task.progress(done / steps)

    def _size(self, mask: TextureMask, task: Task) -> Shape:
        """Return the patches' (height, width), px."""
        room = _shape(task.sample)
        if self.patch > min(room):
            raise Refused(
                f"the sample is {room[1]}x{room[0]} px, a patch {self.patch}x{self.patch} px; "
                f"choose patch <= {min(room)}, or leave it out"
            )
        size = (self.patch, self.patch) if self.patch else automatic_size(mask, room)
        margin = 2 if self.tileable else 0
        if min(task.shape) <= margin:
            raise Refused("an output of less than 3 px a side has no inside to its edges; leave tileable out")
        return min(size[0], task.shape[0] - margin), min(size[1], task.shape[1] - margin)


def _shape(image: Image) -> Shape:
    return image.shape[0], image.shape[1]


def whole(image: Image, weight: float = 1.0) -> Features:
    """Return an image as whole gray levels, times a weight."""
    return np.ascontiguousarray(np.rint(image.astype(np.float64) * (255 * weight)), np.int32)


def automatic_size(mask: TextureMask, room: Shape) -> Shape:
    """Return the (height, width) of patches, px, that suits a mask and a sample of (height, width) ``room``."""
    half = (max(room[0] // 2, 1), max(room[1] // 2, 1))
    tile = mask.tileable(HALF_PIXEL, float(max(half)))
    if tile is None:
        return min(NO_TILE, half[0]), min(NO_TILE, half[1])
    sides = (side * math.ceil(LEAST_PATCH / side) for side in tile.size[::-1])
    height, width = (min(round(side), most) for side, most in zip(sides, half, strict=True))
    return height, width
