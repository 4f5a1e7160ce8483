"""Tiles that claim to wrap: whether their borders show, and how small they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

_INSIDE = 0.95
_ROUNDING = 0.5 / 255
_LEAST_SIDE = 4


def claimed_tile(output: Image, extras: Mapping[str, NDArray[Any]]) -> Image | str:
    """Return the tile that claims to wrap, or why there is none.

    Parameters
    ----------
    output
        The output.
    extras
        ``tile``: ``(H, W)`` or ``(H, W, C)`` in [0, 1], a tile that repeats along both axes; or ``tileable``, not zero:
        the output itself does.
    """
    if "tile" in extras:
        tile = np.asarray(extras["tile"], np.float32)
        tile = tile[..., np.newaxis] if tile.ndim == 2 else tile
        if tile.ndim != 3 or min(tile.shape[:2]) < _LEAST_SIDE or tile.shape[2] not in (1, 3):
            return f"not applicable: extras['tile'] of shape {tile.shape} is no image of at least 4 px a side"
        return tile
    if "tileable" in extras and np.asarray(extras["tileable"]).any():
        return output
    return "not applicable: no tile in the extras, and the output does not claim to wrap"


def border_excess(tile: Image) -> float:
    """Return the gradient across the wrapped borders over that across lines inside, the worse of both borders.

    The root mean squared difference between the last row and the first, over what 95 % of neighboring rows inside do
    not exceed; and the same for columns. 1 and less: no more to see than inside.
    """
    return max(_excess(tile), _excess(tile.transpose(1, 0, 2)))


def _excess(tile: Image) -> float:
    jumps = np.sqrt(((tile - np.roll(tile, 1, 0)) ** 2).mean((1, 2), dtype=np.float64))
    return float(jumps[0] + _ROUNDING) / float(np.quantile(jumps[1:], _INSIDE) + _ROUNDING)


def byte_share(tile: Image, sample: Image) -> float:
    """Return the bytes of the tile over those of the sample, both of 8 bits a value."""
    return tile.size / sample.size
