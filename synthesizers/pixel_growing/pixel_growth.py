"""Pixel-based synthesis: each output pixel is copied from the sample's pixel with the most similar neighborhood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require, require_ranges
from nrbench.imaging.convert import Image, to_bytes
from nrbench.plugins.forms import Refused, SourceMap, Task
from nrbench.plugins.parameters import SharedParameters

from .neighbor_search import Integers, KdTree, Projection
from .pixel_growing_kernels import CanvasArrays, NeighborhoodArrays, SampleArrays, grow_box

Layers = NDArray[np.uint8]
"""``uint8 (L, H, W, C)``: the texture, and (L = 2) its mask."""

BAND = 8
"""Number of rows that are synthesized between two reports of progress."""
SIMILAR = 4
"""Number of similar pixels for each continuation in search ``k-coherence``."""
SEARCH_OF_THE_PAPER: Final[Mapping[str, Any]] = {"search": "ann", "coherence": 2.5, "dimensions": 16}
"""The search of Nicoll et al. (2005), section 4.1, in terms of :class:`SearchParameters`. Their library favors the
neighbors of a source (figure 5) by an amount that they do not state; ``coherence`` stands for it."""
LEAF = 8
"""Largest number of points of a leaf of the k-d tree."""


@dataclass(frozen=True, kw_only=True)
class SearchParameters(SharedParameters):
    """The parameters of the search for sources. All pixel-based methods inherit from this class.

    The descriptions below are appended to the page of each method.

    Parameters
    ----------
    search
        How sources are searched. ``"ann"``: by a k-d tree, exactly. ``"exhaustive"``: among all pixels of the sample.
        ``"k-coherence"``: among the continuations of the sources of the pixels in the window, and the four pixels of
        the sample most similar to each (Tong et al. 2002). The continuation of a neighbor's source is the pixel that
        lies beside that source as the current pixel lies beside the neighbor.
    coherence
        1 or more: the continuation of a neighbor's source is preferred if its distance is at most this multiple of the
        least distance. 0: it is not preferred.
    dimensions
        Number of principal components that are compared. 0, or at least the number of values: all values are compared.
    """

    search: Literal["ann", "exhaustive", "k-coherence"] = "ann"
    coherence: float = 2.5
    dimensions: int = 16

    def __post_init__(self) -> None:
        require_ranges(self, coherence=(0, np.inf), dimensions=(0, np.inf))
        require(not 0 < self.coherence < 1, f"coherence {self.coherence}; choose 0, or 1 or more")


@dataclass(frozen=True, eq=False)
class Neighborhood:
    """The offsets around a pixel at which the texture and its mask are compared.

    Parameters
    ----------
    taps
        ``int64 (t, 3)``: (x, y, layer). Layer 0 is the texture, layer 1 the mask.
    """

    taps: Integers

    @classmethod
    def first_pass(cls, size: int, masked: bool) -> Neighborhood:
        """Return the neighborhood of the first pass: N_upper in the texture and, if ``masked``, N_lower in the mask.

        Both lie in the window of ``size`` x ``size`` px that starts at -size//2. N_upper are the offsets before the
        pixel in scan-line order; N_lower are the pixel itself and the offsets after it (Nicoll et al. 2005, figure 4).
        """
        x, y = _window(size)
        lower = (y > 0) | ((y == 0) & (x >= 0))
        return cls(np.stack([x, y, lower], -1)[masked | ~lower])

    @classmethod
    def second_pass(cls, size: int, masked: bool) -> Neighborhood:
        """Return the neighborhood of the second pass: the texture around the pixel, and the mask at the pixel.

        It reaches size//2 px to all sides. The mask is included if ``masked``.
        """
        x, y = _window(size // 2 * 2 + 1)
        own = (y == 0) & (x == 0)
        return cls(np.stack([x, y, own], -1)[masked | ~own])

    @classmethod
    def of_mask(cls, size: int) -> Neighborhood:
        """Return the whole window of ``size`` x ``size`` px in the mask."""
        x, y = _window(size)
        return cls(np.stack([x, y, np.ones_like(x)], -1))

    @property
    def texture_offsets(self) -> Integers:
        """``(m, 2)``: the offsets (x, y) at which the texture is compared."""
        return np.ascontiguousarray(self.taps[self.taps[:, 2] == 0, :2])

    @property
    def box(self) -> tuple[int, int, int, int]:
        """(left, top, right, bottom): the extent of the offsets from the pixel, px."""
        (x0, y0), (x1, y1) = self.taps[:, :2].min(0), self.taps[:, :2].max(0)
        return max(-int(x0), 0), max(-int(y0), 0), max(int(x1), 0), max(int(y1), 0)

    def weights(self, weight: float, channels: int) -> NDArray[np.float64]:
        """Return the weight of each value's squared difference: 1 in the texture, ``weight`` in the mask."""
        return np.repeat(np.where(self.taps[:, 2] == 1, weight, 1.0), channels)

    def steps(self, layers: Layers) -> Integers:
        """Return the steps from a pixel's first value to those of its neighborhood in the flat array, ``(t C,)``."""
        _, height, width, channels = layers.shape
        x, y, layer = self.taps.T
        pixels = (layer * height + y) * width + x
        return np.asarray((pixels[:, np.newaxis] * channels + np.arange(channels)).ravel())

    def find_complete(self, shape: tuple[int, int]) -> Integers:
        """Return the pixels, as row * width + column, whose neighborhoods lie inside an image of ``shape``."""
        (height, width), (left, top, right, bottom) = shape, self.box
        numbers = np.arange(height * width).reshape(height, width)
        return numbers[top : max(height - bottom, 0), left : max(width - right, 0)].ravel()

    def vectors(self, layers: Layers, pixels: Integers) -> NDArray[np.uint8]:
        """Return the neighborhoods of some pixels, ``uint8 (n, t C)``."""
        values, starts, steps = layers.reshape(-1), pixels * layers.shape[3], self.steps(layers)
        vectors = np.empty((len(pixels), len(steps)), np.uint8)
        for column, step in enumerate(steps.tolist()):
            vectors[:, column] = values[starts + step]
        return vectors


