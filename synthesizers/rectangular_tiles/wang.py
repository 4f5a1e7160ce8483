"""Wang tiles cut from a sample: squares whose edges have colors, laid side by side where the colors agree."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Refused

from ..sampling.patches import Patches
from .tile_rectangle import TileFrame, pixel_grid
from .wang_pieces import Cutter, Joints

_CANDIDATES = 16
"""Places looked at for either direction's edges, drawn from all: each pair costs four seams."""
_PHASES, _FEW = 4, 5
"""Phases along each side of the tile, and places for either direction's edges by which each is rated."""
_LEAST_SIDE = 6


@dataclass(frozen=True, eq=False)
class WangSet:
    """Tiles, where their pixels come from, and the colors of their edges.

    Parameters
    ----------
    sources
        ``float64 (k, rows, columns, 2)``: for each tile's pixel the point (x, y) of the scaled sample.
    edges
        ``int64 (k, 4)``: the colors of the north, east, south and west edge; horizontal edges meet horizontal ones.
    corner
        (x, y) in the scaled sample of what a tile's first pixel is equal to, by the lattice.
    """

    sources: Points
    edges: NDArray[np.int64]
    corner: tuple[int, int]

    @classmethod
    def single(cls, frame: TileFrame, place: tuple[int, int]) -> WangSet:
        """Return the set of the one tile at a place, which fits itself."""
        return cls(pixel_grid(frame.size)[np.newaxis] + place, np.zeros((1, 4), np.int64), place)

    def pictures(self, patches: Patches, frame: TileFrame) -> dict[str, NDArray[Any]]:
        """Return the tiles of the set, ``tile-01`` and on, and ``edges``."""
        tiles = patches.read(frame.to_sample(self.sources))
        return {**{f"tile-{number:02d}": tile for number, tile in enumerate(tiles, 1)}, "edges": self.edges}

    def lay_out(self, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.int64]:
        """Return which tile lies where, ``(rows, columns)``: row by row, drawn uniformly from those that fit.

        Cohen, Shade, Hiller and Deussen 2003, section 3: a tile's north and west edges are given, and at least two
        tiles have them.
        """
        found = np.zeros(shape, np.int64)
        if len(self.sources) == 1:
            return found
        north, east, south, west = self.edges.T
        fitting = {
            (a, b): np.flatnonzero((north == a) & (west == b)) for a in set(north.tolist()) for b in set(west.tolist())
        }
        chance = rng.random(shape)
        above = rng.choice(north, shape[1])
        for row in range(shape[0]):
            left = int(rng.choice(west))
            for column in range(shape[1]):
                choice = fitting[int(above[column]), left]
                tile = choice[int(chance[row, column] * len(choice))]
                found[row, column], above[column], left = tile, south[tile], int(east[tile])
        return found


def colors_for(tiles: int) -> tuple[int, int] | None:
    """Return how many colors horizontal and vertical edges have in a set of so many tiles; None where none will do.

    Each pair of a north and a west color needs two tiles, that there be a choice (Cohen et al. 2003, section 3.1), and
    no two tiles have the same four colors: 2 a b <= tiles <= (a b)^2. As many colors as possible, as even as possible.
    """
    most = math.isqrt(tiles)
    fits = [(a, b) for a in range(1, most + 1) for b in (a, a + 1) if 2 * a * b <= tiles <= (a * b) ** 2]
    fits += [(1, b) for b in range(3, tiles // 2 + 1) if tiles <= b * b and not fits]
    return max(fits, key=math.prod) if fits else None


def wang_set(cutter: Cutter, place: tuple[int, int], tiles: int) -> WangSet:
    """Return a set of tiles made of samples that differ least where they meet.

    Every color of an edge is a piece of the sample around that edge, from a place that the lattice calls equal. A tile
    shows its four edges' pieces, joined from its corners to its middle along the lines on which they differ least
    (Cohen et al. 2003, section 3.2: there each is a square turned by 45 degrees; here pieces lie as the tile does, and
    seams may leave the diagonals, so that the lattice goes on and seams find more).

    Where tiles are cut, relative to ``place``, is the phase of 16, of those with pieces enough, at which seams differ
    least on average: pieces are then whole bricks rather than halves. The first horizontal piece is drawn at random,
    the others are chosen one after the other, horizontal and vertical in turn, each where its seams with those chosen
    differ least.

    Raises
    ------
    Refused
        When the sample has fewer places than there are colors, or the tile is too small for seams.
    """
    colors, frame = colors_for(tiles), cutter.frame
    if min(frame.size) < _LEAST_SIDE or colors is None:
        raise Refused(f"a tile of {frame.size[1]}x{frame.size[0]} px has no room for seams; choose tiles=1")
    shifts = [(x * frame.size[1] // _PHASES, y * frame.size[0] // _PHASES) for y, x in np.ndindex(_PHASES, _PHASES)]
    corners = [(place[0] + x, place[1] + y) for x, y in shifts]
    costs = [Joints.found(cutter, corner, max(_FEW, *colors)).costs for corner in corners]
    rated = [cost.mean() if cost.shape[0] >= colors[0] and cost.shape[1] >= colors[1] else np.inf for cost in costs]
    corner = corners[int(np.argmin(np.round(rated, 9)))]
    joints = Joints.found(cutter, corner, max(_CANDIDATES, *colors))
    chosen, edges = joints.compatible(colors, cutter.rng), _edges(colors, tiles, cutter.rng)
    sources = [joints.tile(frame.size, chosen, tuple(four)) + corner for four in edges]
    return WangSet(np.stack(sources), edges, corner)


def _edges(colors: tuple[int, int], tiles: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the tiles' north, east, south and west colors: each pair of north and west meets many others.

    The j-th tile of a pair has colors that run through all south and all east ones before any pair comes back.
    """
    across, down = colors
    steps = [(j % across, (j % across + j // across) % down) for j in range(across * down)]
    turns = [(rng.permutation(across), rng.permutation(down)) for _ in range(across * down)]
    made = [
        (pair % across, int(turns[pair][1][east]), int(turns[pair][0][south]), pair // across)
        for south, east in steps
        for pair in rng.permutation(across * down).tolist()
    ]
    return np.array(made[:tiles], np.int64)
