"""Make Wang tiles from a sample: squares whose edges have colors, laid side by side where the colors agree.

The method is that of Cohen, Shade, Hiller and Deussen, "Wang Tiles for Image and Texture Generation" (SIGGRAPH 2003),
on the lattice of the sample. :func:`make_wang_tiles` cuts the set, :meth:`WangTiles.lay_out` lays it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused

from ..sampling.equal_places import pixel_grid
from ..sampling.patches import Patches
from ..seams.dynamic_seam import corner_seam
from .tile_frame import TileFrame

_CANDIDATES = 16
"""Number of places tried for the edges of each direction, drawn from all places: each pair costs four seams."""
_PHASES, _FEW = 4, 5
"""Phases along each side of the tile, and number of places for the edges of each direction by which each is rated."""
_LEAST_SIDE = 6
_COARSE = 16
"""To rate a seam, differences are averaged down to about this many px along a quarter's shorter side."""


@dataclass(frozen=True, eq=False)
class WangTiles:
    """A set of tiles: where their pixels come from, and the colors of their edges.

    Parameters
    ----------
    sources
        ``float64 (k, rows, columns, 2)``: for each tile's pixel the point (x, y) of the scaled sample.
    edges
        ``int64 (k, 4)``: the colors of the north, east, south and west edge. Horizontal and vertical edges have
        separate colors.
    corner
        (x, y) in the scaled sample of the place that a tile's first pixel is equivalent to.
    """

    sources: Points
    edges: NDArray[np.int64]
    corner: tuple[int, int]

    @classmethod
    def single(cls, frame: TileFrame, place: tuple[int, int]) -> WangTiles:
        """Return the set of the one tile at a place, which fits itself."""
        rows, columns = frame.size
        sources = pixel_grid(columns, rows).astype(np.float64) + place
        return cls(sources[np.newaxis], np.zeros((1, 4), np.int64), place)

    def pictures(self, patches: Patches, frame: TileFrame) -> dict[str, NDArray[Any]]:
        """Return the images of the tiles, ``tile-01`` and on, and ``edges``."""
        tiles = patches.read_points(frame.to_sample(self.sources))
        return {**{f"tile-{number:02d}": tile for number, tile in enumerate(tiles, 1)}, "edges": self.edges}

    def lay_out(self, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.int64]:
        """Return the number of the tile at each place, ``(rows, columns)``: row by row, uniform among those that fit.

        Cohen et al. 2003, section 3: a tile's north and west edges are given, and at least two tiles have them.
        """
        layout = np.zeros(shape, np.int64)
        if len(self.sources) == 1:
            return layout
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
                layout[row, column], above[column], left = tile, south[tile], int(east[tile])
        return layout


