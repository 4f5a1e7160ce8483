"""Estimate how much a mean over tiles scatters where neighboring tiles share threads or other long elements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Levels = NDArray[np.float64]


def sum_variance(numbers: NDArray[np.int64], departures: Levels) -> float:
    """Return the variance of a sum over the tiles of one image, from the departures of the tiles from their mean.

    The variance of a sum is the sum of the covariances of all pairs of tiles. If tiles are independent, only the pairs
    of a tile with itself count. A thread crosses a line of tiles, so the pairs of one line count too: lines along both
    lattice vectors, their sum and their difference. A direction whose pairs have a negative sum is left out. This makes
    the estimate up to a half too large where tiles are independent. All other pairs are taken as independent: their
    products are mostly noise. An image has many lines, so a few images suffice, while the scatter of the sum from image
    to image would need dozens.

    Parameters
    ----------
    numbers
        ``(n, 2)``: cell coordinates of the tiles, integers. Tiles may have equal numbers; such tiles belong together.
    departures
        ``(n,)``: departures from the expected value.
    """
    u, v = numbers.T
    alone = _squares(np.stack([u, v], 1), departures)
    lines = (_squares(line[:, np.newaxis], departures) for line in (u, v, u + v, u - v))
    return alone + sum(max(line - alone, 0.0) for line in lines)


def _squares(groups: NDArray[np.int64], departures: Levels) -> float:
    """Return the sum over groups of the squared sums of their departures; ``groups`` is ``(n, k)``."""
    if not len(departures):
        return 0.0
    low = groups.min(0)
    sides = groups.max(0) - low + 1
    index = np.ravel_multi_index(tuple((groups - low).T), tuple(sides))
    return float((np.bincount(index, departures) ** 2).sum())
