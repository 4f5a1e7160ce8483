"""Wang tiles cut from a sample: squares whose edges have colors, laid side by side where the colors agree."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.seams import dynamic_seam
from nrbench.lattice.geometry import Lattice, Points
from nrbench.synthesis import Refused, Task

from .splines import resampled
from .tile_rectangle import TileFrame

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
        return cls(_pixels(frame.size)[np.newaxis] + place, np.zeros((1, 4), np.int64), place)

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


def wang_set(task: Task, frame: TileFrame, lattice: Lattice, place: tuple[int, int], tiles: int) -> WangSet:
    """Return a set of tiles made of samples that differ least where they meet.

    Every color of an edge is a piece of the sample around that edge, from a place that the lattice calls equal. A tile
    shows its four edges' pieces, joined from its corners to its middle along the lines on which they differ least
    (Cohen et al. 2003, section 3.2: there each is a square turned by 45 degrees; here pieces lie as the tile does, and
    seams may leave the diagonals, so that the lattice goes on and seams find more).

    Where tiles are cut, relative to ``place``, is the phase of 16 at which seams differ least on average: pieces are
    then whole bricks rather than halves. The first horizontal piece is drawn at random, the others are chosen one after
    the other, horizontal and vertical in turn, each where its seams with those chosen differ least.

    Raises
    ------
    Refused
        When the sample has fewer places than there are colors, or the tile is too small for seams.
    """
    colors = colors_for(tiles)
    if min(frame.size) < _LEAST_SIDE or colors is None:
        raise Refused(f"a tile of {frame.size[1]}x{frame.size[0]} px has no room for seams; choose tiles=1")
    shifts = [(x * frame.size[1] // _PHASES, y * frame.size[0] // _PHASES) for y, x in np.ndindex(_PHASES, _PHASES)]
    corners = [(place[0] + x, place[1] + y) for x, y in shifts]
    costs = [_Joints.found(task, frame, lattice, corner, _FEW).costs for corner in corners]
    rated = [cost.mean() if cost.size else np.inf for cost in costs]
    corner = corners[int(np.argmin(np.round(rated, 9)))]
    joints = _Joints.found(task, frame, lattice, corner, max(_CANDIDATES, *colors))
    chosen, edges = joints.compatible(colors, task.rng), _edges(colors, tiles, task.rng)
    sources = [joints.tile(frame.size, chosen, tuple(four)) + corner for four in edges]
    return WangSet(np.stack(sources), edges, corner)


def _pixels(size: tuple[int, int]) -> Points:
    """Return the (x, y) of each pixel, ``(rows, columns, 2)``."""
    y, x = np.indices(size)
    return np.stack([x, y], -1).astype(np.float64)


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


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of the sample around one direction's edges: how far from the tile's own edge, and their pixels."""

    moves: Points
    pixels: NDArray[np.float32]

    @classmethod
    def found(cls, task: Task, frame: TileFrame, lattice: Lattice, at: Points, most: int) -> _Pieces:
        """Return at most so many of the pieces equal, by the lattice, to that whose first pixel lies ``at``."""
        places = _equal_places(frame, lattice, at, task.sample.shape)
        if len(places) > most:
            places = places[np.sort(task.rng.choice(len(places), most, replace=False))]
        return cls(places - at, _cut(task, frame, places))


def _equal_places(frame: TileFrame, lattice: Lattice, at: Points, shape: tuple[int, ...]) -> Points:
    """Return the real-valued places (x, y) in the scaled sample, equal to ``at``, whose pieces lie inside it."""
    rows, columns = frame.size
    a, b = (lattice.matrix @ np.linalg.inv(frame.steps)).tolist()
    places = Lattice((a[0], a[1]), (b[0], b[1]), (float(at[0]), float(at[1]))).reduced().points(frame.shape)
    corners = np.array([[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]])
    return np.asarray(places[frame.holds(places[:, np.newaxis] + corners, shape).all(1)])


