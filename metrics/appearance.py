"""Appearance: color, gradients, spectrum, sharpness and seams of the output, compared with fresh draws."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import fft, ndimage

from nrbench.imaging.convert import Image, gray
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, Observation, Score, Texture, Value

from .ncc.periodic import tile_box
from .residual_tiles.tiles import try_fresh
from .seam_detection.seam_lines import Line, draw_line, find_worst_lines
from .verdict.reference import FIRST_DRAW

_DRAWS = 2
_FIRST_DRAW = FIRST_DRAW + (1 << 10)

_BINS = 512
_DIRECTIONS = 12
"""Directions in color space along which distributions of colors are compared."""
_COLOR_PIXELS = 1 << 14
"""About how many pixels, evenly spaced over the image, a distribution of colors uses."""
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

_SPECTRUM_WINDOW = 64
_ROUNDING_VARIANCE = 1 / 12 / 255**2
_SCALES = (0.0, 1.0, 2.0, 4.0, 8.0)
"""Standard deviations in px of the Gaussians whose differences are the octave bands."""
_SUBSAMPLED = 2.0
"""Standard deviation of a Gaussian, over the distance of the samples, from which every second sample is left out."""
_BLURRIEST = 0.01
"""The blurriest window is this quantile of all windows."""
_WIDTH_IN_TILES, _WIDTH_WITHOUT_LATTICE, _LEAST_WIDTH, _WIDEST_SHARE = 1.5, 24.0, 8, 4
"""Width of the windows for sharpness: in tiles, in px without a lattice, at least in px, at most side over this."""

_LEAST_SEAM_SIDE = 16
_INSIDE = 0.95
"""Quantile of the gradients across lines inside a tile, to which its border is compared."""
_ROUNDING_STEP = 0.5 / 255
_LEAST_TILE_SIDE = 4

Levels = NDArray[np.float64]
Histograms = NDArray[np.float64]
"""``(k, _BINS + 1)``: k histograms over [0, 1]."""


def _column(meaning: str, unit: str = "", better: Literal["lower", "one"] = "lower") -> Column:
    return Column(meaning, unit, (0.0, math.inf), better)


@dataclass(frozen=True)
class Appearance:
    """Whether the output looks like the texture, regardless of its lattice.

    Everything is compared with two fresh draws of the output's size, or with the sample of a photograph. Distances
    compare distributions over the whole image, so they do not depend on places. A fresh draw's own distance is not 0;
    the row of the oracle shows it. Sharpness and seams are ratios to fresh draws, about 1 for a fresh draw.

    Seams are searched on every straight line of at least half the image's side, in every direction, because the places
    where a method has cut are unknown. A tile that claims to be seamless when it is repeated is also measured across
    its border: ``extras["tile"]``, or the output itself if ``extras["tileable"]`` is not zero.
    """

    version: ClassVar[str] = "4"
    columns: ClassVar[Mapping[str, Column]] = {
        "color": _column("Sliced Wasserstein distance between the colors of output and fresh draws.", "values"),
        "gradient": _column(
            "Wasserstein distance between gradient magnitudes of output and fresh draws, over the latter's mean."
        ),
        "spectrum": _column("Difference of the power spectra of output and fresh draws, rms over frequencies.", "dB"),
        "sharpness": _column(
            "Amplitude of four octaves of detail over that of fresh draws; below 1 the output is blurred.", better="one"
        ),
        "sharpness_worst": _column(
            "Amplitude of detail in the blurriest window over that in the blurriest window of fresh draws.",
            better="one",
        ),
        "seam": _column(
            "Visibility (size, and contrast to its parallels) of the worst line over that of fresh draws' worst line."
        ),
        "seam_step": _column("Step of brightness across the line with the most visible step.", "values"),
        "tileable": _column(
            "Gradient across the wrapped border over that across lines inside; up to 1 the border is invisible."
        ),
        "tile_bytes": _column("Bytes of the tile over those of the sample."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``seam`` that shows the most visible line."""
        output = observation.output
        references = fresh_images(observation, _DRAWS) or [observation.sample]
        lattice = _repeated_lattice(observation)
        values: dict[str, Value] = dict(_distances(output, references))
        reasons: dict[str, str] = {}
        width = _window_width(lattice, min(min(image.shape[:2]) for image in (output, *references)))
        values["sharpness"], values["sharpness_worst"] = _sharpness(
            _local_energies(output, width), [_local_energies(reference, width) for reference in references]
        )
        values["seam"], values["seam_step"], line = _seam(output, references, lattice)
        if line is None:
            reason = f"undecided: the images are smaller than {_LEAST_SEAM_SIDE} px, too small to compare lines"
            reasons |= dict.fromkeys(("seam", "seam_step"), reason)
        tile = _claimed_tile(output, observation.extras)
        if isinstance(tile, str):
            reasons |= dict.fromkeys(("tileable", "tile_bytes"), tile)
        values["tileable"] = None if isinstance(tile, str) else border_excess(tile)
        values["tile_bytes"] = None if isinstance(tile, str) else tile.size / observation.sample.size
        pictures = {} if line is None else {"seam": draw_line(output, line)}
        records = {"reference": "sample" if references[0] is observation.sample else "fresh draws"}
        return Score({name: values[name] for name in self.columns}, reasons, pictures, records)


