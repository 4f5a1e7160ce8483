"""The compiled loops of a patchwork: the costs of a window's links, the patch that it shows, and feathered seams."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Boolx2, Float32x3, Float32x4, Float64x2, Float64x4, Int32x3, Int64x3, kernel, step_kernel

from ..canvas.seam_kernels import FIRST, SECOND, STAY

UNIT = 16.0
"""Costs are integers, in units of 1 / UNIT gray levels, so that flows are exact."""

SeamRule = tuple[Int32x3, Int32x3, bool, int]
"""How a seam is rated: the sample's ``features``, their gradients ``(2, H, W)``, and the parameters ``normalized`` and
``power`` of :class:`~nrbench.synthesizers.patchwork.patchwork.Patchwork`."""


@step_kernel
def seam_cost(rule: SeamRule, apart: float, busy: int) -> int:
    """Return the cost of a seam on a link, from the summed differences and gradients of two patches at its pixels."""
    normalized, power = rule[2], rule[3]
    if not normalized:
        return int(np.rint(UNIT * apart))
    return int(np.rint(UNIT * UNIT * apart * (apart if power == 2 else UNIT) / (busy + UNIT)))


@step_kernel
def feature_distance(features: Int32x3, y: int, x: int, v: int, u: int) -> float:
    """Return the Euclidean distance of the features of two pixels, (y, x) and (v, u)."""
    squares = 0
    for c in range(features.shape[2]):
        difference = int(features[y, x, c]) - int(features[v, u, c])
        squares += difference * difference
    return float(np.sqrt(np.float64(squares)))


@step_kernel
def step_cost(rule: SeamRule, axis: int, y: int, x: int, v: int, u: int) -> int:
    """Return the cost of a seam between two patches on a link to the right (axis 0) or downward (axis 1).

    (y, x) and (v, u) are the places of the link's first pixel in the sample, for either patch. Beyond the sample's
    edges its outermost pixels are repeated.
    """
    if y == v and x == u:
        return 0
    features, slopes = rule[0], rule[1]
    last_row, last_column = features.shape[0] - 1, features.shape[1] - 1
    apart, busy = 0.0, 0
    for k in range(2):
        down, right = k * axis, k * (1 - axis)
        j, i = min(max(y + down, 0), last_row), min(max(x + right, 0), last_column)
        n, m = min(max(v + down, 0), last_row), min(max(u + right, 0), last_column)
        apart += feature_distance(features, j, i, n, m)
        busy += slopes[axis, j, i] + slopes[axis, n, m]
    return seam_cost(rule, apart, busy)


@step_kernel
def measure_pixels(
    rule: SeamRule, source: Int64x3, known: Boolx2, x: int, y: int, apart: Float64x2, busy: Int64x3
) -> None:
    """Write each known pixel's distance from the new patch, ``(h, w)``, and the sums of both gradients, ``(2, h, w)``.

    Most links join pixels of one patch; their costs follow from these numbers. Parameters are those of
    :func:`link_choices`.
    """
    features, slopes = rule[0], rule[1]
    for j in range(known.shape[0]):
        for i in range(known.shape[1]):
            if not known[j, i]:
                continue
            v, u = source[j, i, 1], source[j, i, 0]
            n, m = min(max(y + j, 0), features.shape[0] - 1), min(max(x + i, 0), features.shape[1] - 1)
            apart[j, i] = feature_distance(features, v, u, n, m)
            for axis in range(2):
                busy[axis, j, i] = slopes[axis, v, u] + slopes[axis, n, m]


@kernel
def link_choices(rule: SeamRule, source: Int64x3, known: Boolx2, x: int, y: int) -> Float64x4:
    """Return the cost of each link of a window for each case of replaced pixels.

    Parameters
    ----------
    rule
        See :data:`SeamRule`.
    source
        ``(h, w, 2)``: (x, y) in the sample of the window's pixels.
    known
        ``(h, w)``: whether they are known.
    x, y
        The place in the sample of the new patch's first pixel.

    Returns
    -------
    NDArray
        ``(2, 3, h, w)``: for the link to the right of each pixel and the link below it, the costs in the cases
        :data:`STAY`, :data:`SECOND` and :data:`FIRST`. 0 if there is no link, or if a pixel that stays is unknown.

    Notes
    -----
    Kwatra et al. 2003, equation 1. Let the link's pixels s and t show patches A and B, and let N be the new patch. With
    M(s, t, P, Q) = |P(s) - Q(s)| + |P(t) - Q(t)| the costs are ::

        STAY:   M(s, t, A, B)      both pixels stay
        SECOND: M(s, t, A, N)      only t becomes new
        FIRST:  M(s, t, N, B)      only s becomes new

    each divided by the gradients if the costs are normalized. Most links lie inside one patch, A = B: then STAY is 0,
    and both others follow from the distances that :func:`measure_pixels` has written. O(h w F).
    """
    height, width = known.shape
    costs, apart = np.zeros((2, 3, height, width)), np.zeros((height, width))
    busy = np.zeros((2, height, width), np.int64)
    measure_pixels(rule, source, known, x, y, apart, busy)
    for axis in range(2):
        down, right = axis, 1 - axis
        for j in range(height - down):
            for i in range(width - right):
                n, m = j + down, i + right
                first, second = known[j, i], known[n, m]
                ay, ax = source[j, i, 1], source[j, i, 0]
                by, bx = source[n, m, 1] - down, source[n, m, 0] - right
                # Inside one patch.
                if first and second and ay == by and ax == bx:
                    if ay != y + j or ax != x + i:
                        cost = seam_cost(rule, apart[j, i] + apart[n, m], busy[axis, j, i] + busy[axis, n, m])
                        costs[axis, SECOND, j, i] = costs[axis, FIRST, j, i] = cost
                    continue
                # Between two patches, or beside unknown pixels.
                if first and second:
                    costs[axis, STAY, j, i] = step_cost(rule, axis, ay, ax, by, bx)
                if first:
                    costs[axis, SECOND, j, i] = step_cost(rule, axis, ay, ax, y + j, x + i)
                if second:
                    costs[axis, FIRST, j, i] = step_cost(rule, axis, y + j, x + i, by, bx)
    return costs


@kernel
def feather_seams(
    sample: Float32x3, origin: Int64x3, image: Float32x3, weights: Float64x2
) -> tuple[Float32x3, Float32x3, Float32x4]:
    """Return an output whose patches are blended near their seams, its source map, and its further sources.

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
        ``(H, W, 3)``: the (x, y) in the sample of the patch of the largest weight, and its share of the weights.
    further
        ``(H, W, 3, 3)``: the same of the patches of the next weights; 0 where there is none.

    Notes
    -----
    Kwatra et al. 2003, section 5, "feathering". For each pixel p::

        for each neighbor q up to r px away, which shows the sample's pixel o(q):
            the patch of q shows o(q) + p - q at p; if the sample has it, its share grows by the weight of q - p
        p becomes the mean of what these patches show, weighted by their shares

    O(H W r^2).
    """
    height, width, channels = image.shape
    rows, columns = sample.shape[:2]
    reach = weights.shape[0] // 2
    blended, source = image.copy(), np.ones((height, width, 3), np.float32)
    further = np.zeros((height, width, 3, 3), np.float32)
    places, shares = np.empty((weights.size, 2), np.int64), np.empty(weights.size)
    for y in range(height):
        for x in range(width):
            places[0, 0], places[0, 1], shares[0] = origin[y, x, 0], origin[y, x, 1], 0.0
            count = 1
            # The share of each patch around; the first one is the pixel's own.
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
            # The mean of what they show, and the one of the largest share.
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
            for n in range(min(count - 1, further.shape[2])):
                shares[best] = -1.0
                best = int(np.argmax(shares[:count]))
                further[y, x, n, 0], further[y, x, n, 1] = places[best, 0], places[best, 1]
                further[y, x, n, 2] = shares[best] / total
    return blended, source, further