def _window(size: int) -> tuple[Integers, Integers]:
    y, x = np.indices((size, size)).reshape(2, -1) - size // 2
    return x, y


def stack_layers(*pictures: Image) -> Layers:
    """Return the layers of a texture and, if it is given, of its mask."""
    return np.stack([to_bytes(picture) for picture in pictures])


def scatter_pixels(layers: Layers, shape: tuple[int, int], rng: np.random.Generator) -> Layers:
    """Return layers of ``shape`` (height, width) of random pixels of a sample's layers."""
    colors = layers.reshape(len(layers), -1, layers.shape[3])
    return np.ascontiguousarray(colors[:, rng.integers(colors.shape[1], size=shape)])


@dataclass(frozen=True, eq=False)
class Candidates:
    """The sample's pixels that may be sources.

    Parameters
    ----------
    pixels
        ``(n,)``: row * width + column.
    ranks
        ``(n,)``: of two candidates at the same distance, the one of lower rank becomes the source.
    groups
        ``(n,)``: the group of each. The candidates of an output pixel belong to one group. None: there is one group.
    """

    pixels: Integers
    ranks: Integers
    groups: Integers | None = None


def list_candidates(layers: Layers, neighborhood: Neighborhood, rng: np.random.Generator) -> Candidates:
    """Return the pixels of a sample whose neighborhoods lie inside, with random ranks.

    Raises
    ------
    Refused
        If there are none, because the sample is smaller than a neighborhood.
    """
    _, height, width, _ = layers.shape
    pixels = neighborhood.find_complete((height, width))
    if not len(pixels):
        left, top, right, bottom = neighborhood.box
        raise Refused(
            f"a neighborhood takes {left + right + 1}x{top + bottom + 1} px, the sample is {width}x{height} px; "
            "choose a larger sample or a smaller neighborhood"
        )
    return Candidates(pixels, rng.permutation(len(pixels)))


class NeighborhoodIndex:
    """The neighborhoods of candidates in a search tree, which is built in O(n D dimensions + n log n).

    Parameters
    ----------
    layers
        The sample and its mask.
    candidates
        The pixels that may be sources.
    neighborhood
        The offsets that are compared.
    rules
        The parameters of the search.
    weight
        Weight of the mask's squared differences, or of their norm.
    norms
        Whether the norms of the differences are added, in the texture and in the mask; else their squares.

    Attributes
    ----------
    tree
        The tree of the points of ``candidates``.
    arrays
        The arrays of the sample for compiled loops.
    """

    def __init__(
        self,
        layers: Layers,
        candidates: Candidates,
        neighborhood: Neighborhood,
        rules: SearchParameters,
        weight: float = 1.0,
        norms: bool = False,
    ) -> None:
        self.neighborhood, self.rules = neighborhood, rules
        _, height, width, channels = layers.shape
        vectors = neighborhood.vectors(layers, candidates.pixels)
        weights = neighborhood.weights(weight**2 if norms else weight, channels)
        masked = np.repeat(neighborhood.taps[:, 2] == 1, channels) if norms else None
        self._projection = Projection.fit(vectors, weights, rules.dimensions, masked)
        points = self._projection.points(vectors)
        leaf = len(points) if rules.search == "exhaustive" else LEAF
        self.tree = KdTree.build(points, candidates.ranks, candidates.groups, leaf, self._projection.leading)
        similar = np.zeros((len(points), 0), np.int64)
        if rules.search == "k-coherence":
            similar = _find_similar_places(self.tree, points, candidates.groups)
        placed = candidates.pixels[self.tree.order]
        places = np.full(height * width, -1, np.int64)
        places[placed] = np.arange(len(placed))
        colors = layers[0].reshape(-1, channels)
        self.arrays = SampleArrays(self.tree.arrays, colors, placed, places, similar, width)

    def neighborhood_arrays(self, layers: Layers) -> NeighborhoodArrays:
        """Return the arrays of the neighborhood and the projection for compiled loops, for the layers of an output."""
        steps, projection = self.neighborhood.steps(layers), self._projection
        offsets = self.neighborhood.texture_offsets
        return NeighborhoodArrays(steps, projection.matrix, projection.shift, projection.bits, offsets)


