"""Recomposition: a picture whose elements are copies of the elements of a sample.

The pattern of a model repeats on a lattice. An element of a picture can therefore copy the departures of any element of
a sample at an equal place, which is a place that differs by a lattice vector. This is the best possible copying method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Vector, integers_within
from nrbench.plugins.forms import Shape, Texture

from .pattern import Field, Index, Layer, Pattern
from .random_fields import role_seed, unit

Indices = NDArray[np.int64]
"""``(n, k)``, one row for each element."""
Reader = Callable[[Callable[[Shape], NDArray[Any]]], NDArray[Any]]
"""Takes a function that draws a random field of a given shape, and returns the field at each pixel of a picture."""
KindLattice = tuple[tuple[Vector, Vector], Lattice]
"""The generating vectors of one kind of element in the model's axes, and their lattice in the picture."""


@dataclass(frozen=True)
class Draw:
    """The random numbers of the elements and the pixels of a picture: those of the draw of ``seed``."""

    seed: int

    def elements(self, layer: int, index: Indices) -> Indices:
        """Return the index of the element of that draw whose numbers each element of a layer takes: its own."""
        return index

    def reader(self, pattern: Pattern) -> Reader:
        """Return a function that reads random fields of that draw at the pixels of ``pattern``."""
        shape = pattern.layers[0].coverage.shape
        return lambda draw: draw(shape)


@dataclass(frozen=True)
class Copies:
    """The element that each element of one layer copies.

    Parameters
    ----------
    low, sizes
        The least value, and the number of values, of each part of the index. The table holds all these indices.
    index
        ``(n, k)``: the index of the copied element, in the order of the table.
    steps
        ``(n, 2)``: whole px (x, y) from the element to the copied one.
    """

    low: NDArray[np.int64]
    sizes: tuple[int, ...]
    index: Indices
    steps: NDArray[np.int64]

    def rows(self, parts: tuple[Index, ...]) -> NDArray[np.intp]:
        """Return the rows of the table for indices given by their parts; indices beyond the table are clipped."""
        offsets = tuple(part - first for part, first in zip(parts, self.low, strict=True))
        return np.asarray(np.ravel_multi_index(offsets, self.sizes, mode="clip"))


@dataclass(frozen=True)
class CopiedDraw(Draw):
    """Random numbers of which elements and pixels take those of elements and pixels of a sample.

    Parameters
    ----------
    seed, shape
        Seed and shape (height, width) of the sample.
    layers
        The copied elements, for each layer.
    cells
        The same for the cells of ``lattice``, as if each were an element.
    lattice
        The smallest lattice of the pattern, reduced.
    """

    shape: Shape
    layers: tuple[Copies, ...]
    cells: Copies
    lattice: Lattice

    def elements(self, layer: int, index: Indices) -> Indices:
        """Return the index of the sample's element that each element of a layer copies."""
        copies = self.layers[layer]
        return copies.index[copies.rows(tuple(index.T))]

    def reader(self, pattern: Pattern) -> Reader:
        """Return a function that reads fields of the sample at the pixels that :meth:`pixels` gives."""
        x, y = np.moveaxis(self.pixels(pattern), -1, 0)
        return lambda draw: draw(self.shape)[y, x]

    def pixels(self, pattern: Pattern) -> NDArray[np.int64]:
        """Return the (x, y) of the sample's pixel that each pixel copies, ``(H, W, 2)``.

        A pixel belongs to the element that covers most of it, or to the nearest one of the first layer. It takes the
        step of this element. If that step leads out of the sample, the pixel takes the step of its lattice cell. If
        this step leads out as well, because the sample holds no whole cell, the sample is repeated.
        """
        coverage = np.stack([layer.coverage for layer in pattern.layers])
        owner, here = coverage.argmax(0), _pixel_grid(coverage.shape[1:])
        steps = np.zeros_like(here)
        for number, (layer, copies) in enumerate(zip(pattern.layers, self.layers, strict=True)):
            mine = owner == number
            steps[mine] = copies.steps[copies.rows(tuple(part[mine] for part in layer.index))]
        places = here + steps
        outside = ~_inside(places, self.shape)
        i, j = _cell_index(self.lattice, here[outside])
        places[outside] = here[outside] + self.cells.steps[self.cells.rows((i, j))]
        return np.asarray(places % self.shape[::-1])