def fresh_images(observation: Observation, number: int) -> list[Image]:
    """Return up to ``number`` fresh draws of the output's shape; none of a photograph.

    The first ones are those that ``integrity`` and ``randomness`` use, too.
    """
    shape = (observation.output.shape[0], observation.output.shape[1])
    draws: list[Texture | None] = [*observation.shared(try_fresh)[:number]]
    if observation.again is not None:
        draws += [observation.again(shape, _FIRST_DRAW + k) for k in range(len(draws), number)]
    return [draw.image for draw in draws if draw is not None]


def _repeated_lattice(observation: Observation) -> Lattice | None:
    """Return the true lattice if sample and output hold two cells along each side; in less everything is regular."""
    lattice = observation.truth.lattice if observation.truth else None
    room = np.minimum(observation.sample.shape[1::-1], observation.output.shape[1::-1])
    return lattice if lattice is not None and (2 * tile_box(lattice.canonical()) <= room).all() else None


# Distances between distributions: colors, gradients, spectra.


def _distances(output: Image, references: list[Image]) -> dict[str, float]:
    colors = [color_histograms(image) for image in (output, *references)]
    slopes = [_slopes(image) for image in (output, *references)]
    steep = [histograms(slope[:, np.newaxis]) for slope in slopes]
    mean = max(float(np.mean([slope.mean() for slope in slopes[1:]])), 1e-6)
    side = min(_SPECTRUM_WINDOW, *(min(image.shape[:2]) for image in (output, *references)))
    power = [_spectrum(image, side) for image in (output, *references)]
    return {
        "color": histogram_distance(colors[0], np.mean(colors[1:], 0)) * color_scale(output.shape[2]),
        "gradient": histogram_distance(steep[0], np.mean(steep[1:], 0)) / mean,
        "spectrum": float(np.sqrt(((power[0] - np.mean(power[1:], 0)) ** 2).mean())),
    }


def histograms(values: NDArray[np.float32]) -> Histograms:
    """Return the histogram of each column of values in [0, 1], ``(n, k)``.

    A value between two bins is shared among them, so that distances do not depend on the bins.
    """
    at = np.clip(values, 0, 1) * np.float32(_BINS)
    low = np.minimum(at.astype(np.int32), _BINS - 1)
    share = at - low
    upper = [np.bincount(column, weight, _BINS) for column, weight in zip(low.T, share.T, strict=True)]
    whole = [np.bincount(column, minlength=_BINS) for column in low.T]
    counts = np.zeros((values.shape[1], _BINS + 1))
    counts[:, :-1] = np.array(whole) - upper
    counts[:, 1:] += upper
    return counts / len(values)


