"""Follow the lattice of an image that is bent, drop what was not found, and straighten the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import interpolate
from nrbench.imaging.fold_kernels import spline_coefficients, spline_windows
from nrbench.imaging.largest_box import largest_box
from nrbench.lattice.geometry import Points
from nrbench.tracking.known_texture import FollowedImage, follow_texture
from nrbench.tracking.tracker import MeanTile

from .covariance import Correlogram, Covariance, SampledField
from .field_tests import drop_outliers, smooth_field

Flags = NDArray[np.bool_]
Values = NDArray[np.float64]
_CORRELATION = 0.75
"""Share of the references' median correlation below which a node is not reliable."""
_MARGIN = 0.45
"""Distance, in s, from the border of the image from which nodes must be found."""
_SPACING = 0.25
"""Distance, in s, of the places at which the displacements are inverted."""
_STEPS, _LONGEST = 12, 0.25
"""Number of Newton steps of the inversion, and the length of the longest one, in s."""


@dataclass(frozen=True)
class TrackedImage:
    """An image and its displacement field.

    Parameters
    ----------
    followed
        Where the content of each node was found.
    s
        Length of the shortest lattice vector, px.
    level
        Correlation below which a node is not reliable.
    dropped
        ``bool (rows, columns)``: further nodes of the coarse grid that are not reliable.
    """

    followed: FollowedImage
    s: float
    level: float
    dropped: Flags | None = None

    @cached_property
    def field(self) -> SampledField:
        """The displacement field at every second node along both axes, about 0.8 tiles apart."""
        followed = self.followed
        reliable = (followed.correlation > self.level)[::2, ::2]
        if self.dropped is not None:
            reliable = reliable & ~self.dropped
        return SampledField(followed.nodes[::2, ::2] / self.s, followed.displacement[::2, ::2] / self.s, reliable)

    @property
    def reliable_share(self) -> float:
        """Share of the nodes that are reliable, without those so near to the border that their windows are cut."""
        last = np.array(self.followed.image.shape[1::-1]) - 1
        at = self.field.places * self.s
        inside = ((at >= _MARGIN * self.s) & (at <= last - _MARGIN * self.s)).all(-1)
        return float(self.field.reliable[inside].mean()) if inside.any() else 0.0


def track_references(images: Sequence[Image], tile: MeanTile) -> tuple[tuple[TrackedImage, ...], Covariance]:
    """Track images without faults, and return them with the covariance of their fields."""
    s = tile.harmonics.lattice.s
    followed = [follow_texture(image, tile) for image in images]
    values = np.concatenate([one.correlation[one.correlation > 0] for one in followed])
    level = _CORRELATION * float(np.median(values)) if len(values) else 0.0
    tracked = tuple(TrackedImage(one, s, level) for one in followed)
    covariance = Covariance.fit(Correlogram.of([one.field for one in tracked]))
    tracked = tuple(_drop(one, covariance) for one in tracked)
    return tracked, Covariance.fit(Correlogram.of([one.field for one in tracked]))


def _drop(tracked: TrackedImage, covariance: Covariance) -> TrackedImage:
    """Drop the outlying nodes of an image."""
    kept = drop_outliers(tracked.field, covariance).reliable
    return replace(tracked, dropped=tracked.field.reliable & ~kept)


def track_image(image: Image, tile: MeanTile, level: float, covariance: Covariance) -> TrackedImage:
    """Track an image whose field has the covariance of the references, if it has no faults."""
    return _drop(TrackedImage(follow_texture(image, tile), tile.harmonics.lattice.s, level), covariance)


def _smooth_displacement(tracked: TrackedImage, covariance: Covariance) -> Points:
    """Return the smooth displacement at all nodes, px, ``(rows, columns, 2)``."""
    places = tracked.followed.nodes
    smooth = smooth_field(tracked.field, covariance, places.reshape(-1, 2) / tracked.s)
    return smooth.reshape(places.shape) * tracked.s


@dataclass(frozen=True)
class StraightenedImage:
    """An image without its smooth displacement, cropped to where it is known.

    Parameters
    ----------
    image
        ``(h, w, C)``.
    corner
        (x, y) px of its first pixel on the plane of the undisturbed lattice.
    sources
        ``(h, w, 2)``: place (x, y) px of each pixel in the bent image.
    tracked
        The bent image.
    """

    image: Image
    corner: tuple[int, int]
    sources: Points
    tracked: TrackedImage


def straighten(tracked: TrackedImage, covariance: Covariance) -> StraightenedImage:
    """Return the image without the smooth part of its displacement."""
    image = tracked.followed.image
    height, width = image.shape[:2]
    sources = _invert(_smooth_displacement(tracked, covariance), tracked)
    inside = np.asarray(((sources >= 0) & (sources <= (width - 1, height - 1))).all(-1))
    y0, y1, x0, x1 = largest_box(inside)
    sources = np.ascontiguousarray(sources[y0:y1, x0:x1])
    coefficients = spline_coefficients(np.array(image, np.float32, order="C"))
    values = spline_windows(coefficients, np.clip(sources, 0, (width - 1, height - 1)).reshape(-1, 2), np.zeros((1, 2)))
    values = np.clip(values.reshape(y1 - y0, x1 - x0, image.shape[2]), 0, 1)
    return StraightenedImage(values, (x0, y0), sources, tracked)


def _invert(displacement: Points, tracked: TrackedImage) -> Points:
    """Return the place (x, y) px in the image of each pixel of the plane, ``(H, W, 2)``, by Newton's method.

    Parameters
    ----------
    displacement
        ``(rows, columns, 2)`` px: that of the content at each node of the image.
    tracked
        The image.
    """
    height, width = tracked.followed.image.shape[:2]
    nodes, s = tracked.followed.nodes, tracked.s
    sides = nodes[:, 0, 1], nodes[0, :, 0]
    pixels = np.arange(float(height)), np.arange(float(width))
    field = _spread(displacement, sides, pixels)
    table = np.concatenate([field, *np.gradient(field, axis=(1, 0))], -1).astype(np.float32)
    counts = [max(math.ceil((n - 1) / (_SPACING * s)), 3) + 1 for n in (height, width)]
    few = np.linspace(0, height - 1, counts[0]), np.linspace(0, width - 1, counts[1])
    points = np.stack(np.meshgrid(few[1], few[0]), -1)
    places, last = points.copy(), (width - 1.0, height - 1.0)
    for _ in range(_STEPS):
        read = interpolate(table, np.clip(places, 0, last)).astype(np.float64)
        slopes = np.eye(2) - np.stack([read[..., 2:4], read[..., 4:6]], -1)
        rest = places - read[..., :2] - points
        step = np.linalg.solve(slopes, rest[..., np.newaxis])[..., 0]
        length = np.hypot(step[..., 0], step[..., 1])
        places -= step * np.minimum(1, _LONGEST * s / np.maximum(length, 1e-9))[..., np.newaxis]
    return _spread(places, few, pixels)


def _spread(values: Points, at: tuple[Values, Values], wanted: tuple[Values, Values]) -> Points:
    """Return values ``(rows, columns, 2)``, given at rows and columns ``at``, at others by cubic splines."""
    down, along = (_spline_weights(one, other) for one, other in zip(at, wanted, strict=True))
    return np.asarray(np.einsum("yr,rcd,xc->yxd", down, values, along, optimize=True))


def _spline_weights(at: Values, wanted: Values) -> Values:
    """Return the matrix ``(m, n)`` of cubic splines from n places to m others."""
    return np.asarray(make_interp_spline(at, np.eye(len(at)), k=min(3, len(at) - 1))(wanted))
