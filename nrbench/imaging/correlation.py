"""The generalized normalized autocorrelation of an image: every lag, every partial overlap, all channels."""

from __future__ import annotations

import itertools

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nrbench.imaging.door import Image

Correlation = NDArray[np.float32]
"""Normalized autocorrelation gamma in [-1, 1]. Whole: ``(2H-1, 2W-1)``, lag (dx, dy) at ``[H-1+dy, W-1+dx]``. Right
half: ``(2H-1, W)``, lag (dx, dy) with dx >= 0 at ``[H-1+dy, dx]``."""

FLAT = 1e-5
"""An overlap with less than this share of the whole image's sum of squares drowns in rounding: gamma is 0 there."""


def autocorrelation(image: Image) -> Correlation:
    """Return the normalized autocorrelation at all lags, ``(2H-1, 2W-1)``.

    As :func:`half_autocorrelation`, completed by gamma(-x) = gamma(x).
    """
    right = half_autocorrelation(image)
    return np.concatenate([right[::-1, :0:-1], right], 1)


def half_autocorrelation(image: Image) -> Correlation:
    """Return the right half of the normalized autocorrelation, ``(2H-1, W)``: the left half mirrors it.

    Each lag compares the image with its own shifted copy over their overlap, of any size. Channels are weighted by
    their standard deviations in the overlap, so gamma is the sum of the channels' covariances over the sum of the
    products of their deviations (the deviations as printed are roots of sums, which makes the weighted mean just
    that).

    Parameters
    ----------
    image
        :data:`~nrbench.imaging.door.Image`.

    Returns
    -------
    Correlation
        0 where an overlap is flat (:data:`FLAT`).

    Notes
    -----
    RSGF (2011), section 3.1, equations 3 to 6, and section 3.2, equations 7 and 8. One transform for each channel and
    one back; the sums over overlaps are cumulative sums from the corners.
    """
    channels = np.moveaxis(image - image.mean((0, 1), dtype=np.float64), 2, 0)
    covariance = _products(channels.astype(np.float32))
    scale = np.zeros_like(covariance)
    for channel in channels:
        means, deviations = _moments(channel)
        covariance -= means
        scale += deviations
    structured = scale > FLAT * scale[0, 0, 0]
    gamma = np.clip(np.divide(covariance, scale, out=np.zeros_like(scale), where=structured), -1, 1)
    return np.concatenate([gamma[1, :0:-1], gamma[0]])


def _products(channels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the sums of products over the overlaps, pooled over channels.

    At ``[0, dy, dx]`` for the lag (dx, dy), at ``[1, dy, dx]`` for (dx, -dy), both >= 0: ``(2, H, W)``.
    """
    height, width = channels.shape[1:]
    rows, columns = (scipy.fft.next_fast_len(2 * n - 1, real=True) for n in (height, width))
    spectra = scipy.fft.fft(scipy.fft.rfft(channels, columns, axis=2), rows, axis=1, overwrite_x=True)
    power = (spectra.real**2 + spectra.imag**2).sum(0)
    lags = np.arange(height)
    return np.asarray(scipy.fft.irfft(scipy.fft.ifft(power, axis=0)[[lags, -lags]], columns, axis=2)[..., :width])


def _moments(channel: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return count times the product of the overlaps' means, and the product of the roots of their sums of squares.

    ``(2, H, W)`` each, lags as in :func:`_products`; squares are taken from the overlap's own mean.
    """
    height, width = channel.shape
    count = np.outer(np.arange(height, 0, -1), np.arange(width, 0, -1)).astype(np.float32)
    one, other = _corner_sums(channel)
    one_squared, other_squared = _corner_sums(channel**2)
    variances = np.maximum(one_squared - one**2 / count, 0) * np.maximum(other_squared - other**2 / count, 0)
    return one * other / count, np.sqrt(variances, out=variances)


def _corner_sums(values: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the sums over the h x w pixels in opposite corners at ``[:, H - h, W - w]``, ``(2, H, W)`` each.

    First top left and bottom left, second bottom right and top right: what a lag overlaps.
    """
    integral = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    integral[1:, 1:] = values.cumsum(1)
    for above, row in itertools.pairwise(integral):
        row += above
    top, bottom = integral, integral[-1] - integral[::-1]
    left = np.stack([top[:0:-1, :0:-1], bottom[:0:-1, :0:-1]]).astype(np.float32)
    right = np.stack([(half[:, -1:] - half[:, :-1])[:0:-1] for half in (bottom, top)]).astype(np.float32)
    return left, right
