"""Structure of the pixels instead of the scene: offsets of a sensor's lines, and the grid of an enlarged picture."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.peaks import find_prominent_peaks, subpixel
from nrbench.detectors.autocorrelation.surrogates import require_texture
from nrbench.imaging.convert import Image, crop_middle
from nrbench.imaging.correlation import half_autocorrelation
from nrbench.imaging.masks import Mask
from nrbench.plugins.forms import Detection, NoLatticeFound

LEAST_SHARE = 0.2
"""Least share of the variance of the part of lines' means that does not repeat with the rest of the image."""
SIDE = 384
"""px; side of the middle of the image from which is read where the rest of the image repeats."""
REACH = 0.6
"""Lags up to this share of its sides are read."""
MOST_PEAKS, FEWEST_PEAKS = 60, 6
"""Largest and least number of lags at which the rest repeats."""
LEAST_PROMINENCE = 0.05
"""Least prominence of the third peak. Peaks of at least half its prominence are used."""
REPEATED = 0.3
"""Correlation of lines' means with their mean over these lags, from which a part of them repeats with the rest."""
MOST_ALIKE = 0.35
"""If the steps from line to line correlate more than this at any lag, they are joints or threads of the scene ..."""
ERRORS = 4.0
"""Standard errors of that correlation in noise that are chance; of few lines they are more than :data:`MOST_ALIKE`."""
BAND, BINS = 0.6, 2
"""... unless this share of the power of the means lies within this number of bins of one frequency: banding."""
LARGEST_PIXEL = 32
"""px; largest side of a pixel of an enlarged picture."""
FINE = 4.0
"""Periods of fewer pixels of the picture before are measured at the edges of these pixels."""
SHORTEST = 5.0
"""px; shorter periods are not told from grids of pixels that are not whole."""
MOST_INSIDE, MOST_INSIDE_CODED = 0.25, 0.5
"""Share of the steps between neighboring pixels that may lie inside its pixels; the same after a lossy coding, if the
lattice is that of the pixels. In photographs and texture models it is 0.32 or more."""

GRID = "only the grid of an enlarged picture of {} px a pixel repeats"


