"""Masks that repeat with the output: what makes it tileable."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nrbench.plugins.forms import Refused, Shape

from .common_period import misses
from .fftm_mask import TextureMask

Array = NDArray[np.float64]

SLACK = 0.1
"""Share of s by which the mask may be stretched or sheared over the whole output, so that it repeats."""
LONGEST = 4096
"""px: waves longer than that along a side do not vary along it."""


def tileable_mask(mask: TextureMask, shape: Shape) -> TextureMask:
    """Return the mask with its fundamentals fitted to the output: whole numbers of waves along both its sides.

    Equation 7 divides by the components of one frequency pair, which can be 0; here a side is a period where it is a
    vector of the mask's lattice (or a period of its stripes), give or take :data:`SLACK`, over which the lattice is
    then fitted to it. Further groups of waves are stretched by up to half a period over the whole output.

    Parameters
    ----------
    mask
        Of tied harmonics.
    shape
        (height, width) px of the output.

    Raises
    ------
    Refused
        Where a side is no period, naming the nearest sizes that are.
    """
    height, width = shape
    fundamentals = mask.groups[0] if mask.lattice is None else mask.lattice.dual().matrix
    near = [_nearest(fundamentals, axis, side) for axis, side in enumerate((width, height))]
    if near != [width, height]:
        sides = "x".join("?" if side is None else str(side) for side in near)
        raise Refused(f"{width}x{height} px is no period of the mask, so that the output cannot tile; nearest: {sides}")
    harmonics = mask.harmonics
    fitted = np.rint(harmonics.fundamentals * (width, height)) / (width, height)
    return replace(mask, harmonics=replace(harmonics, fundamentals=fitted, frequencies=harmonics.orders @ fitted))


def _nearest(fundamentals: Array, axis: int, side: int) -> int | None:
    """Return the length along an axis nearest to ``side`` that is a period; any, where nothing varies along it."""
    waves = np.abs(fundamentals[:, axis])
    slack = SLACK * float(np.hypot(*np.linalg.pinv(fundamentals)).min())
    reach = 1 / waves[waves > 1 / LONGEST].min(initial=1.0)
    lengths = np.arange(1, math.ceil(2 * max(side, reach)) + 1)
    fits = misses(fundamentals, axis, len(lengths)) <= slack
    good = lengths[fits & ((lengths > 2 * slack) | fits.all())]
    return int(good[np.abs(good - side).argmin()]) if len(good) else None
