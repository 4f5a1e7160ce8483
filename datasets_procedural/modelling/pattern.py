"""Draw the elements of a texture model: coordinates, shapes, shades, threads, and layers.

A model calls these functions with the coordinates of all pixels at once. A coordinate function returns the element of a
lattice to which each point belongs. A shape function returns the signed distance to an outline. :func:`coverage`
returns the share of the pixel inside the outline. :class:`Pattern` holds the result as layers of elements on a ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Vector
from nrbench.plugins.forms import Shape

Field = NDArray[np.float64]
"""One number for each point, any shape; usually ``(H, W)``."""
Index = NDArray[np.int64]
"""One whole number for each point: a part of an element's index."""
Displacement = NDArray[np.float64]
"""(x, y) px for each pixel, in the picture's axes, ``(H, W, 2)``."""
Local = tuple[Field, Field]
"""(x, y) in px from the center of the cell that a point lies in."""


@dataclass(frozen=True)
class Frame:
    """Where a model's axes lie in the picture.

    Parameters
    ----------
    origin
        Position (x, y) px of the model's origin in the picture.
    rotation
        Degrees from the picture's x axis to the model's, positive towards y (clockwise on the screen).
    """

    origin: Vector = (0.0, 0.0)
    rotation: float = 0.0

    def grid(self, shape: Shape, margin: int = 0, moved: Displacement | None = None) -> tuple[Field, Field]:
        """Return the model's coordinates (x, y) px of each pixel center, two arrays of ``shape``.

        Parameters
        ----------
        shape
            (height, width) of the picture.
        margin
            Number of pixels that the grid goes beyond the picture on each side.
        moved
            Displacement of the content at each pixel. A pixel gets the coordinates from which its content has moved.
        """
        x = np.arange(-margin, shape[1] + margin) - self.origin[0]
        y = np.arange(-margin, shape[0] + margin)[:, np.newaxis] - self.origin[1]
        if moved is not None:
            x, y = x - moved[..., 0], y - moved[..., 1]
        return rotate(x, y, self.rotation)

    def vector(self, model: Vector) -> Vector:
        """Return a vector (x, y) of the model in the picture's axes."""
        cos, sin = _cos_sin(self.rotation)
        return model[0] * cos - model[1] * sin, model[0] * sin + model[1] * cos


def _cos_sin(degrees: float) -> tuple[float, float]:
    """Return cosine and sine, exact at right angles."""
    quarter, rest = divmod(degrees, 90.0)
    cos, sin = math.cos(math.radians(rest)), math.sin(math.radians(rest))
    return [(cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos)][int(quarter) % 4]


# Coordinates: which element of a lattice a point belongs to


def split_period(x: Field, period: float) -> tuple[Index, Field]:
    """Return the number i of the nearest point ``period * i``, and the signed distance from it in px."""
    steps = np.rint(x / period)
    return steps.astype(np.int64), x - steps * period


def rows(x: Field, y: Field, width: float, height: float, shift: float) -> tuple[tuple[Index, Index], Local]:
    """Return the cell (i, j) of rows of boxes, each row moved by ``shift`` widths against the one above it.

    The centers of the boxes form the lattice of ``(width, 0)`` and ``(shift * width, height)``; (i, j) are their
    coordinates in it.
    """
    j, across = split_period(y, height)
    i, along = split_period(x - j * (shift * width), width)
    return (i, j), (along, across)


def boxes(x: Field, widths: tuple[float, ...]) -> tuple[Index, Field, Field]:
    """Return the number of the box that each point lies in, the signed distance from its middle, and its width.

    The row repeats ``widths``; the middle of its first box lies at x = 0.
    """
    sizes = np.asarray(widths)
    if len(sizes) == 1:
        return (*split_period(x, widths[0]), np.broadcast_to(sizes, x.shape))
    turn = np.floor((x + sizes[0] / 2) / sizes.sum())
    rest = x + sizes[0] / 2 - turn * sizes.sum()
    ends = np.cumsum(sizes)
    which = np.searchsorted(ends[:-1], rest, side="right")
    return turn.astype(np.int64) * len(sizes) + which, rest - (ends - sizes / 2)[which], sizes[which]


def cells(x: Field, y: Field, width: float, height: float) -> tuple[tuple[Index, Index], Local]:
    """Return the box (i, j) of a rectangular grid that each point lies in. The centers are at (i width, j height)."""
    (i, right), (j, down) = split_period(x, width), split_period(y, height)
    return (i, j), (right, down)


