"""Pixel-based synthesis: an output grown pixel by pixel from the sample's pixels whose neighborhoods fit best."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Refused, SourceMap, Task

from .kdtree import KdTree
from .neighborhoods import Integers, Layers, Neighborhood
from .pixel_growth_kernels import CanvasArrays, QueryArrays, StockArrays, grow
from .projection import Projection

Search = Literal["ann", "exhaustive", "k-coherence"]

BAND = 8
"""Rows that are synthesized between two reports of progress."""
SIMILAR = 4
LEAF = 8


@dataclass(frozen=True)
class Rules:
    """How sources are chosen.

    Parameters
    ----------
    search, coherence, eps, dimensions, similar
        See :class:`~nrbench.synthesizers.fftm_pixel.FftmPixel`.
    """

    search: Search
    coherence: float
    eps: float
    dimensions: int
    similar: int | None

    def __post_init__(self) -> None:
        _check(
            self.coherence == 0 or 1 <= self.coherence < np.inf, f"coherence {self.coherence}; choose 0, or 1 or more"
        )
        _check(0 <= self.eps < np.inf, f"eps {self.eps}; choose 0 or more")
        _check(
            self.search == "ann" or self.eps == 0,
            f"eps {self.eps} with search {self.search!r}; choose search 'ann', or leave it out",
        )
        _check(self.dimensions >= 0, f"dimensions {self.dimensions}; choose 1 or more, or 0 for all")
        _check(
            self.search == "k-coherence" or self.similar is None,
            f"similar {self.similar} with search {self.search!r}; choose search 'k-coherence', or leave it out",
        )
        _check(self.similar is None or 1 <= self.similar <= 64, f"similar {self.similar}; choose from 1 to 64")


@dataclass(frozen=True, eq=False)
class Candidates:
    """The sample's pixels that may be sources.

    Parameters
    ----------
    pixels
        ``(n,)``: row * width + column.
    ranks
        ``(n,)``: of two that fit equally well the one of lower rank is taken.
    groups
        ``(n,)``: which may stand for which; None: any for any.
    """

    pixels: Integers
    ranks: Integers
    groups: Integers | None = None

    def stock(self, layers: Layers, neighborhood: Neighborhood, rules: Rules, weight: float) -> Stock:
        """Return the candidates ready to be searched, O(n D dimensions + n log n).

        Parameters
        ----------
        layers
            The sample, and its mask.
        neighborhood
            What is compared.
        rules
            How sources are chosen.
        weight
            What the mask's squared differences count.
        """
        vectors = neighborhood.vectors(layers, self.pixels)
        projection = Projection.of(vectors, neighborhood.weights(weight, layers.shape[3]), rules.dimensions)
        points = projection.points(vectors)
        leaf = len(points) if rules.search == "exhaustive" else LEAF
        tree = KdTree.of(points, self.ranks, self.groups, leaf)
        similar = np.zeros((len(points), 0), np.int64)
        if rules.search == "k-coherence":
            similar = _similar(tree, points, rules.similar or SIMILAR, self.groups)
        return Stock(layers, neighborhood, rules, projection, tree, self.pixels, similar)


@dataclass(frozen=True, eq=False)
class Stock:
    """The sample's neighborhoods, ready to be searched.

    Parameters
    ----------
    layers, neighborhood, rules
        As in :meth:`Candidates.stock`.
    projection
        Neighborhood vectors to points.
    tree
        Of the points of ``pixels``.
    pixels
        ``(n,)``: row * width + column.
    similar
        ``(n, k)``: for each place of the tree those that are most like it, -1 where there are fewer.
    """

    layers: Layers
    neighborhood: Neighborhood
    rules: Rules
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

    def query(self, layers: Layers) -> QueryArrays:
        """Return what kernels make a query with, in the layers of an output."""
        steps, projection = self.neighborhood.steps(layers), self.projection
        return steps, projection.matrix, projection.shift, projection.bits, self.neighborhood.causes


def sources(layers: Layers, neighborhood: Neighborhood, rng: np.random.Generator) -> Candidates:
    """Return the pixels of a sample whose neighborhoods are complete, in a random order of preference.

    Raises
    ------
    Refused
        Where there are none.
    """
    _, height, width, _ = layers.shape
    pixels = neighborhood.complete((height, width))
    if not len(pixels):
        left, top, right, bottom = neighborhood.box
        raise Refused(
            f"a neighborhood takes {left + right + 1}x{top + bottom + 1} px, the sample is {width}x{height} px"
        )
    return Candidates(pixels, rng.permutation(len(pixels)))


def scattered(layers: Layers, shape: tuple[int, int], rng: np.random.Generator) -> Layers:
    """Return layers of ``shape`` (height, width) of random pixels of a sample's."""
    colors = layers.reshape(len(layers), -1, layers.shape[3])
    return np.ascontiguousarray(colors[:, rng.integers(colors.shape[1], size=shape)])


def _similar(tree: KdTree, points: NDArray[np.int16], k: int, groups: Integers | None) -> Integers:
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
        ``uint8 (L, P, Q, C)``: what stands for the texture before it is synthesized, and the mask; written.
    corner
        Rows and columns of the border at the top and left.
    wraps
        Whether neighborhoods go on at the opposite side: the border repeats what stands there.
    """

    def __init__(self, task: Task, layers: Layers, corner: tuple[int, int], wraps: bool = False) -> None:
        self.task, self.layers, self.corner, self.wraps = task, layers, corner, wraps
        self.sources = np.full(layers.shape[1:3], -1, np.int64)
        self.told = 0.0

    @property
    def arrays(self) -> CanvasArrays:
        """What kernels see."""
        period = self.task.shape if self.wraps else self.sources.shape
        return self.layers.reshape(-1), self.sources, np.array([*period, *self.corner])

    def grow(self, stock: Stock, rows: range, columns: range, groups: Integers | None = None) -> None:
        """Synthesize some rows and columns of the output in scan-line order.

        Parameters
        ----------
        stock
            What the pixels are taken from.
        rows, columns
            Of the output.
        groups
            ``(height, width)`` of the output: from which group of the stock; None: there is but one.
        """
        query, rules = stock.query(self.layers), stock.rules
        for start in range(rows.start, rows.stop, BAND):
            box = np.array([start, min(start + BAND, rows.stop), columns.start, columns.stop])
            among = np.zeros((box[1] - start, len(columns)), np.int64)
            if groups is not None:
                among[:] = groups[start : box[1], columns.start : columns.stop]
            grow(
                self.arrays, stock.arrays, query, stock.tree.arrays, stock.tree.roots, among, box,
                float(rules.coherence) ** 2, (1.0 + rules.eps) ** 2, rules.search != "k-coherence",
            )  # fmt: skip
            self.told = max(self.told, float(box[1]) / self.task.shape[0])
            self.task.progress(self.told)

    def finished(self) -> tuple[Image, SourceMap]:
        """Return the output and its source map."""
        (top, left), (height, width) = self.corner, self.task.shape
        image = self.layers[0, top : top + height, left : left + width] / np.float32(255)
        y, x = np.divmod(self.sources[top : top + height, left : left + width], self.task.sample.shape[1])
        return np.asarray(image, np.float32), np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)


_check = checker("pixels")
