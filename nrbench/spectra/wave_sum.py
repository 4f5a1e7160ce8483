"""Fourier synthesis: the picture that waves make, on any window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array
from nrbench.spectra.harmonic_fit import Waves


def wave_sum(
    frequencies: Array,
    cosine: Array,
    sine: Array,
    mean: Array,
    shape: tuple[int, int],
    offset: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Return mean + sum of cosine cos(2 pi f r) + sine sin(2 pi f r), ``(H, W, C)``: equation 6 of the FFTM paper.

    Each wave is a product of functions of x and of y: two matrix products a channel, O(n H W) in all.

    Parameters
    ----------
    frequencies
        ``(n, 2)`` cycles/px.
    cosine, sine
        ``(n, C)``.
    mean
        ``(C,)``.
    shape
        (height, width) px.
    offset
        (x, y) px of the window's first pixel, any real numbers.
    """
    x, y = (
        2 * np.pi * np.outer(f, np.arange(n) + o) for f, n, o in zip(frequencies.T, shape[::-1], offset, strict=True)
    )
    rows = np.concatenate([np.cos(y), np.sin(y)]).T
    cos, sin = np.cos(x), np.sin(x)
    planes = [
        rows @ np.concatenate([c * cos + s * sin, s * cos - c * sin]) + level
        for c, s, level in zip(cosine.T[..., np.newaxis], sine.T[..., np.newaxis], mean, strict=True)
    ]
    return np.stack(planes, -1)


def origin_amplitudes(waves: Waves, kept: NDArray[np.bool_] | None = None) -> tuple[Array, Array, Array]:
    """Return fitted waves as seen from pixel (0, 0): cosine ``(n, C)``, sine ``(n, C)``, mean ``(C,)``.

    Parameters
    ----------
    waves
        Whose amplitudes are those about the picture's centre.
    kept
        ``(n, C)``: the channels in which each is wanted; elsewhere its amplitude is 0. None: all.
    """
    spectrum, (p, q) = waves.spectrum, waves.amplitudes
    wanted = np.ones((len(p) - 1, 1)) if kept is None else kept
    p_kept, q_kept = p[1:] * wanted, q[1:] * wanted
    phase = 2 * np.pi * (waves.frequencies @ ((spectrum.size - 1) / 2))[:, np.newaxis]
    cosine = p_kept * np.cos(phase) - q_kept * np.sin(phase)
    sine = p_kept * np.sin(phase) + q_kept * np.cos(phase)
    return cosine, sine, spectrum.mean + p[0]
