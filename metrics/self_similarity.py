"""Self-similarity: regularity of a pattern along its most regular direction, without a lattice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import find_vertex, half_autocorrelation
from nrbench.plugins.forms import Column, Observation, Score, Value

REACH = 0.6
"""Longest lag, as a share of the smallest side."""
_LEAST_LAG, _LEAST_REACH = 4, 12
_DIRECTIONS = 180
_FINE = 2
"""Lags per px."""
_LONGER, _SHORTER = 1.2, 0.8
"""Range of the second minimum, relative to twice the lag of the first."""
_FLAT = 1e-6


@dataclass(frozen=True)
class Regular:
    """The most regular direction of an image.

    Parameters
    ----------
    score
        Regularity, in [0, 1].
    period
        Length, px, of the step that repeats; 0 where none does.
    direction
        Its angle in degrees, from x towards y, in [-90, 90).
    """

    score: float
    period: float
    direction: float


@dataclass(frozen=True)
class SelfSimilarity:
    """Regularity of sample and output after Chetverikov, computed from the autocorrelation.

    D. Chetverikov: Pattern regularity as a visual key, Image and Vision Computing 18 (2000) 975-985. Let rho be the
    normalized autocorrelation (of all channels together, each lag over its overlap). The *contrast function* of a
    direction a is F(d) = 1 - rho(d cos a, d sin a), here for 180 directions and 4 <= d <= D px in steps of 1/2, where D
    is 0.6 of the smallest side of sample and output; a minimum lies where the parabola through three steps does. For
    every minimum d1 and every minimum d2 within 20 % of 2 d1::

        R_int = 1 - (F(d1) + F(d2)) / (2 F_max)     F_max: the lower of the highest F before d1, and between d1 and d2
        R_pos = 1 - |d2 - 2 d1| / d2
        R(a)  = max over d1, d2 of (R_int R_pos)^2
        score = max over a of R(a)

    R_int, R_pos, their squared product and the maximum over directions are those of the paper. The paper chooses the
    two lowest minima as d1 and d2, which need not be neighbors if D exceeds two periods, and only the lowest one counts
    in R_int. Here both must be low, and d2 must be near 2 d1.

    The score is 1 if the pattern is perfectly regular along some direction, and 0 if nothing repeats. It does not
    depend on brightness, contrast, rotation or period, as long as two periods fit into D. It is blind to single faults,
    and stripes count as regular.
    """

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column("Regularity of the output along its most regular direction, without a lattice."),
        "sample_score": Column("Regularity of the sample along its most regular direction, without a lattice."),
        "difference": Column("Regularity of the output less that of the sample.", "", (-1.0, 1.0)),
        "period": Column("Length of the step that repeats in the output.", "px", (0.0, math.inf)),
        "sample_period": Column("Length of the step that repeats in the sample.", "px", (0.0, math.inf)),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores of sample and output, over the same lags."""
        images = {"": observation.output, "sample_": observation.sample}
        reach = int(REACH * min(min(image.shape[:2]) for image in images.values()))
        values: dict[str, Value] = dict.fromkeys(self.columns)
        reasons: dict[str, str] = {}
        for start, image in images.items():
            obstacle = _obstacle(image, reach)
            best = None if obstacle else regularity(image, reach)
            values[f"{start}score"] = best.score if best else None
            values[f"{start}period"] = best.period if best and best.period else None
            reasons |= dict.fromkeys((f"{start}score", f"{start}period"), obstacle or "not applicable: nothing repeats")
        if isinstance(one := values["score"], float) and isinstance(other := values["sample_score"], float):
            values["difference"] = one - other
        reasons["difference"] = "not measured: sample or output has no score"
        return Score(values, {name: reasons[name] for name, value in values.items() if value is None})


def _obstacle(image: Image, reach: int) -> str:
    if reach < _LEAST_REACH:
        return f"not measured: lags of only {reach} px fit into the images, at least {_LEAST_REACH} are needed"
    return "" if image.var((0, 1)).sum() > _FLAT else "not applicable: the image is flat"


def regularity(image: Image, reach: int) -> Regular:
    """Return the most regular direction of an image, for lags of up to ``reach`` px."""
    contrast = contrast_functions(image, reach)
    low, lags = _find_minima(contrast)
    best = Regular(0.0, 0.0, 0.0)
    for lag in range(_FINE * _LEAST_LAG, _FINE * reach // 2 + 1):
        rows = np.flatnonzero(low[:, lag])
        scores = _best_pair(contrast[rows], low[rows], lags[rows], lag)
        if len(rows) and scores.max() > best.score:
            row = rows[int(scores.argmax())]
            best = Regular(float(scores.max()), float(lags[row, lag]) / _FINE, 180.0 * row / _DIRECTIONS - 90.0)
    return best


def contrast_functions(image: Image, reach: int) -> NDArray[np.float64]:
    """Return 1 - rho by direction, from -90 degrees, and lag, in steps of half a px: ``(180, 2 reach + 1)``."""
    half = half_autocorrelation(image)
    middle, edge = image.shape[0] - 1, min(reach + 3, image.shape[0] - 1)
    near = half[middle - edge : middle + edge + 1, : reach + 4].astype(np.float64)
    near = np.concatenate([near[::-1, 3:0:-1], near], 1)
    angle = np.pi * np.arange(_DIRECTIONS)[:, np.newaxis] / _DIRECTIONS - np.pi / 2
    lag = np.arange(_FINE * reach + 1) / _FINE
    at = [edge + lag * np.sin(angle), 3 + lag * np.cos(angle)]
    return np.asarray(1 - np.clip(ndimage.map_coordinates(near, at, order=3, mode="nearest"), -1, 1))


def _find_minima(contrast: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return which lags are minima of their direction, and where each minimum lies between the steps.

    The place is that of the parabola through the minimum and its two neighbors. Whole steps would cost a period of
    15 px up to 3 % of its score.
    """
    before, here, after = contrast[:, :-2], contrast[:, 1:-1], contrast[:, 2:]
    low = np.zeros(contrast.shape, np.bool_)
    low[:, 1:-1] = (here <= before) & (here < after)
    lags = np.broadcast_to(np.arange(contrast.shape[1], dtype=np.float64), contrast.shape).copy()
    lags[:, 1:-1] += np.where(low[:, 1:-1], find_vertex(-before, -here, -after), 0)
    return low, lags


def _best_pair(
    contrast: NDArray[np.float64], low: NDArray[np.bool_], lags: NDArray[np.float64], lag: int
) -> NDArray[np.float64]:
    """Return for each direction the largest (R_int R_pos)^2 of a minimum at ``lag`` and one near twice the lag."""
    first, last = math.ceil(2 * _SHORTER * lag), min(math.floor(2 * _LONGER * lag), contrast.shape[1] - 2)
    if first > last or not len(contrast):
        return np.zeros(len(contrast))
    second = np.arange(first, last + 1)
    before = contrast[:, :lag].max(1, keepdims=True)
    between = np.maximum.accumulate(contrast[:, lag:], 1)[:, second - lag]
    barrier = np.maximum(np.minimum(before, between), _FLAT)
    depth = 1 - (contrast[:, [lag]] + contrast[:, second]) / (2 * barrier)
    place = 1 - np.abs(lags[:, second] - 2 * lags[:, [lag]]) / lags[:, second]
    return np.asarray((np.where(low[:, second], np.clip(depth, 0, 1) * place, 0) ** 2).max(1))
