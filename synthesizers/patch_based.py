"""Patch-based sampling: square patches, matched in their boundary zones and feathered (method ``patch-based``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.plugins.forms import Synthesis, Task

from .canvas.canvas import Box, Canvas, ExactPatch, feather_weights
from .gap_filling.holes import leaves_out
from .matching.frame_matching import FrameMatcher, frame_mask
from .patch_laying.raster_order import (
    LARGEST_SHARE,
    Place,
    RasterGrid,
    Spot,
    check_patch,
    choose_size,
    cover,
    draw_within,
)
from .pixel_growing.neighbor_search import FARTHEST, LANES, KdTree, TreePoints

NEIGHBORS = 40
"""Number of patches that the k-d tree finds."""
SEARCH_ERROR = 1.0
"""The tree may return a patch whose distance is up to 1 + this times that of the one which it stands for."""
DIMENSIONS = 16
"""Number of principal components."""
FITTED = 256
"""Number of patches, evenly spaced over the sample, from which the components are computed."""
SCALE = 1 << 12
"""The components are rounded to multiples of 1 / SCALE."""
LONGER = 1.05
"""Rounded components are at most this long, and at most so far from orthogonal."""


@leaves_out
@dataclass(frozen=True)
class PatchBased:
    """Patch-based sampling (Liang, Liu, Xu, Guo, Shum 2001).

    Square patches of the sample are laid in scan-line order, so that the boundary zone of each overlaps the boundary
    zones of the patches laid before: at its left, at its top, or both in the shape of an L. A patch fits if the root
    of the mean squared difference over the zone is below d_max, which is epsilon times the root of the mean squared
    pixel value of the output there. One of the patches that fit is drawn, all with the same probability. If there is
    none, one of those of least distance is drawn. Then the patch is feathered into the zone: its weight increases
    linearly from its border. The first patch is drawn from all patches of the sample.

    The defaults of ``patch`` and ``zone`` had the best mean quality on texture models. The default of ``epsilon`` is
    the largest value tried at which four draws of each perfectly regular figure of ``report2004`` keep their lattice.
    The paper's zone and epsilon are the preset ``paper``. Epsilon is relative to the brightness of pixels, not to their
    contrast, so that 0.2 accepts almost every patch of a texture of low contrast; 0.02 still accepts patches that are
    misplaced by a pixel or two. A zone of 4 px misses the lattice of many textures; one of 16 px blurs a large part of
    the output.

    The paper starts at the lower left; here the upper left comes first, which makes no difference to a texture. The
    paper searches in three steps, each of which can be left out: principal components, a k-d tree for each of the
    three configurations of sides, and a quadtree pyramid, which compares coarse images first. ``search="kdtree"`` has
    the first two. The pyramid is left out, because Fourier transforms compare all patches exactly in the time that the
    tree takes.

    Parameters
    ----------
    patch
        Side of a patch in px. 0: automatic, half the sample's shorter side. (The paper: a quarter to a half.)
    zone
        Width of the boundary zone in px, from 1 to half a patch. (The paper: 4.)
    epsilon
        The largest relative error of a patch that fits, 0 to 1e6. (The paper: 0.2.) 0: always one of the patches of
        least distance.
    search
        ``"exhaustive"``: all patches are compared. ``"kdtree"``: only the 40 nearest neighbors that the tree
        finds. A neighbor may be up to twice as far, in the space of the components, as the one that it stands for.

    References
    ----------
    .. [1] Lin Liang, Ce Liu, Ying-Qing Xu, Baining Guo, Heung-Yeung Shum. "Real-Time Texture Synthesis by Patch-Based
           Sampling." ACM Transactions on Graphics 20(3):127-150, 2001. :DOI:`10.1145/501786.501787`
    """

    patch: int = 0
    zone: int = 8
    epsilon: float = 0.01
    search: Literal["exhaustive", "kdtree"] = "exhaustive"

    wraps: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "patches without a lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "1"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"zone": 4, "epsilon": 0.2, "search": "kdtree"},
    }
    patch_shape: ClassVar[str] = "user defined, rectangular patch"
    patch_placement: ClassVar[str] = "patch grids"
    patch_stitching: ClassVar[str] = "image-feathering"
    paper: ClassVar[str] = """@article{liang2001real,
  author = {Lin Liang and Ce Liu and Ying-Qing Xu and Baining Guo and Heung-Yeung Shum},
  title = {Real-Time Texture Synthesis by Patch-Based Sampling},
  journal = {ACM Transactions on Graphics},
  volume = {20},
  number = {3},
  pages = {127--150},
  year = {2001}
}"""

    def __post_init__(self) -> None:
        require_ranges(self, zone=(1, math.inf), epsilon=(0, LARGEST_SHARE))
        check_patch("patch", self.patch, "zone", self.zone)

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            If the sample does not hold a patch.
        """
        patch = choose_size("patch", self.patch, "zone", self.zone, task.sample.shape)
        grid = RasterGrid.of(task, patch, self.zone)
        matcher = FrameMatcher(task.sample, grid.size)
        tree = lru_cache(maxsize=3)(lambda hole: ZoneTree(matcher, hole))

        def choose(old: NDArray[np.float32], hole: Box) -> Place:
            limit = squared_limit(old[frame_mask(hole, grid.size)], self.epsilon)
            if self.search == "exhaustive":
                index = draw_within(-matcher.rate_everywhere(old, hole), limit, task.rng)
                y, x = divmod(index, matcher.search_shape[1])
            else:
                places = tree(hole).find_nearest(old, NEIGHBORS, SEARCH_ERROR)
                x, y = places[draw_within(-matcher.rate(old, hole, places), limit, task.rng)].tolist()
            return x, y

        def feather(canvas: Canvas, spot: Spot, patch: ExactPatch) -> None:
            canvas.blend(spot.window, patch, feather_weights(grid.size, self.zone, spot.sides), self.zone + 1)

        return cover(task, grid, choose, feather)


