"""The fractional spectrum: the Fourier transform of a finite picture at any real frequency."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.special import i0, i1

Planes = NDArray[np.floating[Any]]
"""``(H, W, C)``, any floating dtype, any range."""

Weights = tuple[NDArray[np.float64], NDArray[np.float64]]

TAPS = 10
"""Width of the interpolation kernel in samples of the doubled grid: errors near 1e-9 of the largest coefficient."""
BETA = 0.75 * np.pi * TAPS
"""Shape of the Kaiser-Bessel kernel for a doubled grid."""


@dataclass(frozen=True)
class Spectrum:
    """FT(f) = sum of (a - mean) exp(-2 pi i f r), r from the picture's centre, f in cycles/px (the paper's equation 3).

    One transform on a doubled grid, of the planes divided by the kernel's own transform, is all that is made of the
    picture: any value is then a weighted sum of 10 x 10 samples of it (a non-uniform Fourier transform). Building costs
    O(n log n), a frequency O(1). Precision and memory follow the planes' dtype.

    Parameters
    ----------
    planes
        ``(H, W, C)``.
    """

    planes: Planes

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) px."""
        return self.planes.shape[0], self.planes.shape[1]

    @property
    def channels(self) -> int:
        """How many channels."""
        return int(self.planes.shape[2])

    @property
    def size(self) -> NDArray[np.float64]:
        """(width, height) px: bins a cycle/px along x and y."""
        return np.array(self.shape[::-1], np.float64)

    @cached_property
    def mean(self) -> NDArray[np.float64]:
        """The channels' means, ``(C,)``."""
        return np.asarray(self.planes.mean((0, 1), dtype=np.float64))

    @cached_property
    def energy(self) -> NDArray[np.float64]:
        """The channels' sums of squares about the mean, ``(C,)``."""
        return np.asarray(self.planes.var((0, 1), dtype=np.float64) * self.planes[..., 0].size)

    def bins(self) -> NDArray[np.complexfloating[Any, Any]]:
        """Return the values at whole bins, ``(C, H, W // 2 + 1)``, in the order of ``rfft2``."""
        height, width = self.shape
        values = scipy.fft.rfft2(self._centred_planes(), overwrite_x=True)
        turn = [
            np.exp(1j * np.pi * k * (n - 1) / n) for k, n in zip(bin_numbers(self.shape), (height, width), strict=True)
        ]
        values *= turn[0].astype(values.dtype)[:, np.newaxis]
        values *= turn[1].astype(values.dtype)
        return np.asarray(values)

    def at(self, frequencies: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return FT and its moments, the transforms of (a - mean) times x and times y from the centre.

        Parameters
        ----------
        frequencies
            ``(n, 2)``: (f_x, f_y) cycles/px, any.

        Returns
        -------
        tuple
            ``(n, C)`` and ``(2, n, C)``.
        """
        flip = frequencies[:, 0] < 0
        f = np.where(flip[:, np.newaxis], -frequencies, frequencies)
        near, (wx, dx), (wy, dy) = self._near(f)
        along = np.matmul(near, wx[..., np.newaxis])[..., 0]
        value = (along * wy).sum(2).T
        by_x = (np.matmul(near, dx[..., np.newaxis])[..., 0] * wy).sum(2).T
        by_y = (along * dy).sum(2).T
        return _from_centre(f, self.shape, value, np.stack([by_x, by_y]), flip)

    def values(self, frequencies: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return FT alone, ``(n, C)``."""
        flip = frequencies[:, :1] < 0
        f = np.where(flip, -frequencies, frequencies)
        near, (wx, _), (wy, _) = self._near(f)
        value = (np.matmul(near, wx[..., np.newaxis])[..., 0] * wy).sum(2).T * _turn(f, self.shape)
        return np.asarray(np.where(flip, np.conj(value), value))

    def around(self, frequencies: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return FT on a small grid about each frequency, ``(n, k, k, C)``, y before x.

        Parameters
        ----------
        frequencies
            ``(n, 2)`` cycles/px, with f_x >= 0.
        offsets
            ``(k,)`` bins along either axis, rising, within +-1. The samples that all of them need are read once.
        """
        (cols, wx), (rows, wy) = (
            _fan(frequencies[:, k, np.newaxis] + offsets / self.size[k], self._grid_shape[1 - k], self.shape[1 - k])
            for k in (0, 1)
        )
        near = self._grid[:, rows[:, :, np.newaxis] % self._grid_shape[0], cols[:, np.newaxis, :] + TAPS]
        values = wy @ (near @ wx.transpose(0, 2, 1))
        return np.ascontiguousarray(np.moveaxis(values, 0, 3))

    def _near(self, f: NDArray[np.float64]) -> tuple[NDArray[Any], Weights, Weights]:
        """Return the samples around frequencies, ``(C, n, TAPS, TAPS)``, and the weights along x and y."""
        (cols, *wx), (rows, *wy) = (_taps(f[:, k], self._grid_shape[1 - k]) for k in (0, 1))
        near = self._grid[:, rows[:, :, np.newaxis] % self._grid_shape[0], cols[:, np.newaxis, :] + TAPS]
        return near, (wx[0], wx[1]), (wy[0], wy[1])

    def _centred_planes(self) -> Planes:
        return np.ascontiguousarray(np.moveaxis(self.planes - self.mean.astype(self.planes.dtype), 2, 0))

    @cached_property
    def _grid_shape(self) -> tuple[int, int]:
        return _doubled(self.shape[0]), _doubled(self.shape[1])

    @cached_property
    def _grid(self) -> NDArray[np.complexfloating[Any, Any]]:
        """The doubled transform, ``(C, My, Mx // 2 + 1 + 2 TAPS)``: columns from -TAPS, so that no tap falls off."""
        weights = [1 / _kernel_transform(_whole(n) / m) for n, m in zip(self.shape, self._grid_shape, strict=True)]
        rows, cols = (_whole(n) % m for n, m in zip(self.shape, self._grid_shape, strict=True))
        padded = np.zeros((self.channels, *self._grid_shape), self.planes.dtype)
        weighed = self._centred_planes() * np.multiply.outer(*weights).astype(self.planes.dtype)
        padded[:, rows[:, np.newaxis], cols] = weighed
        return _with_wings(scipy.fft.rfft2(padded, overwrite_x=True), self._grid_shape[1])


def bin_numbers(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the whole bins along y and x in the order of ``rfft2``."""
    return scipy.fft.fftfreq(shape[0], 1 / shape[0]), scipy.fft.rfftfreq(shape[1], 1 / shape[1])


def _whole(length: int) -> NDArray[np.intp]:
    return np.arange(length) - length // 2


def _doubled(length: int) -> int:
    """Return an even size that transforms fast, of at least twice the length and room for the taps."""
    return 2 * int(scipy.fft.next_fast_len(max(length, 2 * TAPS), real=True))


def _with_wings(half: NDArray[Any], width: int) -> NDArray[Any]:
    """Continue a half spectrum ``(C, My, Mx // 2 + 1)`` by TAPS columns on either side, by its symmetry."""
    mirrored = np.arange(0, -half.shape[1], -1) % half.shape[1]
    left = np.conj(half[:, mirrored][:, :, TAPS:0:-1])
    right = np.conj(half[:, mirrored][:, :, width // 2 - 1 : width // 2 - 1 - TAPS : -1])
    return np.concatenate([left, half, right], 2)


def _taps(
    frequency: NDArray[np.float64], grid: int
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Return the samples' numbers, their weights, and those of the moment (times i / 2 pi), each ``(n, TAPS)``."""
    place = frequency * grid
    first = np.ceil(place - TAPS / 2).astype(np.intp)
    samples = first[:, np.newaxis] + np.arange(TAPS)
    t = (place[:, np.newaxis] - samples) * (2 / TAPS)
    root = np.sqrt(np.maximum(1 - t * t, 1e-12))
    slope = -i1(BETA * root) * BETA * t / root * (2 / TAPS)
    return samples, i0(BETA * root), slope * grid


def _fan(frequencies: NDArray[np.float64], grid: int, length: int) -> tuple[NDArray[np.intp], NDArray[np.complex128]]:
    """Return the numbers of the samples that rows of rising frequencies need, and their weights, ``(n, k, taps)``."""
    place = frequencies * grid
    first = np.ceil(place[:, 0] - TAPS / 2).astype(np.intp)
    taps = TAPS + int(np.ceil(float((place[:, -1] - place[:, 0]).max(initial=0)))) + 1
    samples = first[:, np.newaxis] + np.arange(taps)
    t = (place[:, :, np.newaxis] - samples[:, np.newaxis]) * (2 / TAPS)
    weights = np.where(np.abs(t) <= 1, i0(BETA * np.sqrt(np.maximum(1 - t * t, 0))), 0)
    turn = np.exp(-2j * np.pi * frequencies * (length // 2 - (length - 1) / 2))
    return samples, weights * turn[:, :, np.newaxis]


def _kernel_transform(cycles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Kaiser-Bessel kernel's Fourier transform at frequencies of at most 1/4 cycle/sample."""
    root = np.sqrt(BETA**2 - (np.pi * TAPS * cycles) ** 2)
    return np.asarray(TAPS * np.sinh(root) / root)


def _offset(shape: tuple[int, int]) -> NDArray[np.float64]:
    return np.array([n // 2 - (n - 1) / 2 for n in shape[::-1]])


def _turn(f: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.complex128]:
    return np.asarray(np.exp(-2j * np.pi * (f @ _offset(shape)))[:, np.newaxis])


def _from_centre(
    f: NDArray[np.float64],
    shape: tuple[int, int],
    value: NDArray[np.complex128],
    slopes: NDArray[np.complex128],
    flip: NDArray[np.bool_],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Move the coordinates' origin from the whole pixel at the middle to the very centre; undo the flip."""
    turn, offset = _turn(f, shape), _offset(shape)
    moments = turn * (slopes * (1j / (2 * np.pi)) + offset[:, np.newaxis, np.newaxis] * value)
    flipped = flip[:, np.newaxis]
    value = turn * value
    return np.where(flipped, np.conj(value), value), np.where(flipped, np.conj(moments), moments)
