"""The largest upright box inside a mask with a ragged border."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def largest_box(inside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return first and last row and column, half-open, of a box whose borders hold True values alone.

    The worst border of the mask is removed until none holds a False value. Where False values lie along the borders of
    the mask, the box is close to the largest one without any. Holes in the middle are not seen.
    """
    y0, y1, x0, x1 = 0, inside.shape[0], 0, inside.shape[1]
    while y1 - y0 > 1 and x1 - x0 > 1:
        box = inside[y0:y1, x0:x1]
        worst = [float((~border).mean()) for border in (box[0], box[-1], box[:, 0], box[:, -1])]
        side = int(np.argmax(worst))
        if worst[side] == 0:
            break
        y0, y1, x0, x1 = y0 + (side == 0), y1 - (side == 1), x0 + (side == 2), x1 - (side == 3)
    return y0, y1, x0, x1
