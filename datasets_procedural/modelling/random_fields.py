"""Random numbers, grain and waves as functions of a seed and a position, so that overlapping windows of a draw agree.

The hash is the output function of SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators,
OOPSLA 2014), applied once for each part of the index.
"""

from __future__ import annotations

import hashlib
import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import smooth_inside
from nrbench.plugins.forms import Shape

from .pattern import Field

Words = NDArray[np.uint64]
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
WAVES = 12
"""Number of plane waves that make a smooth random field."""
_PALETTES = 64
"""Number of palettes of which the one with the most distinct inks is taken."""
_GRAIN = 0.7
"""Standard deviation in px of the Gaussian that smooths the grain."""


def role_seed(seed: int, role: str) -> int:
    """Return the 64-bit seed of one role (``"brick.color"``, ``"noise"``) of a draw."""
    return int.from_bytes(hashlib.blake2b(f"{seed} {role}".encode(), digest_size=8).digest(), "little")


def hash_bits(seed: int, *index: NDArray[Any]) -> Words:
    """Return 64 random bits for each index: integer arrays, one for each part of it, broadcast together."""
    state = np.array([seed], np.uint64)
    for part in index:
        state = _mix(state + (part.astype(np.int64).view(np.uint64) + np.uint64(1)) * _GOLDEN)
    return state


def _mix(z: Words) -> Words:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def unit(seed: int, *index: NDArray[Any]) -> NDArray[np.float64]:
    """Return a uniform number in [0, 1) for each index."""
    return (hash_bits(seed, *index) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def uniform(seed: int, *index: NDArray[Any]) -> NDArray[np.float64]:
    """Return a uniform number of mean 0 and variance 1, in [-sqrt(3), sqrt(3)], for each index."""
    return (2 * unit(seed, *index) - 1) * math.sqrt(3)


def factors(seed: int, name: str, index: NDArray[np.int64], color: float, intensity: float) -> NDArray[np.float64]:
    """Return the factor of each element and channel, ``(n, 3)``.

    Parameters
    ----------
    seed
        Seed of the draw.
    name
        The kind of element.
    index
        ``(n, k)``, one row for each element.
    color, intensity
        Strengths. The factor is a product of one number for each channel (color) and one for all channels (intensity).
        Each is uniform, with mean 1 and a standard deviation of half the strength.
    """
    parts = [column[:, np.newaxis] for column in index.T]
    own = uniform(role_seed(seed, f"{name}.color"), *parts, np.arange(3))
    common = uniform(role_seed(seed, f"{name}.intensity"), *parts)
    return np.asarray((1 + 0.5 * color * own) * (1 + 0.5 * intensity * common))


def ink_shares(count: int) -> NDArray[np.float64]:
    """Return the probabilities of ``count`` inks, in proportion to ``count``, ``count - 1``, ..., 1."""
    return np.asarray(np.arange(count, 0, -1) * (2 / (count * (count + 1))), np.float64)


@cache
def palette(name: str, count: int, color: float, intensity: float) -> NDArray[np.float64]:
    """Return the factor of each ink of a kind of element, ``(count, 3)``: the same in all draws.

    Of some random palettes, scaled to the mean 1 and, in each channel, to the variance of :func:`factors`, it is the
    one whose two most similar inks differ most.

    Parameters
    ----------
    name
        The kind of element.
    count
        Number of inks, at least 2.
    color, intensity
        Strengths, as in :func:`factors`.
    """
    seed, shares = role_seed(count, f"{name}.palette"), ink_shares(count)
    index = np.indices((_PALETTES, count)).reshape(2, -1).T
    tables = factors(seed, name, index, color, intensity).reshape(_PALETTES, count, 3)
    tables = tables - (shares[:, np.newaxis] * tables).sum(1, keepdims=True)
    spread = np.sqrt((shares[:, np.newaxis] * tables**2).sum(1, keepdims=True))
    tables *= math.sqrt(factor_variance(color, intensity)) / np.maximum(spread, 1e-9)
    first, second = np.triu_indices(count, 1)
    nearest = np.linalg.norm(tables[:, first] - tables[:, second], axis=-1).min(-1)
    # Palettes of two inks differ by rounding errors alone. The first one is taken, whatever the processor.
    return np.asarray(1 + tables[nearest.round(6).argmax()])


def factor_variance(color: float, intensity: float) -> float:
    """Return the variance of :func:`factors` and, by their shares, of the inks of :func:`palette`."""
    return (1 + color**2 / 4) * (1 + intensity**2 / 4) - 1


def grain(seed: int, shape: Shape) -> NDArray[np.float32]:
    """Return stationary noise of mean 0 and variance 1, correlated over about one px.

    White noise, smoothed by a Gaussian of 0.7 px. Each pixel of the white noise is the sum of four uniform numbers, so
    the result is very nearly Gaussian.
    """
    reach = math.ceil(4 * _GRAIN)
    y = np.arange(-reach, shape[0] + reach)[:, np.newaxis]
    x = np.arange(-reach, shape[1] + reach)
    words = hash_bits(seed, y, x).view(np.uint16).reshape(y.size, x.size, 4)
    white = words @ np.ones(4, np.float32) / 65535 - 2
    kernel = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * _GRAIN**2))
    kernel /= np.sqrt((kernel**2).sum())
    smooth = smooth_inside(smooth_inside(white, kernel).T, kernel).T
    return np.ascontiguousarray(smooth) * np.float32(math.sqrt(3))


def waves(seed: int, shape: Shape, period: float, count: int = WAVES) -> Field:
    """Return the sum of ``count`` plane waves of random direction, phase and length: a smooth random field.

    Over seeds each pixel has mean 0 and variance 1. The values are nearly Gaussian for the default count, and at most
    ``sqrt(2 * count)``.

    Parameters
    ----------
    seed
        Seed of the role, see :func:`role_seed`.
    shape
        (height, width) in px.
    period
        Typical wave length in px: waves are between 0.7 and 1.4 times as long, half of them shorter and half longer.
    count
        Number of waves.
    """
    total = np.zeros(shape)
    y, x = np.arange(shape[0])[:, np.newaxis], np.arange(shape[1])
    turn, start, stretch = unit(seed, np.arange(3)[:, np.newaxis], np.arange(count))
    for angle, phase, step in zip(2 * math.pi * turn, 2 * math.pi * start, 2 ** (stretch - 0.5), strict=True):
        number = 2 * math.pi / (period * step)
        along, across = number * math.cos(angle) * x, number * math.sin(angle) * y + phase
        total += np.cos(along) * np.cos(across) - np.sin(along) * np.sin(across)
    return np.asarray(total * math.sqrt(2 / count))
