"""Waves: smooth random fields, functions of a seed and a pixel, so that any window of a draw is the same draw."""

from __future__ import annotations

import math

import numpy as np

from nrbench.plugins.forms import Shape

from .coordinates import Field
from .fields import unit


def waves(seed: int, shape: Shape, period: float, count: int = 12) -> Field:
    """Return the sum of ``count`` plane waves of random direction, phase and length, as ``shape``.

    Over seeds each pixel has mean 0 and variance 1; it is nearly Gaussian for the default count, and never above
    ``sqrt(2 * count)``.

    Parameters
    ----------
    seed
        The role's.
    shape
        (height, width) in px.
    period
        Wave length in px: waves are between 0.7 and 1.4 times as long, as many above as below.
    count
        How many.
    """
    total = np.zeros(shape)
    y, x = np.arange(shape[0])[:, np.newaxis], np.arange(shape[1])
    turn, start, stretch = unit(seed, np.arange(3)[:, np.newaxis], np.arange(count))
    for angle, phase, step in zip(2 * math.pi * turn, 2 * math.pi * start, 2 ** (stretch - 0.5), strict=True):
        number = 2 * math.pi / (period * step)
        along, across = number * math.cos(angle) * x, number * math.sin(angle) * y + phase
        total += np.cos(along) * np.cos(across) - np.sin(along) * np.sin(across)
    return np.asarray(total * math.sqrt(2 / count))
