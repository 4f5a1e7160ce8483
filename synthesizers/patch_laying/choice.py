"""Draw one of the places of a sample at which a patch fits its surroundings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_SHARE = 1e6
"""The largest relative error that a method accepts as a parameter. Its square times an error is finite."""


def draw_within(errors: NDArray[Any], limit: float, rng: np.random.Generator) -> int:
    """Draw one of the entries that are at most ``limit``, all with the same probability.

    If there are none, one of the least entries is drawn, so that there is always a result.

    Parameters
    ----------
    errors
        At least one, of any shape.
    limit
        The largest accepted error, in the unit of ``errors``.
    rng
        The generator; at most one number is drawn from it.

    Returns
    -------
    int
        Flat index of the entry.
    """
    accepted = np.flatnonzero(errors <= max(limit, errors.min()))
    return int(accepted[rng.integers(len(accepted))])
