"""Regions of dominance: the largest disk around each peak that holds no higher one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.dominance_kernels import region_radii
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
    O(n log n): see :func:`~nrbench.detectors.autocorrelation.dominance_kernels.region_radii`.
    """
    order = np.argsort(-values, kind="stable")
    radii = np.empty(len(values))
    radii[order] = region_radii(np.ascontiguousarray(np.asarray(lags, np.float64)[order]))
    return radii
