"""Images moved by fractions of a pixel, ready to be copied from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, to_bytes

from .patches import Patches


@dataclass(frozen=True, eq=False)
class Fractions:
    """Copies of images at every fraction 0, 1/n, ... of a pixel along x and y.

    Parameters
    ----------
    values
        ``uint8 (k * n * n, H * W * C)``: copy ``(m * n + fy) * n + fx`` shows at pixel (x, y) what the m-th image shows
        at (x + fx / n, y + fy / n).
    shape
        (H, W, C) of the images.
    parts
        n: 1 where images are copied in whole pixels alone.
    """

    values: NDArray[np.uint8]
    shape: tuple[int, int, int]
    parts: int


def fractions(images: Sequence[Image], parts: int) -> Fractions:
    """Return copies of some images at all fractions, interpolated by splines of order 5, mirrored at the border.

    Parameters
    ----------
    images
        ``(H, W, C)``, all of one shape.
    parts
        How many fractions a pixel has along each axis, at least 1; with 1 every copy is exact.
    """
    copies = [copy for image in images for copy in _copies(image, parts)]
    height, width, channels = images[0].shape
    return Fractions(np.stack(copies).reshape(len(copies), -1), (height, width, channels), parts)


def _copies(image: Image, parts: int) -> Iterator[NDArray[np.uint8]]:
    if parts == 1:
        yield to_bytes(image)
        return
    patches, shape = Patches(image), image.shape[:2]
    for fy in range(parts):
        for fx in range(parts):
            yield to_bytes(patches.cut(np.array([fx, fy]) / parts, shape)[0])
