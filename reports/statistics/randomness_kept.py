"""How much of the randomness is kept, as one number: the vertical axis of the perils plane."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from nrbench.plugins.forms import Column

VARIATION, REPETITION, DISTANCE = "randomness.variation", "randomness.repetition", "randomness.distance"
KEPT = "perils.randomness_kept"
KEPT_COLUMN = Column(
    "Randomness kept: the worst of variation v, repetition r and distance d, "
    "min(v, 1/v, 1/(1 + max(r, 0)), 1 - max(d, 0)/0.41); 1 is a fresh draw, 1/2 the best possible copier, 0 wallpaper.",
    better="higher",
)
COPIER = 0.5
"""Where the best possible copier lies: its repetition is 1."""
WALLPAPER = math.sqrt(2) - 1
"""Distance of one tile repeated: ``2 E|Y| - E|Y - Y'|`` over ``E|Y - Y'|``, where departures Y are normal."""


def kept(variation: ArrayLike, repetition: ArrayLike, distance: ArrayLike) -> NDArray[np.float64]:
    """Return the worst of variation, repetition and distance, each as its departure from a fresh draw, in [0, 1].

    Variation v is a ratio to fresh draws and a fault on both sides: twice as much is as far off as half as much, so it
    counts ``min(v, 1/v)``. Repetition r is 0 for a fresh draw and 1 for the best possible copier, and a fault on one
    side only: it counts ``1 / (1 + max(r, 0))``, in units of the copier's excess of twins. Both
    are 1 for a fresh draw and fall to 0 without ever reaching it at a limit of their own, so that methods worse than
    the best copier can still be told apart. Distance d is 0 for a fresh draw and :data:`WALLPAPER` for one tile
    repeated: it counts ``1 - max(d, 0) / WALLPAPER``, not below 0. It binds where departures are as strong as they
    should be and never the same, but of another kind: noise on wallpaper is right on the first two.

    Parameters
    ----------
    variation, repetition, distance
        ``randomness.variation``, ``randomness.repetition`` and ``randomness.distance``, of equal shape; NaN where
        there is none.

    Returns
    -------
    numpy.ndarray
        NaN unless all are known: the worst of known and unknown numbers is not known.
    """
    v, r, d = (np.asarray(score, np.float64) for score in (variation, repetition, distance))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        varied = np.where(v > 0, np.minimum(v, 1 / v), np.where(np.isnan(v), np.nan, 0.0))
    alike = np.maximum(1 - np.maximum(d, 0) / WALLPAPER, 0)
    return np.minimum(np.minimum(varied, 1 / (1 + np.maximum(r, 0))), alike)


def is_asked(columns: Iterable[str]) -> bool:
    """Return whether a run has all scores that the number is made of."""
    return {VARIATION, REPETITION, DISTANCE} <= set(columns)


def derived(scores: pd.DataFrame) -> dict[str, Any]:
    """Return the column :data:`KEPT` of a table that has the three scores; nothing where it lacks one.

    The worst is taken cell by cell, before any mean: a method that varies too little on one texture and repeats itself
    on another fails on both.
    """
    if not is_asked(scores.columns):
        return {}
    return {KEPT: kept(*(scores[name] for name in (VARIATION, REPETITION, DISTANCE)))}