@dataclass(frozen=True)
class Picture:
    """A pattern without displacement, on a picture and on some px around it, whose elements copy those of a sample.

    Parameters
    ----------
    draw
        Returns the pattern at points of the model's axes.
    x, y
        The points of the picture's pixels in the model's axes.
    margin
        Number of px around the picture.
    sample
        A draw of the same model and lattice.
    seed
        Seed of the random choice.
    """

    draw: Callable[[Field, Field], Pattern]
    x: Field
    y: Field
    margin: int
    sample: Texture
    seed: int

    def copied_draw(self, lattice_of: Callable[[str], KindLattice]) -> CopiedDraw:
        """Draw the element of the sample that each element of the picture copies.

        Only elements that are visible in the sample are copied. Places at which the whole element of the picture fits
        into the sample are preferred. If there are none, all elements at equal places are used. If there are none of
        these, because the sample is smaller than a cell, all elements of the same kind are used. One of the elements is
        drawn uniformly.

        Parameters
        ----------
        lattice_of
            Returns the lattice of a kind of element, by the name of its layer.
        """
        assert self.sample.lattice is not None and self.sample.draw_seed is not None
        pattern, layers = self.draw(self.x, self.y), []
        for number, layer in enumerate(pattern.layers):
            vectors, lattice = lattice_of(layer.name)
            places = _Places.of(layer, self.margin)
            changes = self._index_changes(pattern, number, places, vectors)
            nothing = np.zeros((0, len(layer.index)))
            visible = self.sample.elements.get(f"{layer.name}.index", nothing).astype(np.int64)
            layers.append(self._copies(layer, places, lattice, changes, visible))
        lattice = self.sample.lattice.reduced()
        index = _cell_index(lattice, _pixel_grid(self.x.shape) - self.margin)
        layer = Layer("cell", index, np.ones(self.x.shape), 0.0)
        places = _Places.of(layer, self.margin)
        changes = np.broadcast_to(np.eye(2, dtype=np.int64), (len(places.rows), 2, 2))
        cells = self._copies(layer, places, lattice, changes, None)
        return CopiedDraw(self.sample.draw_seed, self._shape, tuple(layers), cells, lattice)

    @property
    def _shape(self) -> Shape:
        """Shape (height, width) of the sample."""
        return self.sample.image.shape[0], self.sample.image.shape[1]

    def _index_changes(
        self, pattern: Pattern, number: int, places: _Places, vectors: tuple[Vector, Vector]
    ) -> NDArray[np.int64]:
        """Return how the index of each element changes from a place to the next equal ones, ``(n, 2, k)``.

        The equal element may lie in another layer of the same name: the one that covers as much there.
        """
        layer, changes = pattern.layers[number], []
        x, y = (field.reshape(-1)[places.pixel][:, np.newaxis] for field in (self.x, self.y))
        own = np.stack([part.reshape(-1)[places.pixel] for part in layer.index], -1)
        covered = layer.coverage.reshape(-1)[places.pixel][:, np.newaxis]
        for dx, dy in vectors:
            equal = [other for other in self.draw(x + dx, y + dy).layers if other.name == layer.name]
            best = min(equal, key=lambda other: float(np.abs(other.coverage - covered).sum()))
            changes.append(np.stack([part.reshape(-1) for part in best.index], -1) - own)
        return np.stack(changes, 1)

    def _copies(
        self, layer: Layer, places: _Places, lattice: Lattice, changes: NDArray[np.int64], visible: Indices | None
    ) -> Copies:
        """Return the element that each element of a layer copies. Those that are not in the picture copy themselves.

        Parameters
        ----------
        layer, places, lattice
            The elements, where they lie, and their lattice.
        changes
            How the index changes by each of the two lattice vectors, ``(n, 2, k)``.
        visible
            Indices of the elements that are visible in the sample; None: all elements are.
        """
        census, shape = layer.census(), self._shape
        own = census.index[places.rows]
        numbers = _vectors_into(lattice, places.center, shape)
        moves = np.rint(numbers @ lattice.matrix).astype(np.int64)
        index = own[:, np.newaxis] + numbers @ changes
        known = np.ones(index.shape[:2], np.bool_) if visible is None else _contains(visible, index)
        inside = known & _inside(places.center[:, np.newaxis] + moves, shape)
        whole = inside & _inside(places.first[:, np.newaxis] + moves, shape)
        whole &= _inside(places.last[:, np.newaxis] + moves, shape)
        allowed = np.where(whole.any(1, keepdims=True), whole, inside)
        number = unit(role_seed(self.seed, f"{layer.name}.source"), *own.T)
        count = allowed.sum(1)
        chosen = (allowed.cumsum(1) > np.floor(number * count)[:, np.newaxis]).argmax(1)
        row = np.arange(len(chosen))
        source, steps = index[row, chosen], moves[row, chosen]
        lost = count == 0
        source[lost], steps[lost] = own[lost], 0
        if visible is not None and len(visible):
            source[lost] = visible[(number[lost] * len(visible)).astype(np.int64)]
        low, high = census.index.min(0), census.index.max(0)
        table, still = census.index.copy(), np.zeros((len(census.index), 2), np.int64)
        table[places.rows], still[places.rows] = source, steps
        return Copies(low, tuple((high - low + 1).tolist()), table, still)