def honeycomb(x: Field, y: Field, period: float) -> tuple[tuple[Index, Index], Local]:
    """Return the hexagon (i, j) nearest to each point: centers at the lattice of (p, 0) and (p/2, p sqrt(3)/2).

    The centers form two rectangular lattices, one in the middles of the other. The nearer of the two centers is used.
    """
    rise = period * math.sqrt(3)
    ((i, j), (dx, dy)), ((k, m), (ex, ey)) = (
        cells(x, y, period, rise),
        cells(x - period / 2, y - rise / 2, period, rise),
    )
    first = dx**2 + dy**2 <= ex**2 + ey**2
    column, row = np.where(first, i, k), np.where(first, j, m)
    return (column - row, 2 * row + ~first), (np.where(first, dx, ex), np.where(first, dy, ey))


def hats(u: Field, v: Field) -> list[tuple[tuple[Index, Index], Field]]:
    """Return the four whole points (i, j) around each point (u, v), each with its bilinear weight (hat function).

    In each of the four, i and j have a fixed parity, so that no two of them are the same point.
    """
    columns, rows = ([_hat(part, parity) for parity in range(2)] for part in (u, v))
    return [((i, j), right * down) for j, down in rows for i, right in columns]


def _hat(u: Field, parity: int) -> tuple[Index, Field]:
    """Return the nearest even (parity 0) or odd (parity 1) number, and its linear weight."""
    i = 2 * np.rint((u - parity) / 2).astype(np.int64) + parity
    return i, np.maximum(1 - np.abs(u - i), 0)


def rotate(x: NDArray[Any], y: NDArray[Any], degrees: float) -> tuple[Field, Field]:
    """Return the coordinates along axes turned by ``degrees`` from x towards y."""
    cos, sin = _cos_sin(degrees)
    return x * cos + y * sin, y * cos - x * sin


# Shapes: signed distances in px, negative inside; the exact Euclidean distances collected by I. Quilez,
# "2D distance functions" (iquilezles.org).


def stripe(x: Field, width: Field | float) -> Field:
    """Return the distance to a stripe of ``width`` px around x = 0."""
    return np.abs(x) - width / 2


def box(x: Field, y: Field, width: Field | float, height: Field | float, radius: float = 0.0) -> Field:
    """Return the distance to a box around the origin, its corners rounded by ``radius`` px."""
    dx, dy = np.abs(x) - (width / 2 - radius), np.abs(y) - (height / 2 - radius)
    outside = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0))
    return np.asarray(outside + np.minimum(np.maximum(dx, dy), 0) - radius)


def hexagon(x: Field, y: Field, width: float, radius: float = 0.0) -> Field:
    """Return the distance to a regular hexagon around the origin, ``width`` px from flat to flat along x."""
    inner = width / 2 - radius
    along, across = np.abs(y), np.abs(x)
    fold = np.minimum(across / 2 - along * (math.sqrt(3) / 2), 0)
    along, across = along + fold * math.sqrt(3), across - fold
    side = inner / math.sqrt(3)
    ahead = across - inner
    return np.asarray(np.copysign(np.hypot(along - np.clip(along, -side, side), ahead), ahead) - radius)


def disc(x: Field, y: Field, width: Field | float) -> Field:
    """Return the distance to a disc around the origin, ``width`` px across."""
    return np.asarray(np.hypot(x, y) - width / 2)


def lozenge(x: Field, y: Field, width: float, height: float) -> Field:
    """Return the distance to the sides of a lozenge around the origin (exact but for its tips)."""
    along = np.hypot(width, height)
    return np.asarray((np.abs(x) * height + np.abs(y) * width - width * height / 2) / along)


def capsule(x: Field, y: Field, length: float, width: float) -> Field:
    """Return the distance to a box with round ends, ``length`` px from end to end along x."""
    return np.asarray(np.hypot(np.maximum(np.abs(x) - (length - width) / 2, 0), y) - width / 2)


def coverage(distance: Field) -> Field:
    """Return the share in [0, 1] of a pixel that lies inside a straight edge ``distance`` px from its center.

    The pixel is a box one px wide across the edge. The share depends on the point alone, so a periodic pattern stays
    exactly periodic at any phase and angle.
    """
    return np.clip(0.5 - distance, 0, 1)


# Shades: factors of an element's color, and mixed colors


def rim(distance: Field, depth: float, width: float) -> Field:
    """Return a shade in [1 - depth, 1]: darkest at the edge, fading over ``width`` px towards the inside."""
    return np.asarray(1 - depth * np.exp(np.minimum(distance, 0) / width))


def round_profile(x: Field, width: float, depth: float) -> Field:
    """Return a shade in [1 - depth, 1]: that of a round thread of ``width`` px, lit from the front."""
    return np.asarray(1 - depth * (1 - np.sqrt(np.maximum(1 - (2 * x / width) ** 2, 0))))


