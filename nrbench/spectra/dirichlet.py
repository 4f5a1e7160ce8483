"""Dirichlet kernels: the spectrum of a wave on a finite picture, with its derivatives, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class DirichletKernel(NamedTuple):
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


def dirichlet_kernel(frequency: Array, length: int) -> Array:
    """Return sum cos(2 pi f u) over the ``length`` samples u centred on 0: sin(pi n f) / sin(pi f).

    The samples are half-integers where ``length`` is even: the sum then changes sign from one unit of frequency to the
    next.

    Parameters
    ----------
    frequency
        Cycles/px, any shape.
    length
        n.
    """
    turns = np.rint(frequency)
    x = np.pi * (frequency - turns)
    near = np.abs(x) < 1e-12
    value = np.where(near, float(length), np.sin(length * x) / np.where(near, 1.0, np.sin(x)))
    return (1 - 2 * ((turns * (length - 1)) % 2)) * value


def pair_kernels(frequencies: Array, shape: tuple[int, int]) -> tuple[DirichletKernel, DirichletKernel]:
    """Return the kernels at the differences f_i - f_j and at the sums f_i + f_j, each ``(n, n)``.

    By the addition theorems all of them are inner products of the cosines and sines along x and along y: ten matrix
    products of n^2 H or n^2 W steps, which take less time than as many sines as there are pairs would.

    Parameters
    ----------
    frequencies
        ``(n, 2)``: (f_x, f_y) cycles/px.
    shape
        (height, width) px.
    """
    along = [_line_kernels(f, length) for f, length in zip(frequencies.T, shape[::-1], strict=True)]
    apart, together = (_plane(x, y) for x, y in zip(*along, strict=True))
    return apart, together


def _line_kernels(frequency: Array, length: int) -> tuple[Array, Array]:
    """Return sum cos(2 pi f u) and its two derivatives by f, ``(3, n, n)``, at f_i - f_j and at f_i + f_j."""
    u = 2 * np.pi * (np.arange(length) - (length - 1) / 2)
    cosine, sine = np.cos(np.outer(frequency, u)), np.sin(np.outer(frequency, u))
    values = cosine @ cosine.T, sine @ sine.T
    slope = (sine * u) @ cosine.T
    bends = (cosine * u**2) @ cosine.T, (sine * u**2) @ sine.T
    return (
        np.stack([values[0] + values[1], slope.T - slope, -bends[0] - bends[1]]),
        np.stack([values[0] - values[1], -slope.T - slope, bends[1] - bends[0]]),
    )


def _plane(x: Array, y: Array) -> DirichletKernel:
    """Return the kernel of a picture from those along its lines."""
    mixed = x[1] * y[1]
    return DirichletKernel(
        x[0] * y[0],
        np.stack([x[1] * y[0], x[0] * y[1]]),
        np.stack([np.stack([x[2] * y[0], mixed]), np.stack([mixed, x[0] * y[2]])]),
    )
