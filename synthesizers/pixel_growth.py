"""Pixel-based synthesis: an output grown pixel by pixel from the sample's pixels whose neighborhoods fit best."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.kdtree import KdTree
from nrbench.imaging.projection import Projection
from nrbench.synthesis import SourceMap, Task
from nrbench.texture import Shape

from .neighborhoods import Integers, Layers, Neighborhood
from .pixel_growth_kernels import CanvasArrays, StockArrays, grow

Search = Literal["ann", "exhaustive", "k-coherence"]

BAND = 8
"""Rows that are synthesized between two reports of progress."""


@dataclass(frozen=True)
class Rules:
    """How sources are chosen.

    Parameters
    ----------
    search
        See :class:`~nrbench.synthesizers.fftm_pixel.FftmPixel`, like all the rest.
    eps, similar, dimensions, coherence
        Coherence 0: off.
    """

    search: Search
    eps: float
    similar: int
    dimensions: int
    coherence: float


@dataclass(frozen=True, eq=False)
class Stock:
    """The sample's neighborhoods, ready to be searched.

    Parameters
    ----------
    layers
        The sample, and its mask.
    neighborhood
        What is compared.
    projection
        Neighborhood vectors to points.
    tree
        Of the points of ``pixels``.
    pixels
        ``(n,)``: those whose neighborhoods are complete, row * width + column.
    similar
        ``(n, k)``: for each place of the tree those that are most like it.
    """

    layers: Layers
    neighborhood: Neighborhood
    projection: Projection
    tree: KdTree
    pixels: Integers
    similar: Integers

    @cached_property
    def arrays(self) -> StockArrays:
        """What kernels see."""
        _, height, width, channels = self.layers.shape
        placed = self.pixels[self.tree.order]
        places = np.full(height * width, -1, np.int64)
        places[placed] = np.arange(len(placed))
        return self.layers[0].reshape(-1, channels), placed, places, self.similar, width


def stock_of(
    layers: Layers,
    neighborhood: Neighborhood,
    rules: Rules,
    weight: float,
    pixels: Integers,
    ranks: Integers,
    groups: Integers | None = None,
) -> Stock:
    """Build a stock, O(n D dimensions + n log n).

    Parameters
    ----------
    layers, neighborhood, rules
        As in :class:`Stock`.
    weight
        What the mask's squared differences count.
    pixels
        Those that may be sources.
    ranks, groups
        ``(n,)``: which of two that fit equally well is taken, and which may stand for which, see :class:`KdTree`.
    """
    vectors = neighborhood.vectors(layers, pixels)
    projection = Projection.of(vectors, neighborhood.weights(weight, layers.shape[3]), rules.dimensions)
    points = projection.points(vectors)
    tree = KdTree.of(points, ranks, groups, leaf=len(points) if rules.search == "exhaustive" else 8)
    similar = np.zeros((len(points), 0), np.int64)
    if rules.search == "k-coherence" and rules.similar:
        similar = _similar(tree, points, rules.similar, groups)
    return Stock(layers, neighborhood, projection, tree, pixels, similar)


def _similar(tree: KdTree, points: NDArray[np.int16], k: int, groups: Integers | None) -> Integers:
    """Return the places of the k others that are nearest to each place of the tree, -1 where there are fewer."""
    numbers, _ = tree.nearest(points, k + 1, groups=groups)
    own = numbers == np.arange(len(points))[:, np.newaxis]
    others = np.take_along_axis(numbers, np.argsort(own, 1, kind="stable"), 1)[:, :k]
    place = np.empty(len(points) + 1, np.int64)
    place[tree.order], place[-1] = np.arange(len(points)), -1
    return np.ascontiguousarray(place[others][tree.order])


class Growth:
    """An output while it grows, with the border that its first pixels' neighborhoods reach into.

    Parameters
    ----------
    task
        The sample, the output's shape, progress.
    layers
        ``uint8 (L, P, Q, C)``: what stands in the texture before it is synthesized, and the mask.
    corner
        Rows and columns of the border at the top and left.
    wraps
        Whether neighborhoods go on at the opposite side, and the border repeats what stands there.
    """

    def __init__(self, task: Task, layers: Layers, corner: tuple[int, int], wraps: bool = False) -> None:
        self.task, self.layers = task, np.ascontiguousarray(layers)
        self.corner, self.wraps = corner, wraps
        self.sources = np.full(layers.shape[1:3], -1, np.int64)

    @property
    def arrays(self) -> CanvasArrays:
        """What kernels see."""
        period = self.task.shape if self.wraps else self.sources.shape
        return self.layers.reshape(-1), self.sources, np.array([*period, *self.corner])

    def grow(
        self, stock: Stock, rules: Rules, rows: range, columns: range, groups: Integers | None, done: float = 1.0
    ) -> None:
        """Synthesize some rows and columns in scan-line order.

        Parameters
        ----------
        stock
            What the pixels are taken from.
        rules
            How they are chosen.
        rows, columns
            Of the output.
        groups
            ``(height, width)`` of the output: from which group of the stock. None: there is but one.
        done
            The progress to report at the end; 0 reports none.
        """
        projection = stock.projection
        steps, causes = stock.neighborhood.steps(self.layers), stock.neighborhood.causes
        query = steps, projection.matrix, projection.shift, projection.bits, causes
        for start in range(rows.start, rows.stop, BAND):
            stop = min(start + BAND, rows.stop)
            box = np.array([start, stop, columns.start, columns.stop])
            among = np.zeros((stop - start, len(columns)), np.int64)
            if groups is not None:
                among = np.ascontiguousarray(groups[start:stop, columns.start : columns.stop])
            grow(
                self.arrays, stock.arrays, query, stock.tree.arrays, stock.tree.roots, among, box,
                float(rules.coherence) ** 2, (1.0 + rules.eps) ** 2, rules.search != "k-coherence",
            )  # fmt: skip
            if done:
                self.task.progress(done * (stop - rows.start) / len(rows))

    def finished(self) -> tuple[Image, SourceMap]:
        """Return the output and its source map."""
        (top, left), (height, width) = self.corner, self.task.shape
        image = self.layers[0, top : top + height, left : left + width] / np.float32(255)
        numbers = self.sources[top : top + height, left : left + width]
        y, x = np.divmod(numbers, self.task.sample.shape[1])
        return image, np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)
