"""Check that a sample shows two periods. With less, a method cannot learn how its tiles differ."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused

PERIOD_SLACK: Final = 0.05
"""px by which a sample may be smaller than two periods. Periods are not measured more accurately than this."""


def require_two_periods(lattice: Lattice, shape: tuple[int, ...]) -> None:
    """Check that a sample of ``shape`` (height, width, ...) shows two periods along x and along y.

    Raises
    ------
    Refused
        If the sample is narrower or lower than twice the extent of the lattice's two shortest vectors.
    """
    if not shows_two_periods(lattice, shape):
        extent = _extent(lattice)
        raise Refused(
            f"the lattice reaches {extent[0]:.1f}x{extent[1]:.1f} px, the sample is {shape[1]}x{shape[0]} px: it shows "
            "less than two periods; choose a larger sample"
        )


def shows_two_periods(lattice: Lattice, shape: tuple[int, ...]) -> bool:
    """Return whether a sample of ``shape`` (height, width, ...) shows two periods along x and along y."""
    return bool((2 * _extent(lattice) <= np.array(shape[1::-1]) + 2 * PERIOD_SLACK).all())


def _extent(lattice: Lattice) -> NDArray[np.float64]:
    """Return the extent of the two shortest vectors along x and along y: the larger component of both, px."""
    return np.asarray(np.abs(lattice.canonical().matrix).max(0))
