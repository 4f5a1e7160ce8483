"""Follow the lattice of an image that is bent, drop what was not found, and straighten the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.largest_box import largest_box
from nrbench.imaging.mean_tile import interpolate
from nrbench.imaging.mean_tile_kernels import spline_coefficients, spline_windows
from nrbench.lattice.geometry import Points
from nrbench.tracking.known_texture import FollowedImage, follow_texture
from nrbench.tracking.tracker import MeanTile

from .covariance import Covariance, SampledField
from .field_tests import drop_outliers, smooth_field

Flags = NDArray[np.bool_]
Values = NDArray[np.float64]
_CORRELATION = 0.75
"""Share of the references' median correlation below which a node is not reliable."""
_MARGIN = 0.45
"""Distance, in s, from the border of the image from which nodes must be found."""
_LEAST_CORRELATION = 0.05
"""Correlation to which smaller ones are raised where errors are computed from them."""
_AT_BORDER = 6.0
"""Variance of the error of a node at the border, whose window is cut, over that of another one."""
_ROUNDS = 3
"""Largest number of times that outlying nodes are dropped."""
_SPACING = 0.25
"""Distance, in s, of the places at which the displacements are inverted."""
_MOST_STEPS, _LONGEST, _EXACT = 15, 0.25, 0.02
"""Largest number of Newton steps of the inversion, the length of the longest one, in s, and that, in px, below which
the places count as exact."""
_LEAST_DETERMINANT = 0.05
"""Least area of the image, over that on the plane, that a Newton step assumes."""


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
    usual
        Covariance of the fields of images without faults.
    """

    followed: FollowedImage
    s: float
    level: float
    dropped: Flags | None = None
    usual: Covariance | None = None

    @cached_property
    def field(self) -> SampledField:
        """The displacement field at every second node along both axes, about 0.8 tiles apart."""
        followed, places = self.followed, self.followed.nodes[::2, ::2]
        reliable = (followed.correlation > self.level)[::2, ::2]
        if self.dropped is not None:
            reliable = reliable & ~self.dropped
        correlation = np.clip(followed.correlation[::2, ::2], _LEAST_CORRELATION, 1)
        error = (1 / correlation**2 - 1) * np.where(self._far_from_border, 1, _AT_BORDER)
        return SampledField(places / self.s, followed.displacement[::2, ::2] / self.s, reliable, error)

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of the field: the usual one, or its own where waves of some length are larger."""
        return Covariance.fit([self.field]) if self.usual is None else self.usual.extended_to(self.field)

    @property
    def _far_from_border(self) -> Flags:
        """Which nodes of the coarse grid are so far from the border that little of their windows is cut."""
        last = np.array(self.followed.image.shape[1::-1]) - 1
        at, margin = self.followed.nodes[::2, ::2], _MARGIN * self.s
        return np.asarray(((at >= margin) & (at <= last - margin)).all(-1))

    @property
    def reliable_share(self) -> float:
        """Share of the nodes that are reliable, without those so near to the border that their windows are cut."""
        inside = self._far_from_border
        return float(self.field.reliable[inside].mean()) if inside.any() else 0.0


def track_references(images: Sequence[Image], tile: MeanTile) -> tuple[tuple[TrackedImage, ...], Covariance]:
    """Track images without faults, and return them with the covariance of their fields."""
    s = tile.harmonics.lattice.s
    followed = [follow_texture(image, tile) for image in images]
    values = np.concatenate([one.correlation[one.correlation > 0] for one in followed])
    level = _CORRELATION * float(np.median(values)) if len(values) else 0.0
    tracked = tuple(TrackedImage(one, s, level) for one in followed)
    covariance = Covariance.fit([one.field for one in tracked])
    tracked = tuple(_drop(replace(one, usual=covariance)) for one in tracked)
    covariance = Covariance.fit([one.field for one in tracked])
    return tuple(replace(one, usual=covariance) for one in tracked), covariance


def _drop(tracked: TrackedImage) -> TrackedImage:
    """Drop the outlying nodes of an image. Those that support one another show after others have been dropped."""
    dropped = np.zeros_like(tracked.field.reliable)
    for _ in range(_ROUNDS):
        kept = drop_outliers(tracked.field, tracked.covariance).reliable
        outlying = tracked.field.reliable & ~kept
        if not outlying.any():
            break
        dropped = dropped | outlying
        tracked = replace(tracked, dropped=dropped)
    return tracked


