"""Regions of dominance: the largest disk around each peak that holds no higher one."""

from __future__ import annotations

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from nrbench.lattice.geometry import Points


def dominance(lags: Points, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radius, px, of the region of dominance of each peak of an autocorrelation, ``(n,)``.

    The peak at lag 0 is higher than all, and each peak has its mirror image. Of equal peaks the first is the higher.

    Parameters
    ----------
    lags, values
        ``(n, 2)`` and ``(n,)``: the peaks on the right half-plane.

    Notes
    -----
    Each half of the ranking looks for its nearest among the half above: O(n log(n)^2).
    """
    order = np.argsort(-values, kind="stable")
    ranked = np.asarray(lags, np.float64)[order]
    radii = np.asarray(np.hypot(*ranked.T), np.float64)
    pending = [(0, len(ranked))]
    while pending:
        start, end = pending.pop()
        half = (start + end) // 2
        if half == start:
            continue
        tree = scipy.spatial.KDTree(np.concatenate([ranked[start:half], -ranked[start:half]]))
        radii[half:end] = np.minimum(radii[half:end], tree.query(ranked[half:end])[0])
        pending += [(start, half), (half, end)]
    return np.asarray(radii[np.argsort(order)])
