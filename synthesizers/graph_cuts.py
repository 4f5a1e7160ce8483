"""Graph cut textures (method ``graph-cuts``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from nrbench.errors import require, require_ranges
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task

from .canvas.canvas import Window
from .gap_filling.holes import leaves_out
from .patchwork.patchwork import LEAST_OVERLAP, Patchwork, Placement, SeamHeat, WholePatches, to_gray_levels

LEAST_REGION = 3
"""px: least side of a region that a patch covers."""
MARGIN = 8
"""In sub-patch matching the compared window is larger than the region by 1 / MARGIN of its side on each side ("slightly
larger than the error region")."""
MOST_RANDOM = 1e6
"""The largest k. It makes all translations almost equally probable."""
LEAST_FEATHER = 0.1
"""px: the least width of feathering. At this width the weight of a pixel's neighbor is 2e-22."""


@leaves_out
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
    refine: Literal["worst", "random", "minima", "extremes"] = "worst"
    passes: int = 1
    normalized: bool = True
    feather: float = 1.0

    wraps: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "patches without a lattice"
    maps: ClassVar[str] = "source"
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
        patches.assemble_output(self.passes, task.progress, lambda heat: self._choose_region(heat, task.rng), True)
        image, source, blended = work.feathered(self.feather)
        task.progress(1.0)
        return Synthesis(image, source=source, blended=blended)

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

    def _choose_region(self, heat: SeamHeat, rng: np.random.Generator) -> Window:
        if self.refine == "worst":
            return heat.find_worst()
        if self.refine == "random":
            return heat.draw_window(rng)
        return heat.draw_extreme(rng, maxima=self.refine == "extremes")
