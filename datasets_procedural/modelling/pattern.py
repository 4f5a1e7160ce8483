"""The pattern: what a model looks like without departures, element by element."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nrbench.imaging.convert import Image

from .coordinates import Field, Index


@dataclass(frozen=True)
class Layer:
    """One kind of element, as seen at each point.

    Parameters
    ----------
    name
        The kind: ``"brick"``.
    index
        Which element it is: one whole number a point for each part of the index.
    coverage
        The share in [0, 1] of each pixel that the element covers, visibly: those of all layers add up to at most 1.
    color
        Expected color in [0, 1], broadcastable to ``(H, W, 3)``.
    shade
        A factor of the color at each point.
    """

    name: str
    index: tuple[Index, ...]
    coverage: Field
    color: ArrayLike
    shade: Field | float = 1.0

    def paint(self) -> Image:
        """Return what the layer adds to the ideal image."""
        weight = np.asarray(self.coverage * self.shade, np.float32)[..., np.newaxis]
        return weight * np.asarray(self.color, np.float32)

    def census(self) -> Census:
        """Return which elements there are, and to which one each point belongs."""
        low = [int(part.min()) for part in self.index]
        sizes = [int(part.max()) - first + 1 for part, first in zip(self.index, low, strict=True)]
        place = np.ravel_multi_index([part - first for part, first in zip(self.index, low, strict=True)], sizes)
        return Census(np.indices(sizes).reshape(len(sizes), -1).T + low, place)


@dataclass(frozen=True)
class Census:
    """The elements of a layer.

    Parameters
    ----------
    index
        ``(n, k)``: every index between the least and the greatest; not each need be in the picture.
    place
        The row of ``index`` at each point.
    """

    index: NDArray[np.int64]
    place: NDArray[np.intp]

    def seen(self, coverage: Field) -> NDArray[np.bool_]:
        """Return which elements cover a part of any pixel, ``(n,)``."""
        return np.bincount(self.place[coverage > 0], minlength=len(self.index)) > 0

    def means(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean of ``(H, W, k)`` over the points of each element, ``(n, k)``; 0 where it has none."""
        count = np.maximum(np.bincount(self.place.ravel(), minlength=len(self.index)), 1)
        axes = np.moveaxis(field, -1, 0)
        sums = [np.bincount(self.place.ravel(), axis.ravel(), len(self.index)) for axis in axes]
        return np.stack(sums, -1) / count[:, np.newaxis]


@dataclass(frozen=True)
class Pattern:
    """What a model looks like without departures: layers of elements on a ground.

    Parameters
    ----------
    ground
        The color between the elements, broadcastable to ``(H, W, 3)``.
    layers
        Kinds of element; no two at the same pixel are the same element.
    """

    ground: ArrayLike
    layers: tuple[Layer, ...]

    def covered(self) -> Field:
        """Return the share of each pixel that elements cover."""
        return reduce(np.add, (layer.coverage for layer in self.layers))

    def bare(self) -> Image:
        """Return the ground where no element covers it."""
        return np.asarray((1 - self.covered())[..., np.newaxis] * np.asarray(self.ground), np.float32)

    def ideal(self) -> Image:
        """Return the pattern as it is without departures."""
        image = self.bare()
        for layer in self.layers:
            image += layer.paint()
        return image

    def cropped(self, margin: int) -> Pattern:
        """Return the pattern without its outer ``margin`` px."""
        inside = slice(margin, -margin or None)

        def crop(part: ArrayLike) -> NDArray[Any]:
            array = np.asarray(part)
            return array[inside, inside] if array.ndim > 1 else array

        layers = (
            Layer(each.name, tuple(map(crop, each.index)), crop(each.coverage), crop(each.color), crop(each.shade))
            for each in self.layers
        )
        return Pattern(crop(self.ground), tuple(layers))

    def tinted(self, turn: NDArray[np.float64]) -> Pattern:
        """Return the pattern with the matrix ``turn`` applied to its colors."""
        layers = [replace(layer, color=_turned(layer.color, turn)) for layer in self.layers]
        return Pattern(_turned(self.ground, turn), tuple(layers))


def _turned(color: ArrayLike, turn: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.clip(np.asarray(color) @ turn.T, 0.0, 1.0)
