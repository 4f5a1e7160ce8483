"""Track the lattice of an image that is bent, repair the track, and straighten the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nrbench.imaging.convert import Image
from nrbench.imaging.fold_kernels import spline_coefficients, spline_windows
from nrbench.imaging.largest_box import largest_box
from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking.tracker import MeanTile, Track, track_lattice

from .covariance import Correlogram, Covariance, SampledField
from .field_tests import drop_outliers, smooth_field

Flags = NDArray[np.bool_]
_WIDTH, _REFINEMENTS = 1.0, 3
"""Width in tiles of the windows of the tracker, and number of its refinements."""
_CORRELATION = 0.75
"""Share of the references' median correlation below which a node is not reliable."""
_STEEPEST = 0.75
"""Largest slope between neighboring nodes that belong together."""
_ROUNDS = 2
"""Number of times that the references are tracked again in this case."""
_COSTS = (0.006, 0.002)
"""Costs of departures from the prediction that are tried in this case. The track that fits best is kept."""
_LARGE = 0.16
"""Standard deviation of displacements, in s, above which their covariance is used while they are unwrapped."""
_BORDER = 1.0
"""Distance, px, of reliable nodes from the border of the image."""
_NEAR = 0.3
"""Largest median distance, in s, of a group of nodes from the field of the largest group."""


@dataclass(frozen=True)
class TrackedImage:
    """An image and its displacement field.

    Parameters
    ----------
    track
        The track.
    level
        Correlation below which a node is not reliable.
    dropped
        ``bool (rows, columns)``: further nodes of the coarse grid that are not reliable.
    """

    track: Track
    level: float
    dropped: Flags | None = None

    @property
    def s(self) -> float:
        """Length of the shortest lattice vector, px."""
        return self.track.lattice.s

    @cached_property
    def inside(self) -> Flags:
        """``bool (rows, columns)``: which nodes of the track were found inside the image."""
        at = self.track.nodes.places + self.track.field
        height, width = self.track.image.shape[:2]
        return np.asarray(((at >= _BORDER) & (at <= (width - 1 - _BORDER, height - 1 - _BORDER))).all(-1))

    @cached_property
    def field(self) -> SampledField:
        """The displacement field at every second node of the track along both axes, about a tile apart."""
        reliable = (self.inside & (self.track.correlation > self.level))[::2, ::2]
        if self.dropped is not None:
            reliable = reliable & ~self.dropped
        return SampledField(self.track.nodes.places[::2, ::2] / self.s, self.track.field[::2, ::2] / self.s, reliable)

    @property
    def reliable_share(self) -> float:
        """Share of the nodes inside the image that are reliable."""
        inside = self.inside[::2, ::2]
        return float(self.field.reliable[inside].mean()) if inside.any() else 0.0


def track_references(
    images: Sequence[Image], lattice: Lattice, tile: MeanTile
) -> tuple[tuple[TrackedImage, ...], Covariance]:
    """Track images without faults, and return them with the covariance of their fields.

    If the displacements are large, the images are tracked again with that covariance.
    """
    tracked, covariance = _track_all(images, lattice, tile, None)
    if covariance.variance <= _LARGE**2:
        return tracked, covariance
    for _ in range(_ROUNDS):
        tracked, covariance = _track_all(images, lattice, tile, covariance)
    return tracked, covariance


def _track_all(
    images: Sequence[Image], lattice: Lattice, tile: MeanTile, covariance: Covariance | None
) -> tuple[tuple[TrackedImage, ...], Covariance]:
    tracks = [_track(image, lattice, tile, covariance) for image in images]
    inside = [TrackedImage(track, -1.0).inside for track in tracks]
    values = np.concatenate([track.correlation[where] for track, where in zip(tracks, inside, strict=True)])
    level = _CORRELATION * float(np.median(values)) if len(values) else 0.0
    tracked = tuple(join_groups(TrackedImage(track, level), covariance) for track in tracks)
    covariance = Covariance.fit(Correlogram.of([one.field for one in tracked]))
    tracked = tuple(_drop(one, covariance) for one in tracked)
    return tracked, Covariance.fit(Correlogram.of([one.field for one in tracked]))


def _drop(tracked: TrackedImage, covariance: Covariance) -> TrackedImage:
    """Drop the outlying nodes of an image."""
    kept = drop_outliers(tracked.field, covariance).reliable
    dropped = np.zeros_like(kept) if tracked.dropped is None else tracked.dropped
    return replace(tracked, dropped=dropped | (tracked.field.reliable & ~kept))


def track_image(image: Image, lattice: Lattice, tile: MeanTile, level: float, covariance: Covariance) -> TrackedImage:
    """Track an image whose field has the covariance of the references, if it has no faults."""
    known = covariance if covariance.variance > _LARGE**2 else None
    return _drop(join_groups(TrackedImage(_track(image, lattice, tile, known), level), covariance), covariance)


