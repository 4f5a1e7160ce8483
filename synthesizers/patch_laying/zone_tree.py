"""Approximate search for the patches of a sample whose boundary zones fit: k-d trees of principal components."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..gap_filling.blocks import Box, box_slices
from ..gap_filling.matching import FrameMatcher, frame_mask
from ..pixel_growing.neighbor_search import FARTHEST, LANES, KdTree, TreePoints

DIMENSIONS = 16
"""Number of principal components."""
FITTED = 256
"""Number of patches, evenly spaced over the sample, from which the components are computed."""
SCALE = 1 << 12
"""The components are rounded to multiples of 1 / SCALE."""
LONGER = 1.05
"""Rounded components are at most this long, and at most so far from orthogonal."""


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
        vectors[(slice(None), *box_slices(self.hole))] = 0
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
