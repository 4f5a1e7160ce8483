"""The period of a curve: its evenly spaced peaks, one at each multiple."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.parabola import find_vertex

Values = NDArray[np.float64]

NEAR = 1.5
"""A peak further than this, px, from where a multiple was expected does not belong to it."""
LOST = 0.25
"""Nor does one further than this share of the period; a period that has moved so far has followed other peaks."""


@dataclass(frozen=True)
class Period:
    """The period of a curve over lags.

    Parameters
    ----------
    length
        px.
    peaks
        Lags, px, of the peak at each multiple 1, 2, ..., n.
    height
        The curve at the multiples, on average.
    contrast
        How far that is above the curve's median.
    strength
        The contrast where each multiple weighs as much as its number squared, times the root of how many there are:
        what repeats by chance fades with the lag.
    """

    length: float
    peaks: tuple[float, ...]
    height: float
    contrast: float
    strength: float


def find_period(curve: Values, share: float, subpixel: bool) -> Period | None:
    """Return the shortest period whose contrast is at least ``share`` of the highest; None where nothing stands out.

    Each peak of the curve is a candidate. Its multiples are followed outward, one at a time, as each tells the period
    more precisely than the last: the whole lag that is highest near each counts.

    Parameters
    ----------
    curve
        ``(n,)``: the higher, the more alike, at lags 0, 1, ..., n - 1.
    share
        In (0, 1].
    subpixel
        Peaks are vertices of parabolas, and the period fits them all; else it is the last one over its number.
    """
    if len(curve) < 3:
        return None
    level, inner = float(np.median(curve)), curve[1:-1]
    candidates = np.flatnonzero((inner > curve[:-2]) & (inner >= curve[2:]) & (inner > level)) + 1
    found = [_follow(curve, level, int(lag), subpixel) for lag in candidates]
    highest = max((period.contrast for period in found), default=0.0)
    return next((period for period in found if period.contrast >= share * highest > 0), None)


def _follow(curve: Values, level: float, lag: int, subpixel: bool) -> Period:
    """Return the period whose first peak is at ``lag``, followed to the curve's end."""
    period, peaks, heights = float(lag), list[float](), list[float]()
    products, squares, near = 0.0, 0.0, min(NEAR, LOST * lag)
    while abs(period - lag) <= LOST * lag and (k := len(peaks) + 1) * period <= len(curve) - 2:
        low = max(round(k * period - near), 1)
        place = low + int(curve[low : min(round(k * period + near) + 1, len(curve) - 1)].argmax())
        peaks.append(place + float(find_vertex(*curve[place - 1 : place + 2])[0]) if subpixel else float(place))
        heights.append(float(curve[place]))
        products, squares = products + k * peaks[-1], squares + k * k
        period = products / squares if subpixel else peaks[-1] / k
    height = float(np.mean(heights))
    far = float(np.average(heights, weights=np.square(np.arange(len(heights)) + 1.0))) - level
    return Period(period, tuple(peaks), height, height - level, far * float(np.sqrt(len(heights))))