def histogram_distance(one: Histograms, other: Histograms) -> float:
    """Return the Wasserstein distance of order 1 between distributions over [0, 1], mean over the histograms."""
    bins = np.arange(_BINS + 1) / _BINS
    return float(np.mean([scipy.stats.wasserstein_distance(bins, bins, a, b) for a, b in zip(one, other, strict=True)]))


def color_histograms(image: Image) -> Histograms:
    """Return histograms of an image's colors along directions spread evenly over the half-sphere.

    They serve the sliced Wasserstein distance (Rabin, Peyré, Delon, Bernot, SSVM 2011). The directions are fixed, not
    random, so that equal pixels have equal scores. Projected colors are scaled into [0, 1]; multiply a distance by
    :func:`color_scale`.
    """
    pixels = image.reshape(-1, image.shape[2])
    pixels = pixels[:: len(pixels) // _COLOR_PIXELS | 1]
    if image.shape[2] == 1:
        return histograms(pixels)
    # A Fibonacci spiral over the half-sphere.
    z = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    angle = _GOLDEN_ANGLE * np.arange(_DIRECTIONS)
    radius = np.sqrt(1 - z**2)
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).astype(np.float32)
    return histograms(pixels @ directions.T / np.float32(color_scale(3)) + np.float32(0.5))


def color_scale(channels: int) -> float:
    """Return the factor that converts a distance of :func:`color_histograms` to values."""
    return 1.0 if channels == 1 else 2 * np.sqrt(3.0)


def _slopes(image: Image) -> NDArray[np.float32]:
    """Return the gradient magnitude at every pixel, rms over channels, as a share of the largest possible one."""
    across, down = np.diff(image[:-1], axis=1), np.diff(image[:, :-1], axis=0)
    squares = np.einsum("ijk,ijk->ij", across, across) + np.einsum("ijk,ijk->ij", down, down)
    return np.asarray(np.sqrt(squares.ravel() / np.float32(2 * image.shape[2])), np.float32)


