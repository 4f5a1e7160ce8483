"""Surrogates: images with the spectrum of a given one, and no structure besides."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import scipy.fft
from numpy.typing import NDArray

EULER_GAMMA = 0.5772156649015329


def phase_randomized(image: NDArray[np.float32], rng: np.random.Generator, count: int) -> Iterator[NDArray[np.float32]]:
    """Yield Gaussian textures with the image's spectrum, mean 0 and any range, ``(H, W, C)``.

    The same random phases are added to all channels, which keeps the correlations between them. They are drawn for the
    spectrum of the image on a torus twice its size, of which one quarter is returned: on its own torus, a lattice that
    is commensurate with the image would survive any change of phases, and its edges would have to meet.

    Parameters
    ----------
    image
        ``(H, W, C)``, any range.
    rng
        Source of the phases.
    count
        How many.
    """
    height, width = image.shape[:2]
    torus = [scipy.fft.next_fast_len(2 * n, real=True) for n in (height, width)]
    spectra = scipy.fft.rfft2(np.moveaxis(image - image.mean((0, 1)), 2, 0), torus)
    for _ in range(count):
        noise = scipy.fft.rfft2(rng.standard_normal(torus, np.float32))
        turns = noise / np.sqrt(np.maximum(noise.real**2 + noise.imag**2, np.float32(1e-12)))
        planes = scipy.fft.irfft2(spectra * turns, torus, overwrite_x=True)[:, :height, :width]
        yield np.ascontiguousarray(np.moveaxis(planes, 0, 2))


def chance(
    image: NDArray[np.float32],
    statistic: Callable[[NDArray[np.float32]], float],
    rng: np.random.Generator,
    count: int,
) -> NDArray[np.float64]:
    """Return a detector's statistic for ``count`` phase-randomized copies of an image, ``(count,)``."""
    return np.array([statistic(copy) for copy in phase_randomized(image, rng, count)])


def upper_limit(values: NDArray[np.float64], exceeded: float) -> float:
    """Return what a further value exceeds with probability ``exceeded``, each value being a maximum over many.

    The Gumbel law with the mean and the standard deviation of ``values``: the best of many candidates follows it more
    nearly than a normal law, and its tail is reached without hundreds of values.
    """
    standard = (-math.log(-math.log(1 - exceeded)) - EULER_GAMMA) * math.sqrt(6) / math.pi
    return float(values.mean() + standard * values.std(ddof=1))
