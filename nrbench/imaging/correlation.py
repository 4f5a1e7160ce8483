"""Compute the generalized normalized autocorrelation of an image: all lags, partial overlaps, and channels."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.masks import Mask

Correlation = NDArray[np.float32]
"""Normalized autocorrelation gamma in [-1, 1]. In full: ``(2H-1, 2W-1)``, lag (dx, dy) at ``[H-1+dy, W-1+dx]``. Right
half: ``(2H-1, W)``, lag (dx, dy) with dx >= 0 at ``[H-1+dy, dx]``."""

FLAT = 1e-5
"""gamma is 0 at overlaps with less than this share of the image's sum of squares, where rounding errors dominate."""


LEAST_OVERLAP = 0.02
"""gamma is 0 where fewer pairs of pixels that count overlap, as a share of all pixels that count."""


def half_autocorrelation(image: Image, known: Mask | None = None) -> Correlation:
    """Return the right half of the normalized autocorrelation, ``(2H-1, W)``; gamma(-x) = gamma(x).

    At each lag the image is compared with its shifted copy over their overlap, of any size. Channels are weighted by
    their standard deviations in the overlap, so gamma is the sum of the channels' covariances over the sum of the
    products of their deviations.

    Parameters
    ----------
    image
        :data:`~nrbench.imaging.convert.Image`.
    known
        The pixels that count: an overlap is that of pixels of which both count. None: all count.

    Returns
    -------
    Correlation
        0 if the overlap is flat (:data:`FLAT`), or too small a part of the pixels that count (:data:`LEAST_OVERLAP`).

    Notes
    -----
    RSGF (2011), section 3.1, equations 3 to 6, and section 3.2, equations 7 and 8. One transform for each channel and
    one inverse transform; the sums over overlaps are cumulative sums from the corners. The masked correlation of
    scikit-image takes one channel and any mask, and 7 to 12 times as long (``benchmarks/speed.py correlation``). With a
    mask the sums are correlations with it, as there: D. Padfield, "Masked object registration in the Fourier domain",
    IEEE Transactions on Image Processing 21(5), 2012.
    """
    if known is not None:
        return _masked_autocorrelation(image, known)
    height, width = image.shape[:2]
    channels = np.ascontiguousarray(np.moveaxis(image, 2, 0))
    channels = channels - channels.mean((1, 2), np.float64, keepdims=True).astype(np.float32)
    covariance = _products(channels)
    scale = np.zeros_like(covariance)
    counts = np.outer(np.arange(height, 0, -1), np.arange(width, 0, -1)).astype(np.float32)
    for channel in channels:
        means, deviations = _moments(channel, counts)
        covariance -= means
        scale += deviations
    structured = scale > FLAT * scale[0, 0, 0]
    gamma = np.divide(covariance, scale, out=np.zeros_like(scale), where=structured)
    np.clip(gamma, -1, 1, out=gamma)
    return np.concatenate([gamma[1, :0:-1], gamma[0]])


def find_vertex(before: ArrayLike, middle: ArrayLike, after: ArrayLike) -> NDArray[np.float64]:
    """Return the position of the vertex of the parabola through three equally spaced samples.

    Parameters
    ----------
    before, middle, after
        The samples at -1, 0 and 1; arrays of one shape, or numbers.

    Returns
    -------
    NDArray
        In [-0.5, 0.5] steps from the middle sample; 0 if that is no maximum.

    Examples
    --------
    >>> from nrbench.imaging.correlation import find_vertex
    >>> float(find_vertex(0.0, 3.0, 2.0))
    0.25
    """
    before, middle, after = (np.asarray(sample, np.float64) for sample in (before, middle, after))
    bend = 2 * middle - before - after
    offset = np.clip((after - before) / 2 / np.maximum(bend, 1e-12), -0.5, 0.5)
    return np.where((middle >= before) & (middle >= after) & (bend > 0), offset, 0.0)


