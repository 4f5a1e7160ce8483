"""How much of the randomness is kept, as one number: the vertical axis of the perils plane."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from nrbench.synthesis import Column

VARIATION, REPETITION = "randomness.variation", "randomness.repetition"
KEPT = "perils.randomness_kept"
KEPT_COLUMN = Column(
    "Randomness kept: the worse of variation v and repetition r, min(v, 1/v, 1/(1 + max(r, 0))); 1 is a fresh draw, "
    "1/2 the best possible copier, 0 wallpaper.",
    better="higher",
)
COPIER = 0.5
"""Where the best possible copier lies: its repetition is 1."""


def kept(variation: ArrayLike, repetition: ArrayLike) -> NDArray[np.float64]:
    """Return the worse of variation and repetition, each as its departure from a fresh draw, in [0, 1].

    Variation v is a ratio to fresh draws and a fault on both sides: twice as much is as far off as half as much, so it
    counts ``min(v, 1/v)``. Repetition r is 0 for a fresh draw and 1 for the best possible copier, and a fault on one
    side only: it counts ``1 / (1 + max(r, 0))``, in units of the copier's excess of twins. Both
    are 1 for a fresh draw and fall to 0 without ever reaching it at a limit of their own, so that methods worse than
    the best copier can still be told apart.

    Parameters
    ----------
    variation, repetition
        ``randomness.variation`` and ``randomness.repetition``, of equal shape; NaN where there is none.

    Returns
    -------
    numpy.ndarray
        NaN unless both are known: the worse of a known and an unknown number is not known.
    """
    v, r = np.asarray(variation, np.float64), np.asarray(repetition, np.float64)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        varied = np.where(v > 0, np.minimum(v, 1 / v), np.where(np.isnan(v), np.nan, 0.0))
    return np.minimum(varied, 1 / (1 + np.maximum(r, 0)))


def is_asked(columns: Iterable[str]) -> bool:
    """Return whether a run has both scores that the number is made of."""
    return {VARIATION, REPETITION} <= set(columns)


def derived(scores: pd.DataFrame) -> dict[str, Any]:
    """Return the column :data:`KEPT` of a table that has both scores; nothing where it lacks one.

    The worse is taken cell by cell, before any mean: a method that varies too little on one texture and repeats itself
    on another fails on both.
    """
    return {KEPT: kept(scores[VARIATION], scores[REPETITION])} if is_asked(scores.columns) else {}