def squared_limit(zone: NDArray[np.float32], epsilon: float) -> float:
    """Return the largest sum of squared differences of a patch that fits a boundary zone.

    Liang et al. 2001, section 3: d_max = epsilon sqrt(sum of p^2 / A) for a zone of A pixels p, and the distance is the
    root of the mean squared difference over the same pixels. Squared and times A, this is epsilon^2 times the sum of
    p^2.

    Parameters
    ----------
    zone
        ``(n, C)``: the pixels of the output in the zone, whole numbers from 0 to 255.
    epsilon
        The relative error.
    """
    return epsilon**2 * float((zone.astype(np.float64) ** 2).sum())


@dataclass(frozen=True, eq=False)
class ZoneTree:
    """A k-d tree of the boundary zones of all patches of a sample, for one configuration of sides.

    Liang et al. 2001 reduce the zones by principal components and search them in a k-d tree, one for each
    configuration. Here the components are computed from :data:`FITTED` patches, because those of all patches cost more
    than the search saves. They are rounded once; all later arithmetic is in integers, so that which patch is nearest
    does not depend on the order of sums.

    Parameters
    ----------
    matcher
        The patches of the sample.
    hole
        The part of a patch that is not in its boundary zone.
    """

    matcher: FrameMatcher
    hole: Box

    def find_nearest(self, template: NDArray[np.float32], count: int, eps: float = 0.0) -> NDArray[np.int64]:
        """Return the patches whose boundary zones are nearest to that of a template, among the components.

        Parameters
        ----------
        template
            ``(size, size, C)``: whole numbers from 0 to 255.
        count
            Number of patches.
        eps
            The distance of each returned patch is at most 1 + eps times that of the one which an exact search returns
            in its stead.

        Returns
        -------
        NDArray
            ``(n, 2)``, n at most ``count``: (x, y) of the patches, the nearest first.
        """
        frame = np.where(frame_mask(self.hole, self.matcher.size)[..., np.newaxis], template, 0).astype(np.float64)
        query = self._round(np.tensordot(self._components, frame, 3)[np.newaxis])
        numbers = self._tree.nearest(query, min(count, len(self._products)), eps)[0][0]
        y, x = np.divmod(numbers[numbers >= 0], self.matcher.search_shape[1])
        return np.stack([x, y], -1)

    @cached_property
    def _components(self) -> NDArray[np.float64]:
        """The strongest components times :data:`SCALE`, ``(d, size, size, C)``: whole numbers, 0 in the hole."""
        size, (rows, columns) = self.matcher.size, self.matcher.search_shape
        shape = (size, size, self.matcher.values.shape[2])
        patches = sliding_window_view(self.matcher.values, shape)[:, :, 0]
        chosen = np.unique(np.linspace(0, rows * columns - 1, FITTED).astype(np.int64))
        vectors = patches[np.divmod(chosen, columns)].astype(np.float64)
        y0, y1, x0, x1 = self.hole
        vectors[:, y0:y1, x0:x1] = 0
        # There are fewer patches than values, so the components follow from the products of the patches.
        centered = vectors.reshape(len(vectors), -1) - vectors.reshape(len(vectors), -1).mean(0)
        _, weights = np.linalg.eigh(centered @ centered.T)
        matrix = weights[:, ::-1][:, :DIMENSIONS].T @ centered
        matrix /= np.maximum(np.linalg.norm(matrix, axis=1, keepdims=True), 1.0)
        peaks = np.take_along_axis(matrix, np.abs(matrix).argmax(1)[:, np.newaxis], 1)
        return np.asarray(np.rint(matrix * np.where(peaks < 0, -SCALE, SCALE)).reshape(-1, *shape))

    @cached_property
    def _products(self) -> NDArray[np.int64]:
        """The product of each patch with each component, ``(n, d)``."""
        each = [self.matcher.correlate_everywhere(component).ravel() for component in self._components]
        return np.stack(each, -1).astype(np.int64)

    @cached_property
    def _tree(self) -> KdTree:
        return KdTree.build(self._round(self._products))

    def _round(self, products: NDArray[Any]) -> TreePoints:
        """Return products as points of the tree, in quarters of a gray level, or coarser if the zone is very large."""
        values = int(frame_mask(self.hole, self.matcher.size).sum()) * self.matcher.values.shape[2]
        unit = max(SCALE // 4, math.ceil(SCALE * LONGER * 255 * math.sqrt(values) / FARTHEST))
        away = products.astype(np.int64) - self._products.sum(0) // len(self._products)
        points = np.zeros((len(products), -(-DIMENSIONS // LANES) * LANES), np.int16)
        points[:, : away.shape[1]] = away // unit
        return points