def _track(image: Image, lattice: Lattice, tile: MeanTile, covariance: Covariance | None) -> Track:
    refined = (_WIDTH,) * _REFINEMENTS
    if covariance is None:
        return track_lattice(image, lattice, tile, _WIDTH, refined)
    known = covariance.scaled(lattice.s)
    tracks = [track_lattice(image, lattice, tile, _WIDTH, refined, known, cost) for cost in _COSTS]
    return max(tracks, key=_fit)


def _fit(track: Track) -> float:
    """Return the mean correlation of the nodes inside the image."""
    inside = TrackedImage(track, -1.0).inside
    return float(track.correlation[inside].mean()) if inside.any() else -1.0


def join_groups(tracked: TrackedImage, covariance: Covariance | None) -> TrackedImage:
    """Find groups of nodes that the tracker moved by a lattice vector against the largest group, and drop or join them.

    Neighboring nodes belong together if the slope between them is possible. A group is joined to the largest group if
    it continues the field of that group after a displacement by a lattice vector; otherwise it is dropped.

    Parameters
    ----------
    tracked
        The image.
    covariance
        Covariance by which the field of the largest group is continued; None: all other groups are dropped.
    """
    field = tracked.field
    labels = _label_groups(field)
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    if len(sizes) < 2:
        return tracked
    largest = labels == sizes.argmax()
    dropped = field.reliable & ~largest
    if covariance is None:
        return replace(tracked, dropped=dropped)
    lattice, s = tracked.track.lattice, tracked.s
    main = replace(field, reliable=largest)
    moved = tracked.track.field.copy()
    expected = smooth_field(main, covariance, field.places[dropped])
    apart = np.zeros_like(field.displacement)
    apart[dropped] = (expected - field.displacement[dropped]) * s
    for label in np.unique(labels[dropped]):
        group = labels == label
        middle = np.median(apart[group], 0)
        step = middle - lattice.wrap(middle)
        rest = np.hypot(*(apart[group] - step).T)
        if np.median(rest) <= _NEAR * s:
            rows, columns = np.nonzero(group)
            # The finer grid has the coarse nodes at its even rows and columns; only these count.
            moved[2 * rows, 2 * columns] += step
            dropped[group] = rest > _NEAR * s
    return replace(tracked, track=replace(tracked.track, field=moved), dropped=dropped)


def _label_groups(field: SampledField) -> NDArray[np.intp]:
    """Return the number of the group of each node, -1 where it is not reliable."""
    rows, columns = field.reliable.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    pairs = []
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = np.hypot(*np.moveaxis(field.displacement[one] - field.displacement[other], -1, 0))
        length = np.hypot(*np.moveaxis(field.places[one] - field.places[other], -1, 0))
        near = (step <= _STEEPEST * length) & field.reliable[one] & field.reliable[other]
        pairs.append(np.stack([index[one][near], index[other][near]]))
    ends = np.concatenate(pairs, 1)
    graph = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(index.size, index.size))
    _, labels = connected_components(graph, directed=False)
    labels = np.where(field.reliable.ravel(), labels, -1)
    _, numbers = np.unique(labels, return_inverse=True)
    first = int((labels < 0).any())
    return np.asarray(numbers.reshape(rows, columns) - first)


def _smooth_displacement(tracked: TrackedImage, covariance: Covariance) -> Points:
    """Return the smooth displacement at all nodes of the track, px, ``(rows, columns, 2)``."""
    places = tracked.track.nodes.places
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
    image, nodes = tracked.track.image, tracked.track.nodes
    height, width = image.shape[:2]
    field = _smooth_displacement(tracked, covariance)
    down, along = (_spline_weights(at, n) for at, n in ((nodes.y, height), (nodes.x, width)))
    sources = np.einsum("yr,rcd,xc->yxd", down, field, along, optimize=True)
    sources += np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    inside = ((sources >= 0) & (sources <= (width - 1, height - 1))).all(-1)
    y0, y1, x0, x1 = largest_box(inside)
    sources = np.ascontiguousarray(sources[y0:y1, x0:x1])
    coefficients = spline_coefficients(np.array(image, np.float32, order="C"))
    values = spline_windows(coefficients, np.clip(sources, 0, (width - 1, height - 1)).reshape(-1, 2), np.zeros((1, 2)))
    values = np.clip(values.reshape(y1 - y0, x1 - x0, image.shape[2]), 0, 1)
    return StraightenedImage(values, (x0, y0), sources, tracked)


def _spline_weights(at: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the matrix ``(count, n)`` of cubic splines from nodes to pixels, constant beyond the last node."""
    if len(at) == 1:
        return np.ones((count, 1))
    spline = make_interp_spline(at, np.eye(len(at)), k=min(3, len(at) - 1))
    return np.asarray(spline(np.clip(np.arange(count), at[0], at[-1])))
