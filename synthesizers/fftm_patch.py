"""Patch-based synthesis guided by a fractional Fourier texture mask (method ``fftm-patch``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from nrbench.detectors.frdft import Frdft
from nrbench.errors import require, require_ranges
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task
from nrbench.spectra.harmonics import lowest_period

from .gap_filling.holes import leaves_out
from .masks.texture_mask import MASK_OF_THE_PAPER, MaskParameters, TextureMask
from .patchwork.patchwork import LEAST_OVERLAP, Patchwork, WholePatches, to_gray_levels

PatchRule = Literal["period", "lowest"]

LEAST_PATCH = 24
"""px: least side of an automatic patch if the sample is large enough. Small tiles are joined until they reach it."""
PATCH_WITHOUT_TILE = 40
"""px: side of an automatic patch if no upright rectangle is a tile (the example in section 5 of the paper)."""
LARGEST_WEIGHT = 100.0


@leaves_out
@dataclass(frozen=True)
class FftmPatch(MaskParameters):
    """Fractional Fourier texture masks, patch-based (Nicoll et al. 2005, sections 4.2 and 4.3).

    The mask is the regular part of the sample, a sum of waves, and is drawn at the output's size
    (:class:`~nrbench.synthesizers.masks.texture_mask.MaskParameters`). Its frequencies are found by
    :mod:`nrbench.spectra.harmonics`. Each pixel is described by its color and by its mask value times the root
    of the weight. The output is assembled by sub-patch matching (Kwatra et al. 2003, section 4), as ``graph-cuts``
    assembles its own (:class:`~nrbench.synthesizers.patchwork.patchwork.WholePatches`): line by line, a window of
    the size of a patch at the first unknown pixel, slightly enlarged, is compared with all parts of the sample, in
    color where the output is synthesized already, in the mask everywhere. This chooses a translation of the sample. The
    whole sample is laid there, fills all unknown pixels under it, and a minimum cut determines which known pixels it
    replaces. With ``refinements``, the windows with the most expensive seams are covered again, pass by pass, until a
    pass does not reduce the cost of all seams by 1 %.

    The paper prints the compared sum as d_MM + c d_TT, with the weight on the texture, which contradicts its section
    4.1. Here it is d_TT + c d_MM, squared differences, as in ``fftm-pixel``; at c = 0 the mask has no effect. One
    addition keeps more elements whole: seams prefer places where the texture varies strongly. Kwatra et al. force at
    least one pixel of each new patch into the output; here a patch that does not reduce the cost is dropped, and the
    seams cost less in the end.

    ``preset=paper`` has free waves of the analytic signal in each channel, patches whose size is that of a tile by
    equation 7, computed for each sample, and plain seams. The paper synthesizes by sub-patch matching and mentions
    entire-patch matching as slower. It does not say at what temperature translations are drawn or how often seams are
    improved ("many minutes", section 5). The preset takes the default of the first, and up to four passes; its
    threshold is one of the four in table 1.

    If a lattice is given, the search for the waves starts from it, unless the waves are free; otherwise the method also
    finds the lattice.

    Parameters
    ----------
    weight
        c, 0 to 100: the weight of d_MM, the squared difference in the mask; that in color has weight 1. (The paper uses
        about 1. Below 0.1 the mask has no effect; above 5 it is too strong.)
    matching
        ``"sub-patch"``: by comparing a window (the paper). ``"entire"``: the whole sample is laid where it agrees best
        with all of the output that it overlaps, by mean squared differences (entire-patch matching, Kwatra et al.,
        section 4); ``overlap`` then has no effect.
    patch
        Side of a patch in px. 0: automatic. An automatic patch is as many of the mask's smallest upright tiles as are
        needed for 24 px along each side; 40 px if there is no such tile; at most half the sample.
    patch_rule
        The size of automatic patches. ``"period"``: as above. ``"lowest"``: the tile of the lowest wave, 1 / f_x by
        1 / f_y px (equation 7 of the paper with n = 1), 3 px to half the sample; along a side on which no wave varies,
        as long as the other side.
    overlap
        Share of a patch's side by which the compared window is larger than the patch, on each side; 0 to 0.9.
    randomness
        k, 0 or more. Translations are drawn with a probability proportional to exp(-cost / (k sigma^2)); the cost is
        the mean squared difference, sigma^2 is the variance of the sample (Kwatra et al., section 4; they use 0.001 to
        1). 0: one of least cost.
    refinements
        The most passes in which windows are covered again; each pass covers as many windows as the output holds. With
        passes, more elements are whole, and larger parts of the sample are repeated.
    normalized
        Whether the cost of a seam is the square of the differences, in color and weighted mask, divided by the
        gradients along the seam (after section 5 of Kwatra et al.), so that seams prefer places where the texture
        varies strongly. False: the differences alone, as in the paper (equation 1 of Kwatra et al.).

    References
    ----------
    .. [1] Alexander Nicoll, Jan Meseth, Gero Müller, Reinhard Klein. "Fractional Fourier Texture Masks: Guiding
           Near-Regular Texture Synthesis." Computer Graphics Forum 24(3), 2005.
    """

    weight: float = 4.0
    matching: Literal["sub-patch", "entire"] = "sub-patch"
    patch: int = 0
    patch_rule: PatchRule = "period"
    overlap: float = 0.15
    randomness: float = 0.1
    refinements: int = 0
    normalized: bool = True

    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "weight": 1.0,
            "matching": "sub-patch",
            "patch": 0,
            "patch_rule": "lowest",
            "overlap": 0.15,
            "randomness": 0.1,
            "refinements": 4,
            "normalized": False,
            **MASK_OF_THE_PAPER,
        }
    }
    patch_shape: ClassVar[str] = "rectangular patch from the period, matching={matching}"
    patch_placement: ClassVar[str] = "best match of color and mask"
    patch_stitching: ClassVar[str] = "graph cut"
    paper: ClassVar[str] = Frdft.paper

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.patch == 0 or self.patch >= 3, f"patch {self.patch}; choose 0 (automatic), or 3 px or more")
        require_ranges(self, weight=(0, LARGEST_WEIGHT), overlap=(0, 0.9))
        require_ranges(self, randomness=(0, math.inf), refinements=(0, math.inf))

    def synthesize_with_mask(self, task: Task, mask: TextureMask) -> Synthesis:
        """Return the synthesis guided by a given mask of the sample. Exceptions are those of :meth:`synthesize`."""
        output_mask = self.fit_to_output(mask, task.shape).draw(task.shape)
        size = self._patch_size(mask, task)
        colors = to_gray_levels(task.sample)
        root = math.sqrt(self.weight)
        sample_mask = to_gray_levels(mask.draw(task.sample.shape[:2]), root)
        guide = to_gray_levels(output_mask, root), sample_mask
        features = np.concatenate([colors, sample_mask], -1)
        work = Patchwork(task.sample, features, task.shape, self.normalized, 2 if self.normalized else 1, self.tileable)
        margin = round(self.overlap * size[0]), round(self.overlap * size[1])
        patches = WholePatches(
            work, colors, size, self.matching, self.randomness, LEAST_OVERLAP, margin, task.rng, guide
        )
        patches.assemble_output(self.refinements, task.progress)
        image, source = work.output()
        task.progress(1.0)
        return Synthesis(image, mask.lattice, source, {"mask": output_mask})

    def _patch_size(self, mask: TextureMask, task: Task) -> Shape:
        """Return the (height, width) of the patches, px."""
        height, width = task.sample.shape[:2]
        if self.patch > min(height, width):
            raise Refused(
                f"the sample is {width}x{height} px, a patch {self.patch}x{self.patch} px; "
                f"choose patch <= {min(height, width)}, or leave it out"
            )
        size = (self.patch, self.patch) if self.patch else automatic_size(mask, (height, width), self.patch_rule)
        margin = 2 if self.tileable else 0
        if min(task.shape) <= margin:
            raise Refused("a tileable output needs at least 3 px a side; choose a larger size, or leave tileable out")
        return min(size[0], task.shape[0] - margin), min(size[1], task.shape[1] - margin)


def automatic_size(mask: TextureMask, shape: Shape, rule: PatchRule = "period") -> Shape:
    """Return the (height, width) px of automatic patches for a mask and a sample of ``shape``."""
    half = (max(shape[0] // 2, 1), max(shape[1] // 2, 1))
    if rule == "lowest":
        across, down = lowest_period(mask.harmonics.frequencies, mask.harmonics.amplitudes, shape)
        lengths = (down or across or math.inf, across or down or math.inf)
        height, width = (round(min(max(side, 3), most)) for side, most in zip(lengths, half, strict=True))
        return height, width
    tile = mask.find_period(limit=max(half))
    if tile is None:
        return min(PATCH_WITHOUT_TILE, half[0]), min(PATCH_WITHOUT_TILE, half[1])
    sides = (side * math.ceil(LEAST_PATCH / side) for side in tile[::-1])
    height, width = (min(round(side), most) for side, most in zip(sides, half, strict=True))
    return height, width
