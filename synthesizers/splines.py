"""Outputs whose pixels show points between the sample's pixels, interpolated by splines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.door import Image
from nrbench.imaging.quintic_kernels import PAD, quintic_at
from nrbench.lattice.geometry import Points
from nrbench.synthesis import Task

BAND = 1 << 18
"""Pixels mapped at a time."""
SPLINE: Final = 5
"""Order of the interpolating B-spline: no visible blur."""


class Spline:
    """The interpolating spline of a sample, mirrored at its border.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    """

    def __init__(self, sample: Image) -> None:
        planes = [ndimage.spline_filter(plane, SPLINE, mode="mirror") for plane in np.moveaxis(sample, 2, 0)]
        self._coefficients = np.pad(np.stack(planes, -1), ((PAD, PAD), (PAD, PAD), (0, 0)), "reflect")

    def at(self, points: Points) -> NDArray[np.float32]:
        """Return the values, clipped to [0, 1], at points (x, y) of the sample: ``(..., 2)`` to ``(..., C)``."""
        found = quintic_at(self._coefficients, np.ascontiguousarray(points, np.float64).reshape(-1, 2))
        return np.asarray(np.clip(found, 0, 1)).reshape(*points.shape[:-1], -1)


def resampled(
    task: Task, points: Callable[[Points], Points], spline: Spline | None = None
) -> tuple[Image, NDArray[np.float32]]:
    """Return the output whose pixels show given points of the sample, and its source map.

    Parameters
    ----------
    task
        The sample, and the output's shape.
    points
        From pixels (x, y) of the output, ``(h, W, 2)``, to the points (x, y) of the sample that they show.
    spline
        Of the sample, where it is at hand.

    Returns
    -------
    image, source
        ``(H, W, C)`` in [0, 1]; ``(H, W, 3)``: the nearest pixel (x, y) of the sample and its bilinear weight, which is
        1 where a pixel was copied.
    """
    height, width = task.shape
    spline = Spline(task.sample) if spline is None else spline
    image = np.empty((height, width, task.sample.shape[2]), np.float32)
    source = np.empty((height, width, 3), np.float32)
    rows = max(1, BAND // width)
    for top in range(0, height, rows):
        at = points(_pixels(top, min(top + rows, height), width))
        image[top : top + rows] = spline.at(at)
        nearest = np.clip(np.rint(at), 0, np.array(task.sample.shape[1::-1]) - 1)
        source[top : top + rows, :, :2] = nearest
        source[top : top + rows, :, 2] = (1 - np.abs(at - nearest)).prod(-1)
        task.progress(min(1.0, (top + rows) / height))
    return image, source


def _pixels(top: int, bottom: int, width: int) -> Points:
    return np.stack(np.meshgrid(np.arange(width), np.arange(top, bottom)), -1).astype(np.float64)
