"""The sliced Wasserstein distance between the patches of two images, and its gradient."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from .patch_projection_kernels import collect_gradient, match_ranks, project_patches

Planes = NDArray[np.float32]
"""``float32 (C, H, W)``: an image, channel by channel."""
Filters = NDArray[np.float32]
"""``float32 (P, C, size, size)``: directions in the space of patches, of length 1."""


def to_planes(image: Image) -> Planes:
    """Return the planes of an image."""
    return np.ascontiguousarray(np.moveaxis(image, -1, 0), np.float32)


def from_planes(planes: Planes) -> Image:
    """Return the image of planes."""
    return np.ascontiguousarray(np.moveaxis(planes, 0, -1))


def draw_filters(count: int, channels: int, size: int, rng: np.random.Generator) -> Filters:
    """Return random directions, uniform on the sphere."""
    filters = rng.standard_normal((count, channels, size, size), np.float32)
    return np.asarray(filters / np.sqrt((filters**2).sum((1, 2, 3), keepdims=True)))


class SlicedDistance:
    """Measures the distance between the patches of two images of given shapes, again and again.

    Parameters
    ----------
    shape, other
        ``(C, H, W)`` of the image and of the one that it is compared with.
    size
        Side of a patch in px.
    count
        Number of directions.
    wrap
        Whether patches cross the edges of the image.
    """

    def __init__(
        self, shape: tuple[int, ...], other: tuple[int, ...], size: int, count: int, wrap: bool = False
    ) -> None:
        self._more, channels = size - 1 if wrap else 0, shape[0]
        shape = channels, shape[1] + self._more, shape[2] + self._more
        self._own, self._theirs = (
            np.empty((count, height - size + 1, width - size + 1), np.float32) for _, height, width in (shape, other)
        )
        self._slopes, self._gradient = np.empty_like(self._own), np.empty(shape, np.float32)

    def measure(self, planes: Planes, other: Planes, filters: Filters) -> tuple[float, Planes]:
        """Return the distance, and its gradient by the pixels of ``planes`` times the number of projected values.

        Parameters
        ----------
        planes, other
            The image and the one that it is compared with.
        filters
            The directions.
        """
        more = self._more
        around = np.pad(planes, ((0, 0), (0, more), (0, more)), "wrap") if more else planes
        project_patches(around, filters, self._own)
        project_patches(other, filters, self._theirs)
        count = len(filters)
        targets = np.sort(self._theirs.reshape(count, -1), 1)
        distance = match_ranks(self._own.reshape(count, -1), targets, self._slopes.reshape(count, -1))
        collect_gradient(self._slopes, filters, self._gradient)
        return distance, sum_periods(self._gradient, planes.shape) if more else self._gradient


def sum_periods(planes: Planes, shape: tuple[int, ...]) -> Planes:
    """Return the sums, of shape ``(C, H, W)``, of the pixels of larger planes that lie whole periods H and W apart."""
    _, height, width = shape
    sums = np.zeros(shape, np.float32)
    for top in range(0, planes.shape[1], height):
        for left in range(0, planes.shape[2], width):
            part = planes[:, top : top + height, left : left + width]
            sums[:, : part.shape[1], : part.shape[2]] += part
    return sums
