"""Straighten a bent sample, synthesize on the regular lattice, and bend the output: one mechanism for all methods."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.boxes import largest_box
from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import (
    FoundLattice,
    Geometry,
    NoLatticeFound,
    Refused,
    Shape,
    SourceMap,
    Synthesis,
    Synthesizer,
    Task,
    find_lattice,
)
from nrbench.plugins.registry import BENT_FINDERS, NamedDetector
from nrbench.tracking.bent_lattice import LEAST_AMPLITUDE, Deformation
from nrbench.views.deformed import find_deformation

from .deformed_lattice import DeformedLattice, find_deformed_lattice, output_field, read_deformation
from .free_form import REPEATS, FreeForm

LEAST_GAIN: Final = 1.25
"""Factor by which straightening must raise the share of the variance that the mean tile explains."""
_SAME = 0.15
"""Tolerance, in s, at which the mean lattice of a bent sample counts as the given one."""
_LEAST_PERIODS = 2.0
"""Periods along both vectors that the straightened sample must show."""
_MARGIN = 3
"""px of the straight output beyond the outermost point that the deformed output shows."""
_ROWS = 256
"""Rows of an output whose places are computed at a time."""
_MOST_WEIGHT = 0.999
"""Largest weight in the source map of a pixel that was interpolated."""


def read_spline(image: Image, points: Points) -> Image:
    """Return the values of an image at points (x, y), ``(..., 2)``, by splines of order 5, in [0, 1]: ``(..., C)``."""
    at = np.moveaxis(points, -1, 0)[::-1]
    planes = [scipy.ndimage.map_coordinates(plane, at, order=5, mode="mirror") for plane in np.moveaxis(image, -1, 0)]
    return np.asarray(np.clip(np.stack(planes, -1), 0, 1), np.float32)


def pixel_places(height: int, width: int, top: int = 0) -> Points:
    """Return the (x, y) of each pixel of some rows, ``(height, width, 2)``."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(top, top + height)), -1).astype(np.float64)


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

    @property
    def still(self) -> bool:
        """Whether the whole tiles were found in their places, to 0.04 s (root mean square)."""
        return not self.deformed.obstacle and self.deformed.amplitude < LEAST_AMPLITUDE * self.deformed.lattice.s

    @cached_property
    def gain(self) -> float:
        """Share of the variance that the mean tile explains in the straight sample, over that in the sample itself.

        Where a texture hardly changes along a line, displacements along that line may be large, and undoing them gains
        nothing. 0 if the displacements could not be measured.
        """
        if self.deformed.obstacle:
            return 0.0
        before = explained_share(self.sample, self.deformed.lattice)
        return explained_share(self.image, self.lattice) / max(before, 1e-6)

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
        sources = self.locate(pixel_places(height, width))
        inside = np.asarray(((sources >= 0) & (sources <= (width - 1, height - 1))).all(-1))
        box = largest_box(inside)
        return sources[box[0] : box[1], box[2] : box[3]], box

    @cached_property
    def image(self) -> Image:
        """``(h, w, C)``: the straightened sample, cropped to a box that shows the sample alone."""
        return read_spline(self.sample, self._box[0])

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

    shape: Shape
    field: FreeForm | None

    @classmethod
    def of(cls, straight: StraightSample, shape: Shape, geometry: Geometry, rng: np.random.Generator) -> Bend:
        """Return the deformation of an output; the warp is that of the sample, from the displaced vertices back."""
        if geometry == "straight":
            return cls(shape, None)
        places, moved, nearest = output_field(straight.deformed, shape, geometry, rng)
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
            for points in [self.locate(pixel_places(min(_ROWS, height - top), width, top))]
        ]
        lows, highs = zip(*ends, strict=True)
        return np.min(lows, 0), np.max(highs, 0)


@dataclass(frozen=True)
class SampleSurvey:
    """What is found of a sample before a method gets it. It is the same for all methods with the same detector.

    Parameters
    ----------
    found
        The lattice, given or detected.
    straight
        The straightened sample; None if the sample is not bent.
    note
        Its description in one line.
    seconds
        Wall seconds that this took.
    """

    found: FoundLattice
    straight: StraightSample | None
    note: str
    seconds: float


def survey_sample(method: Synthesizer, task: Task) -> SampleSurvey | None:
    """Find the lattice of a sample, and whether it is bent; None for a method that gets the sample as it is.

    If no lattice is given, the detector of the method finds one, or ``consensus`` if it names none. Where the detector
    finds none, a bent one is looked for.

    Parameters
    ----------
    method, task
        As for :func:`synthesize_in_geometry`.
    """
    if getattr(method, "geometry", "as-is") == "as-is" or not getattr(method, "uses_lattice", True):
        return None
    start = time.perf_counter()
    found = find_lattice(task, _detector_of(method))
    straight, note = straighten_sample(task.sample, found.lattice, task.lattice is not None)
    return SampleSurvey(found, straight, note, time.perf_counter() - start)


def _detector_of(method: Synthesizer) -> NamedDetector:
    return NamedDetector(getattr(method, "finder", "") or "consensus")


