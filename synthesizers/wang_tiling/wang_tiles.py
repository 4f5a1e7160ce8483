"""Wang tiles: a set of tiles whose edges have colors, laid at random so that the colors agree.

Cohen, Shade, Hiller and Deussen 2003 (Wang tiles for image and texture generation), on the lattice of the sample. The
set is complete, as that of Wei 2004 (Tile-based texture mapping on graphics hardware): there is a tile for each
combination of four colors, so that the colors of edges can be drawn freely, also around an output that repeats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Shape
from nrbench.storage import json_text

from ..canvas.canvas import Mask, cut_closed_seam

Layer = NDArray[np.float32]
"""``(h, w, C + 2)``: pixels, and the point (x, y) of the scaled sample that each one shows."""


@dataclass(frozen=True, eq=False)
class WangTiles:
    """A complete set of Wang tiles. Horizontal and vertical edges have separate colors.

    The tiles are packed as by Wei: the horizontal edges follow a cycle of colors in which each pair occurs once
    (:func:`pair_cycle`), and so do the vertical ones. So the packed set is itself a tiling, which repeats.

    Parameters
    ----------
    colors
        Number of colors n.
    layers
        ``(n^2, n^2, h, w, C + 2)``: the :data:`Layer` of each tile. If n is 1, a single tile fits itself.
    """

    colors: int
    layers: NDArray[np.float32]

    @classmethod
    def cut(cls, blocks: Sequence[Layer], colors: int) -> WangTiles:
        """Return the set that is cut from blocks of a sample.

        Each color is a block around an edge. A tile is a block of its own, to which the blocks of its four edges are
        joined; either side of an edge shows its block. Cohen and others join four squares along the diagonals of the
        tile. Here the joints are minimum cuts that may run anywhere between the edges and the middle of the tile, so
        that elements stay whole. At the corners Cohen's tiles leave it to chance which pieces meet. Here the first
        block is joined to both ends of each edge, and all tiles show it at their corners.

        Parameters
        ----------
        blocks
            More blocks than ``colors``, of even height and width, at places that the lattice makes equal also if they
            are moved by half of their height or width. If a set needs more, some are used again.
        colors
            Number of colors, at least 2.
        """
        shape = blocks[0].shape[0], blocks[0].shape[1]
        places = list(zip(np.indices(shape), shape, strict=True))
        border = [(at == 0) | (at == side - 1) for at, side in places]
        middle = [abs(2 * at + 1 - side) == 1 for at, side in places]
        count = colors**2
        order = np.resize(np.arange(1, len(blocks)), 2 * colors + count**2).tolist()
        edges: list[list[Layer]] = []
        for along, across in ((1, 0), (0, 1)):
            corners, show = _halve([blocks[0], blocks[0]], along), border[along] & middle[across]
            used = order[across * colors : (across + 1) * colors]
            edges.append([_join(blocks[k], corners, middle[along], show) for k in used])
        cycle, tiles = [*pair_cycle(colors), 0], []
        for i, j in np.ndindex(count, count):
            tile = blocks[order[2 * colors + i * count + j]]
            rows, columns = ([edges[axis][cycle[k]] for k in (at, at + 1)] for axis, at in ((0, i), (1, j)))
            tile = _join(tile, _halve(rows, 0), middle[0], border[0])
            tiles.append(_join(tile, _halve(columns, 1), middle[1] | (border[0] & ~border[1]), border[1]))
        return cls(colors, np.stack(tiles).reshape(count, count, *blocks[0].shape))

    @property
    def shape(self) -> Shape:
        """Height and width of a tile."""
        return self.layers.shape[2], self.layers.shape[3]

    @property
    def atlas(self) -> Image:
        """``(n^2 h, n^2 w, C)``: the packed tiles."""
        side, (height, width) = self.colors**2, self.shape
        return np.asarray(self.layers[..., :-2].swapaxes(1, 2).reshape(side * height, side * width, -1))

    def lay(self, counts: tuple[int, int], rng: np.random.Generator) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the row and the column in the set of each tile of an output.

        Parameters
        ----------
        counts
            (rows, columns) of tiles. Opposite edges of the output have the same colors.
        rng
            Draws the colors of all edges, independent of each other.
        """
        cycle = pair_cycle(self.colors)
        number = np.zeros((self.colors, self.colors), np.intp)
        number[cycle, np.roll(cycle, -1)] = np.arange(len(cycle))
        rows, columns = rng.integers(self.colors, size=(2, *counts))
        return number[rows, np.roll(rows, -1, 0)], number[columns, np.roll(columns, -1, 1)]

    def describe(self, prefix: str) -> str:
        """Return the rules as a tileset of the editor Tiled, in its JSON format.

        Parameters
        ----------
        prefix
            What stands before ``atlas.png`` in the name of the picture :attr:`atlas`.

        Notes
        -----
        ``wangid`` has the colors, from 1 on, of the top, right, bottom and left edge at the indices 0, 2, 4 and 6, and
        0 for the corners. The colors of vertical edges are numbered after those of horizontal ones.
        """
        cycle, count, (height, width) = pair_cycle(self.colors), self.colors**2, self.shape
        tiles = []
        for i, j in np.ndindex(count, count):
            (top, bottom), (left, right) = ((1 + cycle[k], 1 + cycle[(k + 1) % count]) for k in (i, j))
            wang = [top, 0, self.colors + right, 0, bottom, 0, self.colors + left, 0]
            tiles.append({"tileid": i * count + j, "wangid": wang})
        names = [f"{kind} {k}" for kind in ("horizontal", "vertical") for k in range(1, self.colors + 1)]
        tints = np.linspace(0x20, 0xE0, len(names)).astype(int).tolist()
        colors = [
            {"name": name, "color": f"#{tint:02x}80{255 - tint:02x}", "probability": 1, "tile": -1}
            for name, tint in zip(names, tints, strict=True)
        ]
        tileset = {
            "type": "tileset", "version": "1.10", "name": "wang tiles",
            "image": f"{prefix}atlas.png",
            "imagewidth": count * width, "imageheight": count * height, "margin": 0, "spacing": 0, "tilewidth": width,
            "tileheight": height, "tilecount": count**2, "columns": count,
            "wangsets": [{"name": "edges", "type": "edge", "tile": -1, "colors": colors, "wangtiles": tiles}],
        }  # fmt: skip
        return json_text(tileset)


def pair_cycle(colors: int) -> list[int]:
    """Return a cycle in which each ordered pair of colors occurs once: ``colors``^2 numbers, the first one 0.

    Examples
    --------
    >>> pair_cycle(3)
    [0, 0, 1, 0, 2, 1, 1, 2, 2]
    """
    return [color for i in range(colors) for color in [i, *(k for j in range(i + 1, colors) for k in (i, j))]]


def _halve(layers: Sequence[Layer], axis: int) -> Layer:
    """Return the second half of one layer and the first half of another one, side by side along an axis."""
    return np.concatenate([np.split(layer, 2, axis)[1 - k] for k, layer in enumerate(layers)], axis)


def _join(old: Layer, new: Layer, stay: Mask, show: Mask) -> Layer:
    """Return a layer joined to another one by a minimum cut; both are shown where they must be."""
    pixels = [np.ascontiguousarray(layer[..., :-2]) for layer in (old, new)]
    mask = cut_closed_seam(pixels[0], pixels[1], np.ones(stay.shape, np.bool_), (stay, show))
    return np.where(mask[..., np.newaxis], new, old)
