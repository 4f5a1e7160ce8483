"""Fill the holes of a picture by a method that can, on the picture's own lattice, also where that is bent."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from nrbench.calling.bent_samples import MOST_WEIGHT, survey_sample
from nrbench.displacement.deformation_field import Deformation, map_points, pixel_places, read_spline
from nrbench.displacement.free_form import FreeForm
from nrbench.imaging.convert import depth_of, quantize
from nrbench.imaging.masks import known_at
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Synthesis, Task

Map = Callable[[Points], Points]
_AROUND: Final = 512
"""px around the holes of a large picture from which they are filled."""
_MUCH: Final = 0.5
"""Share of a picture that is rarely to be filled: its mask may be the wrong way round."""


def fill_picture(method: Any, task: Task) -> Synthesis:
    """Return the picture of a task with its holes filled; all other pixels stay as they are.

    Where the lattice is bent, the picture is straightened, filled, and what fills the holes is bent as the picture is.

    Parameters
    ----------
    method
        A method whose class variable ``fills`` is True.
    task
        Its ``known`` is False in the holes; ``shape`` is that of the picture.

    Raises
    ------
    Refused
        If the method cannot fill a hole.
    """
    assert task.known is not None
    share = 1 - float(task.known.mean())
    if share > _MUCH:
        warnings.warn(f"{100 * share:.0f} % of the picture are to be filled: white is kept", UserWarning, stacklevel=2)
    rows, columns = np.nonzero(~task.known)
    top, left = max(int(rows.min()) - _AROUND, 0), max(int(columns.min()) - _AROUND, 0)
    part = np.s_[top : int(rows.max()) + _AROUND + 1, left : int(columns.max()) + _AROUND + 1]
    sample, known = np.ascontiguousarray(task.sample[part]), np.ascontiguousarray(task.known[part])
    lattice = None if task.lattice is None else task.lattice.shifted((-left, -top))
    made = _fill_part(method, replace(task, sample=sample, known=known, shape=known.shape, lattice=lattice))
    assert made.source is not None
    image, source = task.sample.copy(), np.ones((*task.shape, 3), np.float32)
    source[..., :2] = pixel_places(*task.shape)
    image[part][~known], source[part][~known] = made.image[~known], made.source[~known] + (left, top, 0)
    lattice = None if made.lattice is None else made.lattice.shifted((left, top))
    note = "; ".join(filter(None, (f"{100 * share:.3g} % of the picture filled", made.note)))
    return replace(made, image=image, source=source, lattice=lattice, extras={}, note=note)


def _fill_part(method: Any, task: Task) -> Synthesis:
    """Return a picture with its holes filled, on its followed lattice if that is bent."""
    survey = survey_sample(method, task)
    if survey is None:
        made: Synthesis = method.fill(task)
        return made
    if survey.bent is None:
        made, note = method.fill(replace(task, lattice=survey.found.lattice)), survey.note
    else:
        made, note = _fill_bent(method, task, survey.bent), f"{survey.note}, and filled as it is bent"
    note = "; ".join(filter(None, (made.note, note)))
    return replace(made, detection_seconds=made.detection_seconds + survey.seconds, note=note)


def _fill_bent(method: Any, task: Task, bent: Deformation) -> Synthesis:
    """Fill the holes of a bent picture on the plane of its mean lattice."""
    assert task.known is not None
    hole, (to_plane, to_picture) = ~task.known, _maps(bent)
    plane = to_plane(pixel_places(*task.shape))
    low = np.floor(plane.min((0, 1)))
    columns, rows = (np.ceil(plane.max((0, 1))) - low).astype(int) + 1
    places = to_picture(pixel_places(int(rows), int(columns)) + low)
    last = np.array(task.shape[::-1]) - 1
    known = known_at(task.known, places) & ((places >= 0) & (places <= last)).all(-1)
    straight = quantize(read_spline(task.sample, np.clip(places, 0, last)), depth_of(task.sample))
    flat = replace(task, sample=straight, known=known, shape=known.shape, lattice=bent.lattice.shifted(-low))
    made: Synthesis = method.fill(flat)
    assert made.source is not None
    at = plane[hole] - low
    near = made.source[*np.rint(at).astype(np.intp).T[::-1]]
    image, source = task.sample.copy(), np.ones((*task.shape, 3), np.float32)
    image[hole] = read_spline(made.image, at)
    points = bent.locate(near[:, :2] + (at - np.rint(at)) + low)
    source[hole] = np.column_stack([np.clip(points, -0.5, last + 0.5), MOST_WEIGHT * near[:, 2]])
    return replace(made, image=image, source=source, lattice=bent.lattice)


def _maps(bent: Deformation) -> tuple[Map, Map]:
    """Return the maps from a bent picture to the plane of its mean lattice, and back.

    They are the homography if there is one, else smooth maps through the knots.
    """
    if bent.homography is not None:
        inverse = np.asarray(np.linalg.inv(bent.homography))
        return partial(map_points, inverse), partial(map_points, bent.homography)
    places, points = bent.places, bent.lattice.from_cell(bent.cells)
    forms = [FreeForm.fit(a, b - a, bent.lattice.s / 2) for a, b in ((places, points), (points, places))]
    return (lambda at: at + forms[0].at(at)), (lambda at: at + forms[1].at(at))
