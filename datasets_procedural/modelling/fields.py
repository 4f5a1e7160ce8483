"""Random fields: numbers that are functions of a seed and an index, so that any window of a draw is the same draw.

The hash is the output function of SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators,
OOPSLA 2014), applied once for each part of the index.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from nrbench.plugins.forms import Shape

Words = NDArray[np.uint64]
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_GRAIN = 0.7
"""Standard deviation in px of the Gaussian that correlates the noise: less looks like a bad sensor, more like blur."""


def role_seed(seed: int, role: str) -> int:
    """Return the 64-bit seed of one role (``"brick.color"``, ``"noise"``) of a draw."""
    return int.from_bytes(hashlib.blake2b(f"{seed} {role}".encode(), digest_size=8).digest(), "little")


def hashed(seed: int, *index: NDArray[Any]) -> Words:
    """Return 64 random bits for each index: integer arrays, one for each part of it, broadcast together."""
    state = np.array([seed], np.uint64)
    for part in index:
        state = _mixed(state + (part.astype(np.int64).view(np.uint64) + np.uint64(1)) * _GOLDEN)
    return state


def _mixed(z: Words) -> Words:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def unit(seed: int, *index: NDArray[Any]) -> NDArray[np.float64]:
    """Return uniform numbers in [0, 1) for each index."""
    return (hashed(seed, *index) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def uniform(seed: int, *index: NDArray[Any]) -> NDArray[np.float64]:
    """Return uniform numbers of mean 0 and variance 1, in [-sqrt(3), sqrt(3)], for each index."""
    return (2 * unit(seed, *index) - 1) * math.sqrt(3)


def factors(seed: int, name: str, index: NDArray[np.int64], color: float, intensity: float) -> NDArray[np.float64]:
    """Return the factor of each element and channel, ``(n, 3)``.

    Parameters
    ----------
    seed
        The draw's.
    name
        The kind of element.
    index
        ``(n, k)``, one row an element.
    color, intensity
        Strengths: a factor of mean 1 and standard deviation half of it, uniform, own to each channel (color) or
        common to all (intensity).
    """
    parts = [column[:, np.newaxis] for column in index.T]
    own = uniform(role_seed(seed, f"{name}.color"), *parts, np.arange(3))
    common = uniform(role_seed(seed, f"{name}.intensity"), *parts)
    return np.asarray((1 + 0.5 * color * own) * (1 + 0.5 * intensity * common))


def factor_variance(color: float, intensity: float) -> float:
    """Return the variance of :func:`factors`."""
    return (1 + color**2 / 4) * (1 + intensity**2 / 4) - 1


def grain(seed: int, shape: Shape) -> NDArray[np.float32]:
    """Return stationary noise of mean 0 and variance 1, correlated over about one px, as ``shape``.

    White noise (each pixel the sum of four uniform numbers) under a Gaussian of 0.7 px: very nearly Gaussian.
    """
    reach = math.ceil(4 * _GRAIN)
    y = np.arange(-reach, shape[0] + reach)[:, np.newaxis]
    x = np.arange(-reach, shape[1] + reach)
    words = hashed(seed, y, x).view(np.uint16).reshape(y.size, x.size, 4)
    white = words.sum(-1, dtype=np.int64).astype(np.float32) / 65535 - 2
    kernel = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * _GRAIN**2))
    kernel /= np.sqrt((kernel**2).sum())
    smooth = correlate1d(correlate1d(white, kernel, 0), kernel, 1)
    return np.asarray(smooth[reach:-reach, reach:-reach] * np.float32(math.sqrt(3)))
