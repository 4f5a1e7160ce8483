"""Graph cut textures (method ``graph-cuts``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require, require_ranges
from nrbench.imaging.boxes import box_sums
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task

from .canvas.canvas import Mask, Window
from .matching.frame_matching import FourierProducts, Spectra
from .patchwork.patchwork import (
    Costs,
    Features,
    Patchwork,
    SeamHeat,
    Translations,
    draw_translation,
    summed_variance,
    to_gray_levels,
)

Refine = Literal["worst", "random", "minima", "extremes"]

LEAST_REGION = 3
"""px: least side of a region that a patch covers."""
LEAST_OVERLAP = 0.25
"""Least overlap with known pixels, as a share of the largest overlap of all translations that cover a region. The paper
normalizes by the overlap and names no least one; the mean over a few pixels would then decide."""
MARGIN = 8
"""In sub-patch matching the compared window is larger than the region by 1 / MARGIN of its side on each side ("slightly
larger than the error region")."""
MOST_RANDOM = 1e6
"""The largest k. It makes all translations almost equally probable."""
LEAST_FEATHER = 0.1
"""px: the least width of feathering. At this width the weight of a pixel's neighbor is 2e-22."""
LEAST_GAIN = 0.01
"""A pass of refinement pays if it reduces the total cost of the seams by at least this share."""
Placement = Literal["entire", "sub-patch", "random"]


@dataclass(frozen=True)
class GraphCuts:
    """Graph cut textures (Kwatra, Schödl, Essa, Turk, Bobick 2003).

    The patch is the whole sample. It is laid over the output at one translation after the other, and a minimum cut
    determines which of its pixels are shown (section 3). Old seams are accounted for: they may be covered, and their
    costs count where they stay (section 3.1; :class:`~nrbench.synthesizers.patchwork.patchwork.Patchwork`). First the
    output is filled. The next region is the one at the first unknown pixel, line by line. Then regions are covered
    again, until it does not pay: a pass has as many steps as the output holds regions, and the last pass is the first
    one that reduces the cost of all seams by less than 1 %. A pass that increases it is undone. Only translations at
    which the sample covers the region completely are considered (section 4). Finally the seams are feathered
    (section 5).

    The method does not use a lattice. The translations of least cost often keep the period of the texture, not always.

    The paper does not fix the size of a region, the order of the filling, or the least overlap of entire-patch
    matching. Here a region is half of the sample's side, the order is line by line, and the least overlap is a quarter
    of the largest one of all translations considered. In a known region the translations that are already shown there
    are not considered, because they fit best and change nothing. The paper varies k from 0.001 to 1; 0.01 is ours. The
    defaults are the variants of the paper: on our models they worked best, or as well as the others.

    All cuts are computed by one solver,
    :func:`~nrbench.synthesizers.canvas.seam_kernels.cut_links`: on patches of 128 x 128 px with old seams it takes 1 to
    3 ms and ``scipy.sparse.csgraph.maximum_flow`` 18 to 50 ms. A shortest path in the planar dual (Dijkstra) takes 3 to
    4 ms instead of 10 to 22 ms, but only for strips without old seams inside, of which an output has few.

    Parameters
    ----------
    placement
        How a translation is chosen (section 4). ``"entire"``: the whole sample is compared with all known pixels that
        it overlaps, by the mean squared difference; the paper's choice for structured textures. ``"sub-patch"``: only
        the region and its surroundings are compared; the paper's choice for stochastic textures. The paper sums the
        differences there; here they are averaged, so that k has the same meaning. ``"random"``: all translations are
        equally probable.
    randomness
        k, 0 to 1e6: translations are drawn with a probability proportional to exp(-C / (k sigma^2)); C is the mean
        squared difference, sigma^2 is the variance of the sample. 0: one of the least C. It has no effect if the
        placement is random.
    region
        Side of a region, as a share of the sample's side; above 0, at most 0.8. The rest of the side is the range of
        the translations, which should span a period of the texture: with 0.5, samples of two periods are enough. With
        larger regions fewer patches are laid.
    refine
        Which region is covered again. ``"worst"``: the one whose seams cost most; the cost counts half for each earlier
        try. ``"random"``, ``"minima"``, ``"extremes"``: a random one of all regions, of those at local minima of the
        cost of their seams, or of those at local minima and maxima (figure 46 of Lin, Hays, Wu, Kwatra, Liu 2004).
    passes
        The most passes of refinement, 0 or more. 0: the output is only filled. ``preset=paper`` has 4. More than one
        cost time and gain nothing that can be measured: on ``core``, three draws, the mean quality is 0.54, 0.55, 0.55
        and 0.55 with 0, 1, 2 and 4 passes, each with an interval of 0.06 to both sides.
    normalized
        Whether the cost of a seam is divided by the gradients along it (section 5), so that seams prefer places where
        the texture varies strongly.
    feather
        Standard deviation in px of the Gaussian that weights the patches around a pixel near a seam (section 5); 0.1
        to 8. 0: every pixel is a copy.

    References
    ----------
    .. [1] Vivek Kwatra, Arno Schödl, Irfan Essa, Greg Turk, Aaron Bobick. "Graphcut Textures: Image and Video Synthesis
           Using Graph Cuts." ACM Transactions on Graphics 22(3):277-286, 2003. :DOI:`10.1145/882262.882264`
    """

    placement: Placement = "entire"
    randomness: float = 0.01
    region: float = 0.5
    refine: Refine = "worst"
    passes: int = 1
    normalized: bool = True
    feather: float = 1.0

    wraps: ClassVar[bool] = True
    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "patches without a lattice"
    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "placement": "entire",
            "randomness": 0.01,
            "refine": "worst",
            "normalized": True,
            "passes": 4,
        }
    }
    patch_shape: ClassVar[str] = "input texture image"
    patch_placement: ClassVar[str] = "random or maximal correlation locations, placement={placement}"
    patch_stitching: ClassVar[str] = "graph cut & blending"
    paper: ClassVar[str] = """@article{kwatra2003graphcut,
  author = {Kwatra, Vivek and Sch{\\"o}dl, Arno and Essa, Irfan and Turk, Greg and Bobick, Aaron},
  title = {Graphcut Textures: Image and Video Synthesis Using Graph Cuts},
  journal = {ACM Transactions on Graphics},
  volume = {22},
  number = {3},
  pages = {277--286},
  year = {2003}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, randomness=(0, MOST_RANDOM), passes=(0, math.inf), feather=(0, 8))
        require(0 < self.region <= 0.8, f"region {self.region}; choose a share of the sample above 0, at most 0.8")
        soft = self.feather == 0 or self.feather >= LEAST_FEATHER
        require(soft, f"feather {self.feather}; choose 0 (copies only), or {LEAST_FEATHER:g} to 8 px")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`GraphCuts`.

        Raises
        ------
        Refused
            If a region would be smaller than 3 px.
        """
        work, patches = self.prepare(task)
        regions = math.prod(task.shape) / math.prod(patches.size)
        filled = 1 / (1 + self.passes)
        while (region := patches.find_unknown()) is not None:
            patches.cover_region(region)
            task.progress(filled * region[0] / task.shape[0])
        self._refine(work, patches, task, math.ceil(regions), filled)
        image, source = work.feathered(self.feather)
        task.progress(1.0)
        return Synthesis(image, source=source)

    def prepare(self, task: Task) -> tuple[Patchwork, WholePatches]:
        """Return the empty output, and what lays patches over it. Exceptions are those of :meth:`synthesize`."""
        size = self._region_size(task)
        colors = to_gray_levels(task.sample)
        work = Patchwork(task.sample, colors, task.shape, self.normalized, wrap=task.tileable)
        margin = size[0] // MARGIN, size[1] // MARGIN
        return work, WholePatches(work, colors, size, self.placement, self.randomness, LEAST_OVERLAP, margin, task.rng)

    def _region_size(self, task: Task) -> Shape:
        """Return the (height, width) of a region, px."""
        rows, columns = (round(self.region * side) for side in task.sample.shape[:2])
        if min(rows, columns) < LEAST_REGION:
            height, width = task.sample.shape[:2]
            least = math.ceil(LEAST_REGION / min(height, width) * 100) / 100
            raise Refused(
                f"the sample is {width}x{height} px: a region of {self.region:g} of it is less than {LEAST_REGION} px "
                f"high or wide; choose region >= {least:g}, or a larger sample"
            )
        ring = 2 if task.tileable else 0
        return min(rows, task.shape[0] - ring), min(columns, task.shape[1] - ring)

    def _refine(self, work: Patchwork, patches: WholePatches, task: Task, steps: int, filled: float) -> None:
        """Cover regions again, pass by pass, until a pass does not pay."""
        heat = SeamHeat(work, patches.size)
        reach = max(whole - part for whole, part in zip(task.sample.shape[:2], patches.size, strict=True))
        for number in range(self.passes):
            before, kept = work.cost, [array.copy() for array in (work.image, work.source, work.seams)]
            if before == 0:
                return
            for step in range(steps):
                region = self._choose_region(heat, task.rng)
                patches.cover_region(region, _costliest_pixel(work, region))
                heat.update(region, reach)
                task.progress(filled * (1 + number + step / steps))
            after = work.cost
            if after > before:
                work.image, work.source, work.seams = kept
            if before - after <= LEAST_GAIN * before:
                return

    def _choose_region(self, heat: SeamHeat, rng: np.random.Generator) -> Window:
        if self.refine == "worst":
            return heat.find_worst()
        if self.refine == "random":
            return heat.draw_window(rng)
        return heat.draw_extreme(rng, maxima=self.refine == "extremes")


