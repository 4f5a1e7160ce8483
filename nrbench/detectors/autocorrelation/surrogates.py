"""Make surrogates, random images with the autocorrelation of an image, to measure what a detector finds by chance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, crop_middle
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Detection, NoLatticeFound
from nrbench.streams import pixels_hash, stream

SIDE = 512
"""px; smallest side to which an image is cropped."""
PERIODS = 10.0
"""Number of periods along a side that are tested. More periods take more time and change few decisions."""


def require_texture(image: Image) -> None:
    """Raise :class:`NoLatticeFound` if an image is constant."""
    if (image[0] == image[0, 0]).all() and (image == image[0]).all():
        raise NoLatticeFound("the image is constant: it has no texture")


def crop_for_test(image: Image, lattice: Lattice) -> Image:
    """Return the middle of an image: a side is :data:`PERIODS` of the longer generating vector, or :data:`SIDE` px.

    Phase-randomized copies of a 4096 x 4096 image take minutes; those of its middle take seconds.
    """
    longest = float(abs(lattice.reduced().matrix).max())
    return crop_middle(image, max(SIDE, round(PERIODS * longest)))


def phase_randomized(image: NDArray[np.float32], rng: np.random.Generator, count: int) -> Iterator[NDArray[np.float32]]:
    """Yield Gaussian textures ``(H, W, C)`` with the spectrum of an image, mean 0 and any range.

    The same random phases are added to all channels, which preserves the correlations between channels. The spectrum is
    that of the image on a torus of twice its size, and one quarter of the torus is returned. On a torus of the image's
    own size a lattice that is commensurate with the image would survive any change of phases, and opposite borders
    would match.

    Parameters
    ----------
    image
        ``(H, W, C)``, any range.
    rng
        Source of the phases.
    count
        Number of textures.
    """
    height, width = image.shape[:2]
    torus = [scipy.fft.next_fast_len(2 * n, real=True) for n in (height, width)]
    spectra = scipy.fft.rfft2(np.moveaxis(image - image.mean((0, 1)), 2, 0), torus)
    scale = np.float32(1 / (torus[0] * torus[1]))
    for _ in range(count):
        noise = scipy.fft.rfft2(rng.standard_normal(torus, np.float32))
        turns = noise / np.sqrt(np.maximum(noise.real**2 + noise.imag**2, np.float32(1e-12)))
        # the inverse transform of one quarter alone, scaled at the end as that of the torus would be
        columns = scipy.fft.ifft(spectra * turns, axis=1, norm="forward", overwrite_x=True)[:, :height]
        planes = scipy.fft.irfft(columns, torus[1], norm="forward")[:, :, :width] * scale
        yield np.ascontiguousarray(np.moveaxis(planes, 0, 2))


def check_test(detector: Any, check: Callable[[bool, str], None]) -> None:
    """Check the parameters of a detector's test against chance: ``reject``, ``surrogates`` and ``false_alarms``.

    ``check`` raises if its first argument is false.
    """
    check(detector.reject in ("none", "surrogate"), f"reject is {detector.reject!r}; give none or surrogate")
    check(detector.surrogates >= 2, f"surrogates is {detector.surrogates}; give at least 2")
    check(0 < detector.false_alarms < 1, f"false_alarms is {detector.false_alarms}; give a probability, e.g. 0.01")


def reject_chance(
    detector: Any,
    detection: Detection,
    image: Image,
    part: NDArray[np.float32],
    statistic: Callable[[NDArray[np.float32]], float],
    value: float,
    name: str,
    subject: str = "the best lattice",
) -> Detection:
    """Return a detection with the statistics of phase-randomized copies; raise if its own is no higher.

    Parameters
    ----------
    detector
        Its parameters ``surrogates`` and ``false_alarms`` are the number of copies, and the probability that a further
        copy exceeds the limit.
    detection
        The lattice that is tested.
    image
        The image whose lattice is sought; its pixels seed the random phases.
    part
        The part of it that is copied, ``(H, W, C)``, any range.
    statistic
        Returns the statistic of an image.
    value
        The statistic of the lattice.
    name, subject
        Words for the statistic and for the lattice, in the diagnostics and in the reason.

    Raises
    ------
    NoLatticeFound
        If the value does not exceed what chance explains.
    """
    rng = stream("detection", pixels_hash(image))
    copies = np.array([statistic(copy) for copy in phase_randomized(part, rng, detector.surrogates)])
    limit = upper_limit(copies, detector.false_alarms)
    measured = {f"tested_{name}": value, f"surrogate_{name}": copies, "limit": limit}
    detection = replace(detection, diagnostics={**detection.diagnostics, **measured})
    if value <= limit:
        raise NoLatticeFound(f"{subject} ({name} {value:.2f}) is no better than chance ({limit:.2f})", detection)
    return detection


def upper_limit(values: NDArray[np.float64], false_alarms: float) -> float:
    """Return the limit that a further value exceeds with probability ``false_alarms``.

    The limit is a quantile of the Gumbel distribution with the mean and the standard deviation of ``values``. Each
    value is the best of many candidates, which follows this distribution more closely than a normal distribution. An
    empirical quantile would need hundreds of values.
    """
    standard = (-math.log(-math.log(1 - false_alarms)) - np.euler_gamma) * math.sqrt(6) / math.pi
    return float(values.mean() + standard * values.std(ddof=1))
