"""A patchwork: patches of a sample, cut into an output along the least visible seams, and the choice of patches.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts). Sections 3 and
5: seams; section 4: comparison of an output with the sample at every translation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, Table, box_sums, box_sums_from, integral_image

from ..canvas.canvas import Canvas, Further, Mask, Source, Window, copy_patch
from ..canvas.seam_kernels import FIRST, SECOND, cut_links
from ..matching.frame_matching import FourierProducts, Spectra
from .patchwork_kernels import UNIT, feather_seams, link_choices

Features = NDArray[np.int32]
"""``int32 (H, W, F)``: the values of the pixels that are compared. They are integers, so that sums are exact."""
Costs = NDArray[np.float64]
"""``float64 (rows, columns)``: the cost of each place (y, x) of the window's first pixel in the sample."""
_FARTHEST = 746.0
"""exp of less than minus this is 0."""
Placement = Literal["entire", "sub-patch", "random"]
LEAST_OVERLAP = 0.25
"""Least overlap with known pixels, as a share of the largest overlap of all translations that cover a region. The paper
normalizes by the overlap and names no least one; the mean over a few pixels would then decide."""
LEAST_GAIN = 0.01
"""A pass of refinement pays if it reduces the total cost of the seams by at least this share."""
BLOCKS_PER_SIDE = 6
"""Number of blocks along the shorter side of a window; the search for the worst window moves in steps of a block."""


def to_gray_levels(image: Image, weight: float = 1.0) -> Features:
    """Return an image, times a weight, rounded to integer gray levels, ``int32 (H, W, C)``."""
    return np.ascontiguousarray(np.rint(image.astype(np.float64) * (255 * weight)), np.int32)


