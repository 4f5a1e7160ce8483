"""Straighten a sample, synthesize on the regular lattice, and deform the output: one mechanism for all methods."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.largest_box import largest_box
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Detector, SourceMap, Synthesis, Synthesizer, Task, find_lattice
from nrbench.tracking.bent_lattice import LEAST_AMPLITUDE

from ..sampling.equal_places import pixel_grid
from ..sampling.patches import Patches
from .deformed_lattice import Deform, DeformedLattice, find_deformed_lattice, output_field
from .free_form import REPEATS, FreeForm

Geometry = Literal["as-is", "straighten"]
"""Whether a method takes the sample as it is, or straightens it first and deforms the output again."""
LEAST_GAIN: Final = 1.2
"""Factor by which straightening must raise the share of the variance that the mean tile explains."""
_MARGIN = 3
"""px of the straight output beyond the outermost point that the deformed output shows."""
_ROWS = 256
"""Rows of an output whose places are computed at a time."""
_MOST_WEIGHT = 0.999
"""Largest weight in the source map of a pixel that was interpolated."""


@dataclass(frozen=True, eq=False)
class StraightSample:
    """A sample, and the map that straightens it.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    deformed
        Its lattice, as it lies in the sample.
    repeats
        Of :meth:`.FreeForm.fit`, for this map and that of the output.
    """

    sample: Image
    deformed: DeformedLattice
    repeats: int = REPEATS

    @classmethod
    def of(cls, sample: Image, lattice: Lattice, repeats: int = REPEATS) -> StraightSample:
        """Track the lattice through a sample."""
        return cls(sample, find_deformed_lattice(sample, lattice), repeats)

    @cached_property
    def departs(self) -> bool:
        """Whether the geometry of the sample departs from the lattice by more than the tracker's errors.

        The displacements must have been measured, exceed 0.04 s, and be worth it: the mean tile of the straightened
        sample must explain a share of its variance 1.2 times as large as before. Where a texture hardly changes along
        a line, the tracker's displacements along that line are large, and straightening gains nothing.
        """
        deformed = self.deformed
        if deformed.obstacle or deformed.amplitude < LEAST_AMPLITUDE * deformed.lattice.s:
            return False
        before = explained_share(self.sample, deformed.lattice)
        return explained_share(self.image, self.lattice) >= LEAST_GAIN * before

    @cached_property
    def _field(self) -> FreeForm:
        deformed = self.deformed
        return FreeForm.fit(deformed.places, deformed.displacements, deformed.knots.s, self.repeats)

    def locate(self, points: Points) -> Points:
        """Return the places (x, y) px in the sample of points of the straight plane, ``(..., 2)``.

        The content has moved by nothing on average, so that the plane is in phase with the sample.
        """
        return points + self._field.at(points)

    @cached_property
    def _box(self) -> tuple[Points, tuple[int, int, int, int]]:
        height, width = self.sample.shape[:2]
        sources = self.locate(pixel_grid(width, height).astype(np.float64))
        inside = np.asarray(((sources >= 0) & (sources <= (width - 1, height - 1))).all(-1))
        box = largest_box(inside)
        return sources[box[0] : box[1], box[2] : box[3]], box

    @cached_property
    def image(self) -> Image:
        """``(h, w, C)``: the straightened sample, cropped to a box that shows the sample alone."""
        return Patches(self.sample).read_points(self._box[0])

    @property
    def corner(self) -> tuple[int, int]:
        """(x, y) px of the first pixel of :attr:`image` on the straight plane."""
        _, (top, _, left, _) = self._box
        return left, top

    @property
    def lattice(self) -> Lattice:
        """The regular lattice, in pixels of :attr:`image`."""
        x, y = self.corner
        return self.deformed.lattice.shifted((-x, -y))


def explained_share(image: Image, lattice: Lattice) -> float:
    """Return the share of the variance of an image that its mean tile explains."""
    mean = fold(image, lattice).unfold(image.shape[:2])
    around = np.square(image - image.mean((0, 1), dtype=np.float64)).sum(dtype=np.float64)
    return 1 - float(np.square(image - mean).sum(dtype=np.float64) / max(float(around), 1e-12))


@dataclass(frozen=True, eq=False)
class Bend:
    """The map from a deformed output to the straight plane.

    Parameters
    ----------
    shape
        Height and width of the output, px.
    field
        How far each place of the output lies from the point of the plane that it shows; None: nowhere.
    """

    shape: tuple[int, int]
    field: FreeForm | None

    @classmethod
    def of(cls, straight: StraightSample, shape: tuple[int, int], deform: Deform, rng: np.random.Generator) -> Bend:
        """Return the deformation of an output; the warp is that of the sample, from the displaced vertices back."""
        if deform == "none":
            return cls(shape, None)
        places, moved, nearest = output_field(straight.deformed, shape, deform, rng)
        return cls(shape, FreeForm.fit(places + moved, -moved, nearest, straight.repeats))

    def locate(self, pixels: Points) -> Points:
        """Return the points of the straight plane that pixels (x, y) of the output show, ``(..., 2)``."""
        return pixels if self.field is None else pixels + self.field.at(pixels)

    @cached_property
    def extent(self) -> tuple[Points, Points]:
        """Least and greatest (x, y) px on the plane that the output shows."""
        height, width = self.shape
        if self.field is None:
            return np.zeros(2), np.array([width - 1.0, height - 1.0])
        ends = [
            (points.min((0, 1)), points.max((0, 1)))
            for top in range(0, height, _ROWS)
            for points in [self.locate(pixel_grid(width, min(_ROWS, height - top), top=top).astype(np.float64))]
        ]
        lows, highs = zip(*ends, strict=True)
        return np.min(lows, 0), np.max(highs, 0)


def synthesize_straight(task: Task, lattice: Lattice, synthesize: Callable[[Task], Synthesis]) -> Synthesis:
    """Return a synthesis that is made on the regular lattice and then deformed as the sample is.

    The sample is straightened, and the method is called with it. Its output is deformed by a field with the covariance
    of the sample's own (:mod:`~.vertex_field`). Both warps interpolate by splines of order 5. If the geometry of the
    sample does not depart (:attr:`StraightSample.departs`), the method is called with the task itself.

    Parameters
    ----------
    task
        The task.
    lattice
        The regular lattice.
    synthesize
        The method. Its output has the phase of the sample that it is given.
    """
    straight = StraightSample.of(task.sample, lattice)
    if not straight.departs:
        return synthesize(replace(task, lattice=lattice))
    bend = Bend.of(straight, task.shape, "normal", task.rng)
    margin = _MARGIN + math.ceil(lattice.covering_radius)
    low, high = np.floor(bend.extent[0]) - margin, np.ceil(bend.extent[1]) + margin
    width, height = (high - low).astype(int) + 1
    part = replace(task, sample=straight.image, shape=(int(height), int(width)), lattice=straight.lattice)
    made = synthesize(part)
    # The output continues the phase of the straightened sample, whose corner is elsewhere on the plane.
    points = bend.locate(pixel_grid(task.shape[1], task.shape[0]).astype(np.float64))
    places = points - low + lattice.wrap(low - straight.corner)
    image = Patches(np.ascontiguousarray(made.image)).read_points(places)
    source = None if made.source is None else _trace(straight, made.source, places)
    return replace(
        made, image=image, lattice=lattice, source=source, extras={**made.extras, "straightened": straight.image}
    )


def straighten_first(method: Synthesizer, task: Task, detector: Detector) -> Synthesis:
    """Return the synthesis of a method on the straightened sample, deformed again; see :func:`synthesize_straight`.

    Parameters
    ----------
    method
        The method as it is without straightening.
    task
        The task.
    detector
        Finds the lattice if none is given. If there is none, the method is called with the task itself.
    """
    found = find_lattice(task, detector)
    if found.lattice is None:
        return method.synthesize(task)
    made = synthesize_straight(task, found.lattice, method.synthesize)
    return replace(made, detection_seconds=found.seconds)


def _trace(straight: StraightSample, source: SourceMap, places: Points) -> SourceMap:
    """Return the source map of a deformed output, to about a pixel, from that of the straight output."""
    pixels = np.rint(places).astype(np.intp)
    near = source[pixels[..., 1], pixels[..., 0]]
    points = near[..., :2] + (places - pixels) + straight.corner
    traced = trace_points(straight.locate(np.nan_to_num(points)), straight.sample.shape, near[..., 2])
    traced[~np.isfinite(near).all(-1)] = np.nan
    return traced


def trace_points(points: Points, shape: tuple[int, ...], weight: NDArray[np.floating[Any]]) -> SourceMap:
    """Return the source map of pixels that were interpolated at points of a sample.

    Parameters
    ----------
    points
        ``(..., 2)``: (x, y) px.
    shape
        Height and width of the sample.
    weight
        ``(...)``: the weight of the value that was read there.
    """
    nearest = np.clip(np.rint(points), 0, np.array(shape[1::-1]) - 1)
    share = np.clip(1 - np.abs(points - nearest), 0, 1).prod(-1) * weight
    traced = np.concatenate([nearest, np.clip(share, 1e-6, _MOST_WEIGHT)[..., np.newaxis]], -1)
    return np.asarray(traced, np.float32)
