"""How much an image shows at each scale: local energies of octave bands, and the power spectrum."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from nrbench.imaging.convert import Image, gray

Levels = NDArray[np.float64]
_SCALES = (0.0, 1.0, 2.0, 4.0, 8.0)
"""Standard deviations of the Gaussians in px: a band is what one leaves of the one before."""
SPECTRUM_WINDOW = 64
_ROUNDING = 1 / 12 / 255**2
_WORST = 0.01


def local_energies(image: Image, width: int) -> NDArray[np.float32]:
    """Return the mean energy of each of four octave bands in windows of ``width`` px, ``(4, rows, columns)``.

    Windows are a quarter of their width apart and lie inside. That of rounding to 8 bits is added.
    """
    plane = gray(image)
    smooth = [plane if s == 0 else ndimage.gaussian_filter(plane, s, mode="reflect") for s in _SCALES]
    bands = [(fine - coarse) ** 2 for fine, coarse in itertools.pairwise(smooth)]
    half = width // 2
    means = [ndimage.uniform_filter(band, width, mode="reflect") for band in bands]
    step = max(width // 4, 1)
    return np.stack([mean[half : len(mean) - half : step, half : mean.shape[1] - half : step] for mean in means]) + (
        np.float32(_ROUNDING)
    )


def sharpness(output: NDArray[np.float32], references: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Return amplitude over that of references, geometric mean over the bands: of the whole, and of the worst window.

    The worst is the 1st percentile, over that of each reference.
    """
    usual = np.mean([np.log(reference.mean((1, 2))) for reference in references], 0)
    whole = float((np.log(output.mean((1, 2))) - usual).mean())
    middle = usual[:, np.newaxis, np.newaxis]
    worst = [float(np.quantile((np.log(seen) - middle).mean(0), _WORST)) for seen in (output, *references)]
    return float(np.exp(whole / 2)), float(np.exp((worst[0] - np.mean(worst[1:])) / 2))


def spectrum(image: Image, side: int) -> Levels:
    """Return the power spectrum in dB, mean over Hann windows half overlapped (Welch, 1967), without the image's mean.

    Parameters
    ----------
    image
        The image, no smaller than a window.
    side
        Of the windows, px.

    Returns
    -------
    Levels
        ``(side, side // 2 + 1)``; each power is the mean of 3 x 3 frequencies.
    """
    plane = gray(image)
    taper = np.hanning(side + 2)[1:-1].astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(plane - plane.mean(), (side, side))[:: side // 2, :: side // 2]
    power = (np.abs(fft.rfft2(windows * np.outer(taper, taper))) ** 2).mean((0, 1)) / float((taper**2).sum()) ** 2
    power = ndimage.uniform_filter(power, 3, mode=("wrap", "mirror"))
    return np.asarray(10 * np.log10(power + _ROUNDING), np.float64)


def spectrum_distance(one: Levels, other: Levels) -> float:
    """Return the root mean squared difference of two spectra in dB."""
    return float(np.sqrt(((one - other) ** 2).mean()))