def bevel(distance: Field, x: Field, y: Field, depth: float, width: float) -> Field:
    """Return a shade in [1 - depth, 1 + depth]: an edge ``width`` px broad, lit from the upper left.

    ``(x, y)`` points from the middle of the element; ``distance`` is the distance to its outline, negative inside.
    """
    away = np.maximum(np.hypot(x, y), 1e-9)
    near = np.exp(-((np.minimum(distance, 0) / width) ** 2))
    return np.asarray(1 - depth * near * (x + y) / away / math.sqrt(2))


def nearness(distance: Field) -> Field:
    """Return how near each point is to an edge: 1 at the edge, and hardly anything 3 px from it."""
    return np.asarray(np.exp(-((distance / 1.5) ** 2)))


def mix(share: Field, under: ArrayLike, over: ArrayLike) -> NDArray[np.float64]:
    """Return the color ``under`` where ``share`` is 0, ``over`` where it is 1, and mixtures between, ``(H, W, 3)``."""
    weight = np.asarray(share)[..., np.newaxis]
    return np.asarray((1 - weight) * np.asarray(under) + weight * np.asarray(over))


def hue_rotation(degrees: float) -> NDArray[np.float64]:
    """Return the matrix that turns colors around the gray axis; the mean of their channels stays."""
    angle = math.radians(degrees)
    third, across = 1 / 3, math.sin(angle) / math.sqrt(3)
    cross = np.array([[0.0, -1, 1], [1, 0, -1], [-1, 1, 0]])
    return np.asarray(math.cos(angle) * (np.eye(3) - third) + third + across * cross)


# Threads


@dataclass(frozen=True)
class Thread:
    """One family of parallel threads, at each point.

    Parameters
    ----------
    index
        The number of the thread.
    distance
        Distance to its edge in px, negative inside.
    coverage
        The share of each pixel in which the thread is visible.
    shade
        The shade of a round thread that passes over and under the others.
    """

    index: Index
    distance: Field
    coverage: Field
    shade: Field

    def layer(self, name: str, color: ArrayLike) -> Layer:
        """Return the layer of these threads."""
        return Layer(name, (self.index,), self.coverage, color, self.shade, nearness(self.distance))


def interlace(
    x: Field, y: Field, spacings: tuple[float, float], gap: float, draft: NDArray[np.bool_], depth: float = 0.45
) -> tuple[Thread, Thread]:
    """Return warp and weft threads that pass over and under each other.

    Parameters
    ----------
    x, y
        The points in px; the origin is a crossing.
    spacings
        From a warp thread to the next along x, and from a weft thread to the next along y, in px.
    gap
        Width of the gap between the threads in px.
    draft
        Whether the warp lies above: a row for each weft thread, a column for each warp thread; it repeats.
    depth
        Darkness of the sides of a thread, in [0, 1].
    """
    (i, right), (j, down) = split_period(x, spacings[0]), split_period(y, spacings[1])
    sides = stripe(right, spacings[0] - gap), stripe(down, spacings[1] - gap)
    above = _look_up(draft, i, j)
    warp, weft = (coverage(side) for side in sides)
    warp_next = _look_up(draft, i, j + np.where(down >= 0, 1, -1))
    weft_next = _look_up(draft, i + np.where(right >= 0, 1, -1), j)
    warp_shade = round_profile(right, spacings[0] - gap, depth) * _pass_shade(above, warp_next, down / spacings[1])
    weft_shade = round_profile(down, spacings[1] - gap, depth) * _pass_shade(~above, ~weft_next, right / spacings[0])
    warp_seen = np.where(above, warp, warp * (1 - weft))
    weft_seen = np.where(above, weft * (1 - warp), weft)
    return Thread(i, sides[0], warp_seen, warp_shade), Thread(j, sides[1], weft_seen, weft_shade)


def _look_up(draft: NDArray[np.bool_], i: Index, j: Index) -> NDArray[np.bool_]:
    return np.asarray(draft.ravel().take(j % draft.shape[0] * draft.shape[1] + i % draft.shape[1]))


def _pass_shade(here: NDArray[np.bool_], beyond: NDArray[np.bool_], along: Field) -> Field:
    """Return the shade of a thread between two crossings, at each of which it lies above or below."""
    wave = np.where(here == beyond, 1.0, np.cos(np.pi * along))
    return np.asarray(0.78 + 0.22 * np.where(here, wave, -wave))


# Layers of elements on a ground