def synthesize_in_geometry(method: Synthesizer, task: Task, survey: SampleSurvey | None = None) -> Synthesis:
    """Return the synthesis of a method: on the straightened sample, and bent again, where the sample is bent.

    The parameter ``geometry`` of the method says how (:data:`~nrbench.plugins.forms.Geometry`). Both warps interpolate
    by splines of order 5. A sample that is not bent reaches the method as it is.

    Parameters
    ----------
    method
        The method. Its output has the phase of the sample that it is given.
    task
        The task.
    survey
        What :func:`survey_sample` returns; found here if None.

    Raises
    ------
    Refused
        If the method refuses the sample, or if the straightened sample does not show two periods.
    """
    survey = survey or survey_sample(method, task)
    if survey is None:
        return method.synthesize(task)
    geometry: Geometry = getattr(method, "geometry", "as-is")
    seconds, straight, note = 0.0 if task.lattice else survey.seconds, survey.straight, survey.note
    task = replace(task, detected=(task.sample, _detector_of(method), survey.found))
    made = method.synthesize(task) if straight is None else _synthesize_bent(method, task, straight, geometry)
    if straight is not None:
        note += f", and the output is {'straight' if geometry == 'straight' else 'bent'}"
    note = "; ".join(filter(None, (made.note, note)))
    return replace(made, detection_seconds=made.detection_seconds + seconds, note=note)


def _synthesize_bent(method: Synthesizer, task: Task, straight: StraightSample, geometry: Geometry) -> Synthesis:
    if geometry == "argmax":
        straight = replace(straight, repeats=1)
    lattice, (height, width) = straight.deformed.lattice, straight.image.shape[:2]
    if min(np.ptp(straight.lattice.to_cell(pixel_places(height, width)), axis=(0, 1))) < _LEAST_PERIODS:
        raise Refused(
            f"the sample is bent so much that only {width}x{height} px of it can be straightened, less than two "
            "periods; choose a larger sample, or geometry=as-is"
        )
    bend = Bend.of(straight, task.shape, geometry, task.rng)
    margin = _MARGIN + math.ceil(lattice.covering_radius)
    low, high = np.floor(bend.extent[0]) - margin, np.ceil(bend.extent[1]) + margin
    columns, rows = (high - low).astype(int) + 1
    shape = int(rows), int(columns)
    made = method.synthesize(replace(task, sample=straight.image, shape=shape, lattice=straight.lattice))
    # The output continues the phase of the straightened sample, whose corner is elsewhere on the plane.
    places = bend.locate(pixel_places(*task.shape)) - low + lattice.wrap(low - straight.corner)
    image = read_spline(made.image, places)
    source = None if made.source is None else _trace(straight, made.source, places)
    extras = {**made.extras, "straightened": straight.image}
    return replace(made, image=image, lattice=lattice, source=source, extras=extras)


def straighten_sample(sample: Image, lattice: Lattice | None, given: bool) -> tuple[StraightSample | None, str]:
    """Return the straight sample, None if the sample is not bent, and a note.

    If the tiles of the lattice lie in their places, the sample is straight. Otherwise the lattice is followed through
    the sample (:func:`~nrbench.views.deformed.find_deformation`), which tells a smooth deformation from elements that
    are displaced one by one. Where the sample is bent, the displacements are those of whichever straightens it
    better: the tracker, which is more exact, or the followed lattice, which bends farther.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        Its lattice; None if it is not known.
    given
        Whether the lattice is known for sure. If not, and it cannot be followed, another one is looked for.
    """
    tracked = None if lattice is None else StraightSample(sample, find_deformed_lattice(sample, lattice))
    if tracked is not None and tracked.still:
        return None, ""
    deformation = _follow(sample, lattice, given)
    if deformation is None:
        return None, "whether the sample is bent cannot be told: it is taken as it is" if lattice else ""
    amplitude = f"{deformation.amplitude:.2f} s"
    if not deformation.bent:
        off = deformation.amplitude >= LEAST_AMPLITUDE
        return (
            None,
            f"tiles lie off the lattice by {amplitude}, not smoothly: the sample is taken as it is" if off else "",
        )
    mean = deformation.lattice
    if tracked is None or not given:
        tracked = StraightSample(sample, find_deformed_lattice(sample, mean))
    followed = read_deformation(deformation, np.array(tracked.deformed.lattice.origin))
    ways = [tracked] if followed is None else [tracked, StraightSample(sample, followed)]
    best = max(ways, key=lambda way: way.gain)
    if best.gain < LEAST_GAIN:
        return None, "the sample seems bent, but straightening gains nothing: it is taken as it is"
    return best, f"bent by {amplitude}: the sample was straightened"


def _follow(sample: Image, lattice: Lattice | None, given: bool) -> Deformation | None:
    """Return the deformation of a sample; None if its lattice cannot be followed.

    If the lattice cannot be followed from what it is on average, one that is detected in a part of the sample is.
    """
    thorough, quick = map(NamedDetector, BENT_FINDERS)
    for start in (None,) if lattice is None else (lattice, None):
        try:
            found = find_deformation(sample, thorough, quick, start).deformation
        except (NoLatticeFound, BadInput):
            continue
        other = start is None and given and lattice and not found.lattice.is_equivalent(lattice, _SAME * lattice.s)
        if found.covered and not other:
            return found
    return None


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