@dataclass(frozen=True)
class _Places:
    """Where the elements of a layer lie.

    Parameters
    ----------
    rows
        Their rows in the census, ``(n,)``.
    pixel
        The flat index of the pixel that represents each element: of the most covered pixels, the most central.
    center
        The (x, y) of this pixel in the picture, ``(n, 2)``.
    first, last
        The corners (x, y) of the box around the pixels that each element covers, inclusive, ``(n, 2)``.
    """

    rows: NDArray[np.intp]
    pixel: NDArray[np.intp]
    center: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]

    @classmethod
    def of(cls, layer: Layer, margin: int) -> _Places:
        """Return the places of the elements of a layer on a picture with a margin."""
        census, shape = layer.census(), layer.coverage.shape
        rows, label = np.unique(census.row, return_inverse=True)
        label = label.reshape(shape)
        grid = _pixel_grid(shape)
        count = np.bincount(label.ravel())
        middle = np.stack([np.bincount(label.ravel(), grid[..., k].ravel()) / count for k in range(2)], -1)
        distance = ((grid - middle[label]) ** 2).sum(-1)
        central = layer.coverage - 1e-3 * distance / distance.max(initial=1.0)
        positions = np.asarray(scipy.ndimage.maximum_position(central, label, np.arange(len(rows))), np.int64)
        # An element that covers no pixel is as large as its cell.
        hidden = (np.bincount(label.ravel(), layer.coverage.ravel()) == 0)[label]
        boxes = scipy.ndimage.find_objects(np.where((layer.coverage > 0) | hidden, label + 1, 0))
        first = np.array([[box[1].start, box[0].start] for box in boxes])
        last = np.array([[box[1].stop - 1, box[0].stop - 1] for box in boxes])
        pixel = np.ravel_multi_index(tuple(positions.T), shape)
        return cls(rows, np.asarray(pixel), positions[:, ::-1] - margin, first - margin, last - margin)


def _vectors_into(lattice: Lattice, center: NDArray[np.int64], shape: Shape) -> NDArray[np.int64]:
    """Return cell coordinates of lattice vectors that lead to places in a sample of ``shape``, ``(n, m, 2)``.

    They include all that lead from a center (x, y), ``(n, 2)``, into the sample, and some others.
    """
    base = np.floor(lattice.to_cell(center.astype(np.float64))).astype(np.int64)
    corners = lattice.from_cell([(0, 0), (1, 0), (0, 1), (1, 1)])
    last = np.array(shape[::-1]) - 0.5
    low, high = -0.5 - corners.max(0) - 1, last - corners.min(0) + 1
    reduced = lattice.reduced().matrix
    change = np.rint(reduced @ np.linalg.inv(lattice.matrix)).astype(np.int64)
    return np.asarray(integers_within(reduced, low, high) @ change - base[:, np.newaxis])


def _contains(known: Indices, index: Indices) -> NDArray[np.bool_]:
    """Return whether each index, ``(..., k)``, is one of the known ones, ``(n, k)``."""
    if not len(known):
        return np.zeros(index.shape[:-1], np.bool_)
    low, sizes = known.min(0), np.ptp(known, axis=0) + 1
    table = np.zeros(sizes, np.bool_)
    table[tuple((known - low).T)] = True
    offset = index - low
    near = ((offset >= 0) & (offset < sizes)).all(-1)
    return np.asarray(near & table[tuple(np.moveaxis(np.clip(offset, 0, sizes - 1), -1, 0))])


def _inside(places: NDArray[np.int64], shape: Shape) -> NDArray[np.bool_]:
    """Return whether each pixel (x, y), ``(..., 2)``, lies in a picture of ``shape``."""
    return np.asarray(((places >= 0) & (places < shape[::-1])).all(-1))


def _pixel_grid(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the (x, y) of each pixel, ``(H, W, 2)``."""
    y, x = np.indices(shape)
    return np.stack([x, y], -1)


def _cell_index(lattice: Lattice, pixels: NDArray[np.int64]) -> tuple[Index, Index]:
    """Return the cell coordinates of the cell that each pixel (x, y) lies in."""
    i, j = np.moveaxis(np.floor(lattice.to_cell(pixels)).astype(np.int64), -1, 0)
    return i, j
