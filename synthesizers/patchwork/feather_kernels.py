"""The compiled loop of feathering: pixels near seams are blended from the patches that meet there."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x3, Float64x2, Int64x3, kernel


@kernel
def feather_seams(
    sample: Float32x3, origin: Int64x3, image: Float32x3, weights: Float64x2
) -> tuple[Float32x3, Float32x3]:
    """Return an output whose patches are blended near their seams, and its source map.

    Each pixel is the weighted mean of the values that the patches around it have there. The weight of a patch is the
    sum of ``weights`` over the neighbors that show it. A patch that ends before the pixel has no weight.

    Parameters
    ----------
    sample
        ``(h, w, C)``.
    origin
        ``(H, W, 2)``: the (x, y) in the sample of each pixel.
    image
        ``(H, W, C)``: the output before blending.
    weights
        ``(2 r + 1, 2 r + 1)``: the weight of each neighbor, by its distance; the middle one is the largest.

    Returns
    -------
    blended
        ``(H, W, C)``. Pixels around which all neighbors show one patch are copies.
    source
        ``(H, W, 3)``: the (x, y) in the sample of the patch of the largest weight, and its share of the weights. The
        time is O(H W r^2).
    """
    height, width, channels = image.shape
    rows, columns = sample.shape[:2]
    reach = weights.shape[0] // 2
    blended, source = image.copy(), np.ones((height, width, 3), np.float32)
    places, shares = np.empty((weights.size, 2), np.int64), np.empty(weights.size)
    for y in range(height):
        for x in range(width):
            places[0, 0], places[0, 1], shares[0] = origin[y, x, 0], origin[y, x, 1], 0.0
            count = 1
            for j in range(max(y - reach, 0), min(y + reach + 1, height)):
                for i in range(max(x - reach, 0), min(x + reach + 1, width)):
                    u, v = origin[j, i, 0] + x - i, origin[j, i, 1] + y - j
                    if u < 0 or v < 0 or u >= columns or v >= rows:
                        continue
                    k = 0
                    while k < count and (places[k, 0] != u or places[k, 1] != v):
                        k += 1
                    if k == count:
                        places[k, 0], places[k, 1], shares[k] = u, v, 0.0
                        count += 1
                    shares[k] += weights[j - y + reach, i - x + reach]
            source[y, x, 0], source[y, x, 1] = places[0, 0], places[0, 1]
            if count == 1:
                continue
            total, best = 0.0, 0
            for k in range(count):
                total += shares[k]
                if shares[k] > shares[best]:
                    best = k
            for c in range(channels):
                value = 0.0
                for k in range(count):
                    value += shares[k] * sample[places[k, 1], places[k, 0], c]
                blended[y, x, c] = min(max(value / total, 0.0), 1.0)
            source[y, x, 0], source[y, x, 1] = places[best, 0], places[best, 1]
            source[y, x, 2] = min(shares[best] / total, np.float64(np.float32(1) - np.float32(2**-24)))
    return blended, source