def _cut(task: Task, frame: TileFrame, places: Points) -> NDArray[np.float32]:
    """Return the pieces at real-valued places, ``(n, rows, columns, C)``."""
    rows, columns = frame.size
    if not len(places):
        return np.empty((0, rows, columns, task.sample.shape[2]), np.float32)

    def points(pixels: Points) -> Points:
        x, y = pixels[..., 0], pixels[..., 1]
        number = (y // rows).astype(np.intp)
        return frame.to_sample(places[number] + np.stack([x, y % rows], -1))

    asked = replace(task, shape=(len(places) * rows, columns), progress=lambda done: None)
    return resampled(asked, points)[0].reshape(len(places), rows, columns, -1)


@dataclass(frozen=True, eq=False)
class _Joints:
    """The seams of each horizontal piece with each vertical one, in a tile's four quarters.

    ``middle`` is the (row, column) of the first pixel of the south east quarter.
    """

    across: _Pieces
    down: _Pieces
    middle: tuple[int, int]

    @classmethod
    def found(cls, task: Task, frame: TileFrame, lattice: Lattice, corner: tuple[int, int], most: int) -> _Joints:
        """Return those of at most so many pieces around the edges of a tile at ``corner``."""
        rows, columns = frame.size
        firsts = np.add(corner, [(0, rows // 2 - rows), (columns // 2 - columns, 0)]).astype(np.float64)
        across, down = (_Pieces.found(task, frame, lattice, first, most) for first in firsts)
        return cls(across, down, (rows // 2, columns // 2))

    @cached_property
    def costs(self) -> NDArray[np.float64]:
        """How much each horizontal piece differs from each vertical one along their four seams."""
        pairs = np.ndindex(len(self.across.moves), len(self.down.moves))
        sums = [sum(self.seam(i, j, quarter)[1] for quarter in range(4)) for i, j in pairs]
        return np.array(sums, np.float64).reshape(len(self.across.moves), len(self.down.moves))

    def seam(self, one: int, other: int, quarter: int) -> tuple[NDArray[np.bool_], float]:
        """Return which pixels of a quarter the horizontal piece takes, and how much the two differ along the seam."""
        south, east = divmod(quarter, 2)
        (row, column), piece = self.middle, self.across.pixels
        rows, columns = piece.shape[1:3]
        side = slice(0, rows - row) if south else slice(rows - row, rows)
        beside = slice(0, columns - column) if east else slice(columns - column, columns)
        flat = piece[one, side, slice(column, columns) if east else slice(0, column)]
        tall = self.down.pixels[other, slice(row, rows) if south else slice(0, row), beside]
        difference = ((flat.astype(np.float64) - tall) ** 2).sum(-1)
        turn = (slice(None, None, -1 if south else 1), slice(None, None, -1 if east else 1))
        taken, cost = corner_seam(difference[turn])
        return taken[turn], cost

    def compatible(self, colors: tuple[int, int], rng: np.random.Generator) -> tuple[list[int], list[int]]:
        """Return the horizontal and vertical pieces chosen, greedily, for the least sum over all pairs' seams."""
        held = len(self.across.moves), len(self.down.moves)
        if held[0] < colors[0] or held[1] < colors[1]:
            raise Refused(
                f"the sample holds {held[0]} and {held[1]} whole pieces around a tile's horizontal and vertical edges, "
                f"a set needs {colors[0]} and {colors[1]}; choose fewer tiles"
            )
        chosen: tuple[list[int], list[int]] = ([int(rng.integers(held[0]))], [])
        while len(chosen[0]) < colors[0] or len(chosen[1]) < colors[1]:
            axis = int(len(chosen[1]) < min(colors[1], len(chosen[0])) or len(chosen[0]) == colors[0])
            met = self.costs[chosen[0]].sum(0) if axis else self.costs[:, chosen[1]].sum(1)
            met[chosen[axis]] = np.inf
            chosen[axis].append(int(met.argmin()))
        return chosen

    def tile(self, size: tuple[int, int], chosen: tuple[list[int], list[int]], colors: tuple[int, ...]) -> Points:
        """Return where a tile's pixels come from, in the scaled sample, less the place, ``(rows, columns, 2)``."""
        (row, column), (rows, columns) = self.middle, size
        north, east, south, west = colors
        found = _pixels(size)
        for quarter in range(4):
            down, right = divmod(quarter, 2)
            one, other = chosen[0][south if down else north], chosen[1][east if right else west]
            taken, _ = self.seam(one, other, quarter)
            box = (slice(row, rows) if down else slice(0, row), slice(column, columns) if right else slice(0, column))
            flat = self.across.moves[one] - (0, rows * down)
            tall = self.down.moves[other] - (columns * right, 0)
            found[box] += np.where(taken[..., np.newaxis], flat, tall)
        return found


def corner_seam(difference: NDArray[np.float64]) -> tuple[NDArray[np.bool_], float]:
    """Return the best cut from the first pixel to the last of a quarter, and what it costs.

    The cut is a staircase, right or down at each pixel, so that every pixel lies on one side; it leaves the outer edges
    to the pieces whose they are, and the inner ones as well. In coordinates (x + y, x - y) it is a seam from top to
    bottom whose columns change by 1.

    Parameters
    ----------
    difference
        ``(h, w)``, each at least 3: how much the pieces differ.

    Returns
    -------
    taken
        ``bool (h, w)``: the pixels above the cut and on it where it first meets their column, which the horizontal
        piece takes.
    cost
        Sum of ``difference`` along the cut.
    """
    rows, columns = difference.shape
    y, x = np.indices(difference.shape)
    free = ((x > 0) | (y < 2)) & ((y > 0) | (x < 2)) & ((x < columns - 1) | (y > rows - 3))
    free &= (y < rows - 1) | (x > columns - 3)
    surface = np.full((rows + columns - 1, rows + columns - 1), np.inf)
    along, aside = np.asarray(x + y), np.asarray(x - y + rows - 1)
    surface[along[free], aside[free]] = difference[free]
    path, step = dynamic_seam(surface), np.arange(rows + columns - 1)
    over, under = (step + path - rows + 1) // 2, (step - path + rows - 1) // 2
    first = np.take(under, np.searchsorted(over, np.arange(columns)))
    return y <= first, float(difference[under, over].sum())