def edge_colors(tiles: int) -> tuple[int, int] | None:
    """Return the numbers of colors of horizontal and vertical edges in a set of so many tiles; None if impossible.

    Each pair of a north and a west color needs two tiles, so that there is a choice (Cohen et al. 2003, section 3.1),
    and no two tiles have the same four colors: 2 a b <= tiles <= (a b)^2. As many colors as possible, as even as
    possible.
    """
    most = math.isqrt(tiles)
    fits = [(a, b) for a in range(1, most + 1) for b in (a, a + 1) if 2 * a * b <= tiles <= (a * b) ** 2]
    fits += [(1, b) for b in range(3, tiles // 2 + 1) if tiles <= b * b and not fits]
    return max(fits, key=math.prod) if fits else None


def make_wang_tiles(cutter: Cutter, place: tuple[int, int], tiles: int) -> WangTiles:
    """Return a set of tiles whose pieces of the sample differ least where they meet.

    Each color of an edge is a piece of the sample around that edge, from one of the places that are equivalent by the
    lattice. A tile shows the pieces of its four edges, joined from its corners to its middle along the lines on which
    they differ least (Cohen et al. 2003, section 3.2: there each piece is a square turned by 45 degrees; here pieces
    lie as the tile does, and seams may leave the diagonals, so that the lattice continues and seams have more choice).

    Where tiles are cut, relative to ``place``, is the one of 16 phases at which seams differ least on average, among
    those with enough pieces: pieces are then whole bricks rather than halves. The first horizontal piece is drawn at
    random. The others are chosen one after the other, horizontal and vertical in turn, each where its seams with the
    pieces chosen before differ least.

    Raises
    ------
    Refused
        When the sample has fewer places than there are colors, or the tile is too small for seams.
    """
    colors, frame = edge_colors(tiles), cutter.frame
    if min(frame.size) < _LEAST_SIDE or colors is None:
        raise Refused(f"a tile of {frame.size[1]}x{frame.size[0]} px has no room for seams; choose tiles=1")
    shifts = [(x * frame.size[1] // _PHASES, y * frame.size[0] // _PHASES) for y, x in np.ndindex(_PHASES, _PHASES)]
    corners = [(place[0] + x, place[1] + y) for x, y in shifts]
    costs = [Joints.around(cutter, corner, max(_FEW, *colors)).costs for corner in corners]
    rated = [cost.mean() if cost.shape[0] >= colors[0] and cost.shape[1] >= colors[1] else np.inf for cost in costs]
    corner = corners[int(np.argmin(np.round(rated, 9)))]
    joints = Joints.around(cutter, corner, max(_CANDIDATES, *colors))
    chosen, edges = joints.choose(colors, cutter.rng), _draw_edges(colors, tiles, cutter.rng)
    sources = [joints.tile(frame.size, chosen, tuple(four)) + corner for four in edges]
    return WangTiles(np.stack(sources), edges, corner)


def _draw_edges(colors: tuple[int, int], tiles: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the tiles' north, east, south and west colors: each pair of north and west meets many others.

    The colors of the j-th tile of a pair run through all south and all east colors before any pair is repeated.
    """
    across, down = colors
    steps = [(j % across, (j % across + j // across) % down) for j in range(across * down)]
    turns = [(rng.permutation(across), rng.permutation(down)) for _ in range(across * down)]
    edges = [
        (pair % across, int(turns[pair][1][east]), int(turns[pair][0][south]), pair // across)
        for south, east in steps
        for pair in rng.permutation(across * down).tolist()
    ]
    return np.array(edges[:tiles], np.int64)


# Pieces of the sample around a tile's edges, and the seams along which they join in the tile


@dataclass(frozen=True, eq=False)
class Cutter:
    """Cuts pieces of a tile's size out of a sample.

    Parameters
    ----------
    patches, shape
        Of the sample.
    frame
        The tile's size, and where its pixels lie in the sample.
    lattice
        Of the sample; its origin does not matter.
    rng
        Draws the pieces, where there are more than needed.
    """

    patches: Patches
    shape: tuple[int, ...]
    frame: TileFrame
    lattice: Lattice
    rng: np.random.Generator

    def places(self, at: Points) -> Points:
        """Return the real-valued places (x, y) in the scaled sample, equal to ``at``, whose pieces lie inside it."""
        rows, columns = self.frame.size
        basis = self.lattice.matrix @ np.linalg.inv(self.frame.steps)
        places = Lattice.from_basis(basis, (float(at[0]), float(at[1]))).reduced().points(self.frame.shape)
        corners = np.array([[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]])
        return np.asarray(places[self.frame.holds(places[:, np.newaxis] + corners, self.shape).all(1)])

    def pieces(self, at: Points, most: int) -> Pieces:
        """Return at most so many pieces that the lattice makes equal to the piece whose first pixel lies ``at``."""
        places = self.places(at)
        if len(places) > most:
            places = places[np.sort(self.rng.choice(len(places), most, replace=False))]
        rows, columns = self.frame.size
        points = places[:, np.newaxis, np.newaxis] + pixel_grid(columns, rows)
        return Pieces(places - at, self.patches.read_points(self.frame.to_sample(points)))


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of the sample around the edges of one direction.

    Parameters
    ----------
    moves
        ``(n, 2)``: vector (x, y) from the tile's own edge to each piece.
    pixels
        ``(n, rows, columns, C)``.
    """

    moves: Points
    pixels: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Joints:
    """The seams of each horizontal piece with each vertical one, in a tile's four quarters.

    ``middle`` is the (row, column) of the first pixel of the south east quarter.
    """

    across: Pieces
    down: Pieces
    middle: tuple[int, int]

    @classmethod
    def around(cls, cutter: Cutter, corner: tuple[int, int], most: int) -> Joints:
        """Return the joints of at most so many pieces around the edges of a tile at ``corner``."""
        rows, columns = cutter.frame.size
        firsts = np.add(corner, [(0, rows // 2 - rows), (columns // 2 - columns, 0)]).astype(np.float64)
        across, down = (cutter.pieces(first, most) for first in firsts)
        return cls(across, down, (rows // 2, columns // 2))

    @cached_property
    def costs(self) -> NDArray[np.float64]:
        """How much each horizontal piece differs from each vertical one along their four seams."""
        pairs = np.ndindex(len(self.across.moves), len(self.down.moves))
        sums = [sum(self._cost(i, j, quarter) for quarter in range(4)) for i, j in pairs]
        return np.array(sums, np.float64).reshape(len(self.across.moves), len(self.down.moves))

    def seam(self, one: int, other: int, quarter: int) -> NDArray[np.bool_]:
        """Return which pixels of a quarter show the horizontal piece; the others show the vertical one."""
        turn = _outward(quarter)
        return corner_seam(self._difference(one, other, quarter)[turn])[0][turn]

    def _cost(self, one: int, other: int, quarter: int) -> float:
        """Return how much two pieces differ along their seam, per pixel, on a coarse grid where the tile is large."""
        difference = self._difference(one, other, quarter)[_outward(quarter)]
        step = max(min(difference.shape) // _COARSE, 1)
        rows, columns = (side // step for side in difference.shape)
        blocks = difference[: rows * step, : columns * step].reshape(rows, step, columns, step)
        return float(corner_seam(blocks.mean((1, 3)))[1] / (rows + columns))

    def _difference(self, one: int, other: int, quarter: int) -> NDArray[np.float64]:
        """Return the squared difference of a horizontal and a vertical piece in a quarter, channels summed."""
        south, east = divmod(quarter, 2)
        (row, column), piece = self.middle, self.across.pixels
        rows, columns = piece.shape[1:3]
        side = slice(0, rows - row) if south else slice(rows - row, rows)
        beside = slice(0, columns - column) if east else slice(columns - column, columns)
        flat = piece[one, side, slice(column, columns) if east else slice(0, column)]
        tall = self.down.pixels[other, slice(row, rows) if south else slice(0, row), beside]
        return np.asarray(((flat.astype(np.float64) - tall) ** 2).sum(-1))

    def choose(self, colors: tuple[int, int], rng: np.random.Generator) -> tuple[list[int], list[int]]:
        """Return horizontal and vertical pieces, chosen greedily for the least sum of the costs of all pairs."""
        counts = len(self.across.moves), len(self.down.moves)
        if counts[0] < colors[0] or counts[1] < colors[1]:
            raise Refused(
                f"the sample holds {counts[0]} and {counts[1]} whole pieces around a tile's horizontal and vertical "
                f"edges, a set needs {colors[0]} and {colors[1]}; choose fewer tiles"
            )
        chosen: tuple[list[int], list[int]] = ([int(rng.integers(counts[0]))], [])
        while len(chosen[0]) < colors[0] or len(chosen[1]) < colors[1]:
            axis = int(len(chosen[1]) < min(colors[1], len(chosen[0])) or len(chosen[0]) == colors[0])
            cost = self.costs[chosen[0]].sum(0) if axis else self.costs[:, chosen[1]].sum(1)
            cost[chosen[axis]] = np.inf
            chosen[axis].append(int(cost.argmin()))
        return chosen

    def tile(self, size: tuple[int, int], chosen: tuple[list[int], list[int]], colors: tuple[int, ...]) -> Points:
        """Return the points (x, y) of the scaled sample that a tile at (0, 0) shows, ``(rows, columns, 2)``."""
        (row, column), (rows, columns) = self.middle, size
        north, east, south, west = colors
        points = pixel_grid(columns, rows).astype(np.float64)
        for quarter in range(4):
            down, right = divmod(quarter, 2)
            one, other = chosen[0][south if down else north], chosen[1][east if right else west]
            taken = self.seam(one, other, quarter)
            box = (slice(row, rows) if down else slice(0, row), slice(column, columns) if right else slice(0, column))
            flat = self.across.moves[one] - (0, rows * down)
            tall = self.down.moves[other] - (columns * right, 0)
            points[box] += np.where(taken[..., np.newaxis], flat, tall)
        return points


def _outward(quarter: int) -> tuple[slice, slice]:
    """Return the flip that brings a quarter's outer corner to its first pixel, and back."""
    south, east = divmod(quarter, 2)
    return slice(None, None, -1 if south else 1), slice(None, None, -1 if east else 1)