def _masked_autocorrelation(image: Image, known: Mask) -> Correlation:
    """Return the normalized autocorrelation of the pixels that count, right half."""
    height, width = known.shape
    sizes = [scipy.fft.next_fast_len(2 * side - 1, real=True) for side in (height, width)]

    def transform(values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(scipy.fft.rfft2(values, sizes))

    def correlate(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
        """Return the sums of the products with a copy that is shifted back by each lag, for dx >= 0."""
        whole = scipy.fft.irfft2(one.conj() * other, sizes)
        return np.concatenate([whole[-height + 1 :, :width], whole[:height, :width]])

    mask = transform(known.astype(np.float64))
    pairs = np.rint(correlate(mask, mask))
    number, covariance, scale = np.maximum(pairs, 1), np.zeros(pairs.shape), np.zeros(pairs.shape)
    for channel in np.moveaxis(image.astype(np.float64), 2, 0):
        values = np.where(known, channel - channel[known].mean(), 0)
        first, squares = transform(values), transform(values**2)
        sums = correlate(first, mask), correlate(mask, first)
        covariance += correlate(first, first) - sums[0] * sums[1] / number
        before = correlate(squares, mask) - sums[0] ** 2 / number
        after = correlate(mask, squares) - sums[1] ** 2 / number
        scale += np.sqrt(np.maximum(before, 0) * np.maximum(after, 0))
    structured = (scale > FLAT * scale[height - 1, 0]) & (pairs >= LEAST_OVERLAP * pairs[height - 1, 0])
    gamma = np.divide(covariance, scale, out=np.zeros(pairs.shape), where=structured)
    return np.clip(gamma, -1, 1).astype(np.float32)


def _products(channels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the sums of products over the overlaps, summed over channels ``(C, H, W)``.

    At ``[0, dy, dx]`` for the lag (dx, dy), at ``[1, dy, dx]`` for (dx, -dy), both >= 0: ``(2, H, W)``. The power
    spectrum is real and even, so half of one inverse transform gives both.
    """
    height, width = channels.shape[1:]
    rows, columns = (scipy.fft.next_fast_len(2 * n - 1, real=True) for n in (height, width))
    power = np.zeros((rows, columns // 2 + 1), np.float32)
    for channel in channels:
        spectrum = scipy.fft.fft(scipy.fft.rfft(channel, columns, axis=1), rows, axis=0, overwrite_x=True)
        parts = np.square(spectrum.view(np.float32))
        power += parts[:, ::2] + parts[:, 1::2]
    below = scipy.fft.ihfft(power, axis=0)[:height]
    cyclic = scipy.fft.irfft(below, columns, axis=1, overwrite_x=True)
    return np.stack([cyclic[:, :width], np.concatenate([cyclic[:, :1], cyclic[:, :-width:-1]], 1)])


def _moments(channel: NDArray[np.float32], counts: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
    """Return count times the product of the overlaps' means, and the product of their deviations, ``(2, H, W)`` each.

    Lags as in :func:`_products`. A deviation is the root of the sum of squares from the overlap's own mean.
    """
    means, deviations = np.empty((2, 2, *counts.shape), np.float32)
    for half, (sums, others), (squares, other_squares) in zip(
        (0, 1), _corner_sums(channel), _corner_sums(np.square(channel)), strict=True
    ):
        np.multiply(sums, others, out=means[half])
        variance = np.multiply(sums, sums, out=deviations[half])
        variance -= counts * squares
        variance *= np.square(others) - counts * other_squares
    means /= counts
    np.sqrt(np.maximum(deviations, 0, out=deviations), out=deviations)
    deviations /= counts
    return means, deviations


def _corner_sums(values: NDArray[np.float32]) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield the sums over the h x w pixels in two opposite corners, which overlap at a lag, at ``[H - h, W - w]``.

    First the top left and the bottom right corners, then the bottom left and the top right ones.
    """
    integral = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    np.cumsum(values, 1, out=integral[1:, 1:])
    for above, row in itertools.pairwise(integral):
        row += above
    top = integral.astype(np.float32)
    bottom = top[-1] - top[::-1]
    for left, right in ((top, bottom), (bottom, top)):
        yield left[:0:-1, :0:-1], (right[:, -1:] - right[:, :-1])[:0:-1]
