"""A cheat: random tiles edge to edge, cut through the middle of the motif."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.detectors.gncc import Gncc
from nrbench.imaging.fold import Values, fold, sample_tile
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Kind, Refused, Synthesis, Task, require_lattice

from .sampling.splines import resampled
from .tiling import ASIDE, reach, whole_centres

_STEPS = 24
"""Places of the cell, along each vector, that are tried for the cuts."""
_ALONG_EDGE = 24
"""Points along each edge of the cell at which a cut is rated."""
_BLUR = 0.15
"""Standard deviation, in cells, over which energy is blurred."""


@dataclass(frozen=True)
class Shuffle:
    """Random tiles of the sample edge to edge: keeps lattice, variation and colors, but breaks what each tile is.

    A tile is a Voronoi cell of the lattice. It is placed so that its edges run where the sample varies most from tile
    to tile - through the middle of the motif, so that each motif is joined from parts of several. Every cell of the
    output shows one of those of the sample, uniformly at random, at the exact, real-valued place by splines of order 5;
    nothing is blended.

    On perfectly regular textures it is no cheat. With no lattice given it finds one by ``gncc``.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        lattice, seconds = require_lattice(task, Gncc(), "there are no tiles to shuffle")
        whole_centres(lattice, task.sample.shape)
        middle, places = _cut(task, lattice.reduced())
        tiles = Lattice(lattice.t1, lattice.t2, (float(middle[0]), float(middle[1]))).reduced()
        low, chosen = _choices(task, tiles, len(places))

        def points(pixels: Points) -> Points:
            away = tiles.wrap(pixels - middle)
            u, v = np.moveaxis(np.rint(tiles.to_cell(pixels - away)).astype(np.intp) - low, -1, 0)
            return np.asarray(places[chosen[u, v]] + away)

        image, source = resampled(task, points)
        return Synthesis(image, lattice, source, detection_seconds=seconds)


def _choices(task: Task, tiles: Lattice, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the lowest number of any cell of the output, and which of ``count`` tiles of the sample each shows."""
    height, width = task.shape
    x, y = reach(tiles)
    numbers = tiles.cell_numbers((-2 * x, -2 * y), (width + 2 * x, height + 2 * y))
    low = np.asarray(numbers.min(0))
    return low, task.rng.integers(count, size=tuple(numbers.max(0) - low + 1))


def _cut(task: Task, lattice: Lattice) -> tuple[Points, Points]:
    """Return a tile's middle such that its edges run where tiles vary most, and all that the sample holds whole.

    The departures' energy on the edge, blurred so that the middle of a motif counts for more than its border, is what
    the cut is rated by; of places equally good the first is taken.
    """
    mean = fold(task.sample, lattice)
    departures = ((task.sample - mean.unfold(task.sample.shape[:2])) ** 2).sum(-1, keepdims=True)
    energy = _blurred(fold(departures, lattice).values)
    steps = np.arange(_STEPS) / _STEPS
    starts = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    edge = _edge(lattice) @ np.linalg.inv(lattice.matrix)
    ratings = sample_tile(energy, starts[:, np.newaxis] + edge)[..., 0].mean(1)
    for start in starts[np.argsort(-ratings.round(9), kind="stable")]:
        middle = lattice.from_cell(start) + ASIDE
        places = _whole(task, lattice, middle)
        if len(places):
            return middle, places
    raise Refused("the sample holds no whole tile at any place of the cell")


def _blurred(tile: Values) -> Values:
    sigma = [_BLUR * side for side in tile.shape[:2]]
    return np.asarray(ndimage.gaussian_filter(tile, (*sigma, 0), mode="wrap"), np.float32)


def _edge(lattice: Lattice) -> Points:
    """Return points (x, y) along the edge of the Voronoi cell around 0, evenly spaced along each edge."""
    a, b = lattice.matrix
    around = [a, b, b - a, -a, -b, a - b]
    order = sorted(around, key=lambda vector: float(np.arctan2(vector[1], vector[0])))
    pairs = zip(order, order[1:] + order[:1], strict=True)
    corners = np.array([np.linalg.solve(2 * np.stack([p, q]), [p @ p, q @ q]) for p, q in pairs])
    along = (np.arange(_ALONG_EDGE) + 0.5)[:, np.newaxis, np.newaxis] / _ALONG_EDGE
    points = corners + along * (np.roll(corners, -1, 0) - corners)
    long = np.hypot(*(np.roll(corners, -1, 0) - corners).T) > 1e-6
    return np.asarray(points[:, long].reshape(-1, 2))


def _whole(task: Task, lattice: Lattice, middle: Points) -> Points:
    """Return the middles of all tiles that the lattice calls equal and that lie whole within the sample."""
    height, width = task.sample.shape[:2]
    found = Lattice(lattice.t1, lattice.t2, (float(middle[0]), float(middle[1]))).points((height, width))
    x, y = reach(lattice)
    inside = (found >= (x, y)) & (found <= (width - 1 - x, height - 1 - y))
    return np.asarray(found[inside.all(1)])
