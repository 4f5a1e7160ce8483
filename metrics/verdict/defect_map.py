"""The output, dimmed, with its bad tiles in color."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, gray
from nrbench.imaging.fold import cell_coordinates
from nrbench.lattice.geometry import Points

from .tiles import Tiles
from .verdict import Verdict

COLORS = {"moved": (1.0, 0.6, 0.0), "displaced": (0.9, 0.1, 0.1), "broken": (0.7, 0.1, 0.8)}
"""A tile whose window is out of place; one that fits better elsewhere; one that fits nowhere."""
_DIM = 0.5


def defect_map(verdict: Verdict) -> Image:
    """Return the output in faint gray, the quarter cells around the middles of bad tiles tinted by :data:`COLORS`.

    Of several faults of one tile the last of moved, broken, displaced is shown.
    """
    output, tiles = verdict.output.image, verdict.output.tiles
    faint = np.repeat((1 - _DIM + _DIM * gray(output))[..., np.newaxis], 3, 2)
    flags = {"moved": verdict.moved, "broken": verdict.broken, "displaced": verdict.displaced}
    tints = np.full((len(tiles.centers) + 1, 3), np.nan, np.float32)
    for name, flag in flags.items():
        tints[:-1][flag] = COLORS[name]
    tint = tints[nearest_tile(tiles, output.shape[:2])]
    return np.clip(np.where(np.isnan(tint), faint, (1 - _DIM) * faint + _DIM * tint), 0, 1)


def nearest_tile(tiles: Tiles, shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return for each pixel the index of the tile that it is nearest to in cell coordinates; -1 where there is none."""
    halves = _halves(cell_coordinates(tiles.lattice, shape))
    own = _halves(tiles.lattice.to_cell(tiles.centers))
    low, high = halves.reshape(-1, 2).min(0), halves.reshape(-1, 2).max(0)
    table = np.full(high - low + 1, -1, np.intp)
    table[tuple((own - low).T)] = np.arange(len(own))
    return np.asarray(table[tuple(np.moveaxis(halves - low, -1, 0))])


def _halves(uv: Points) -> NDArray[np.intp]:
    return np.rint(2 * uv).astype(np.intp)
