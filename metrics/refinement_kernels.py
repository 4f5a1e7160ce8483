"""The compiled loop of refinement: windows of an image moved over one cell of a periodic image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.jit import kernel


@kernel(
    "float64[:, ::1](float32[:, :, ::1], float32[:, :, ::1], int64[:, ::1], float64[:, ::1], int64[::1],"
    " float64[:, ::1], int64)"
)
def sums(
    image: NDArray[np.float32],
    cell: NDArray[np.float32],
    corners: NDArray[np.int64],
    start: NDArray[np.float64],
    window: NDArray[np.int64],
    inverse: NDArray[np.float64],
    step: int,
) -> NDArray[np.float64]:
    """Return the weighted sums from which each window's displacement is solved, a row a window.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    cell
        ``(V, U, 1 + 3 A)``: one cell of the weights, of A channels of the periodic image, and of what each changes by
        in a px along x and along y; it wraps round, and is bilinear in between.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    start
        ``(n, 2)``: cell coordinates (u, v) of the periodic image under that pixel.
    window
        Height and width.
    inverse
        2 x 2: cell coordinates (u, v) of one px along x, and along y.
    step
        Every so many pixels, along both axes, one is looked at.

    Returns
    -------
    NDArray
        With t, p, q the periodic image and its two changes, and every channel's weighted mean over the window taken
        out first: weighted sums over pixels and channels of tt, tp, tq, pp, pq, qq, of the image times t, p, q, and of
        the image's own square. Time is linear in the pixels of the windows.
    """
    rows, columns, depth = cell.shape
    axes, channels = (depth - 1) // 3, image.shape[2]
    found = np.zeros((corners.shape[0], 10))
    seen = np.zeros(depth)
    linear = np.zeros((axes, 3))
    own = np.zeros(channels)
    for n in range(corners.shape[0]):
        total = 0.0
        linear[:] = 0.0
        own[:] = 0.0
        tt = tp = tq = pp = pq = qq = it = ip = iq = ii = 0.0
        for y in range(0, window[0], step):
            for x in range(0, window[1], step):
                u = (start[n, 0] + x * inverse[0, 0] + y * inverse[1, 0]) % 1.0 * columns
                v = (start[n, 1] + x * inverse[0, 1] + y * inverse[1, 1]) % 1.0 * rows
                left, top = int(u), int(v)
                u -= left
                v -= top
                if left >= columns:
                    left = 0
                if top >= rows:
                    top = 0
                right = left + 1 if left + 1 < columns else 0
                below = top + 1 if top + 1 < rows else 0
                a, b, c, d = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
                for k in range(depth):
                    seen[k] = (
                        a * cell[top, left, k]
                        + b * cell[top, right, k]
                        + c * cell[below, left, k]
                        + d * cell[below, right, k]
                    )
                w = seen[0]
                total += w
                for k in range(channels):
                    value = image[corners[n, 1] + y, corners[n, 0] + x, k]
                    own[k] += w * value
                    ii += w * value * value
                    if k < axes:
                        t, p, q = seen[1 + k], seen[1 + axes + k], seen[1 + 2 * axes + k]
                        linear[k, 0] += w * t
                        linear[k, 1] += w * p
                        linear[k, 2] += w * q
                        tt += w * t * t
                        tp += w * t * p
                        tq += w * t * q
                        pp += w * p * p
                        pq += w * p * q
                        qq += w * q * q
                        it += w * value * t
                        ip += w * value * p
                        iq += w * value * q
        for k in range(channels):
            ii -= own[k] * own[k] / total
            if k < axes:
                t, p, q = linear[k, 0] / total, linear[k, 1] / total, linear[k, 2] / total
                tt -= t * linear[k, 0]
                tp -= t * linear[k, 1]
                tq -= t * linear[k, 2]
                pp -= p * linear[k, 1]
                pq -= p * linear[k, 2]
                qq -= q * linear[k, 2]
                it -= own[k] * t
                ip -= own[k] * p
                iq -= own[k] * q
        found[n, :] = (tt, tp, tq, pp, pq, qq, it, ip, iq, ii)
    return found
