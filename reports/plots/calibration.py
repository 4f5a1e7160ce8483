"""Whether a confidence means what it says: the reliability diagram."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..statistics.statistics import Estimate, wilson

BINS = 10


@dataclass(frozen=True)
class Bin:
    """The answers whose confidence lies in one range.

    Parameters
    ----------
    low, high
        The range.
    confidence
        Their mean confidence.
    right
        The share of them that are right, with Wilson's interval.
    share
        Their share of all answers.
    """

    low: float
    high: float
    confidence: float
    right: Estimate
    share: float

    @property
    def radius(self) -> float:
        """Radius of their point in the diagram, in hundredths of its side: its area tells the count."""
        return 1.2 + 5 * math.sqrt(self.share)


@dataclass(frozen=True)
class Calibration:
    """Confidence against truth.

    Parameters
    ----------
    bins
        Those that are not empty, by ascending confidence.
    error
        Expected calibration error: the mean over answers of how far the share of right ones in an answer's bin is from
        their mean confidence (M. P. Naeini, G. F. Cooper, M. Hauskrecht, "Obtaining well calibrated probabilities using
        Bayesian binning", AAAI 2015); None where there are no answers.
    n
        Number of answers.
    """

    bins: Sequence[Bin]
    error: float | None
    n: int


def calibration(confidence: NDArray[np.float64], right: NDArray[np.bool_]) -> Calibration:
    """Return the calibration of answers, in :data:`BINS` ranges of equal width.

    Parameters
    ----------
    confidence
        ``(n,)`` in [0, 1].
    right
        ``(n,)``: whether each answer was right.
    """
    n = len(confidence)
    place = np.clip((confidence * BINS).astype(int), 0, BINS - 1)
    bins = [_bin(i, confidence[place == i], right[place == i], n) for i in np.unique(place)]
    gaps = [one.share * abs((one.right.value or 0.0) - one.confidence) for one in bins]
    return Calibration(bins, math.fsum(gaps) if bins else None, n)


def _bin(index: int, confidence: NDArray[np.float64], right: NDArray[np.bool_], of: int) -> Bin:
    n = len(confidence)
    low, high = wilson(float(right.sum()), n) or (None, None)
    estimate = Estimate(float(right.mean()), low, high, n, n)
    return Bin(index / BINS, (index + 1) / BINS, float(confidence.mean()), estimate, n / of)
