"""Compiled loops over the pairs of tiles of an image: distances and lags.

A pair (i, j), i < j, of n tiles has the number ``i (2 n - i - 1) / 2 + j - i - 1``, as in :func:`numpy.triu_indices`.
"""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x1, Float32x2, Int64x1, Int64x2, kernel


@kernel
def add_distances(products: Float32x2, powers: Float32x1, mass: np.float32, part: Float32x1, whole: Float32x1) -> None:
    """Compute the squared distances of all pairs of one part of the tiles, and add them to those of the whole tiles.

    Parameters
    ----------
    products
        ``(n, n)``: products of the parts of two tiles.
    powers
        ``(n,)``: products of each part with itself.
    mass
        Weight of the part in the whole tile.
    part
        ``(n (n - 1) / 2,)``: receives the distances of the part, over its mass.
    whole
        ``(n (n - 1) / 2,)``: the distances are added to it.
    """
    count, pair = len(powers), 0
    for i in range(count):
        for j in range(i + 1, count):
            square = powers[i] + powers[j] - np.float32(2) * products[i, j]
            square = square if square > np.float32(0) else np.float32(0)
            part[pair] = square / mass
            whole[pair] += square
            pair += 1


@kernel
def index_lags(numbers: Int64x2) -> Int64x1:
    """Return an index of the lag of each pair, the same from j to i as from i to j.

    Parameters
    ----------
    numbers
        ``(n, 2)``: cell coordinates of the tiles.
    """
    count, pair = len(numbers), 0
    reach = _reach(numbers)
    lags = np.empty(count * (count - 1) // 2, np.int64)
    for i in range(count):
        for j in range(i + 1, count):
            lags[pair] = _index_lag(numbers[j, 0] - numbers[i, 0], numbers[j, 1] - numbers[i, 1], reach)
            pair += 1
    return lags


@kernel
def pair_blocks(whole: Float32x1, blocks: Int64x2, numbers: Int64x2, count: int) -> tuple[Float32x1, Int64x1]:
    """Return the distances and the lags of pairs of blocks of 2 x 2 tiles that have no tile in common.

    Parameters
    ----------
    whole
        Distances of all pairs of tiles.
    blocks
        ``(m, 4)``: the tiles of each block, in the same order in every block.
    numbers
        ``(m, 2)``: cell coordinates of the first tile of each block.
    count
        Number of tiles.
    """
    reach, pair = _reach(numbers), 0
    every = len(blocks) * (len(blocks) - 1) // 2
    distances, lags = np.empty(every, np.float32), np.empty(every, np.int64)
    for i in range(len(blocks)):
        for j in range(i + 1, len(blocks)):
            u, v = numbers[j, 0] - numbers[i, 0], numbers[j, 1] - numbers[i, 1]
            if abs(u) <= 1 and abs(v) <= 1:
                continue
            total = np.float32(0)
            for k in range(4):
                one, other = blocks[i, k], blocks[j, k]
                if one > other:
                    one, other = other, one
                total += whole[one * (2 * count - one - 1) // 2 + other - one - 1]
            distances[pair] = total / np.float32(4)
            lags[pair] = _index_lag(u, v, reach)
            pair += 1
    return distances[:pair].copy(), lags[:pair].copy()


@kernel
def _reach(numbers: Int64x2) -> int:
    """Return the largest difference of the second cell coordinate."""
    low, high = 0, 0
    for n in range(len(numbers)):
        low = numbers[n, 1] if n == 0 or numbers[n, 1] < low else low
        high = numbers[n, 1] if n == 0 or numbers[n, 1] > high else high
    return high - low


@kernel
def _index_lag(u: int, v: int, reach: int) -> int:
    """Return the index of the lag (u, v), which is that of (-u, -v)."""
    if u < 0 or (u == 0 and v < 0):
        u, v = -u, -v
    return u * (2 * reach + 1) + v + reach
