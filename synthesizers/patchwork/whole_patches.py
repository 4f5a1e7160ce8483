"""Placement of the whole sample as a patch over an output.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .patchwork import Patchwork, Window, summed_variance
from .translations import Costs, EntirePatch, Features, Translations, draw_translation

Placement = Literal["entire", "sub-patch", "random"]


@dataclass(eq=False)
class WholePatches:
    """Lays the whole sample over regions of an output; a minimum cut decides which of its pixels are shown.

    The paper calls these regions error regions: the next unknown part of the output, or a part with bad seams. Only
    translations at which the sample covers the region completely are considered. A translation that is already shown in
    a known region is not considered, because it fits best and changes nothing.

    Parameters
    ----------
    work
        The output. It does not wrap.
    colors
        ``int32 (H, W, C)``: the values of the sample that are compared with known pixels.
    size
        (height, width) px of a region, smaller than the sample and not larger than the output.
    placement
        How a translation is chosen. ``"entire"``: the whole sample is compared with all known pixels that it overlaps;
        the cost C(t) is the mean squared difference (entire-patch matching). ``"sub-patch"``: only a window around the
        region is compared. ``"random"``: all translations are equally probable.
    randomness
        The paper's k: translations are drawn with a probability proportional to exp(-C(t) / (k sigma^2)). 0: one of
        the least cost.
    least_overlap
        For ``"entire"``: translations of a smaller overlap are not considered, because a mean over a few pixels says
        little. As a share of the largest overlap of all considered translations.
    margin
        For ``"sub-patch"``: (rows, columns) px by which the window is larger than the region, on each side. The window
        is not larger than the sample.
    rng
        The generator that draws translations.
    """

    work: Patchwork
    colors: Features
    size: tuple[int, int]
    placement: Placement
    randomness: float
    least_overlap: float
    margin: tuple[int, int]
    rng: np.random.Generator

    def find_unknown(self) -> Window | None:
        """Return the region at the first unknown pixel, line by line; None if all pixels are known."""
        known = self.work.known
        index = int(known.argmin())
        if known.flat[index]:
            return None
        ends = zip(divmod(index, known.shape[1]), self.size, known.shape, strict=True)
        top, left = (min(start, side - length) for start, length, side in ends)
        return top, top + self.size[0], left, left + self.size[1]

    def cover_region(self, region: Window, forced_pixel: tuple[int, int] | None = None) -> int:
        """Lay the sample over a region, fill all unknown pixels under it, and return the number of changed pixels.

        Parameters
        ----------
        region
            Inside the output.
        forced_pixel
            See :meth:`~nrbench.synthesizers.patchwork.patchwork.Patchwork.lay_patch`.
        """
        costs = self._rate_translations(region)
        if not np.isfinite(costs).any():
            return 0
        column, row = draw_translation(costs, self.randomness * self._variance, self.rng)
        top, left = row + self._first(region)[0], column + self._first(region)[1]
        height, width = self.colors.shape[:2]
        (bottom, right), (y, x) = (top + height, left + width), (max(top, 0), max(left, 0))
        window = y, min(bottom, self.work.shape[0]), x, min(right, self.work.shape[1])
        return self.work.lay_patch(window, (x - left, y - top), forced_pixel=forced_pixel)

    def _first(self, region: Window) -> tuple[int, int]:
        """Return the (y, x) in the output of the sample's first pixel at the first translation considered."""
        return region[1] - self.colors.shape[0], region[3] - self.colors.shape[1]

    @cached_property
    def _counts(self) -> tuple[int, int]:
        """The number of translations along each axis at which the sample covers a region."""
        return self.colors.shape[0] - self.size[0] + 1, self.colors.shape[1] - self.size[1] + 1

    def _rate_translations(self, region: Window) -> Costs:
        """Return C(t) of each translation that covers a region; infinity where it is not considered."""
        if self.placement == "entire":
            costs = self._compare_all(region)
        elif self.placement == "sub-patch":
            costs = self._compare_window(region)
        else:
            costs = np.zeros(self._counts)
        known = self.work.known[self.work.pixels(region)]
        if known.all():
            costs[self._shown(region)] = np.inf
        return costs

    def _compare_all(self, region: Window) -> Costs:
        """Compare the sample with all known pixels that it overlaps."""
        top, left = self._first(region)
        ends = top + self._reach[0], left + self._reach[1]
        inside = max(top, 0), min(ends[0], self.work.shape[0]), max(left, 0), min(ends[1], self.work.shape[1])
        part = slice(inside[0] - top, inside[1] - top), slice(inside[2] - left, inside[3] - left)
        known, values = np.zeros(self._reach, np.bool_), np.zeros((*self._reach, self.colors.shape[2]), np.int32)
        known[part] = self.work.known[self.work.pixels(inside)]
        values[part] = self.work.read(self.colors, inside)
        costs, areas = self._entire.compute_costs(values, known)
        considered = areas >= self.least_overlap * areas.max()
        return np.where(considered, costs / np.maximum(areas, 1), np.inf)

    def _compare_window(self, region: Window) -> Costs:
        """Compare a window around the region with all parts of the sample; the sample covers the window completely."""
        window: list[int] = []
        for axis in (0, 1):
            start, stop = region[2 * axis], region[2 * axis + 1]
            more = min(self.margin[axis], (self.colors.shape[axis] - self.size[axis]) // 2)
            window += [max(start - more, 0), min(stop + more, self.work.shape[axis])]
        y0, y1, x0, x1 = window
        known = self.work.known[y0:y1, x0:x1]
        sums = self._parts.compute_costs(self.work.read(self.colors, (y0, y1, x0, x1)), known)
        costs = np.full(self._counts, np.inf)
        # A part that starts in row r of the sample lies there at translation y0 - r of the sample's first pixel.
        top, left = self._first(region)
        rows, columns = y0 - top - np.arange(sums.shape[0]), x0 - left - np.arange(sums.shape[1])
        costs[np.ix_(rows, columns)] = sums / max(int(known.sum()), 1)
        return costs

    def _shown(self, region: Window) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the translations, as rows and columns of the costs, that are shown in a known region."""
        pixels, (top, left) = self.work.pixels(region), self._first(region)
        x, y = np.moveaxis(self.work.origin[pixels], -1, 0)
        rows, columns = pixels[0] - y - top, pixels[1] - x - left
        within = (rows >= 0) & (rows < self._counts[0]) & (columns >= 0) & (columns < self._counts[1])
        return rows[within], columns[within]

    @cached_property
    def _reach(self) -> tuple[int, int]:
        """The (height, width) px of the union of all translations of the sample that cover a region."""
        return self.colors.shape[0] + self._counts[0] - 1, self.colors.shape[1] + self._counts[1] - 1

    @cached_property
    def _entire(self) -> EntirePatch:
        return EntirePatch(self.colors, self._counts)

    @cached_property
    def _parts(self) -> Translations:
        return Translations(self.colors, self.colors.shape[2])

    @cached_property
    def _variance(self) -> float:
        return summed_variance(self.colors)
