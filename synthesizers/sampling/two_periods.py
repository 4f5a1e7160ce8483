"""Two periods: the least that a sample must show for its tiles to differ at all."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused

WHOLE: Final = 0.05
"""A period this little, px, under a whole number is that number: none is measured better."""


def require_two_periods(lattice: Lattice, shape: tuple[int, ...]) -> None:
    """Refuse a sample of ``shape`` (height, width, ...) that is under twice as wide or high as the lattice reaches.

    A lattice reaches as far along x, and along y, as the farther of its two shortest vectors does.

    Raises
    ------
    Refused
        Telling how far the lattice reaches, and how large the sample is.
    """
    if not shows_two_periods(lattice, shape):
        extent = _extent(lattice)
        raise Refused(
            f"the lattice reaches {extent[0]:.1f}x{extent[1]:.1f} px, the sample is {shape[1]}x{shape[0]} px: it shows "
            "less than two periods"
        )


def shows_two_periods(lattice: Lattice, shape: tuple[int, ...]) -> bool:
    """Return whether a sample of ``shape`` (height, width, ...) is twice as wide and high as the lattice reaches."""
    return bool((2 * _extent(lattice) <= np.array(shape[1::-1]) + 2 * WHOLE).all())


def _extent(lattice: Lattice) -> NDArray[np.float64]:
    """Return how far a lattice reaches along x and y, px."""
    return np.asarray(np.abs(lattice.canonical().matrix).max(0))
