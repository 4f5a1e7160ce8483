"""Samples in uneven light, which a method gets in even light."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nrbench.displacement.deformation_field import Deformation, pixel_places
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, depth_of, quantize
from nrbench.imaging.light import describe_light, divide_light, estimate_light
from nrbench.imaging.masks import Mask
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesizer, Task

from .bent_samples import detector_of, recognize_sample


def flatten_light(method: Synthesizer | None, task: Task) -> tuple[Task, str]:
    """Return a task whose sample is in even light, and a note.

    Parameters
    ----------
    method
        The method whose detector finds the lattice; None: that of the role ``detector`` does.
    task
        The task.

    Raises
    ------
    BadInput
        If no lattice is given or found, by which light and texture can be told apart.
    """
    survey = recognize_sample(method, task)
    if survey.found.lattice is None:
        raise BadInput(f"--flatten-light: no lattice found ({survey.found.reason}); give one as x1,y1,x2,y2")
    light = (
        estimate_light(task.sample, survey.found.lattice, task.known)
        if survey.bent is None
        else _estimate_bent(survey.bent, task.known)
    )
    sample = quantize(divide_light(task.sample, light), depth_of(task.sample))
    said = describe_light(light) or "the light on the sample hardly varies"
    return replace(
        task, sample=sample, detected=(sample, detector_of(method), survey.found)
    ), f"{said}: it was divided out"


def warn_of_light(sample: Image, lattice: Lattice, known: Mask | None = None) -> None:
    """Warn if the light on a sample varies much from cell to cell of its lattice."""
    if said := describe_light(estimate_light(sample, lattice, known, edges=False)):
        warnings.warn(f"{said}, so the output may be patchy; --flatten-light divides it out", stacklevel=2)


def _estimate_bent(bent: Deformation, known: Mask | None) -> NDArray[np.float64]:
    """Return the light on a bent image, estimated on the straight one."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator  # not for light that is only named

    straight, lattice = bent.straighten()
    step = max(round(lattice.s / 4), 1)
    light = estimate_light(straight, lattice, None if known is None else bent.straighten_mask(known))[
        ::step, ::step
    ].ravel()
    seen = bent.locate(pixel_places(*straight.shape[:2])[::step, ::step].reshape(-1, 2) + bent.corner)
    places = pixel_places(*bent.image.shape[:2])
    found = LinearNDInterpolator(seen, light)(places)
    return np.where(np.isnan(found), NearestNDInterpolator(seen, light)(places), found)