def detect_content(detect: Callable[..., Detection], image: Image, known: Mask | None = None) -> Detection:
    """Return the lattice that a detector finds in the content of an image, not in the structure of its pixels.

    Offsets of rows and columns are removed (:func:`remove_lines`). A picture that was enlarged by copies of its pixels
    is enlarged smoothly instead, so that the grid of these copies is no texture.

    Parameters
    ----------
    detect
        The detector; it gets an image of the same size, of any range.
    image
        ``(H, W, C)``.
    known
        The pixels that count, which the detector gets, too; None: all. With a mask the image stays as it is.

    Raises
    ------
    NoLatticeFound
        If the image is constant, if the detector finds none, or if it finds the grid of an enlarged picture.
    """
    require_texture(image)
    if known is not None:
        return detect(image, known)
    steps = [np.abs(np.diff(image, axis=axis)).sum((1 - axis, 2)) for axis in (0, 1)]
    sides = range(2, min(LARGEST_PIXEL, min(image.shape[:2]) // 8) + 1)
    shares = [max(1 - sums.max() / sums.sum() for sums in _sum_by_place(steps, side)) for side in sides]
    pixel = max((side for side, share in zip(sides, shares, strict=True) if share < MOST_INSIDE), default=1)
    if pixel == 1:
        found = detect(remove_lines(image))
    else:
        found = _detect_enlarged(detect, image, pixel, [int(sums.argmax()) + 1 for sums in _sum_by_place(steps, pixel)])
    width = found.lattice.t1[0]
    pixel, is_square = round(width), np.abs(found.lattice.matrix - width * np.eye(2)).max() < 0.05
    is_grid = pixel in sides and is_square and abs(width - pixel) < 0.05
    if is_square and width < SHORTEST and not is_grid:  # a picture that was enlarged by a factor that is not whole
        raise NoLatticeFound(GRID.format(f"{width:.1f}"), found)
    if is_grid and shares[pixel - 2] < MOST_INSIDE_CODED and not _repeats(image, pixel):
        raise NoLatticeFound(GRID.format(pixel), found)
    return found


def _repeats(image: Image, period: int) -> bool:
    """Return whether colors a third of the image apart repeat by a period, px; those of a grid do not."""
    lag = max(image.shape[1] // 3 // period, 1) * period
    first, second = (part - part.mean((0, 1)) for part in (image[:, lag:], image[:, :-lag]))
    return bool(np.vdot(first, second) > REPEATED * np.vdot(first, first))


def _detect_enlarged(detect: Callable[[Image], Detection], image: Image, pixel: int, starts: list[int]) -> Detection:
    """Return the lattice of the content of an enlarged picture, whose pixels of ``pixel`` px begin at ``starts``."""
    try:
        found = detect(remove_lines(_enlarge_smoothly(image, pixel, starts)))
    except NoLatticeFound as none:
        raise NoLatticeFound(f"{GRID.format(pixel)}; of its content, {none.reason}", none.best) from None
    if found.lattice.s < FINE * pixel:
        with contextlib.suppress(NoLatticeFound):
            sharp = detect(remove_lines(image))
            return sharp if sharp.lattice.is_equivalent(found.lattice, 0.1 * found.lattice.s) else found
    return found


def _sum_by_place(steps: list[NDArray[np.float32]], side: int) -> list[NDArray[np.float64]]:
    """Return the steps along each axis, summed over all that have the same place modulo ``side``."""
    return [np.asarray(np.bincount(np.arange(len(sums)) % side, sums, side) + 1e-9) for sums in steps]


def _enlarge_smoothly(image: Image, side: int, starts: list[int]) -> Image:
    """Return the image with splines through the middle of each pixel of ``side`` px; (y, x) ``starts`` begin one."""
    for axis, (start, length) in enumerate(zip(starts, image.shape[:2], strict=True)):
        places = np.arange(start % side - side, length + side, side) + (side - 1) / 2
        pixels = np.take(image, np.clip(places.astype(int), 0, length - 1), axis)
        spline = scipy.interpolate.make_interp_spline(places, pixels, 3, axis=axis)
        image = np.asarray(spline(np.arange(length)), np.float32)
    return image


def remove_lines(image: Image) -> Image:
    """Return an image without the offsets of its rows and columns that are not of the scene.

    Scan lines and banding of light shift the mean of each row. The courses of a wall do so, too, but they repeat with
    the rest of the wall. Therefore the means of rows are compared at the lags at which the image without them repeats.
    The part that repeats there is kept. The other part is removed if its variance is large, and if its steps are those
    of noise, or its power is that of one band. The same is done for columns. Most images are returned as they are.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    """
    planes = np.array(np.moveaxis(image, 2, 0), order="C")
    planes -= planes.mean((1, 2), keepdims=True)
    least = LEAST_SHARE * float(np.vdot(planes, planes)) / planes[0].size
    for axis in (0, 1):
        means = planes.mean(2 - axis).T
        if _power(means) <= least:
            continue
        rest = (planes - np.expand_dims(means.T, 2 - axis)).mean(0)
        lags = _find_lags(rest if axis == 0 else rest.T)
        if len(lags) < FEWEST_PEAKS:
            continue
        offsets = means - _repeat(means, lags)
        chance = ERRORS / np.sqrt((1 - REACH) * len(offsets))
        if _power(offsets) > least and (
            _is_banding(offsets) or _find_likeness(np.diff(offsets, axis=0), REACH) < max(MOST_ALIKE, chance)
        ):
            image = np.asarray(image - np.expand_dims(offsets, 1 - axis), np.float32)
    return image


def _power(means: NDArray[np.floating[Any]]) -> float:
    return float((means**2).sum() / len(means))


def _find_lags(rest: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the lags along y, px, at which a plane ``(H, W)`` repeats; none if it does not."""
    middle = crop_middle(rest[..., np.newaxis], SIDE)
    pairs = middle[:, : middle.shape[1] // 2 * 2].reshape(len(middle), -1, 2).mean(2)
    gamma = half_autocorrelation(pairs[..., np.newaxis])
    height, width = pairs.shape
    peaks = find_prominent_peaks(gamma, (min(int(REACH * width), width - 4), min(int(REACH * height), height - 4)))
    order = np.argsort(-peaks.prominences, kind="stable")[:MOST_PEAKS]
    if len(order) < FEWEST_PEAKS:
        return np.zeros(0)
    least = max(float(peaks.prominences[order[2]]) / 2, LEAST_PROMINENCE)
    lags = np.abs(subpixel(gamma, peaks.lags[order[peaks.prominences[order] >= least]])[:, 1])
    return np.asarray(lags[lags > 2])


def _repeat(means: NDArray[np.floating[Any]], lags: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of lines' means ``(n, C)`` that repeats at lags: their mean there, or 0 if they differ."""
    at = np.arange(len(means))[:, np.newaxis] + np.concatenate([lags, -lags])
    inside = (at >= 0) & (at <= len(means) - 1)
    counts = np.maximum(inside.sum(1), 1)
    planes = [(np.interp(at, np.arange(len(means)), plane) * inside).sum(1) / counts for plane in means.T]
    repeated = np.stack(planes, 1)
    likeness = (means * repeated).sum() / np.sqrt((means**2).sum() * (repeated**2).sum() + 1e-12)
    return repeated if likeness > REPEATED else np.zeros_like(means)


def _is_banding(offsets: NDArray[np.floating[Any]]) -> bool:
    """Return whether the offsets of lines ``(n, C)`` lie in one band of frequencies."""
    power = (np.abs(np.fft.rfft(offsets - offsets.mean(0), axis=0)) ** 2).sum(1)
    peak = int(power.argmax())
    return bool(power[max(peak - BINS, 0) : peak + BINS + 1].sum() > BAND * power.sum())


def _find_likeness(lines: NDArray[np.floating[Any]], reach: float) -> float:
    """Return the highest correlation of values of lines ``(n, C)`` with themselves at lags up to a share of n."""
    lags = np.arange(4, int(reach * len(lines)))
    squares = np.concatenate([[0.0], np.cumsum((lines**2).sum(1))])
    products = np.sum([np.correlate(plane, plane, "full")[len(lines) - 1 :] for plane in lines.T], 0)
    both = squares[len(lines) - lags] + squares[-1] - squares[lags]
    return float((2 * products[lags] / (both + 1e-12)).max(initial=0.0))
