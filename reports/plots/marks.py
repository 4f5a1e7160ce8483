"""Read the pictures of cells, find the marks that a metric drew over an output, and the place with the most of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

DEFECTS = ("regularity.defects", "integrity.broken")
"""The pictures of defects, from the one that decides where an output is worst."""
_LEVELS = 3
"""Channels that differ by more levels than this make a pixel colored, or different from the output."""


def read_pixels(path: Path) -> NDArray[np.uint8]:
    """Return the pixels of a PNG file of a cell, ``(H, W, 3)``."""
    with path.open("rb") as file, PIL.Image.open(file, formats=("PNG",)) as image:
        return np.asarray(image.convert("RGB"))


def find_marks(layer: NDArray[np.uint8], output: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where a metric's picture has marks, ``(H, W)``.

    A metric draws its marks in color over the output, or over a gray copy of it. Pixels that are gray, or equal to the
    output, are no marks.

    Parameters
    ----------
    layer, output
        The picture and the output, ``(H, W, 3)``.
    """
    # planes are contiguous, which is many times faster than a reduction over the last axis
    planes, below = (np.ascontiguousarray(np.moveaxis(picture, -1, 0)) for picture in (layer, output))
    spread = planes.max(0) - planes.min(0)
    apart = (np.maximum(planes, below) - np.minimum(planes, below)).max(0)
    marked: NDArray[np.bool_] = (spread > _LEVELS) & (apart > _LEVELS)
    return marked


def worst_place(
    output: NDArray[np.uint8], layers: Sequence[NDArray[np.uint8] | None], side: int
) -> tuple[int, int] | None:
    """Return the corner (x, y) of the square of an output that has the most marks of defects.

    Parameters
    ----------
    output
        The output.
    layers
        Pictures of defects over the output; the first with any marks decides.
    side
        Side of the square, px.

    Returns
    -------
    tuple of int or None
        None without marks, and if more than half of the output is marked: then no place is the worst.
    """
    for layer in layers:
        if layer is None or layer.shape != output.shape or side < 2:
            continue
        marked = find_marks(layer, output)
        if 0 < marked.mean() <= 0.5:
            density = uniform_filter(marked.astype(np.float64), side, mode="constant")
            y, x = np.unravel_index(int(density.argmax()), density.shape)
            height, width = marked.shape
            return int(np.clip(x - side // 2, 0, width - side)), int(np.clip(y - side // 2, 0, height - side))
    return None
