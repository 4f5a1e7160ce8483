"""Masks of Fractional Fourier Texture Masks: their speed, what they hold, how far they last, and how exact waves are.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/fftm_mask.py [SEED ...]``. Speed is CPU time in multiples of
the machine unit u. Of each texture, a sample of 128 x 128 px is analyzed; the model knows its ideal image and so the
departures from it.

``ideal``: share of the ideal image's variance that the mask's waves explain; ``departures``: of the departures'.
``residual``: correlation of sample less mask with the ideal image. ``at 8x``: correlation of the mask with the ideal
image at 1024 x 1024 px, waves tied and free; the free ones are those above a threshold (:data:`FREE`), as in the paper.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2ypbpr
from unit import median_units

import nrbench
from nrbench.imaging.door import Image, quantize
from nrbench.imaging.harmonic_fit import FixedWaves
from nrbench.imaging.harmonics import Harmonics, analyze
from nrbench.imaging.places import folded
from nrbench.imaging.spectrum import Spectrum
from nrbench.imaging.wave_sum import about_origin, wave_sum
from nrbench.synthesizers.fftm_mask import Analysis

Planes = NDArray[np.float64]
SIDE, FAR = 128, 8
MODELS = ("brick", "weave", "hexagon")
STRENGTHS = ((0.14, 0.07, 0.02), (0.3, 0.2, 0.03), (0.6, 0.4, 0.08))
FREE = 2.0
"""1/255: threshold of the free waves."""


def planes(image: Image) -> Planes:
    """Return Y, Pb, Pr."""
    return np.asarray(rgb2ypbpr(image.astype(np.float64)))


def variance(values: Planes) -> float:
    """Return the sum of squares about the channels' means."""
    return float(np.square(values - values.mean((0, 1))).sum())


def correlation(a: Planes, b: Planes) -> float:
    """Return the correlation, all channels together, each less its mean."""
    a, b = a - a.mean((0, 1)), b - b.mean((0, 1))
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def explained(mask: Harmonics, values: Planes) -> float:
    """Return the share of a picture's variance that the mask's waves explain, fitted to it."""
    waves = FixedWaves(Spectrum(values), folded(mask.frequencies))
    fitted = wave_sum(waves.frequencies, *about_origin(waves, mask.amplitudes > 0), (SIDE, SIDE))
    return 1 - variance(values - fitted) / variance(values)


def row(model: str, strength: tuple[float, float, float], seed: int, free: bool) -> list[float]:
    """Return the figures of one texture."""
    color, intensity, noise = strength
    whole = (FAR * SIDE, FAR * SIDE)
    texture = nrbench.texture(model, whole, seed, color=color, intensity=intensity, noise=noise)
    assert texture.ideal is not None
    sample = quantize(texture.image[:SIDE, :SIDE])
    ideal = planes(texture.ideal[:SIDE, :SIDE])
    mask = Analysis().of(sample)
    units = median_units(lambda: Analysis().of(sample), 3)
    near = mask.harmonics.evaluate((SIDE, SIDE))
    far = [mask, Analysis(FREE, "free").of(sample)] if free else [mask]
    return [
        units,
        len(mask.harmonics.frequencies),
        mask.harmonics.share,
        explained(mask.harmonics, ideal),
        explained(mask.harmonics, planes(sample) - ideal),
        correlation(planes(sample) - near, ideal),
        *(correlation(m.picture(whole), texture.ideal) for m in far),
    ]


def mask_table(seeds: list[int], free: bool) -> None:
    """Print a row for each model and strength: medians over the seeds, and the worst at 8x."""
    print(f"{'':16}     u  waves  share  ideal  departures  residual  at 8x tied (worst)   free")
    for model in MODELS:
        for strength in STRENGTHS:
            figures = np.array([row(model, strength, seed, free) for seed in seeds])
            u, waves, share, ideal, departures, residual, tied, *rest = np.median(figures, 0)
            print(
                f"{model:8} {strength[0]:7} {u:5.0f} {waves:6.0f} {share:6.2f} {ideal:6.3f} {departures:11.3f}", end=""
            )
            print(
                f" {residual:9.3f} {tied:7.3f} ({figures[:, 6].min():.3f})", *(f"{f:14.3f}" for f in rest), flush=True
            )


def waves_drawn(n: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64], Planes]:
    """Return frequencies at least two bins apart, amplitudes, and their picture."""
    f = np.zeros((0, 2))
    while len(f) < n:
        new = rng.uniform((0.01, -0.48), (0.48, 0.48))
        if not len(f) or np.abs(f - new).max(1).min() * SIDE > 2:
            f = np.concatenate([f, new[np.newaxis]])
    amplitude, phase = rng.uniform(0.2, 1, (n, 1)), rng.uniform(0, 2 * np.pi, (n, 1))
    return (
        f,
        amplitude[:, 0],
        wave_sum(f, amplitude * np.cos(phase), amplitude * np.sin(phase), np.zeros(1), (SIDE, SIDE)),
    )


def accuracy_table(seeds: list[int]) -> None:
    """Print how far found frequencies of 1 to 12 pairs are off, in bins and as multiples of the Cramer-Rao bound."""
    print("\nnoise   median error (bins)   worst   median over the Cramer-Rao bound")
    for noise in (0.0, 0.05, 0.1, 0.2):
        errors, bounds = [], []
        for n in range(1, 13):
            for seed in seeds:
                rng = np.random.default_rng([n, seed])
                f, amplitude, picture = waves_drawn(n, rng)
                found = analyze(picture + noise * rng.standard_normal(picture.shape)).frequencies
                both = np.concatenate([found, -found])
                errors.extend(np.abs(f[:, np.newaxis] - both).max(2).min(1) * SIDE)
                bounds.extend(np.sqrt(24) / (2 * np.pi) * noise / (amplitude * SIDE))
        ratio = f"{np.median(np.divide(errors, bounds)):.2f}" if noise else ""
        print(f"{noise:5} {np.median(errors):21.1e} {np.max(errors):7.1e} {ratio:>34}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("seeds", nargs="*", type=int, default=[31, 32, 33])
    parser.add_argument("--no-free", action="store_true", help="leave out the free waves, which take long")
    arguments = parser.parse_args()
    mask_table(arguments.seeds, not arguments.no_free)
    accuracy_table(arguments.seeds)


if __name__ == "__main__":
    main()
