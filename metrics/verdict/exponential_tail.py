"""How surprising the worst of many values is, calibrated on values that are known to be right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


@dataclass(frozen=True)
class ExponentialTail:
    """The upper tail of a statistic over references: an exponential above a threshold.

    Peaks over a threshold (Pickands, Annals of Statistics 3, 1975), with the shape held at the exponential and the
    scale estimated from few excesses: what it predicts for a new value is then Lomax's law, whose tail is heavier the
    fewer the excesses are.

    Parameters
    ----------
    threshold
        A quantile of the references.
    rate
        Share of the references above it.
    scale
        Mean excess above it.
    excesses
        How many independent excesses the scale rests on.
    """

    threshold: float
    rate: float
    scale: float
    excesses: float

    @classmethod
    def fit(cls, values: Values, quantile: float = 0.95, overlap: float = 1.0) -> ExponentialTail:
        """Fit the tail of the references' values.

        Parameters
        ----------
        values
            One a window, at least one.
        quantile
            Where the tail begins.
        overlap
            How many windows share what one independent window would see.
        """
        threshold = float(np.quantile(values, quantile))
        excess = values[values > threshold] - threshold
        scale = float(excess.mean()) if len(excess) else 0.0
        return cls(threshold, 1 - quantile, max(scale, 1e-3), max(len(excess) / overlap, 1.0))

    def surprisal(self, values: Values) -> Values:
        """Return, for each of n values, about -log of the chance that the largest of n references exceeds it.

        The size of the image is so accounted for: over right images the largest surprise exceeds x in a share of about
        exp(-x), however many windows they have.
        """
        beyond = np.maximum(values - self.threshold, 0) / self.scale
        return np.asarray(self.excesses * np.log1p(beyond / self.excesses) - np.log(max(self.rate * len(values), 1e-9)))