def _find_similar_places(tree: KdTree, points: NDArray[np.int16], groups: Integers | None) -> Integers:
    """Return, for each place of the tree, the :data:`SIMILAR` most similar places; -1 if there are fewer."""
    numbers = tree.nearest(points, SIMILAR + 1, groups=groups)[0]
    own = numbers == np.arange(len(points))[:, np.newaxis]
    others = np.take_along_axis(numbers, np.argsort(own, 1, kind="stable"), 1)[:, :SIMILAR]
    place = np.empty(len(points) + 1, np.int64)
    place[tree.order], place[-1] = np.arange(len(points)), -1
    return np.ascontiguousarray(place[others][tree.order])


class Growth:
    """An output during synthesis, with a border that contains the neighborhoods of its outermost pixels.

    Parameters
    ----------
    task
        The sample, the output's shape, progress.
    layers
        ``uint8 (L, P, Q, C)``: the initial values of the texture, which the synthesis overwrites, and the mask.
    corner
        Rows and columns of the border at the top and at the left.
    wraps
        Whether neighborhoods continue at the opposite side: the border then repeats the pixels there.
    """

    def __init__(self, task: Task, layers: Layers, corner: tuple[int, int], wraps: bool = False) -> None:
        self.task, self.layers, self.corner, self.wraps = task, layers, corner, wraps
        self.sources = np.full(layers.shape[1:3], -1, np.int64)
        self.progress = 0.0

    @property
    def arrays(self) -> CanvasArrays:
        """The arrays of the output for compiled loops, which read and write them."""
        period = self.task.shape if self.wraps else self.sources.shape
        return CanvasArrays(self.layers.reshape(-1), self.sources, np.array([*period, *self.corner]))

    def grow(self, index: NeighborhoodIndex, rows: range, columns: range, groups: Integers | None = None) -> None:
        """Synthesize some rows and columns of the output in scan-line order.

        Parameters
        ----------
        index
            The candidates for sources.
        rows, columns
            Rows and columns of the output.
        groups
            ``(height, width)`` of the output: the group of each pixel's source. None: there is one group.
        """
        neighborhood, rules = index.neighborhood_arrays(self.layers), index.rules
        for start in range(rows.start, rows.stop, BAND):
            box = np.array([start, min(start + BAND, rows.stop), columns.start, columns.stop])
            among = np.zeros((box[1] - start, len(columns)), np.int64)
            if groups is not None:
                among[:] = groups[start : box[1], columns.start : columns.stop]
            preference = float(rules.coherence) ** 2, rules.search != "k-coherence"
            grow_box(self.arrays, index.arrays, neighborhood, among, box, preference)
            self.progress = max(self.progress, float(box[1]) / self.task.shape[0])
            self.task.progress(self.progress)

    def grow_edges(self, index: NeighborhoodIndex, reach: int, groups: Integers | None = None) -> None:
        """Synthesize the pixels within ``reach`` px of the edges again, in the order in which tiled copies show them.

        Other parameters as in :meth:`grow`.
        """
        height, width = self.task.shape
        for rows in (range(max(height - reach, 0), height), range(min(reach, height))):
            self.grow(index, rows, range(width), groups)
        for columns in (range(max(width - reach, 0), width), range(min(reach, width))):
            self.grow(index, range(height), columns, groups)

    def result(self) -> tuple[Image, SourceMap]:
        """Return the output and its source map."""
        (top, left), (height, width) = self.corner, self.task.shape
        image = self.layers[0, top : top + height, left : left + width] / np.float32(255)
        y, x = np.divmod(self.sources[top : top + height, left : left + width], self.task.sample.shape[1])
        return np.asarray(image, np.float32), np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)
