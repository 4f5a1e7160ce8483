"""Pieces of a sample around a tile's edges, and the seams along which they join in the tile."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused

from ..sampling.patches import Patches
from ..seams.corner_seam import corner_seam
from .tile_rectangle import TileFrame, pixel_grid

_COARSE = 16
"""Seams that are only rated see differences averaged down to about so many px a quarter's shorter side."""


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
        Draws some where there are many.
    """

    patches: Patches
    shape: tuple[int, ...]
    frame: TileFrame
    lattice: Lattice
    rng: np.random.Generator

    def equal_places(self, at: Points) -> Points:
        """Return the real-valued places (x, y) in the scaled sample, equal to ``at``, whose pieces lie inside it."""
        rows, columns = self.frame.size
        basis = self.lattice.matrix @ np.linalg.inv(self.frame.steps)
        places = Lattice.from_basis(basis, (float(at[0]), float(at[1]))).reduced().points(self.frame.shape)
        corners = np.array([[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]])
        return np.asarray(places[self.frame.holds(places[:, np.newaxis] + corners, self.shape).all(1)])

    def cut(self, places: Points) -> NDArray[np.float32]:
        """Return the pieces at real-valued places, ``(n, rows, columns, C)``."""
        return self.patches.read(self.frame.to_sample(places[:, np.newaxis, np.newaxis] + pixel_grid(self.frame.size)))


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of the sample around one direction's edges: how far from the tile's own edge, and their pixels."""

    moves: Points
    pixels: NDArray[np.float32]

    @classmethod
    def found(cls, cutter: Cutter, at: Points, most: int) -> Pieces:
        """Return at most so many of the pieces equal, by the lattice, to that whose first pixel lies ``at``."""
        places = cutter.equal_places(at)
        if len(places) > most:
            places = places[np.sort(cutter.rng.choice(len(places), most, replace=False))]
        return cls(places - at, cutter.cut(places))


@dataclass(frozen=True, eq=False)
class Joints:
    """The seams of each horizontal piece with each vertical one, in a tile's four quarters.

    ``middle`` is the (row, column) of the first pixel of the south east quarter.
    """

    across: Pieces
    down: Pieces
    middle: tuple[int, int]

    @classmethod
    def found(cls, cutter: Cutter, corner: tuple[int, int], most: int) -> Joints:
        """Return those of at most so many pieces around the edges of a tile at ``corner``."""
        rows, columns = cutter.frame.size
        firsts = np.add(corner, [(0, rows // 2 - rows), (columns // 2 - columns, 0)]).astype(np.float64)
        across, down = (Pieces.found(cutter, first, most) for first in firsts)
        return cls(across, down, (rows // 2, columns // 2))

    @cached_property
    def costs(self) -> NDArray[np.float64]:
        """How much each horizontal piece differs from each vertical one along their four seams."""
        pairs = np.ndindex(len(self.across.moves), len(self.down.moves))
        sums = [sum(self._rating(i, j, quarter) for quarter in range(4)) for i, j in pairs]
        return np.array(sums, np.float64).reshape(len(self.across.moves), len(self.down.moves))

    def seam(self, one: int, other: int, quarter: int) -> NDArray[np.bool_]:
        """Return which pixels of a quarter the horizontal piece takes; the vertical one takes the others."""
        turn = _outward(quarter)
        return corner_seam(self._difference(one, other, quarter)[turn])[0][turn]

    def _rating(self, one: int, other: int, quarter: int) -> float:
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
        found = pixel_grid(size)
        for quarter in range(4):
            down, right = divmod(quarter, 2)
            one, other = chosen[0][south if down else north], chosen[1][east if right else west]
            taken = self.seam(one, other, quarter)
            box = (slice(row, rows) if down else slice(0, row), slice(column, columns) if right else slice(0, column))
            flat = self.across.moves[one] - (0, rows * down)
            tall = self.down.moves[other] - (columns * right, 0)
            found[box] += np.where(taken[..., np.newaxis], flat, tall)
        return found


def _outward(quarter: int) -> tuple[slice, slice]:
    """Return the turn that brings a quarter's outer corner to its first pixel, and back."""
    south, east = divmod(quarter, 2)
    return slice(None, None, -1 if south else 1), slice(None, None, -1 if east else 1)
