"""The views through which a large picture is looked at: whole but small, and its middle in detail."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

SIDE = 640
"""px; pictures up to this side are looked at as they are."""
LEAST = 24
"""px; no view is shrunk below this side."""
PERIOD = 12.0
"""px; what is shrunk leaves the shorter generating vector at least as long."""


class View(NamedTuple):
    """A part of an image, shrunk.

    Parameters
    ----------
    image
        The part's pixels, means of ``factor`` x ``factor`` of the image's.
    factor
        A power of 2.
    """

    image: Image
    factor: int


def views(image: Image) -> Iterator[View]:
    """Yield views of at most :data:`SIDE` px a side, from the middle in full detail to the whole picture.

    Each doubles the part that is seen and halves its detail: whatever the period, one view shows many and each well.
    """
    factor = 1
    while True:
        yield view(image, factor, SIDE)
        if max(image.shape[:2]) <= factor * SIDE or min(image.shape[:2]) < 2 * factor * LEAST:
            return
        factor *= 2


def view(image: Image, factor: int, side: int) -> View:
    """Return the middle of an image, shrunk by a factor to at most ``side`` px a side."""
    return View(shrunk(middle(image, factor * side), factor), factor)


def middle(image: Image, side: int) -> Image:
    """Return the middle of an image, at most ``side`` px a side."""
    top, left = (max(n - side, 0) // 2 for n in image.shape[:2])
    return image[top : top + side, left : left + side]


def shrunk(image: Image, factor: int) -> Image:
    """Return the means of blocks of ``factor`` x ``factor`` px; what is over at the right and below is left out."""
    if factor == 1:
        return image
    height, width = (n // factor for n in image.shape[:2])
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
    return np.asarray(blocks.mean((1, 3)), np.float32)


def scale_for(basis: Points) -> int:
    """Return the largest factor by which an image with these generating vectors may be shrunk (:data:`PERIOD`)."""
    return 1 << max(0, int(np.log2(max(np.hypot(*basis.T).min() / PERIOD, 1))))
