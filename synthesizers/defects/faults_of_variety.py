"""Faults of variety: content in its place, of which the output holds too much alike, or too much in one tile."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points, Vector

from ..sampling.equal_places import equivalent_positions
from .planting import Field, Mask, Planting, Plot, read

_PATCH_TILES = 2.0


def two_tone(plot: Plot) -> Planting:
    """Cut tiles through their middle across t1, and join to one half the other half of another fresh draw's."""
    tile, away = _tiles(plot.pixels(), plot.lattice)
    tiles, index = np.unique(tile.reshape(-1, 2), axis=0, return_inverse=True)
    rank = plot.rng.permutation(len(tiles))[index.reshape(plot.shape)]
    number = round(plot.size * len(tiles))
    covered = (rank < number) & (away @ plot.lattice.matrix[0] > 0)
    image, other = plot.fresh(), plot.fresh()
    joined = np.where(covered[..., np.newaxis], other, image)
    return Planting(joined, plot.still(), covered, f"{number} of {len(tiles)} tiles")


def over_regular(plot: Plot) -> Planting:
    """Mix the draw with the periodic repetition of one of its tiles."""
    length = math.hypot(*plot.lattice.t1)
    diagonal = math.hypot(length, plot.lattice.area / length) + 1
    margin = math.ceil(max(*plot.box, length, diagonal - plot.reach.min()))
    lattice = plot.lattice.shifted((-margin, -margin))
    tile, _ = _tiles(plot.pixels(), lattice)
    chosen, _ = _tiles(plot.inside(), lattice)
    field: Field = np.rint((tile - chosen) @ lattice.matrix).astype(np.intp) if plot.size else plot.still()
    draw = plot.fresh(margin)
    image, repeated = read(draw, margin, plot.still()), read(draw, margin, field)
    mixed = repeated if plot.size == 1 else image + np.float32(plot.size) * (repeated - image)
    return Planting(mixed, field, amount=f"weight {plot.size:g}")


def verbatim(plot: Plot) -> Planting:
    """Replace patches in one half by copies of places in the other half that the lattice calls equal to theirs."""
    halves = _Halves.of(plot)
    field, order = plot.still(), np.full(plot.shape, plot.shape[0] * plot.shape[1], np.intp)
    count = 0
    for corner in plot.rng.permutation(halves.corners()):
        patch, move = halves.patch(corner), _source(plot, halves, corner)
        if move is not None:
            pixels = order[patch]
            pixels[...] = count + np.arange(pixels.size).reshape(pixels.shape)
            field[patch], count = move, count + pixels.size
    covered: Mask = order < min(round(plot.size * order.size), count)
    field[~covered] = 0
    return Planting(read(plot.fresh(), 0, field), field, covered, f"{covered.mean():.3f} of the area")


def _tiles(points: Points, lattice: Lattice) -> tuple[Points, Points]:
    """Return for each point the tile that holds it, in whole cells, and the vector to it from the tile's middle.

    The middles are the lattice's points. Where the lattice is hexagonal, a tile is what lies nearer to its middle than
    to any other; else a rectangle, as long as t1 and as high as a course, as bricks are.
    """
    if lattice.kind == "hexagonal":
        away = lattice.wrap(points - np.array(lattice.origin))
        return np.rint(lattice.to_cell(points - away)), away
    row = np.rint(lattice.to_cell(points)[..., 1])
    t1, t2 = lattice.matrix
    in_row = points - np.array(lattice.origin) - row[..., np.newaxis] * t2
    column = np.rint(in_row @ t1 / (t1 @ t1))
    return np.stack([column, row], -1), in_row - column[..., np.newaxis] * t1


@dataclass(frozen=True)
class _Halves:
    """The half that copies come from, the half they go to (both x0, y0, x1, y1), and the patches' width and height."""

    source: tuple[int, int, int, int]
    target: tuple[int, int, int, int]
    width: int
    height: int

    @classmethod
    def of(cls, plot: Plot) -> _Halves:
        """Cut the output across its longer side; patches leave half of the source's width and height to choose from."""
        height, width = plot.shape
        low, high = (
            ((0, 0, width // 2, height), (width // 2, 0, width, height))
            if width >= height
            else ((0, 0, width, height // 2), (0, height // 2, width, height))
        )
        source, target = (low, high) if plot.rng.integers(2) else (high, low)
        half = np.array([source[2] - source[0], source[3] - source[1]]) // 2
        patch = np.maximum(np.minimum(np.rint(_PATCH_TILES * plot.box).astype(int), half), 1)
        return cls(source, target, int(patch[0]), int(patch[1]))

    def corners(self) -> NDArray[np.intp]:
        """Return the first pixels (x, y) of the patches of the target."""
        x0, y0, x1, y1 = self.target
        x, y = np.meshgrid(np.arange(x0, x1, self.width), np.arange(y0, y1, self.height))
        return np.stack([x, y], -1).reshape(-1, 2).astype(np.intp)

    def patch(self, corner: NDArray[np.intp]) -> tuple[slice, slice]:
        """Return the patch at a corner, cut off where the target ends."""
        x, y = (int(value) for value in corner)
        return slice(y, min(y + self.height, self.target[3])), slice(x, min(x + self.width, self.target[2]))


def _source(plot: Plot, halves: _Halves, corner: NDArray[np.intp]) -> NDArray[np.intp] | None:
    """Return how far content moves from an equal place to a patch: one of those that whole pixels meet best, if any."""
    x0, y0, x1, y1 = halves.source
    room = (y1 - y0 - halves.height + 1, x1 - x0 - halves.width + 1)
    at: Vector = (float(corner[0] - x0), float(corner[1] - y0))
    places = equivalent_positions(plot.lattice, at, room)
    if not len(places):
        return None
    pixels = np.floor(places + 0.5)
    error = np.hypot(*(pixels - places).T)
    good = np.flatnonzero(error <= np.median(error))
    chosen = pixels[good[plot.rng.integers(len(good))]]
    return np.asarray(np.array(at) - chosen).astype(np.intp)
