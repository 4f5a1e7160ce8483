"""Feathering: blend a patch into what lies under it, with weights that increase from the patch's border."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Weights = NDArray[np.int64]
"""``int64 (h, w)``: weights in units of 1 / (zone + 1), from 1 to zone + 1. They are integers, so that blends are
rounded alike on every machine."""


@lru_cache(maxsize=64)
def feather_weights(size: int, zone: int, left: bool, top: bool) -> Weights:
    """Return the weights of a square patch that overlaps earlier patches on some of its sides.

    The weight of a pixel is its distance to the nearest overlapped side, and is largest from ``zone`` on (Szeliski and
    Shum 1997; Liang et al. 2001, step e). The rest of the weight goes to what lies under the patch.

    Parameters
    ----------
    size
        Side of the patch, px.
    zone
        Width of the overlap, px.
    left, top
        Whether the patch overlaps earlier patches on these sides.

    Examples
    --------
    >>> feather_weights(4, 2, left=True, top=False)[0].tolist()
    [1, 2, 3, 3]
    """
    ramp, full = np.minimum(np.arange(size) + 1, zone + 1), np.full(size, zone + 1)
    weights = np.minimum((ramp if top else full)[:, np.newaxis], ramp if left else full)
    weights.flags.writeable = False
    return weights


def blend(old: NDArray[np.uint8], new: NDArray[np.uint8], weights: Weights, zone: int) -> NDArray[np.uint8]:
    """Return the weighted means of two pictures, rounded to gray levels, halves up.

    Parameters
    ----------
    old, new
        ``(h, w, C)``.
    weights
        ``(h, w)``: the weights of ``new`` in units of 1 / (zone + 1).
    zone
        See :func:`feather_weights`.
    """
    part = weights[..., np.newaxis]
    total = part * new + (zone + 1 - part) * old
    return np.asarray((2 * total + zone + 1) // (2 * zone + 2), np.uint8)
