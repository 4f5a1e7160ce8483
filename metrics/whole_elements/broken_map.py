"""Pictures of broken tiles: where they lie, and the worst of them enlarged."""

from __future__ import annotations

import numpy as np

from nrbench.imaging.convert import Image, gray
from nrbench.imaging.fold import Values

from ..ncc.periodic import tile_box
from .broken import Broken

_DIM = 0.5
_MARK = np.array((0.9, 0.1, 0.1), np.float32)
_WORST, _SIDE, _GAP = 8, 96, 4


def broken_map(output: Image, broken: Broken) -> Image:
    """Return the output in faint gray, broken tiles in their colors and framed."""
    faint = np.repeat((1 - _DIM + _DIM * gray(output))[..., np.newaxis], 3, 2)
    colored = np.broadcast_to(output, (*output.shape[:2], 3))
    reach = np.abs(broken.lattice.matrix).sum(0) / 2 + 1
    for place in broken.places:
        x0, y0 = np.maximum(np.floor(place - reach), 0).astype(int)
        x1, y1 = np.ceil(place + reach).astype(int) + 1
        y, x = np.indices(output[y0:y1, x0:x1].shape[:2])
        uv = np.abs(broken.lattice.shifted(place - broken.lattice.origin).to_cell(np.stack([x + x0, y + y0], -1)))
        inside, edge = (uv < 0.5).all(-1), (uv.max(-1) >= 0.5 - 1.0 / np.sqrt(broken.lattice.area))
        faint[y0:y1, x0:x1][inside] = colored[y0:y1, x0:x1][inside]
        faint[y0:y1, x0:x1][inside & edge] = _MARK
    return np.asarray(np.clip(faint, 0, 1), np.float32)


def worst_tiles(output: Image, broken: Broken) -> Image:
    """Return up to eight of the worst tiles and their neighborhoods, two tiles wide, side by side, worst first."""
    reach = np.maximum(np.ceil(tile_box(broken.lattice)).astype(int), 3)
    crops = [_enlarged(_around(output, place, reach)) for place in broken.places[:_WORST]]
    gap = np.ones((max(crop.shape[0] for crop in crops), _GAP, output.shape[2]), np.float32)
    return np.concatenate([part for crop in crops for part in (crop, gap)][:-1], 1)


def _around(output: Image, place: Values, reach: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> Image:
    middle = np.rint(place).astype(int)
    x, y = (
        np.clip(np.arange(m - r, m + r + 1), 0, side - 1)
        for m, r, side in zip(middle, reach, output.shape[1::-1], strict=True)
    )
    return np.asarray(output[np.ix_(y, x)])


def _enlarged(crop: Image) -> Image:
    """Return a crop, each pixel repeated so that the crop is about 96 px high."""
    times = max(round(_SIDE / crop.shape[0]), 1)
    return np.asarray(crop.repeat(times, 0).repeat(times, 1))
