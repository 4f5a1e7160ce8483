"""Patch-based synthesis guided by a fractional Fourier texture mask (method ``fftm-patch``)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from nrbench.detectors.frdft import Frdft
from nrbench.errors import require, require_ranges
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task
from nrbench.spectra.harmonics import lowest_period

from .canvas.canvas import Window
from .masks.texture_mask import MASK_OF_THE_PAPER, MaskParameters, TextureMask
from .patchwork.patchwork import (
    LEAST_OVERLAP,
    Features,
    Patchwork,
    SeamHeat,
    Translations,
    WholePatches,
    draw_translation,
    summed_variance,
    to_gray_levels,
)

PatchRule = Literal["period", "lowest"]

LEAST_PATCH = 24
"""px: least side of an automatic patch if the sample is large enough. Small tiles are joined until they reach it."""
PATCH_WITHOUT_TILE = 40
"""px: side of an automatic patch if no upright rectangle is a tile (the example in section 5 of the paper)."""
LARGEST_WEIGHT = 100.0


@dataclass(frozen=True)
class FftmPatch(MaskParameters):
    """Fractional Fourier texture masks, patch-based (Nicoll et al. 2005, sections 4.2 and 4.3).

    The mask is the regular part of the sample, a sum of waves, and is drawn at the output's size
    (:class:`~nrbench.synthesizers.masks.texture_mask.MaskParameters`). Its frequencies are found by
    :mod:`nrbench.spectra.harmonics`. Each pixel is described by its color and by its mask value times the root
    of the weight. The output is divided into overlapping windows. Line by line, each window is covered by a patch, a
    part of the sample of the same size. To choose the patch, the method compares all such parts with the window
    (sub-patch matching, Kwatra et al. 2003, section 4): in color where the output is synthesized already, in the mask
    everywhere. A minimum cut then determines which pixels of the window the patch replaces. Finally the windows with
    the most expensive seams are covered again. No such step increases the total cost of the seams.

    The paper prints the compared sum as d_MM + c d_TT, with the weight on the texture, which contradicts its section
    4.1. Here it is d_TT + c d_MM, squared differences, as in ``fftm-pixel``; at c = 0 the mask has no effect. Two
    additions keep more elements whole: seams prefer places where the texture varies strongly, and a patch may extend
    beyond its window. Kwatra et al. force at least one pixel of each new patch into the output; here a patch that does
    not reduce the cost is dropped. With a larger reach and more refinements, patches grow together: fewer tiles are
    broken, but more are repeated.

    ``preset=paper`` has free waves of the analytic signal in each channel, patches whose size is that of a tile by
    equation 7, computed for each sample, and plain seams. The paper synthesizes by sub-patch matching and mentions
    entire-patch matching as slower. It does not say how far a patch reaches beyond its window, what share of it
    overlaps, at what temperature it is drawn, or how often seams are improved. The preset takes the patch to be its
    window, and for the others the defaults; its threshold is one of the four in table 1.

    If a lattice is given, the search for the waves starts from it, unless the waves are free; otherwise the method also
    finds the lattice.

    Parameters
    ----------
    weight
        c, 0 to 100: the weight of d_MM, the squared difference in the mask; that in color has weight 1. (The paper uses
        about 1. Below 0.1 the mask has no effect; above 5 it is too strong.)
    matching
        ``"sub-patch"``: a window is compared with the parts of the sample (the paper). ``"entire"``: the whole sample
        is laid where it agrees best with all of the output that it overlaps, by mean squared differences, and a cut
        decides what is shown (entire-patch matching, Kwatra et al., section 4). The parts that have to be covered have
        the size of a patch. ``overlap`` and ``reach`` have no effect, and the output cannot be tileable.
    patch
        Side of a patch in px. 0: automatic. An automatic patch is as many of the mask's smallest upright tiles as are
        needed for 24 px along each side; 40 px if there is no such tile; at most half the sample.
    patch_rule
        The size of automatic patches. ``"period"``: as above. ``"lowest"``: the tile of the lowest wave, 1 / f_x by
        1 / f_y px (equation 7 of the paper with n = 1), 3 px to half the sample; along a side on which no wave varies,
        as long as the other side.
    overlap
        Share of a patch, along each side, that overlaps earlier patches; 0 to 0.9.
    reach
        Distance beyond its window within which a patch may replace known pixels, as a share of its shorter side; 0 to
        2.
    randomness
        k, 0 or more. Patches are drawn with a probability proportional to exp(-cost / (k sigma^2)); the cost is the
        mean squared difference, sigma^2 is the variance of the sample (Kwatra et al., section 4; they use 0.001 to 1).
        0: one of the patches of least cost.
    refinements
        Number of windows that are covered again, as a multiple of the number of windows.
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
    reach: float = 1.0
    randomness: float = 0.1
    refinements: int = 1
    normalized: bool = True

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "patches and pixels under a mask"
    version: ClassVar[str] = "1"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "weight": 1.0,
            "matching": "sub-patch",
            "patch": 0,
            "patch_rule": "lowest",
            "overlap": 0.15,
            "reach": 0.0,
            "randomness": 0.1,
            "refinements": 1,
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
        require_ranges(self, weight=(0, LARGEST_WEIGHT), overlap=(0, 0.9), reach=(0, 2))
        require_ranges(self, randomness=(0, math.inf), refinements=(0, math.inf))
        straight = self.matching == "sub-patch" or not self.tileable
        require(straight, "tileable outputs need matching 'sub-patch'; drop tileable, or choose it")

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
        if self.matching == "entire":
            placed = WholePatches(work, colors, size, "entire", self.randomness, LEAST_OVERLAP, (0, 0), task.rng, guide)
            self._lay_whole_patches(placed, task)
            image, source = work.output()
            return Synthesis(image, mask.lattice, source, {"mask": output_mask})
        placer = PatchPlacer(work, colors, self.randomness, task.rng, guide, round(self.reach * min(size)))
        step_y, step_x = (max(1, round(side * (1 - self.overlap))) for side in size)
        windows = list(scan_windows(task.shape, size, (step_y, step_x), self.tileable))
        steps = len(windows) * (1 + self.refinements)
        for number, window in enumerate(windows):
            placer.cover_window(window)
            task.progress(number / steps)
        heat = SeamHeat(work, size)
        for number in range(len(windows), steps):
            placer.improve_worst_window(heat)
            task.progress(number / steps)
        image, source = work.output()
        task.progress(1.0)
        return Synthesis(image, mask.lattice, source, {"mask": output_mask})

    def _lay_whole_patches(self, patches: WholePatches, task: Task) -> None:
        """Cover the output by entire-patch matching, then the windows with the most expensive seams again."""
        work, size, filled = patches.work, patches.size, 1 / (1 + self.refinements)
        while (region := patches.find_unknown()) is not None:
            patches.cover_region(region)
            task.progress(filled * region[0] / task.shape[0])
        heat = SeamHeat(work, size)
        steps = self.refinements * math.ceil(math.prod(task.shape) / math.prod(size))
        for number in range(steps):
            region = heat.find_worst()
            patches.cover_region(region)
            heat.update(region, max(task.sample.shape[:2]))
            task.progress(filled + (1 - filled) * number / steps)
        task.progress(1.0)

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


