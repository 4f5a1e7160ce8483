"""Two periods: the least that a sample must show for its tiles to differ at all."""

from __future__ import annotations

from typing import Final

import numpy as np

from nrbench.lattice.geometry import Lattice
from nrbench.synthesis import Refused

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
    extent = np.abs(lattice.canonical().matrix).max(0)
    if (2 * extent > np.array(shape[1::-1]) + 2 * WHOLE).any():
        raise Refused(
            f"the lattice reaches {extent[0]:.1f}x{extent[1]:.1f} px, the sample is {shape[1]}x{shape[0]} px: it shows "
            "less than two periods"
        )
