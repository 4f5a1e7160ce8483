"""Dirichlet kernels: the spectrum of a wave on a finite picture, with its derivatives, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEAR = 0.05
"""Below this phase, rad, the closed forms lose digits and their series are exact to 1e-9."""


class Kernel(NamedTuple):
    """K(f) = sum over the picture of cos(2 pi f r), r from its centre, with its derivatives by f.

    Parameters
    ----------
    value
        ``(...)``.
    slope
        ``(2, ...)``: by f_x, f_y.
    curvature
        ``(2, 2, ...)``.
    """

    value: Array
    slope: Array
    curvature: Array


def dirichlet_sum(frequency: Array, length: int) -> Array:
    """Return the first of what :func:`dirichlet` returns."""
    turns = np.rint(frequency)
    x = np.pi * (frequency - turns)
    near = np.abs(x) < 1e-12
    value = np.where(near, float(length), np.sin(length * x) / np.where(near, 1.0, np.sin(x)))
    return (1 - 2 * ((turns * (length - 1)) % 2)) * value


def dirichlet(frequency: Array, length: int) -> tuple[Array, Array, Array]:
    """Return sum cos(2 pi f u) over the ``length`` samples u centred on 0, and its two derivatives by f.

    That is sin(pi n f) / sin(pi f). The samples are half-integers where ``length`` is even: the sum then changes sign
    from one unit of frequency to the next.

    Parameters
    ----------
    frequency
        Cycles/px, any shape.
    length
        n.
    """
    turns = np.rint(frequency)
    x = np.pi * (frequency - turns)
    sine, cosine, square = np.sin(x), np.cos(x), float(length) ** 2 - 1
    near = np.abs(x) * length < NEAR
    safe = np.where(near, 1.0, sine)
    value = np.sin(length * x) / safe
    slope = (length * np.cos(length * x) - value * cosine) / safe
    bend = -square * value - 2 * slope * cosine / safe
    if near.any():
        z, more = x[near], 3 * float(length) ** 2 - 7
        value[near] = length * (1 - square * z**2 / 6 + square * more * z**4 / 360)
        slope[near] = length * square * (-z / 3 + more * z**3 / 90)
        bend[near] = length * square * (-1 / 3 + more * z**2 / 30)
    sign = 1 - 2 * ((turns * (length - 1)) % 2)
    return sign * value, np.pi * sign * slope, np.pi**2 * sign * bend


def plane_kernel(frequencies: Array, shape: tuple[int, int]) -> Kernel:
    """Return the kernel of a picture at each frequency.

    Parameters
    ----------
    frequencies
        ``(..., 2)``: (f_x, f_y) cycles/px.
    shape
        (height, width) px.
    """
    x, x1, x2 = dirichlet(frequencies[..., 0], shape[1])
    y, y1, y2 = dirichlet(frequencies[..., 1], shape[0])
    mixed = x1 * y1
    return Kernel(x * y, np.stack([x1 * y, x * y1]), np.stack([np.stack([x2 * y, mixed]), np.stack([mixed, x * y2])]))
