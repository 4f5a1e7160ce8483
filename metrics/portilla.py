"""Portilla: distance between texture statistics of output and fresh draws; needs the optional package plenoptic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, ClassVar

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import gray
from nrbench.plugins.forms import Column, Observation, Score

from .judgment.texture_reference import fresh_images

plenoptic: Any = lazy_loader.load("plenoptic", error_on_import=False)
torch: Any = lazy_loader.load("torch", error_on_import=False)

_DRAWS = 6
_SCALES = 4
_STEP = 1 << _SCALES
_LEAST, _MOST = 128, 256
_SPREAD_FLOOR = 1e-3
Statistics = NDArray[np.float64]


@dataclass(frozen=True)
class Portilla:
    """Joint statistics of wavelet coefficients, as z-scores against fresh draws.

    The statistics are those of gray values and of steerable-pyramid coefficients (four scales, four orientations):
    marginals, and correlations across places, orientations and scales (Portilla and Simoncelli, International Journal
    of Computer Vision 40, 2000, section 3), computed by the package plenoptic. Each statistic is standardized by its
    mean and spread over six fresh draws. The root mean squared z-score is divided by that of a fresh draw against the
    others.

    Install the package with ``pip install 'nrbench[perceptual]'``; without it the column is empty. An output takes some
    seconds.
    """

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "distance": Column(
            "Root mean squared z-score of texture statistics against fresh draws, over that of a fresh draw.",
            "",
            (0.0, math.inf),
            "lower",
        )
    }

    def score(self, observation: Observation) -> Score:
        """Return the distance, or None and the reason: the package or the fresh draws are missing."""
        obstacle = _obstacle(observation)
        if obstacle:
            return Score.missing(self.columns, obstacle)
        output = observation.output
        side = min(output.shape[0], output.shape[1], _MOST) // _STEP * _STEP
        draws = [statistics(gray(image)[:side, :side]) for image in fresh_images(observation, _DRAWS)]
        if len(draws) < _DRAWS:
            return Score.missing(self.columns, "not applicable: there are no fresh draws of the output's size")
        own = departure(statistics(gray(output)[:side, :side]), np.array(draws))
        return Score({"distance": own / usual_departure(np.array(draws))})


def _obstacle(observation: Observation) -> str:
    """Return why nothing can be measured; empty if something can."""
    if find_spec("plenoptic") is None:
        return "plenoptic is not installed: pip install 'nrbench[perceptual]'"
    if observation.again is None:
        return "not applicable: there are no fresh draws to compare with"
    if min(observation.output.shape[:2]) < _LEAST:
        return f"undecided: an output of at least {_LEAST}x{_LEAST} px is needed for {_SCALES} scales"
    return ""


def statistics(plane: NDArray[np.float32]) -> Statistics:
    """Return the statistics of a square gray image whose side is a multiple of 16 px, ``(n,)``."""
    model = plenoptic.models.PortillaSimoncelli(plane.shape, n_scales=_SCALES)
    with torch.no_grad():
        values = model(torch.from_numpy(np.ascontiguousarray(plane, np.float32))[None, None])
    return np.asarray(values.numpy().ravel(), np.float64)


def departure(own: Statistics, draws: NDArray[np.float64]) -> float:
    """Return the root mean squared z-score of statistics ``(n,)`` against those of draws, ``(k, n)``.

    A thousandth of the statistic's size is added to its spread, so that rounding does not count in statistics that
    hardly vary.
    """
    spread = draws.std(0, ddof=1) + _SPREAD_FLOOR * (np.abs(draws).mean(0) + _SPREAD_FLOOR)
    return float(np.sqrt((((own - draws.mean(0)) / spread) ** 2).mean()))


def usual_departure(draws: NDArray[np.float64]) -> float:
    """Return the root mean square departure of a draw from the others."""
    each = [departure(draws[k], np.delete(draws, k, 0)) for k in range(len(draws))]
    return max(float(np.sqrt(np.mean(np.square(each)))), _SPREAD_FLOOR)
