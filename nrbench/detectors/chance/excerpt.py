"""The part of a large image on which a detection is tested against chance."""

from __future__ import annotations

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice

SIDE = 512
"""px: no image is cut shorter."""
PERIODS = 10.0
"""A test with this many periods a side leaves no doubt where there is a lattice at all; more only cost time."""


def excerpt(image: Image, lattice: Lattice) -> Image:
    """Return the middle of an image, :data:`PERIODS` of the longer generating vector a side, or :data:`SIDE` px.

    Phase-randomized copies of a 4096 x 4096 image take minutes; those of its middle, seconds.
    """
    longest = float(abs(lattice.reduced().matrix).max())
    side = max(SIDE, round(PERIODS * longest))
    top, left = (max(n - side, 0) // 2 for n in image.shape[:2])
    return image[top : top + side, left : left + side]