def _multiply_color(weight: Field | NDArray[np.float32], color: NDArray[np.floating[Any]]) -> Image:
    """Return weights ``(H, W)`` times a color ``(3,)`` or ``(H, W, 3)``, plane by plane.

    numpy takes 30 times as long for a loop over three channels at every pixel.
    """
    image = np.empty((*weight.shape, color.shape[-1]), np.float32)
    for channel in range(color.shape[-1]):
        np.multiply(weight, color[..., channel], out=image[..., channel], casting="same_kind")
    return image


@dataclass(frozen=True)
class Layer:
    """One kind of element, at each point.

    Parameters
    ----------
    name
        The kind: ``"brick"``.
    index
        The index of the element at each point: one array of whole numbers for each part of the index.
    coverage
        The share in [0, 1] of each pixel in which the element is visible. Over all layers the sum is at most 1.
    color
        Expected color in [0, 1], broadcastable to ``(H, W, 3)``.
    shade
        A factor of the color at each point.
    edge
        How near each point is to the outline, see :func:`nearness`; 0 where elements do not wear.
    """

    name: str
    index: tuple[Index, ...]
    coverage: Field
    color: ArrayLike
    shade: Field | float = 1.0
    edge: Field | float = 0.0

    def paint(self) -> Image:
        """Return what the layer adds to the ideal image."""
        return _multiply_color(np.asarray(self.coverage * self.shade, np.float32), np.asarray(self.color, np.float32))

    def census(self) -> Census:
        """Return the list of elements, and the element to which each point belongs."""
        low = [int(part.min()) for part in self.index]
        sizes = [int(part.max()) - first + 1 for part, first in zip(self.index, low, strict=True)]
        row = np.ravel_multi_index([part - first for part, first in zip(self.index, low, strict=True)], sizes)
        return Census(np.indices(sizes).reshape(len(sizes), -1).T + low, row)


@dataclass(frozen=True)
class Census:
    """The elements of a layer.

    Parameters
    ----------
    index
        ``(n, k)``: every index between the least and the greatest; some may not be in the picture.
    row
        The row of ``index`` at each point.
    """

    index: NDArray[np.int64]
    row: NDArray[np.intp]

    def visible(self, coverage: Field) -> NDArray[np.bool_]:
        """Return whether each element covers a part of any pixel, ``(n,)``."""
        return np.bincount(self.row[coverage > 0], minlength=len(self.index)) > 0

    def means(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean of ``(H, W, k)`` over the points of each element, ``(n, k)``; 0 where it has none."""
        count = np.maximum(np.bincount(self.row.ravel(), minlength=len(self.index)), 1)
        axes = np.moveaxis(field, -1, 0)
        sums = [np.bincount(self.row.ravel(), axis.ravel(), len(self.index)) for axis in axes]
        return np.stack(sums, -1) / count[:, np.newaxis]


@dataclass(frozen=True)
class Pattern:
    """A texture without departures: layers of elements on a ground.

    Parameters
    ----------
    ground
        The color between the elements, broadcastable to ``(H, W, 3)``.
    layers
        The kinds of element. Two layers never show the same element at one pixel.
    """

    ground: ArrayLike
    layers: tuple[Layer, ...]

    def coverage(self) -> Field:
        """Return the share of each pixel that elements cover."""
        return reduce(np.add, (layer.coverage for layer in self.layers))

    def ground_image(self) -> Image:
        """Return the ground, weighted by the share of each pixel that no element covers."""
        return _multiply_color(1 - self.coverage(), np.asarray(self.ground))

    def ideal(self) -> Image:
        """Return the image of the pattern."""
        image = self.ground_image()
        for layer in self.layers:
            image += layer.paint()
        return image

    def crop(self, margin: int) -> Pattern:
        """Return the pattern without its outer ``margin`` px."""
        inside = slice(margin, -margin or None)

        def trim(part: ArrayLike) -> NDArray[Any]:
            array = np.asarray(part)
            return array[inside, inside] if array.ndim > 1 else array

        layers = (
            Layer(
                each.name, tuple(map(trim, each.index)), *map(trim, (each.coverage, each.color, each.shade, each.edge))
            )
            for each in self.layers
        )
        return Pattern(trim(self.ground), tuple(layers))

    def recolor(self, matrix: NDArray[np.float64]) -> Pattern:
        """Return the pattern with ``matrix`` applied to its colors, clipped to [0, 1]."""

        def apply(color: ArrayLike) -> NDArray[np.float64]:
            return np.clip(np.asarray(color) @ matrix.T, 0.0, 1.0)

        return Pattern(apply(self.ground), tuple(replace(layer, color=apply(layer.color)) for layer in self.layers))
