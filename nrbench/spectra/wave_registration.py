"""Fundamentals register_fundamentals: the lattice of frequencies strained until its waves fit the picture, gain set aside."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from nrbench.spectra.dirichlet import Array
from nrbench.spectra.harmonic_fit import Waves
from nrbench.spectra.wave_sum import origin_amplitudes, wave_sum

WINDOW = 0.2
"""Standard deviation, in units of the shortest period, of the window in which gain and level are free."""
FAINT = 0.05
"""Share of the waves' mean variance added to that in a window: where they are flat, no gain is read from them."""
CALM = 0.1
"""Share of the median misfit added to that around a pixel, by whose inverse it counts."""


def register_fundamentals(waves: Waves, frequencies: Array, fundamentals: Array) -> Array:
    """Return the fundamentals of the strained lattice of frequencies, ``(2, 2)``.

    Elements of another color than the rest pull at waves fitted to the picture as it is, and shift them; their edges
    have not moved. So the picture is compared with its waves as a registration compares: in a window of a part of a
    tile, gain and level of each channel are free, and what a small affine displacement of the waves would mend is
    solved for, one Gauss-Newton step. Pixels count by the inverse of the misfit around them.

    Parameters
    ----------
    waves
        Fitted.
    frequencies
        ``(n, 2)`` cycles/px: theirs, not folded.
    fundamentals
        ``(2, 2)`` cycles/px; they should be right within a tenth of a period at the picture's border.
    """
    sigma = WINDOW / float(np.linalg.svd(fundamentals)[1][0])
    planes = waves.spectrum.planes.astype(np.float64)
    model, slopes = _model(waves, frequencies)
    moves = _moves(slopes)
    level, mean, shift = _smooth(model, sigma), _smooth(planes, sigma), _smooth(moves, sigma)
    variance = np.maximum(_smooth(model**2, sigma) - level**2, 0)
    variance += FAINT * variance.mean((0, 1)) + 1e-12
    gain = (_smooth(planes * model, sigma) - mean * level) / variance
    misfit = planes - mean - gain * (model - level)
    slope = (_smooth(moves * model[..., np.newaxis], sigma) - shift * level[..., np.newaxis]) / variance[
        ..., np.newaxis
    ]
    moves = gain[..., np.newaxis] * (moves - shift - slope * (model - level)[..., np.newaxis])
    strain = _solved(moves, misfit, _weights(misfit, sigma))[:4].reshape(2, 2)
    return np.asarray(fundamentals @ (np.eye(2) + strain))


def _model(waves: Waves, frequencies: Array) -> tuple[Array, tuple[Array, Array]]:
    """Return the waves' picture, and its slopes along x and y, ``(H, W, C)`` each."""
    cosine, sine, mean = origin_amplitudes(waves)
    shape, turns = waves.spectrum.shape, 2 * np.pi * frequencies[:, np.newaxis]
    model = wave_sum(frequencies, cosine, sine, mean, shape)
    along_x, along_y = (
        wave_sum(frequencies, turns[..., k] * sine, -turns[..., k] * cosine, 0 * mean, shape) for k in (0, 1)
    )
    return model, (along_x, along_y)


def _moves(slopes: tuple[Array, Array]) -> Array:
    """Return how the model changes by each number of the strain and of a displacement, ``(H, W, C, 6)``."""
    height, width = slopes[0].shape[:2]
    y, x = (np.arange(n) - (n - 1) / 2 for n in (height, width))
    columns = [slope * place for slope in slopes for place in (x[:, np.newaxis], y[:, np.newaxis, np.newaxis])]
    return np.stack([*columns, *slopes], -1)


def _smooth(planes: Array, sigma: float) -> Array:
    """Return weighted means around each pixel, over a window."""
    return np.asarray(gaussian_filter(planes, (sigma, sigma, *[0] * (planes.ndim - 2)), mode="reflect", truncate=3))


def _weights(misfit: Array, sigma: float) -> Array:
    by_channel = 1 / np.maximum((misfit**2).mean((0, 1)), 1e-12)
    around = _smooth((misfit**2 * by_channel).sum(2, keepdims=True), sigma)
    return np.asarray(by_channel / (around + CALM * np.median(around) + 1e-12))


def _solved(moves: Array, misfit: Array, weights: Array) -> Array:
    """Return the weighted least-squares solution, ``(6,)``."""
    flat, root = moves.reshape(-1, moves.shape[-1]), np.sqrt(weights).ravel()
    flat = flat * root[:, np.newaxis]
    matrix = flat.T @ flat
    matrix += 1e-9 * np.diag(np.diag(matrix)) + 1e-300 * np.eye(len(matrix))
    return np.asarray(np.linalg.solve(matrix, flat.T @ (misfit.ravel() * root)))