def _costliest_pixel(work: Patchwork, region: Window) -> tuple[int, int]:
    """Return the (y, x) of the pixel of a region whose links to the right and below cost most."""
    pixels = work.pixels(region)
    y, x = divmod(int(work.seams[:, pixels[0], pixels[1]].sum(0).argmax()), region[3] - region[2])
    return region[0] + y, region[2] + x


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
        For ``"entire"``: values that are compared at all pixels of the output that the sample overlaps, known or not,
        of the output and of the sample; their mean squared difference is added to C(t).
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
            See :meth:`~nrbench.synthesizers.patchwork.patchwork.Patchwork.lay_patch`.
        """
        costs = self._rate_translations(region)
        if not np.isfinite(costs).any():
            return 0
        column, row = draw_translation(costs, self.randomness * self._variance, self.rng)
        top, left = row + self._first(region)[0], column + self._first(region)[1]
        height, width = self.colors.shape[:2]
        window = self._inside((top, top + height, left, left + width), region)
        return self.work.lay_patch(window, (window[2] - left, window[0] - top), forced_pixel=forced_pixel)

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
        known = self.work.known[self.work.pixels(inside)]
        sums = self._parts.compute_costs(self.work.read(self.colors, inside), known)
        costs = np.full(self._counts, np.inf)
        # A part that starts in row r of the sample lies there at translation y0 - r of the sample's first pixel.
        top, left = self._first(region)
        rows, columns = inside[0] - top - np.arange(sums.shape[0]), inside[2] - left - np.arange(sums.shape[1])
        costs[np.ix_(rows, columns)] = sums / max(int(known.sum()), 1)
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
        return Translations(self.colors, self.colors.shape[2])

    @cached_property
    def _variance(self) -> float:
        return summed_variance(self.colors)


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
