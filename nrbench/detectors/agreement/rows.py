"""Compiled: the whole numbers of one row of a lattice within a box."""

from __future__ import annotations

import numpy as np

from nrbench.jit import kernel


@kernel("UniTuple(int64, 2)(float64, float64, float64, float64, int64, float64, float64)")
def row_ends(x1: float, y1: float, x2: float, y2: float, b: int, end_x: float, end_y: float) -> tuple[int, int]:
    """Return the first and the last a for which a (x1, y1) + b (x2, y2) lies within (+-end_x, +-end_y).

    Where no a is, the last is less than the first.
    """
    low, high = -1e9, 1e9
    if abs(x1) > 1e-9:
        one, other = (-end_x - b * x2) / x1, (end_x - b * x2) / x1
        low, high = max(low, min(one, other)), min(high, max(one, other))
    elif abs(b * x2) > end_x:
        return 1, 0
    if abs(y1) > 1e-9:
        one, other = (-end_y - b * y2) / y1, (end_y - b * y2) / y1
        low, high = max(low, min(one, other)), min(high, max(one, other))
    elif abs(b * y2) > end_y:
        return 1, 0
    return int(np.ceil(low)), int(np.floor(high))
