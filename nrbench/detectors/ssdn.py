"""The lattice detector of representative tile: periods along the two axes, from sums of squared differences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
import scipy
import skimage
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.peaks import quantize_correlation
from nrbench.detectors.autocorrelation.pixel_structure import detect_content
from nrbench.detectors.autocorrelation.surrogates import check_test, crop_for_test, reject_chance
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import FLAT, Correlation, find_vertex, half_autocorrelation
from nrbench.imaging.mean_tile import Values, fold
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Curve, Detection, NoLatticeFound

Sequence = NDArray[np.float64]
"""``float64 (n,)``: one value for each lag 0, 1, ..., n - 1 in px along one axis."""

AXES = (("x", 1), ("y", 0))
UPRIGHT = "only rectangular lattices along the axes are found"
NEAR = 1.5
"""A peak belongs to a multiple if it lies within this distance, px, of the expected position."""
MAX_SHIFT = 0.25
"""The peak must also lie within this share of the period. A period that changes by more has followed other peaks."""
CELLS = 4
"""Rectangles along each axis that are averaged; a large image has more than are needed."""
CORNER = 0.125
"""A pixel is near a corner of a rectangle if it lies within this share of the sides from it."""
SEVERAL = 0.63
"""From this inner repetition on a rectangle holds several cells. The value is halfway between the largest of rectangles
of one cell (0.49) and the smallest of rectangles of two (0.78) on procedural textures with departures (seeds 0 to 5,
160 x 160 px)."""
_BLOCK = 1 << 22
"""Number of values that are transformed at a time."""

_check = checker("ssdn")


@dataclass(frozen=True)
class Ssdn:
    """Normalized sum of squared differences: upright rectangular lattices, from one period along each axis.

    For each lag k along an axis, g(k) is the mean squared difference of the image and its copy shifted by k over their
    overlap. The period is x_n / n, where x_n is the position of the last of n minima (section 3, equations 1 to 3).

    The authors read the minima off the curve. Here the minima of a period are those at its multiples, and the shortest
    period is chosen whose minima are on average nearly as deep (``depth``) as those of the deepest period. Depth is
    measured on 1 - g / e, where e is the value of g for unrelated parts of the same means and variances.

    The paper tiles by rectangles, whatever the lattice: for a running bond it finds a rectangle of two cells, a
    supercell. Here this is refused, as is any other lattice that is not rectangular along the axes. ``preset=paper``
    accepts it, and takes x_n / n. The paper does not say which minima count as minima of the period; the preset takes
    the same depth as the default.

    The confidence is the mean of 1 - g / e at the minima, along the axis where it is smaller.

    Parameters
    ----------
    depth
        Share in (0, 1] of the greatest depth that the minima of a period must reach. A tile of several cells keeps the
        lattice and a tile of a part of a cell breaks it, so a strict share is safer: of 27 procedural samples with
        departures (seeds 1 to 3, 128 x 128 px) 0.8 gives 2 wrong tiles, 0.7 gives 8. Larger shares give needlessly
        large tiles.
    overlap
        Lags are searched at which the image and its copy overlap by at least this share, in (0, 1), of the axis.
    subpixel
        Locate minima as vertices of parabolas and fit the period to all of them; otherwise the period is x_n / n.
    primitive
        Refuse rectangles that hold more than one cell: those inside which the image repeats nearly as well as at their
        corners (:func:`inner_repetition`).
    reject
        ``"none"``: return a lattice if both curves have a minimum. ``"surrogate"``: report no lattice if the minima,
        above all those at the largest lags, are no deeper than those of phase-randomized copies of the image (of the
        middle of a large image). The geometric mean of both axes is tested, so a grating has no lattice.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability that a phase-randomized copy is accepted as a lattice.

    References
    ----------
    .. [1] K. Djado, R. Egli, F. Deschênes, "Extraction of a Representative Tile from a Near-Periodic Texture." GRAPHITE
           2005. Unverified: the text that was implemented names only the Université de Sherbrooke, Québec, Canada.
    """

    depth: float = 0.8
    overlap: float = 0.1
    subpixel: bool = True
    primitive: bool = True
    reject: Literal["none", "surrogate"] = "surrogate"
    surrogates: int = 30
    false_alarms: float = 0.01

    version: ClassVar[str] = "3"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"depth": 0.8, "overlap": 0.1, "subpixel": False, "primitive": False, "reject": "none"}
    }
    paper: ClassVar[str] = """@inproceedings{representativetile,
  author    = {Djado, K. and Egli, R. and Desch{\\^e}nes, F.},
  title     = {Extraction of a Representative Tile from a Near-Periodic Texture},
  booktitle = {GRAPHITE},
  year      = {2005},
  note      = {Unverified: the text that was implemented names the Universit{\\'e} de Sherbrooke only. Check authors,
               venue and year before citing},
}"""

    def __post_init__(self) -> None:
        _check(0 < self.depth <= 1, f"depth is {self.depth}; give a share above 0, at most 1")
        _check(0 < self.overlap < 1, f"overlap is {self.overlap}; give a share between 0 and 1")
        check_test(self, _check)

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``; its origin is (0, 0), for the method finds no phase.

        Diagnostics: ``ssdn_x``, ``ssdn_y`` (g over the lag, with the minima); with ``primitive``, ``inner`` (the
        repetition inside the rectangle over that at its corners); with ``"surrogate"``, ``tested_strength`` (of both
        periods), ``surrogate_strength`` and ``limit``.

        Raises
        ------
        NoLatticeFound
            If the image is constant, if an axis has no period or none better than chance, or if the lattice is not
            rectangular along the axes.
        """
        return detect_content(self._detect, image)

    def _detect(self, image: Image) -> Detection:
        """Return the lattice of an image that is not constant, of any range."""
        curves = [shift_ssdn(image, axis) for _, axis in AXES]
        x, y = (self._period(*curve) for curve in curves)
        if x is None or y is None:
            raise NoLatticeFound(f"along {'y' if x else 'x'} the image has no period: {UPRIGHT}")
        detection = self._detection((x, y), [g for g, _ in curves])
        if self.reject == "surrogate":
            detection = self._compare_with_surrogates(image, detection)
        return self._check_primitive(image, detection) if self.primitive else detection

    def _period(self, g: Sequence, unrelated: Sequence) -> Period | None:
        """Return the period of 1 - g / e along one axis; the curve is 0 where e is 0."""
        known = unrelated > FLAT * unrelated[0]
        likeness = 1 - np.divide(g, unrelated, out=np.ones_like(g), where=known)
        return find_period(likeness[: int(len(g) * (1 - self.overlap)) + 1], self.depth, self.subpixel)

    def _detection(self, periods: tuple[Period, Period], curves: list[Sequence]) -> Detection:
        lattice = Lattice((periods[0].length, 0.0), (0.0, periods[1].length)).oriented()
        diagnostics = {
            f"ssdn_{name}": Curve(np.arange(len(g), dtype=np.float64), g, period.peaks, f"lag along {name}, px")
            for (name, _), g, period in zip(AXES, curves, periods, strict=True)
        }
        return Detection(lattice, min(max(min(period.height for period in periods), 0.0), 1.0), diagnostics)

    def _strength(self, image: NDArray[np.float32]) -> float:
        """Return the geometric mean of the strengths of the periods along x and y; 0 if an axis has no period."""
        periods = [self._period(*shift_ssdn(image, axis)) for _, axis in AXES]
        strengths = [max(period.strength, 0.0) if period else 0.0 for period in periods]
        return float(np.sqrt(strengths[0] * strengths[1]))

    def _compare_with_surrogates(self, image: Image, detection: Detection) -> Detection:
        """Return the detection with the strengths of phase-randomized copies; raise if it is no better."""
        part = crop_for_test(image, detection.lattice)
        subject = f"{UPRIGHT}, and the one of the periods along x and y"
        return reject_chance(self, detection, image, part, self._strength, self._strength(part), "strength", subject)

    def _check_primitive(self, image: Image, detection: Detection) -> Detection:
        """Return the detection with its inner repetition; raise if it is a supercell."""
        width, height = detection.lattice.matrix.max(0)
        x_end, y_end = (int((1 - self.overlap) * n) for n in image.shape[1::-1])
        inner = inner_repetition(half_autocorrelation(image), width, height, (x_end, y_end))
        detection = replace(detection, diagnostics={**detection.diagnostics, "inner": inner})
        if inner >= SEVERAL:
            reason = f"the image repeats inside the rectangle as well as at its corners (ratio {inner:.2f})"
            raise NoLatticeFound(f"{reason}: it holds several cells, and {UPRIGHT}", detection)
        return detection


def ssdn(one: Values, other: Values) -> float:
    """Return the sum of squared differences of two images over their number of pixels, summed over channels.

    Notes
    -----
    Representative tile, section 3, equations 1 and 2.
    """
    difference = np.subtract(one, other, dtype=np.float64)
    return float(np.vdot(difference, difference)) / math.prod(one.shape[:2])


def shift_ssdn(image: Values, axis: int) -> tuple[Sequence, Sequence]:
    """Compare an image with its own copy shifted by each lag along one axis, over their overlap.

    Parameters
    ----------
    image
        ``(H, W, C)``, any range.
    axis
        0: shifts along y; 1: along x.

    Returns
    -------
    g
        ``(n,)`` for the n pixels of the axis: :func:`ssdn` of the two overlapping parts at lag k.
    unrelated
        ``(n,)``: the expected value of g if the two parts had their means and variances, but nothing in common.

    Notes
    -----
    Representative tile, section 3, figure 1. O(H W log n): the products by one transform of each line, the squares by
    cumulative sums.
    """
    lines = np.moveaxis(image, (2, axis), (0, 2))
    lines = lines - lines.mean((1, 2), np.float64, keepdims=True)
    length = lines.shape[2]
    counts = lines.shape[1] * np.arange(length, 0, -1)
    squares = np.einsum("crx,crx->x", lines, lines)
    both = (_leading_sums(squares) + _leading_sums(squares[::-1])) / counts
    sums = lines.sum(1)
    means = sum(_leading_sums(channel) * _leading_sums(channel[::-1]) for channel in sums)
    means = means / np.square(counts, dtype=np.float64)
    return np.maximum(both - 2 * _shifted_products(lines.reshape(-1, length)) / counts, 0), both - 2 * means


def _leading_sums(values: Sequence) -> Sequence:
    """Return the sums of the first n - k values, for k = 0, ..., n - 1."""
    return np.asarray(np.cumsum(values)[::-1])


def _shifted_products(lines: NDArray[np.float64]) -> Sequence:
    """Return the sum of products of lines ``(m, n)`` with themselves shifted by each lag, ``(n,)``."""
    length = lines.shape[1]
    padded = scipy.fft.next_fast_len(2 * length - 1, real=True)
    rows = max(_BLOCK // padded, 1)
    power = np.zeros(padded // 2 + 1)
    for start in range(0, len(lines), rows):
        spectra = scipy.fft.rfft(lines[start : start + rows], padded, axis=1)
        power += (spectra.real**2 + spectra.imag**2).sum(0)
    return np.asarray(scipy.fft.irfft(power, padded)[:length])


@dataclass(frozen=True)
class Period:
    """The period of a curve over lags.

    Parameters
    ----------
    length
        px.
    peaks
        Lags, px, of the peak at each multiple 1, 2, ..., n.
    heights
        Values of the curve at the multiples.
    level
        Median of the curve.
    """

    length: float
    peaks: tuple[float, ...]
    heights: tuple[float, ...]
    level: float

    @property
    def height(self) -> float:
        """Mean of the curve at the multiples."""
        return float(np.add.reduce(self.heights)) / len(self.heights)

    @property
    def contrast(self) -> float:
        """The height above the curve's median."""
        return self.height - self.level

    @property
    def strength(self) -> float:
        """The contrast with each multiple weighted by its number squared, times the root of their number.

        A repetition that occurs by chance fades with the lag.
        """
        weights = np.square(np.arange(len(self.heights)) + 1.0)
        far = float(np.average(self.heights, weights=weights)) - self.level
        return far * float(np.sqrt(len(self.heights)))


def find_period(curve: Sequence, share: float, subpixel: bool) -> Period | None:
    """Return the shortest period whose contrast is at least ``share`` of the highest; None if no peak stands out.

    Each peak of the curve is a candidate. Its multiples are followed outward, one at a time, because each determines
    the period more precisely than the one before. The whole lag of the highest value near each multiple counts.

    Parameters
    ----------
    curve
        ``(n,)``: the similarity at lags 0, 1, ..., n - 1.
    share
        In (0, 1].
    subpixel
        Locate peaks as vertices of parabolas and fit the period to all of them; otherwise the period is the lag of the
        last peak over its number.
    """
    if len(curve) < 3:
        return None
    level, inner = float(np.median(curve)), curve[1:-1]
    vertices = np.arange(1, len(curve) - 1) + (find_vertex(curve[:-2], inner, curve[2:]) if subpixel else 0.0)
    candidates = np.flatnonzero((inner > curve[:-2]) & (inner >= curve[2:]) & (inner > level)) + 1
    values, tops = curve.tolist(), [0.0, *vertices.tolist()]
    periods = [_follow_multiples(values, tops, level, lag, subpixel) for lag in candidates.tolist()]
    contrasts = [period.contrast for period in periods]
    least = share * max(contrasts, default=0.0)
    return next((period for period, each in zip(periods, contrasts, strict=True) if each >= least > 0), None)


def _follow_multiples(values: list[float], tops: list[float], level: float, lag: int, subpixel: bool) -> Period:
    """Return the period whose first peak is at ``lag``, followed to the end of the curve.

    The curve has ``values``; the peak at each of its lags has its top at ``tops``. Lists are read faster than arrays.
    """
    period, peaks, heights = float(lag), list[float](), list[float]()
    products, squares, near = 0.0, 0.0, min(NEAR, MAX_SHIFT * lag)
    while abs(period - lag) <= MAX_SHIFT * lag and (k := len(peaks) + 1) * period <= len(values) - 2:
        low = max(round(k * period - near), 1)
        around = values[low : min(round(k * period + near) + 1, len(values) - 1)]
        heights.append(max(around))
        peaks.append(tops[low + around.index(heights[-1])])
        products, squares = products + k * peaks[-1], squares + k * k
        period = products / squares if subpixel else peaks[-1] / k
    return Period(period, tuple(peaks), tuple(heights), level)


def inner_repetition(gamma: Correlation, width: float, height: float, reach: tuple[int, int]) -> float:
    """Return how well an image repeats inside a rectangle, relative to its repetition at the corners.

    The autocorrelation is averaged over rectangles, except the one around lag 0. Peaks are measured from the highest
    pass between them and the corners: a bump on a ridge (along the rows of a wall) is no repetition.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    width, height
        Sides of the rectangle, px.
    reach
        Largest lag along x and y, px.

    Returns
    -------
    float
        The height of the most prominent peak inside above its pass, over the height of the corners above it: about 1 if
        the rectangle holds several cells (that of a running bond holds two), 0 if there is no peak inside, infinite if
        there is no peak at the corners.
    """
    middle = gamma.shape[0] // 2
    x_end, y_end = (min(end, round((CELLS + 0.5) * side)) for end, side in zip(reach, (width, height), strict=True))
    right = gamma[middle - y_end : middle + y_end + 1, : x_end + 1]
    y, x = np.indices(right.shape)
    others = (x >= width / 2) | (np.abs(y - y_end) >= height / 2)
    tile = fold(right[..., np.newaxis], Lattice((width, 0), (0, height), (0, y_end)), others).values[..., 0]
    heights = quantize_correlation(tile.astype(np.float32))
    rows, columns = (np.abs(np.fft.fftfreq(n)) > CORNER for n in tile.shape)
    return inner_relief(heights, rows[:, np.newaxis] | columns)


def inner_relief(tile: NDArray[np.int32], inside: NDArray[np.bool_]) -> float:
    """Return the relief of the most prominent inner peak of a periodic tile, relative to that of the corner peak.

    The relief of an inner peak is its height above the highest pass to the corner peak. It is divided by the height of
    the corner peak above the same pass. The passes are a morphological reconstruction of the corner peak.

    Parameters
    ----------
    tile
        One rectangle of a surface, ``(H, W)``, with periodic borders.
    inside
        ``(H, W)``: the pixels that are not near a corner. The corner peak is the highest of the other pixels.

    Returns
    -------
    float
        The largest ratio over all inner peaks; 0 if there is no inner peak, infinite if the corners have no peak.
    """
    corner = np.unravel_index(np.where(inside, tile.min() - 1, tile).argmax(), tile.shape)
    before, passes = tile, np.full_like(tile, tile.min())
    passes[corner] = tile[corner]
    while (passes != before).any():
        before, (seed, mask) = passes, (np.pad(each, 1, mode="wrap") for each in (passes, tile))
        passes = skimage.morphology.reconstruction(seed, mask)[1:-1, 1:-1]  # type: ignore[no-untyped-call]
    peaks = inside & (tile > passes)
    with np.errstate(divide="ignore"):
        ratios = (tile - passes)[peaks] / (tile[corner] - passes)[peaks]
    return float(ratios.max(initial=0.0))
