"""A baseline: random tiles edge to edge, cut through the middle of the motif."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import fold, sample_tile
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Task

from .baselines.lattice_baseline import OFFSET, LatticeBaseline, edge_points, half_extent, whole_cell_centers
from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import CellTorus

_STEPS = 24
"""Number of places of the cell, along each vector, that are tried for the cuts."""
_ALONG_EDGE = 24
"""Number of points along each side of the cell at which a cut is rated."""
_BLUR = 0.15
"""Standard deviation, in cells, of the blur of the energy."""


@leaves_out
@dataclass(frozen=True)
class Shuffle(LatticeBaseline):
    """Random tiles of the sample edge to edge: keeps lattice, variation and colors, but breaks the elements.

    A tile is a Voronoi cell of the lattice. Its edges run where the sample varies most from tile to tile: through the
    middle of the motif, so that each motif is joined from parts of several. Every cell of the output shows a random
    tile of the sample, drawn uniformly, at the exact, real-valued place, interpolated by splines of order 5. Nothing is
    blended.

    On perfectly regular textures it is a valid method rather than a baseline. Without a given lattice it finds one by
    ``gncc``.
    """

    version: ClassVar[str] = "1"

    def find_tiles(self, task: Task, lattice: Lattice) -> tuple[Callable[[Points], Points], str]:
        """Return the point of the sample that each output pixel shows."""
        whole_cell_centers(lattice, task.sample.shape)
        middle, places = _place_cuts(task, lattice.reduced())
        tiles = Lattice(lattice.t1, lattice.t2, (float(middle[0]), float(middle[1]))).reduced()
        low, chosen = _draw_tiles(task, tiles, len(places))
        torus = CellTorus.closing(tiles, task.shape) if task.tileable else None
        if torus:
            chosen = task.rng.integers(len(places), size=(torus.columns, torus.rows))

        def locate(pixels: Points) -> Points:
            away = tiles.wrap(pixels - middle)
            cells = np.rint(tiles.to_cell(pixels - away)).astype(np.intp)
            u, v = np.moveaxis(torus.wrap(cells) if torus else cells - low, -1, 0)
            return np.asarray(places[chosen[u, v]] + away)

        return locate, ""


def _draw_tiles(task: Task, tiles: Lattice, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the lowest cell numbers (u, v) of the output, and which of ``count`` tiles each cell shows."""
    height, width = task.shape
    x, y = half_extent(tiles)
    numbers = tiles.cell_numbers((-2 * x, -2 * y), (width + 2 * x, height + 2 * y))
    low = np.asarray(numbers.min(0))
    return low, task.rng.integers(count, size=tuple(numbers.max(0) - low + 1))


def _place_cuts(task: Task, lattice: Lattice) -> tuple[Points, Points]:
    """Return a tile's middle such that its edges run where tiles vary most, and the middles of all whole tiles.

    A cut is rated by the energy of the departures along the edge, blurred so that the middle of a motif counts for more
    than its border. Of equally good places the first is used.
    """
    mean = fold(task.sample, lattice)
    departures = ((task.sample - mean.unfold(task.sample.shape[:2])) ** 2).sum(-1, keepdims=True)
    tile = fold(departures, lattice).values
    sigma = (*(_BLUR * side for side in tile.shape[:2]), 0)
    energy = np.asarray(scipy.ndimage.gaussian_filter(tile, sigma, mode="wrap"), np.float32)
    steps = np.arange(_STEPS) / _STEPS
    starts = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    edge = edge_points(lattice, _ALONG_EDGE) @ np.linalg.inv(lattice.matrix)
    ratings = sample_tile(energy, starts[:, np.newaxis] + edge)[..., 0].mean(1)
    for start in starts[np.argsort(-ratings.round(9), kind="stable")]:
        middle = lattice.from_cell(start) + OFFSET
        places = _whole_tiles(task, lattice, middle)
        if len(places):
            return middle, places
    raise Refused("the sample holds no whole tile at any place of the cell")


def _whole_tiles(task: Task, lattice: Lattice, middle: Points) -> Points:
    """Return the middles of all tiles equivalent to the one at ``middle`` that lie entirely within the sample."""
    height, width = task.sample.shape[:2]
    middles = Lattice(lattice.t1, lattice.t2, (float(middle[0]), float(middle[1]))).points((height, width))
    x, y = half_extent(lattice)
    inside = (middles >= (x, y)) & (middles <= (width - 1 - x, height - 1 - y))
    return np.asarray(middles[inside.all(1)])
