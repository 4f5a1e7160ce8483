"""How far the windows of an output lie from their places beside those of references: all of them, and neighborhoods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import limits
from .exponential_tail import ExponentialTail
from .window_registration import RegisteredWindows

_QUARTER = 0.75
"""The quantile that stands for the scatter: no few windows that lock onto a wrong place reach it."""


def scatter_excess(placement: RegisteredWindows, references: Sequence[RegisteredWindows]) -> float:
    """Return how far the windows' scatter exceeds its limits: above 1 the content is bent.

    A smooth displacement leaves most windows within the tolerance, yet all of them off by more than windows of the
    references are: the third quartile of the misplacement tells, where the share beyond the tolerance does not.
    """
    own = np.concatenate([one.misplacement for one in references])
    if not len(own) or not len(placement.misplacement):
        return 0.0
    usual, seen = (float(np.quantile(some, _QUARTER)) for some in (own, placement.misplacement))
    return min(seen / max(usual, 1e-6) / limits.SCATTER_RATIO, seen / limits.SCATTER)


def neighborhood_excess(
    placement: RegisteredWindows, references: Sequence[RegisteredWindows], limit: float, model: bool
) -> float:
    """Return how far the worst neighborhood exceeds its limits: above 1 it has moved.

    It is off by more than ``limit`` (in s) and, where a model gives enough references, by more than theirs
    ever are.
    """
    found = placement.neighborhoods()
    far = float(found.max(initial=0.0)) / limit
    if not model:
        return far
    own = np.concatenate([one.neighborhoods() for one in references])
    surprise = ExponentialTail.fit(own, quantile=0.9, overlap=4).surprisal(found)
    return min(far, float(surprise.max(initial=0.0)) / limits.NEIGHBORHOOD_SURPRISAL)
