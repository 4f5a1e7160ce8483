"""Surprisal of extreme values, calibrated on values of images without defects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


@dataclass(frozen=True)
class ExponentialTail:
    """Exponential model of the upper tail of a statistic over references.

    The model is that of peaks over a threshold (Pickands, Annals of Statistics 3, 1975), with an exponential
    distribution above the threshold. Since the scale is estimated from few excesses, the predictive distribution of a
    new value is Lomax's. Its tail is heavier the fewer the excesses are.

    Parameters
    ----------
    threshold
        A quantile of the references.
    rate
        Share of the references above it.
    scale
        Mean excess over it.
    excesses
        Number of independent excesses from which the scale was estimated.
    """

    threshold: float
    rate: float
    scale: float
    excesses: float

    @classmethod
    def fit(cls, values: Values, quantile: float = 0.95, overlap: float = 1.0) -> ExponentialTail:
        """Fit the tail to the values of references.

        Parameters
        ----------
        values
            ``(n,)``: one value a window, at least one.
        quantile
            Quantile of the values that is the threshold.
        overlap
            Number of overlapping windows that count as one independent window.
        """
        threshold = float(np.quantile(values, quantile))
        excess = values[values > threshold] - threshold
        scale = float(excess.mean()) if len(excess) else 0.0
        return cls(threshold, 1 - quantile, max(scale, 1e-3), max(len(excess) / overlap, 1.0))

    def surprisal(self, values: Values) -> Values:
        """Return for each of n values about -log of the probability that the largest of n references exceeds it.

        The surprisal accounts for the size of the image. The largest surprisal of an image without defects exceeds x
        with a probability of about exp(-x), whatever the number of its windows.
        """
        beyond = np.maximum(values - self.threshold, 0) / self.scale
        return np.asarray(self.excesses * np.log1p(beyond / self.excesses) - np.log(max(self.rate * len(values), 1e-9)))
