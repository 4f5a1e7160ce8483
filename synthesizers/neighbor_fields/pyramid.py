"""Images at several resolutions, of exact scale."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import scipy

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Refused, Shape, Task

ROUNDING: Final = 1e-6
"""px: what a side may exceed a whole number by rounding errors."""


def list_resolutions(shape: Shape, ratio: float, coarsest: int, patch: int) -> list[float]:
    """Return the resolutions of a pyramid, relative to the finest, which is 1, from coarse to fine.

    Parameters
    ----------
    shape
        Height and width of the sample.
    ratio
        Each resolution over the next finer one, less than 1.
    coarsest
        The shorter side of the sample has at least this many px at each resolution but the finest one.
    patch
        Side of a patch in px, which fits into the sample at each resolution.

    Raises
    ------
    Refused
        If the sample is smaller than a patch.
    """
    side = min(shape[:2])
    if side < patch:
        raise Refused(f"the sample is {shape[1]}x{shape[0]} px, a patch {patch} px; choose a smaller patch")
    count = max(math.floor(math.log(max(coarsest, patch) / side, ratio) + ROUNDING), 0)
    return [ratio**level for level in range(count, -1, -1)]


def cover_sample(task: Task) -> Shape:
    """Return the least height and width that hold the output and the sample, so that patches fit in at all levels.

    A tileable output needs no room: its patches may cross its edges.
    """
    if task.tileable:
        return task.shape
    return max(task.shape[0], task.sample.shape[0]), max(task.shape[1], task.sample.shape[1])


def scale_shape(shape: Shape, factor: float) -> Shape:
    """Return the height and width of an image at another resolution, rounded up."""
    height, width = (math.ceil(side * factor - ROUNDING) for side in shape[:2])
    return height, width


def rescale(image: Image, factor: float, shape: Shape, wrap: bool = False) -> Image:
    """Return an image at another resolution, by cubic interpolation, blurred first where it becomes smaller.

    The upper left corner of the image stays in place, and the scale is exact whatever the shape: no lattice drifts.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    factor
        The new resolution over the old one.
    shape
        Height and width of the result in px. Beyond the image its border is repeated.
    wrap
        Whether opposite edges are adjacent. The scale then follows from both shapes, so that they stay adjacent.
    """
    step = 1 / factor
    steps = np.divide(image.shape[:2], shape) if wrap else np.array([step, step])
    sigma = math.sqrt(max(step**2 - 1, 0)) / 2
    planes = [
        scipy.ndimage.affine_transform(
            scipy.ndimage.gaussian_filter(plane, sigma, mode="wrap" if wrap else "nearest"),
            steps,
            (steps - 1) / 2,
            shape,
            output=np.float32,
            order=3,
            mode="grid-wrap" if wrap else "nearest",
        )
        for plane in np.moveaxis(image, -1, 0)
    ]
    return np.stack(planes, -1)