def track_image(image: Image, tile: MeanTile, level: float, covariance: Covariance) -> TrackedImage:
    """Track an image beside references, whose fields have some covariance."""
    return _drop(TrackedImage(follow_texture(image, tile), tile.harmonics.lattice.s, level, usual=covariance))


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


def leave_unchanged(tracked: TrackedImage) -> StraightenedImage:
    """Return the whole image as it is. The displacement of an image in which little was found has no meaning."""
    height, width = tracked.followed.image.shape[:2]
    sources = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), -1)
    return StraightenedImage(tracked.followed.image, (0, 0), sources, tracked)


def straighten(tracked: TrackedImage) -> StraightenedImage:
    """Return the image without the smooth part of its displacement."""
    image = tracked.followed.image
    height, width = image.shape[:2]
    sources = _invert(tracked)
    inside = np.asarray(((sources >= 0) & (sources <= (width - 1, height - 1))).all(-1))
    y0, y1, x0, x1 = largest_box(inside)
    # The box may hold places whose content lies beyond the image: holes in the middle are not seen.
    sources = np.ascontiguousarray(np.clip(sources[y0:y1, x0:x1], 0, (width - 1, height - 1)))
    coefficients = spline_coefficients(np.array(image, np.float32, order="C"))
    values = spline_windows(coefficients, sources.reshape(-1, 2), np.zeros((1, 2)))
    values = np.clip(values.reshape(y1 - y0, x1 - x0, image.shape[2]), 0, 1)
    return StraightenedImage(values, (x0, y0), sources, tracked)


def _invert(tracked: TrackedImage) -> Points:
    """Return the place (x, y) px in the image of each pixel of the plane, ``(H, W, 2)``, by Newton's method.

    The displacement is the smooth part of that of the tracked image.
    """
    height, width = tracked.followed.image.shape[:2]
    field, s = tracked.field, tracked.s
    smooth = smooth_field(field, tracked.covariance, field.places.reshape(-1, 2)).reshape(field.places.shape) * s
    pixels = np.arange(float(height)), np.arange(float(width))
    displacement = _spread(smooth, (field.places[:, 0, 1] * s, field.places[0, :, 0] * s), pixels)
    table = np.concatenate([displacement, *np.gradient(displacement, axis=(1, 0))], -1).astype(np.float32)
    counts = [max(math.ceil((n - 1) / (_SPACING * s)), 3) + 1 for n in (height, width)]
    few = np.linspace(0, height - 1, counts[0]), np.linspace(0, width - 1, counts[1])
    points = np.stack(np.meshgrid(few[1], few[0]), -1)
    places = points.copy()
    for _ in range(_MOST_STEPS):
        x, y, xx, yx, xy, yy = np.moveaxis(interpolate(table, places).astype(np.float64), -1, 0)
        off_x, off_y = places[..., 0] - x - points[..., 0], places[..., 1] - y - points[..., 1]
        determinant = (1 - xx) * (1 - yy) - xy * yx
        step = np.stack([(1 - yy) * off_x + xy * off_y, yx * off_x + (1 - xx) * off_y], -1)
        # Where the content is stretched so far that it nearly folds over, a step is short instead of infinite.
        step /= np.maximum(determinant, _LEAST_DETERMINANT)[..., np.newaxis]
        length = np.hypot(step[..., 0], step[..., 1])
        places -= step * np.minimum(1, _LONGEST * s / np.maximum(length, 1e-9))[..., np.newaxis]
        if length.max() < _EXACT:
            break
    return _spread(places, few, pixels)


def _spread(values: Points, at: tuple[Values, Values], wanted: tuple[Values, Values]) -> Points:
    """Return values ``(rows, columns, 2)``, given at rows and columns ``at``, at others by cubic splines."""
    down, along = (_spline_weights(one, other) for one, other in zip(at, wanted, strict=True))
    return np.asarray(np.einsum("yr,rcd,xc->yxd", down, values, along, optimize=True))


def _spline_weights(at: Values, wanted: Values) -> Values:
    """Return the matrix ``(m, n)`` of cubic splines from n places to m others."""
    return np.asarray(scipy.interpolate.make_interp_spline(at, np.eye(len(at)), k=min(3, len(at) - 1))(wanted))