def _spectrum(image: Image, side: int) -> Levels:
    """Return the power spectrum in dB of the image less its mean, ``(side, side // 2 + 1)``.

    It is averaged over Hann windows of ``side`` px that overlap by half (Welch, 1967), and over 3 x 3 frequencies.
    """
    plane = gray(image)
    taper = np.hanning(side + 2)[1:-1].astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(plane - plane.mean(), (side, side))[:: side // 2, :: side // 2]
    power = (np.abs(fft.rfft2(windows * np.outer(taper, taper))) ** 2).mean((0, 1)) / float((taper**2).sum()) ** 2
    power = ndimage.uniform_filter(power, 3, mode=("wrap", "mirror"))
    return np.asarray(10 * np.log10(power + _ROUNDING_VARIANCE), np.float64)


# Sharpness: energies of octave bands.


def _window_width(lattice: Lattice | None, side: int) -> int:
    wanted = _WIDTH_WITHOUT_LATTICE if lattice is None else _WIDTH_IN_TILES * float(tile_box(lattice.canonical()).max())
    return int(np.clip(round(wanted), min(_LEAST_WIDTH, side // 2), max(side // _WIDEST_SHARE, 1)))


def _local_energies(image: Image, width: int) -> NDArray[np.float32]:
    """Return the mean energy of each of four octave bands in windows of ``width`` px, ``(4, rows, columns)``.

    Windows lie inside the image, a quarter of their width apart. Coarse bands are computed on every second or
    fourth pixel, where next to nothing of them is lost. The variance of rounding to 8 bits is added.
    """
    fine, step, energies = gray(image), 1, []
    for near, far in itertools.pairwise(_SCALES):
        coarse = ndimage.gaussian_filter(fine, math.sqrt(far**2 - near**2) / step, mode="reflect")
        band, own = (fine - coarse) ** 2, max(width // step, 1)
        means = ndimage.uniform_filter1d(ndimage.uniform_filter1d(band, own, 0), own, 1)
        rows, columns = (
            np.minimum(np.arange(width // 2, side - width // 2, max(width // 4, 1)) // step, last)
            for side, last in zip(image.shape[:2], np.array(band.shape) - 1, strict=True)
        )
        energies.append(means[np.ix_(rows, columns)])
        if far >= _SUBSAMPLED * step:
            fine, step = coarse[::2, ::2], 2 * step
        else:
            fine = coarse
    return np.stack(energies) + np.float32(_ROUNDING_VARIANCE)


def _sharpness(output: NDArray[np.float32], references: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Return the amplitude over the references', geometric mean over bands: of the whole, and of the worst window."""
    usual = np.mean([np.log(reference.mean((1, 2))) for reference in references], 0)
    whole = float((np.log(output.mean((1, 2))) - usual).mean())
    middle = usual[:, np.newaxis, np.newaxis]
    worst = [float(np.quantile((np.log(energies) - middle).mean(0), _BLURRIEST)) for energies in (output, *references)]
    return float(np.exp(whole / 2)), float(np.exp((worst[0] - np.mean(worst[1:])) / 2))


# Seams, and the border of a tile that claims to be seamless.


def _seam(
    output: Image, references: list[Image], lattice: Lattice | None
) -> tuple[float | None, float | None, Line | None]:
    """Return the visibility of the worst line over that of the references' worst, the largest step, and the line."""
    if min(min(image.shape[:2]) for image in (output, *references)) < _LEAST_SEAM_SIDE:
        return None, None, None
    own = find_worst_lines(output, lattice)
    others = [find_worst_lines(image, lattice) for image in references]
    usual = [max(float(np.mean([_visibility(lines)[kind] for lines in others])), 1e-6) for kind in (0, 1)]
    ratios = [own_level / level for own_level, level in zip(_visibility(own), usual, strict=True)]
    kind = int(np.argmax(ratios))
    return ratios[kind], own[0].size, own[kind]


def _visibility(lines: tuple[Line, Line]) -> tuple[float, float]:
    """Return the visibility of the worst lines by step and by gradient.

    This is the geometric mean of a line's size (step, or root of the excess of squared gradient) and of its strength.
    Strength alone saturates, since a strong line shows in its neighbors too. Size alone would count what a blur leaves
    along every row of tiles.
    """
    step, edge = lines
    return math.sqrt(step.strength * step.size), math.sqrt(edge.strength * math.sqrt(edge.size))


def _claimed_tile(output: Image, extras: Mapping[str, NDArray[Any]]) -> Image | str:
    """Return the tile that claims to be seamless when it is repeated, or the reason why there is none.

    Parameters
    ----------
    output
        The output.
    extras
        ``tile``: such a tile, ``(H, W)`` or ``(H, W, C)`` in [0, 1]; or ``tileable``: not zero if the output is one.
    """
    if "tile" in extras:
        tile = np.asarray(extras["tile"], np.float32)
        tile = tile[..., np.newaxis] if tile.ndim == 2 else tile
        if tile.ndim != 3 or min(tile.shape[:2]) < _LEAST_TILE_SIDE or tile.shape[2] not in (1, 3):
            return f"not applicable: extras['tile'] of shape {tile.shape} is no image of at least 4 px a side"
        return tile
    if "tileable" in extras and np.asarray(extras["tileable"]).any():
        return output
    return "not applicable: no tile in the extras, and the output does not claim to be tileable"


def border_excess(tile: Image) -> float:
    """Return the gradient across the wrapped borders over that across lines inside, for the worse of both borders.

    For rows, the root mean squared difference between the last row and the first is divided by the 95 % quantile of
    that between neighboring rows inside; columns alike. The border is invisible up to 1.
    """
    return max(_row_excess(tile), _row_excess(tile.transpose(1, 0, 2)))


def _row_excess(tile: Image) -> float:
    jumps = np.sqrt(((tile - np.roll(tile, 1, 0)) ** 2).mean((1, 2), dtype=np.float64))
    return float(jumps[0] + _ROUNDING_STEP) / float(np.quantile(jumps[1:], _INSIDE) + _ROUNDING_STEP)
