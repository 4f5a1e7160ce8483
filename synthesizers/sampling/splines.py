"""Outputs whose pixels show points between the sample's pixels, interpolated by splines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Task

from .equal_places import pixel_grid
from .patches import Patches

BAND = 1 << 18
"""Pixels mapped at a time."""


def resampled(
    task: Task, points: Callable[[Points], Points], patches: Patches | None = None
) -> tuple[Image, NDArray[np.float32]]:
    """Return the output whose pixels show given points of the sample, and its source map.

    Parameters
    ----------
    task
        The sample, and the output's shape.
    points
        From pixels (x, y) of the output, ``(h, W, 2)``, to the points (x, y) of the sample that they show.
    patches
        Of the sample, where they are at hand.

    Returns
    -------
    image, source
        ``(H, W, C)`` in [0, 1]; ``(H, W, 3)``: the nearest pixel (x, y) of the sample and its bilinear weight, which is
        1 where a pixel was copied.
    """
    height, width = task.shape
    patches = Patches(task.sample) if patches is None else patches
    image = np.empty((height, width, task.sample.shape[2]), np.float32)
    source = np.empty((height, width, 3), np.float32)
    rows = max(1, BAND // width)
    for top in range(0, height, rows):
        band = slice(top, top + rows)
        pixels = pixel_grid(width, min(rows, height - top), top=top).astype(np.float64)
        image[band], source[band] = patches.at(points(pixels))
        task.progress(min(1.0, (top + rows) / height))
    return image, source