class PatchPlacer:
    """Covers windows of an output with patches that match their known pixels (sub-patch matching, section 4).

    Parameters
    ----------
    work
        The output.
    colors
        ``int32 (H, W, C)``: the values of the sample's pixels that are compared with known pixels.
    randomness
        The paper's k: places are drawn with a probability proportional to exp(-cost / (k sigma^2)). The cost is the
        mean squared difference of the window's pixels; sigma is the standard deviation of the sample's colors. Both
        are summed over channels. 0: one of the places of least cost is drawn.
    rng
        The generator that draws places.
    guide
        Values that are compared at all pixels, known or not: ``int32 (H, W, M)`` of the output, and the same of the
        sample.
    reach
        See :meth:`Patchwork.lay_patch`.
    """

    def __init__(
        self,
        work: Patchwork,
        colors: Features,
        randomness: float,
        rng: np.random.Generator,
        guide: tuple[Features, Features],
        reach: int = 0,
    ) -> None:
        self.work, self.colors, self.randomness, self.rng = work, colors, randomness, rng
        self.guide, self.reach, self._variance = guide, reach, summed_variance(colors)
        self._translations = Translations(np.concatenate([colors, guide[1]], -1), colors.shape[2])

    def cover_window(self, window: Window) -> int:
        """Lay a patch into a window, and return the number of replaced pixels; 0 if no replacement reduces the cost."""
        pixels = self.work.pixels(window)
        known = self.work.known[pixels]
        values = np.concatenate([self.work.read(self.colors, window), self.guide[0][pixels]], -1)
        costs = self._translations.compute_costs(values, known)
        scale = self.randomness * self._variance * known.size
        return self.work.lay_patch(window, draw_translation(costs, scale, self.rng), self.reach)

    def improve_worst_window(self, heat: SeamHeat) -> int:
        """Cover the window whose seams cost most again, and return the number of replaced pixels."""
        window = heat.find_worst()
        new = self.cover_window(window)
        heat.update(window, self.reach)
        return new


def scan_windows(shape: tuple[int, int], size: tuple[int, int], step: tuple[int, int], wrap: bool) -> Iterator[Window]:
    """Yield windows of a size that cover an output, line by line, at distances of ``step`` (rows, columns).

    The last window of a line and the windows of the last line are cropped at the output's edge. If the output wraps,
    they cross the edge instead.
    """
    for top in range(0, shape[0] if wrap else max(shape[0] - size[0] + step[0], 1), step[0]):
        for left in range(0, shape[1] if wrap else max(shape[1] - size[1] + step[1], 1), step[1]):
            bottom, right = top + size[0], left + size[1]
            yield top, bottom if wrap else min(bottom, shape[0]), left, right if wrap else min(right, shape[1])