@dataclass(frozen=True, eq=False)
class Translations:
    """The translations of a sample that cover a window (sub-patch matching), with the sample's precomputed spectra.

    Parameters
    ----------
    values
        ``int32 (H, W, F)``: the sample, for example its colors and the values of a mask. Sums of squares over it must
        be below 2^47.
    colors
        The number of leading channels that are compared at known pixels only. The others are compared at all pixels.
    """

    values: Features
    colors: int

    def compute_costs(self, window: Features, known: Mask) -> Costs:
        """Return the sum of squared differences between a window and the part of the sample at each place.

        Parameters
        ----------
        window
            ``int32 (h, w, F)``, not larger than the sample.
        known
            ``bool (h, w)``: the pixels at which the leading channels are compared.

        Returns
        -------
        Costs
            ``(H - h + 1, W - w + 1)``, exact.

        Notes
        -----
        The square of the difference is expanded (section 5 of the paper). Fourier transforms compute the products.
        Integral images compute the sums of squares, or transforms if not all pixels are compared. The time is
        O(F H W log(H W)) for windows of any size.
        """
        size, sides = (known.shape[0], known.shape[1]), self.values.shape
        counts = sides[0] - size[0] + 1, sides[1] - size[1] + 1
        seen = np.moveaxis(window, -1, 0).astype(np.float64)
        seen[: self.colors] *= known
        total = float((seen**2).sum()) + box_sums_from(self._tables[1], size)
        planes, spectra = -2 * seen, self._spectra
        if known.all():
            total, spectra = total + box_sums_from(self._tables[0], size), spectra[:-1]
        else:
            planes = np.concatenate([planes, known[np.newaxis]])
        return np.asarray(total + self._products.correlate(spectra, self._products.transform(planes), counts))

    @cached_property
    def _squares(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The squares, summed over the leading channels and over the others."""
        squares = self.values.astype(np.int64) ** 2
        return squares[..., : self.colors].sum(-1), squares[..., self.colors :].sum(-1)

    @cached_property
    def _tables(self) -> tuple[Table, Table]:
        return integral_image(self._squares[0]), integral_image(self._squares[1])

    @cached_property
    def _products(self) -> FourierProducts:
        return FourierProducts(self.values.shape)

    @cached_property
    def _spectra(self) -> Spectra:
        """The spectra of all channels, and last that of the squares of the leading ones."""
        return self._products.transform(np.stack([*np.moveaxis(self.values, -1, 0), self._squares[0]]))


def draw_translation(costs: Costs, scale: float, rng: np.random.Generator) -> tuple[int, int]:
    """Draw a place, (x, y) px, with a probability proportional to exp(-cost / scale).

    Parameters
    ----------
    costs
        Costs of the places, for example from :meth:`Translations.compute_costs`. Places of infinite cost are never
        drawn; at least one cost is finite.
    scale
        The paper's k sigma^2 (section 4) in the unit of the costs: times the number of the window's pixels if the costs
        are sums. 0: one of the places of least cost is drawn.
    rng
        The generator; one number is drawn from it.
    """
    above = costs - costs.min()
    near = np.flatnonzero(above <= _FARTHEST * scale)  # the weights of all others are 0
    weights = np.exp(-above.ravel()[near] / scale) if scale > 0 else np.ones(len(near))
    cumulative = np.cumsum(weights)
    index = int(np.searchsorted(cumulative, rng.random() * cumulative[-1], "right"))
    y, x = divmod(int(near[min(index, len(near) - 1)]), costs.shape[1])
    return x, y


class Patchwork(Canvas):
    """An output that is assembled from patches; it is empty at first.

    Every pixel is a copy of a pixel of the sample. The source map therefore determines the patch of each pixel, the
    pixels that this patch would show beside it, and thus the cost of every seam. When a patch is laid, a minimum cut
    determines which of its pixels are shown, so that the total cost of old and new seams is least. The paper's graph
    with seam nodes (section 3.1) has the same result. Seam nodes are not needed because the cost of seams is a metric
    on patches (equation 1); see the expansion move of Boykov, Veksler and Zabih 2001 (Fast approximate energy
    minimization via graph cuts). The rim of a patch is not constrained: old pixels outside the window are ordinary
    neighbors.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    features
        ``int32 (H, W, F)``: the values from which the cost of seams is computed, in gray levels; for example colors.
    shape
        (height, width) of the output, px.
    normalized
        False: a seam between patch A at pixel s and patch B at pixel t costs ``|A(s) - B(s)| + |A(t) - B(t)|``,
        Euclidean over the features (equation 1). True: this, to the power ``power``, is divided by the sum of the
        gradients of both patches at both pixels along the link, plus one gray level (after section 5). This is no
        metric. In the cut, an old seam that costs more than the two seams that could replace it then counts only as
        much as these. The cut may therefore miss the minimum, but the total cost never increases unless a pixel is
        forced.
    power
        Exponent of the sum of differences if ``normalized``: 1 (the paper) or 2. The normalized cost of power 1 is a
        ratio; it is stored :data:`UNIT` times larger than other costs, so that rounding is negligible.
    wrap
        Whether opposite edges of the output are adjacent.

    Notes
    -----
    The costs of the links, :attr:`seams`, are whole numbers, ``int64``, in 1 / :data:`UNIT` gray levels.
    """

    def __init__(
        self,
        sample: Image,
        features: Features,
        shape: tuple[int, int],
        normalized: bool = False,
        power: int = 1,
        wrap: bool = False,
    ) -> None:
        super().__init__(shape, sample.shape[2], wrap=wrap, seam_type=np.int64)
        self.sample, self.features, self.normalized, self.power = sample, features, normalized, power
        values = features.astype(np.float64)
        gradients = [
            np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values) for axis in (1, 0)
        ]
        lengths = [np.rint(UNIT * np.sqrt((gradient**2).sum(-1))) for gradient in gradients]
        self._rule = (features, np.stack(lengths).astype(np.int32), normalized, power)

    @property
    def cost(self) -> float:
        """The cost of all seams, gray levels."""
        return float(self.seams.sum() / UNIT)

    def feathered(self, sigma: float) -> tuple[Image, Source, Further | None]:
        """Return the output with its patches blended near their seams, its source map, and its further sources.

        Every pixel is the weighted mean of the values that the patches around it have there. The weight of a patch is a
        Gaussian of the distance, summed over the pixels that show it (section 5, "feathering"). Pixels that see one
        patch only are copies.

        Parameters
        ----------
        sigma
            Standard deviation of the Gaussian, px; it is cut off at twice that distance. 0: every pixel is a copy.
        """
        image, source = self.output()
        if sigma == 0:
            return image, source, None
        distance = np.arange(-math.ceil(2 * sigma), math.ceil(2 * sigma) + 1)
        weights = np.exp(-(distance**2) / (2 * sigma**2))
        reach = len(distance) // 2 if self.wrap else 0
        around = [(reach, reach), (reach, reach), (0, 0)]
        origin = source[..., :2].astype(np.int64)
        padded = np.pad(origin, around, "wrap"), np.pad(image, around, "wrap")
        made = feather_seams(self.sample.copy(), *padded, np.outer(weights, weights))
        height, width = self.shape
        image, source, further = (part[reach : reach + height, reach : reach + width] for part in made)
        return image, source, further

    def read(self, values: NDArray[Any], window: Window) -> NDArray[Any]:
        """Return the values of a window's source pixels, ``(h, w, ...)``, from those of the sample's pixels.

        The values of unknown pixels are arbitrary.
        """
        x, y = np.moveaxis(self.origin(window), -1, 0)
        return np.asarray(values[y, x])

    def origin(self, window: Window) -> NDArray[np.int64]:
        """Return the (x, y) in the sample of a window's pixels, ``(h, w, 2)``; (0, 0) where nothing is known."""
        return np.ascontiguousarray(self.source[self.pixels(window)][..., :2], np.int64)

    def lay_patch(self, window: Window, place: tuple[int, int], forced_pixel: tuple[int, int] | None = None) -> int:
        """Cut a patch into a window so that the seams cost least. All unknown pixels of the window are filled.

        Parameters
        ----------
        window
            A window inside the output. If the output wraps, it may cross the edges, but must be at least two px less
            high and wide than the output.
        place
            (x, y) in the sample of the window's first pixel. The patch lies inside the sample.
        forced_pixel
            (y, x) inside the window: a pixel that must show the patch, even if the seams then cost more (section 3.2,
            "surrounded regions"). None: there is none.

        Returns
        -------
        int
            The number of pixels that now show the patch.
        """
        around, ring = self._add_ring(window)
        pixels = self.pixels(around)
        known = np.ascontiguousarray(self.known[pixels])
        forced = np.zeros_like(known)
        forced[_within(window, around)] = ~known[_within(window, around)]
        if forced_pixel is not None:
            forced[forced_pixel[0] - around[0], forced_pixel[1] - around[2]] = True
        x, y = place[0] + around[2] - window[2], place[1] + around[0] - window[0]
        choices = link_choices(self._rule, self.origin(around), known, x, y)
        new = cut_links(choices, (ring | ~known) & ~forced, forced)
        size = window[1] - window[0], window[3] - window[2]
        self.place(window, copy_patch(self.sample, place, size), new[_within(window, around)])
        self.seams[:, *pixels] = _record_links(self.seams[:, *pixels], choices, new)
        return int(new.sum())

    def _add_ring(self, window: Window) -> tuple[Window, Mask]:
        """Return a window extended by one pixel on each side, and a mask of the added ring."""
        y0, y1, x0, x1 = window
        if self.wrap:
            around = (y0 - 1, y1 + 1, x0 - 1, x1 + 1)
        else:
            around = (max(y0 - 1, 0), min(y1 + 1, self.shape[0]), max(x0 - 1, 0), min(x1 + 1, self.shape[1]))
        ring = np.ones((around[1] - around[0], around[3] - around[2]), np.bool_)
        ring[_within(window, around)] = False
        return around, ring


def _record_links(seams: NDArray[np.int64], choices: NDArray[np.float64], new: Mask) -> NDArray[np.int64]:
    """Return the costs of a window's links ``(2, h, w)`` after some of its pixels have become new.

    Links between pixels that stay keep their costs.
    """
    links = seams.copy()
    height, width = new.shape
    for axis, rows, columns in ((0, height, width - 1), (1, height - 1, width)):
        first, second = new[:rows, :columns], new[axis:, 1 - axis :]
        costs = np.where(first, choices[axis, FIRST, :rows, :columns], choices[axis, SECOND, :rows, :columns])
        np.copyto(links[axis, :rows, :columns], np.where(first & second, 0, costs), "unsafe", where=first | second)
    return links


def _within(window: Window, around: Window) -> tuple[slice, slice]:
    """Return the slices of a window inside a larger one around it."""
    y0, y1, x0, x1 = window
    return slice(y0 - around[0], y1 - around[0]), slice(x0 - around[2], x1 - around[2])


class SeamHeat:
    """The costs of an output's seams, summed over blocks, and the number of tries to reduce them.

    With blocks the search for the worst window is cheap: it compares H W / q^2 sums for blocks of q px, and only the
    blocks that a new patch changes, and the windows over them, are summed again.

    Parameters
    ----------
    work
        The output.
    size
        (height, width) px of the windows, not larger than the output.

    Attributes
    ----------
    block
        Side of a block, px.
    costs
        ``float64 (rows, columns)``: the cost of each block's seams.
    tries
        ``int64 (rows, columns)``: how many times each block was in a window that was covered again.
    """

    def __init__(self, work: Patchwork, size: tuple[int, int]) -> None:
        self.work, self.size = work, size
        self.block = max(1, min(size) // BLOCKS_PER_SIDE)
        self.costs = self._sum_blocks(self._blocks(0, work.shape[0], 0), self._blocks(0, work.shape[1], 1))
        self.tries = np.zeros(self.costs.shape, np.int64)
        self._rated = self._sum_windows(self.costs)

    def _sum_blocks(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the cost of the seams in each block; ``rows`` and ``columns`` are ascending numbers of blocks."""
        y, x = ((numbers[:, np.newaxis] * self.block + np.arange(self.block)).ravel() for numbers in (rows, columns))
        y, x = y[y < self.work.shape[0]], x[x < self.work.shape[1]]
        seams = self.work.seams[:, y[:, np.newaxis], x].sum(0)
        by_rows = np.add.reduceat(seams, np.searchsorted(y, rows * self.block), 0)
        return np.add.reduceat(by_rows, np.searchsorted(x, columns * self.block), 1).astype(np.float64)

    def find_worst(self) -> Window:
        """Return the window whose seams cost most. The cost of a block is halved for each earlier try."""
        return self._window_at(int(self._rated.argmax()), self._rated.shape[1])

    def draw_window(self, rng: np.random.Generator) -> Window:
        """Return a random window."""
        sums = self._sum_windows(self.costs)
        return self._window_at(int(rng.integers(sums.size)), sums.shape[1])

    def draw_extreme(self, rng: np.random.Generator, maxima: bool) -> Window:
        """Return a random window of those whose seams cost no more than those of the windows one block from it.

        With ``maxima``, also those whose seams cost no less than these.
        """
        sums = self._sum_windows(self.costs)
        extreme = sums == scipy.ndimage.minimum_filter(sums, 3, mode="nearest")
        if maxima:
            extreme |= sums == scipy.ndimage.maximum_filter(sums, 3, mode="nearest")
        return self._window_at(int(rng.choice(np.flatnonzero(extreme))), sums.shape[1])

    def _sum_windows(self, heat: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum over the blocks of each window, from a value for each block."""
        if self.work.wrap:
            heat = np.pad(heat, [(0, count - 1) for count in self._counts], "wrap")
        return box_sums(heat, self._counts)

    @property
    def _counts(self) -> tuple[int, int]:
        """The rows and columns of blocks of a window."""
        down, across = (min(-(-side // self.block), n) for side, n in zip(self.size, self.costs.shape, strict=True))
        return down, across

    def _window_at(self, index: int, columns: int) -> Window:
        """Return the window of an index into the sums over windows."""
        y, x = (self.block * k for k in divmod(index, columns))
        if not self.work.wrap:
            y, x = min(y, self.work.shape[0] - self.size[0]), min(x, self.work.shape[1] - self.size[1])
        return y, y + self.size[0], x, x + self.size[1]

    def update(self, window: Window, reach: int = 0) -> None:
        """Count a try for the blocks of a window, and sum the blocks up to ``reach`` px from it again."""
        y0, y1, x0, x1 = window
        rows, columns = self._blocks(y0 - 1 - reach, y1 + reach, 0), self._blocks(x0 - 1 - reach, x1 + reach, 1)
        self.costs[np.ix_(rows, columns)] = self._sum_blocks(rows, columns)
        self.tries[np.ix_(self._blocks(*window[:2], 0), self._blocks(*window[2:], 1))] += 1
        down, below = self._windows_over(y0 - 1 - reach, rows, 0)
        across, beside = self._windows_over(x0 - 1 - reach, columns, 1)
        under = np.ix_(below, beside)
        heat = self.costs[under] * 0.5 ** np.minimum(self.tries[under], 50)
        self._rated[np.ix_(down, across)] = box_sums(heat, self._counts)

    def _windows_over(
        self, start: int, blocks: NDArray[np.int64], axis: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first blocks of all windows over some blocks along an axis, and all blocks of these windows.

        ``start`` is the first pixel of the blocks. Past the edge of an output that wraps they go on at the other edge.
        """
        side, more, number = self.work.shape[axis], self._counts[axis] - 1, self._rated.shape[axis]
        first = (start % side if self.work.wrap else max(start, 0)) // self.block - more
        firsts = np.arange(first, first + len(blocks) + more)
        firsts = firsts[:number] if self.work.wrap else firsts[(firsts >= 0) & (firsts < number)]
        under = np.arange(firsts[0], firsts[-1] + more + 1)
        return firsts % number, under % self.costs.shape[axis]

    def _blocks(self, start: int, stop: int, axis: int) -> NDArray[np.int64]:
        """Return the numbers of the blocks that contain the pixels ``start`` to ``stop`` - 1 along an axis."""
        side = self.work.shape[axis]
        pixels = np.arange(start, stop) % side if self.work.wrap else np.arange(max(start, 0), min(stop, side))
        return np.unique(pixels // self.block)


def summed_variance(colors: Features) -> float:
    """Return the variance, summed over channels, from integer sums so that it is the same on every machine."""
    values = colors.reshape(-1, colors.shape[2]).astype(np.int64)
    count, squares = len(values), int((values**2).sum())
    return (count * squares - sum(int(total) ** 2 for total in values.sum(0))) / count**2


@dataclass(eq=False)
class WholePatches:
    """Lays the whole sample over regions of an output; a minimum cut decides which of its pixels are shown.

    The paper calls these regions error regions: the next unknown part of the output, or a part with bad seams. Only
    translations at which the sample covers the region completely are considered. A translation that is already shown in
    a known region is not considered, because it fits best and changes nothing.

    Parameters
    ----------
    work
        The output.
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
    guide
        Values of the output and of the sample that are compared at all pixels, known or not, that the sample or the
        window overlaps. For ``"entire"`` their mean squared difference is added to C(t). For ``"sub-patch"`` C(t) is
        the sum of both squared differences over the number of the window's pixels.
    """

    work: Patchwork
    colors: Features
    size: tuple[int, int]
    placement: Placement
    randomness: float
    least_overlap: float
    margin: tuple[int, int]
    rng: np.random.Generator
    guide: tuple[Features, Features] | None = None

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
            See :meth:`Patchwork.lay_patch`.
        """
        costs = self._rate_translations(region)
        if not np.isfinite(costs).any():
            return 0
        column, row = draw_translation(costs, self.randomness * self._variance, self.rng)
        top, left = row + self._first(region)[0], column + self._first(region)[1]
        height, width = self.colors.shape[:2]
        window = self._inside((top, top + height, left, left + width), region)
        return self.work.lay_patch(window, (window[2] - left, window[0] - top), forced_pixel=forced_pixel)

    def assemble_output(
        self,
        passes: int,
        progress: Callable[[float], None],
        choose: Callable[[SeamHeat], Window] = SeamHeat.find_worst,
        forced: bool = False,
    ) -> None:
        """Fill the output line by line, then cover known regions again, pass by pass, until a pass does not pay.

        A pass has as many steps as the output holds regions. It pays if it reduces the cost of all seams by at least
        :data:`LEAST_GAIN`; one that increases the cost is undone.

        Parameters
        ----------
        passes
            The most passes after the filling.
        progress
            Is called with the share of the work that is done.
        choose
            Returns the next region of a pass.
        forced
            Whether the pixel of a region whose seams cost most must show the new patch (section 3.2). Otherwise no step
            of a pass increases the cost.
        """
        work, filled = self.work, 1 / (1 + passes)
        while (region := self.find_unknown()) is not None:
            self.cover_region(region)
            progress(filled * region[0] / work.shape[0])
        if not passes:
            return
        heat = SeamHeat(work, self.size)
        reach = max(whole - part for whole, part in zip(self.colors.shape[:2], self.size, strict=True))
        steps = math.ceil(math.prod(work.shape) / math.prod(self.size))
        for number in range(passes):
            before, kept = work.cost, [array.copy() for array in (work.image, work.source, work.seams)]
            if before == 0:
                return
            for step in range(steps):
                region = choose(heat)
                self.cover_region(region, _find_costliest_pixel(work, region) if forced else None)
                heat.update(region, reach)
                progress(filled * (1 + number + step / steps))
            after = work.cost
            if after > before:
                work.image, work.source, work.seams = kept
            if before - after <= LEAST_GAIN * before:
                return

    def _inside(self, window: Window, region: Window) -> Window:
        """Return the part of a window around a region that lies inside the output, or does not meet itself."""
        ends: list[int] = []
        for axis in (0, 2):
            side, (start, stop) = self.work.shape[axis // 2], window[axis : axis + 2]
            if not self.work.wrap:
                ends += [max(start, 0), min(stop, side)]
            else:
                reach = (side - 2 - (region[axis + 1] - region[axis])) // 2
                ends += [max(start, region[axis] - reach), min(stop, region[axis + 1] + reach)]
        return ends[0], ends[1], ends[2], ends[3]

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
        """Compare the sample with all known pixels that it overlaps, and its guide with that of the output."""
        top, left = self._first(region)
        ends = top + self._reach[0], left + self._reach[1]
        inside = self._inside((top, ends[0], left, ends[1]), region)
        part = slice(inside[0] - top, inside[1] - top), slice(inside[2] - left, inside[3] - left)
        pixels = self.work.pixels(inside)

        def compare(patch: EntirePatch, values: Features, known: Mask) -> tuple[Costs, Costs]:
            seen, window = np.zeros(self._reach, np.bool_), np.zeros((*self._reach, values.shape[2]), np.int32)
            seen[part], window[part] = known, values
            costs, areas = patch.compute_costs(window, seen)
            return costs / np.maximum(areas, 1), areas

        costs, areas = compare(self._entire, self.work.read(self.colors, inside), self.work.known[pixels])
        considered = areas >= self.least_overlap * areas.max()
        if self.guide is not None:
            guided, _ = compare(self._entire_guide, self.guide[0][pixels], np.ones_like(self.work.known[pixels]))
            costs = costs + guided
        return np.where(considered, costs, np.inf)

    def _compare_window(self, region: Window) -> Costs:
        """Compare a window around the region with all parts of the sample; the sample covers the window completely."""
        window: list[int] = []
        for axis in (0, 1):
            start, stop = region[2 * axis], region[2 * axis + 1]
            more = min(self.margin[axis], (self.colors.shape[axis] - self.size[axis]) // 2)
            window += [start - more, stop + more]
        inside = self._inside((window[0], window[1], window[2], window[3]), region)
        pixels = self.work.pixels(inside)
        known, values = self.work.known[pixels], self.work.read(self.colors, inside)
        compared = max(int(known.sum()), 1)
        if self.guide is not None:
            values, compared = np.concatenate([values, self.guide[0][pixels]], -1), known.size
        sums = self._parts.compute_costs(values, known)
        costs = np.full(self._counts, np.inf)
        # A part that starts in row r of the sample lies there at translation y0 - r of the sample's first pixel.
        top, left = self._first(region)
        rows, columns = inside[0] - top - np.arange(sums.shape[0]), inside[2] - left - np.arange(sums.shape[1])
        costs[np.ix_(rows, columns)] = sums / compared
        return costs

    def _shown(self, region: Window) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the translations, as rows and columns of the costs, that are shown in a known region."""
        top, left = self._first(region)
        x, y = np.moveaxis(self.work.origin(region), -1, 0)
        rows, columns = np.ogrid[region[0] : region[1], region[2] : region[3]]
        rows, columns = rows - y - top, columns - x - left
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
    def _entire_guide(self) -> EntirePatch:
        assert self.guide is not None
        return EntirePatch(self.guide[1], self._counts)

    @cached_property
    def _parts(self) -> Translations:
        values = self.colors if self.guide is None else np.concatenate([self.colors, self.guide[1]], -1)
        return Translations(values, self.colors.shape[2])

    @cached_property
    def _variance(self) -> float:
        return summed_variance(self.colors)


def _find_costliest_pixel(work: Patchwork, region: Window) -> tuple[int, int]:
    """Return the (y, x) of the pixel of a region whose links to the right and below cost most."""
    pixels = work.pixels(region)
    y, x = divmod(int(work.seams[:, pixels[0], pixels[1]].sum(0).argmax()), region[3] - region[2])
    return region[0] + y, region[2] + x


@dataclass(frozen=True, eq=False)
class EntirePatch:
    """The translations of a whole patch over an output that is only partly known (entire-patch matching).

    Parameters
    ----------
    patch
        ``int32 (H, W, C)``: the whole sample. Sums of squares over it must be below 2^47.
    counts
        (rows, columns): the number of translations that are compared along each axis.
    """

    patch: Features
    counts: tuple[int, int]

    def compute_costs(self, window: Features, known: Mask) -> tuple[Costs, Costs]:
        """Compare the patch with the known pixels that it overlaps, at each translation.

        Parameters
        ----------
        window
            ``int32 (H + rows - 1, W + columns - 1, C)``: the part of the output that the patch can reach.
        known
            ``bool (H + rows - 1, W + columns - 1)``: the known pixels. Those beyond the output's edges are unknown.

        Returns
        -------
        costs
            ``(rows, columns)``, exact: the sums of squared differences, at each position of the patch's first pixel in
            the window. The paper's C(t) is this sum over the area.
        areas
            ``(rows, columns)``: the number of known pixels that the patch overlaps.

        Notes
        -----
        With M = 1 at known pixels, the sum over M (O - I)^2 is that of M O^2, a box sum, minus twice the correlation of
        M O with I, plus the correlation of M with I^2. The time is O(C n log n) for windows of n pixels.
        """
        size, channels = (self.patch.shape[0], self.patch.shape[1]), self.patch.shape[2]
        planes = np.empty((channels + 1, *known.shape))
        np.multiply(np.moveaxis(window, -1, 0), known, out=planes[:channels])
        energy = box_sums(np.einsum("chw,chw->hw", planes[:channels], planes[:channels]), size)
        planes[:channels] *= -2
        planes[channels] = known
        products = self._products.correlate(self._products.transform(planes), self._spectra, self.counts)
        return energy + products, box_sums(known, size)

    @cached_property
    def _products(self) -> FourierProducts:
        return FourierProducts((self.patch.shape[0] + self.counts[0] - 1, self.patch.shape[1] + self.counts[1] - 1))

    @cached_property
    def _spectra(self) -> Spectra:
        """The spectra of the patch's channels, and last that of its squares, summed over channels."""
        planes = np.moveaxis(self.patch, -1, 0)
        return self._products.transform(np.stack([*planes, (planes.astype(np.int64) ** 2).sum(0)]))
