"""The compiled loop of RSGF's lattice search: every pair of candidate vectors, rated by its multiples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel("float64[::1](int32[:, ::1], float64[:, ::1], float64, float64, float64)")
def best_pair(
    surface: NDArray[np.int32], candidates: NDArray[np.float64], unit: float, alpha: float, overlap: float
) -> NDArray[np.float64]:
    """Return the pair of generating vectors of the highest goodness.

    Parameters
    ----------
    surface
        ``(2H-1, W)``: normalized autocorrelation of an image ``(H, W)`` in whole multiples of 1 / ``unit``, lag
        (dx, dy) at ``[H-1+dy, dx]``.
    candidates
        ``(n, 2)``: vectors (x, y) px in ascending length, on the right half-plane.
    unit
        What 1 is in ``surface``; sums of whole numbers do not depend on their order.
    alpha
        Exponent of the sum.
    overlap
        Share of the candidate tile's bounding box that a valid multiple's overlap must cover.

    Returns
    -------
    NDArray
        ``(6,)``: goodness, x1, y1, x2, y2, number of valid multiples; zeros where no pair has any.

    Notes
    -----
    RSGF (2011), section 3.3, steps 4 to 7 and equation 9.
    """
    height, width = (surface.shape[0] + 1) // 2, surface.shape[1]
    best = np.zeros(6)
    for i in range(candidates.shape[0]):
        x1, y1 = candidates[i]
        square = x1 * x1 + y1 * y1
        for j in range(i + 1, candidates.shape[0]):
            x2, y2 = candidates[j]
            times = np.rint((x2 * x1 + y2 * y1) / square)
            x2, y2 = x2 - times * x1, y2 - times * y1
            if x2 < 0 or (x2 == 0 and y2 < 0):
                x2, y2 = -x2, -y2
            if x2 * x2 + y2 * y2 < square:
                continue
            # The tile's bounding box; an overlap narrower than `overlap` of it is invalid whatever its height.
            across, down = abs(x1) + abs(x2), abs(y1) + abs(y2)
            box = overlap * across * down
            if min(width - abs(x1), across) * min(height - abs(y1), down) < box or abs(y1) >= height:
                continue
            if min(width - abs(x2), across) * min(height - abs(y2), down) < box or abs(y2) >= height:
                continue
            far_x, far_y = width - overlap * across, height - overlap * down
            reach = int((far_y * abs(x1) + far_x * abs(y1)) / abs(x1 * y2 - x2 * y1)) + 1
            total, count = 0, 0
            for b in range(-reach, reach + 1):
                low, high = -1e9, 1e9
                if x1 > 1e-9:
                    low, high = (-b * x2 - 0.5) / x1, (far_x - b * x2) / x1
                if abs(y1) > 1e-9:
                    one, other = (-far_y - b * y2) / y1, (far_y - b * y2) / y1
                    low, high = max(low, min(one, other)), min(high, max(one, other))
                for a in range(int(np.ceil(low)), int(np.floor(high)) + 1):
                    x, y = a * x1 + b * x2, a * y1 + b * y2
                    if x < 0 or (x == 0 and y <= 0):
                        continue
                    if x > far_x or abs(y) > far_y:
                        continue
                    if min(width - x, across) * min(height - abs(y), down) < box:
                        continue
                    total += surface[int(np.rint(y)) + height - 1, int(np.rint(x))]
                    count += 1
            if total <= 0:
                continue
            goodness = (total / unit) ** alpha / count
            if goodness > best[0]:
                best = np.array((goodness, x1, y1, x2, y2, float(count)))
    return best
