"""Straighten a bent sample, synthesize on the regular lattice, and bend the output: one mechanism for all methods."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nrbench.calling.method_calls import move_sources, synthesize_exactly
from nrbench.displacement.bent_detection import find_bent_lattice, measure_deformation
from nrbench.displacement.deformation_field import LEAST_AMPLITUDE, Deformation, pixel_places, read_spline
from nrbench.displacement.free_form import REPEATS, FreeForm
from nrbench.displacement.random_field import output_field
from nrbench.imaging.convert import Image, depth_of, quantize
from nrbench.imaging.masks import Mask
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import (
    FoundLattice,
    Geometry,
    Refused,
    SourceMap,
    Synthesis,
    Synthesizer,
    Task,
    find_lattice,
)
from nrbench.plugins.registry import NamedDetector, in_role
from nrbench.work import make_once, work_clock

_SAME = 0.15
"""Tolerance, in s, at which the mean lattice of a bent sample counts as the given one."""
_FAR = 0.15
"""Displacement, in s, of tiles that lie off the lattice from which there is a warning."""
_LEAST_PERIODS = 2.0
"""Periods along both vectors that the straightened sample must show."""
_MARGIN = 3
"""px of the straight output beyond the outermost point that the deformed output shows."""
MOST_WEIGHT = 0.999
"""Largest weight in the source map of a pixel that was interpolated."""


@dataclass(frozen=True)
class SampleSurvey:
    """What is found of a sample before a method gets it. It is the same for all methods with the same detector.

    Parameters
    ----------
    found
        The lattice, given or detected.
    bent
        The deformation of the sample; None if it is not bent.
    note
        Its description in one line.
    seconds
        Wall seconds that this took.
    """

    found: FoundLattice
    bent: Deformation | None
    note: str
    seconds: float


def survey_sample(method: Synthesizer, task: Task) -> SampleSurvey | None:
    """Find the lattice of a sample, and whether it is bent; None for a method that gets the sample as it is.

    Parameters
    ----------
    method, task
        As for :func:`synthesize_in_geometry`.
    """
    if getattr(method, "geometry", "as-is") == "as-is" or not getattr(method, "uses_lattice", True):
        return None
    return recognize_sample(method, task)


def recognize_sample(method: Synthesizer | None, task: Task) -> SampleSurvey:
    """Find the lattice of a sample, and whether it is bent.

    If no lattice is given, the detector of the method finds one, or that of the role ``detector`` if it names none.
    Where the detector finds none, a bent lattice is looked for, as :func:`~.bent_detection.recognize` does.
    """
    start = work_clock()
    found = find_lattice(task, detector_of(method))
    followed = None
    if found.lattice is None:
        followed = make_once(("bent", task.sample, task.known), find_bent_lattice, task.sample, task.known)
    if followed is None:
        bent, note = find_bend(task.sample, found.lattice, task.lattice is not None, task.known)
    else:
        bent = followed.deformation
        found, note = FoundLattice(bent.lattice, vertices=bent.lattice_points), _describe(bent)
    seconds = work_clock() - start
    return SampleSurvey(found, bent, note, seconds)


def detector_of(method: Synthesizer | None) -> NamedDetector:
    """Return the detector of a method, or that of the role ``detector``."""
    return NamedDetector(getattr(method, "finder", "") or in_role("detector"))


def _describe(bent: Deformation) -> str:
    kind = "in perspective" if bent.homography is not None else "round or distorted by a lens" if bent.is_global else ""
    return f"bent by {bent.amplitude:.2f} s{f' ({kind})' if kind else ''}: the sample was straightened"


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
        return synthesize_exactly(method, task)
    geometry: Geometry = getattr(method, "geometry", "as-is")
    seconds, bent, note = 0.0 if task.lattice else survey.seconds, survey.bent, survey.note
    if geometry == "waves":
        geometry = "straight" if bent is not None and bent.is_global else "bent"
    task = replace(task, detected=(task.sample, detector_of(method), survey.found))
    made = synthesize_exactly(method, task) if bent is None else _synthesize_bent(method, task, bent, geometry)
    if bent is not None:
        note += f", and the output is {'straight' if geometry == 'straight' else 'bent'}"
    note = "; ".join(filter(None, (made.note, note)))
    return replace(made, detection_seconds=made.detection_seconds + seconds, note=note)


def _synthesize_bent(method: Synthesizer, task: Task, bent: Deformation, geometry: Geometry) -> Synthesis:
    sample, straight = bent.straighten()
    sample = quantize(sample, 16) if depth_of(task.sample) == 16 else sample
    height, width = sample.shape[:2]
    if min(np.ptp(straight.to_cell(pixel_places(height, width)), axis=(0, 1))) < _LEAST_PERIODS:
        raise Refused(
            f"the sample is bent so much that only {width}x{height} px of it can be straightened, less than two "
            "periods; choose a larger sample, or geometry=as-is"
        )
    # The point of the mean lattice's plane that each pixel of the output shows.
    places = pixel_places(*task.shape)
    if geometry != "straight":
        vertices, moved, nearest = output_field(bent, task.shape, geometry, task.rng)
        warp = FreeForm.fit(vertices + moved, -moved, nearest, 1 if geometry == "argmax" else REPEATS)
        places = places + warp.at(places)
    margin = _MARGIN + math.ceil(bent.lattice.covering_radius)
    low, high = np.floor(places.min((0, 1))) - margin, np.ceil(places.max((0, 1))) + margin
    columns, rows = (high - low).astype(int) + 1
    shape = int(rows), int(columns)
    known = None if task.known is None else bent.straighten_mask(task.known)
    made = synthesize_exactly(method, replace(task, sample=sample, shape=shape, lattice=straight, known=known))
    # The output continues the phase of the straightened sample, whose corner is elsewhere on the plane.
    places = places - low + bent.lattice.wrap(low - bent.corner)
    image = read_spline(made.image, places)
    made = replace(made, image=image, source=_show(made.source, places), blended=_show(made.blended, places))
    made = trace_sources(made, lambda points: bent.locate(points + bent.corner), task.sample.shape)
    return replace(made, lattice=bent.lattice, extras={**made.extras, "straightened": sample})


def find_bend(
    sample: Image, lattice: Lattice | None, given: bool, known: Mask | None = None
) -> tuple[Deformation | None, str]:
    """Return the deformation of a sample, None if it is not bent, and a note.

    The lattice is followed through the sample (:func:`~nrbench.displacement.bent_detection.find_deformation`).

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        Its lattice; None if it is not known.
    given
        Whether the lattice is known for sure. If it cannot be followed, it is then looked for in parts of the sample.
    known
        The pixels that count; None: all.
    """
    found = None if lattice is None else _follow(sample, lattice, given, known)
    if found is None:
        return None, "cannot tell whether the sample is bent; it is used as it is" if lattice else ""
    if found.bent:
        regular = replace(found, regular=lattice) if given else found
        return regular if regular.bent else found, _describe(found)
    if found.is_smooth:
        return None, "the sample seems bent, but straightening gains nothing: it is taken as it is"
    if found.amplitude < LEAST_AMPLITUDE:
        return None, ""
    note = f"tiles lie off the lattice by {found.amplitude:.2f} s, not smoothly: the sample is taken as it is"
    if found.amplitude >= _FAR:
        warnings.warn(f"{note}, so elements may be cut or scattered", stacklevel=2)
    return None, note


def _follow(sample: Image, lattice: Lattice, given: bool, known: Mask | None) -> Deformation | None:
    """Return the deformation of a sample; None if its lattice cannot be followed.

    If a given lattice cannot be followed from what it is on average, one that is detected in a part of the sample is.
    """
    found = measure_deformation(sample, lattice, known)
    if found is not None or not given:
        return found
    found = measure_deformation(sample, None, known)
    return found if found is not None and found.lattice.is_equivalent(lattice, _SAME * lattice.s) else None


def _show(source: SourceMap | None, places: Points) -> SourceMap | None:
    """Return the sources of an output that shows places (x, y) of another one: those of the nearest pixels, moved."""
    if source is None:
        return None
    pixels = np.rint(places).astype(np.intp)
    shown: SourceMap = source[pixels[..., 1], pixels[..., 0]]
    moved = (places - pixels).reshape(*places.shape[:2], *[1] * (shown.ndim - 3), 2)
    shown[..., :2] += moved
    return shown


def trace_sources(made: Synthesis, locate: Callable[[Points], Points], shape: tuple[int, ...]) -> Synthesis:
    """Return a synthesis from a deformed sample, with its sources in the sample itself; no pixel is a copy of one.

    Parameters
    ----------
    made, locate
        As for :func:`~nrbench.calling.method_calls.move_sources`.
    shape
        Height and width of the sample.
    """
    last = np.array(shape[1::-1]) - 0.5
    made = move_sources(made, lambda points: np.clip(locate(points), -0.5, last))
    weight = np.array([1, 1, MOST_WEIGHT], np.float32)
    return made if made.source is None else replace(made, source=made.source * weight)
