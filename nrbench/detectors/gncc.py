"""The lattice detector of RSGF: the pair of autocorrelation peaks at whose multiples the image repeats best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.peak_kernels import highest_ridge
from nrbench.detectors.autocorrelation.peaks import (
    UNIT,
    dilate,
    find_prominent_peaks,
    fit_multiples,
    fit_pair,
    quantize_correlation,
    subpixel,
)
from nrbench.detectors.autocorrelation.pixel_structure import detect_content
from nrbench.detectors.autocorrelation.repeated_holes import join_holes
from nrbench.detectors.autocorrelation.surrogates import check_test, crop_for_test, reject_chance
from nrbench.detectors.autocorrelation.vector_pair_kernels import best_pair
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import Correlation, half_autocorrelation
from nrbench.imaging.masks import Mask
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import Detection, NoLatticeFound, Surface

JOINED = 0.5
"""Below this relief a ridge joins the peaks, and a grating alone may explain much of their height."""
LINES = 4
"""Lines per pixel when stripes are removed. With fewer, the edges of stripes leave steps, which form a lattice."""
FURTHEST = 512
"""px; largest lag of the folded autocorrelation, unless :data:`PERIODS` allows a larger one."""
PERIODS = 6
"""The largest lag is at least this number of lengths of the longer generating vector."""

_check = checker("gncc")


class Pair(NamedTuple):
    """The best pair of candidates: goodness, vectors as rows (x, y) px, number of multiples; and all candidates."""

    goodness: float
    vectors: Points
    multiples: int
    candidates: Points


@dataclass(frozen=True)
class Gncc:
    """Generalized normalized autocorrelation: the pair of peaks at whose multiples the image repeats best.

    Every pair of candidate vectors is rated by its goodness. The correlations at the pair's multiples a v1 + b v2 on
    the right half-plane are summed, the sum (0 if negative) is raised to ``alpha`` and divided by the number of
    multiples. For equal means the pair with more multiples wins, that is, the smaller tile. A multiple is valid if the
    overlap of the image and its shifted copy, laid on the tile's bounding box, covers ``overlap`` of its area; a narrow
    strip is never valid, however long it is. A pair is discarded if one of its vectors has no valid multiple.

    ``preset=paper`` is the detector of the paper: it pairs all local maxima, at whole pixels. Unless the periods are
    whole numbers, the multiples of such vectors miss the peaks, and supercells that happen to lie near whole pixels
    win. The preset works where vectors are whole pixels to about 0.1 px, as of textures made for a screen (the rows
    ``fraction`` of the suite ``detectors``); blur, which broadens peaks, helps. Of 114 textures with sharp edges and
    fractional vectors it finds 6, and 22 and 29 of them blurred by 1 and 2 px; the defaults find 110
    (``benchmarks/detector_accuracy.py``). The paper does not say how an overlap is compared with the tile; here it
    is laid on the tile's bounding box. Maxima so far out that they cannot be valid multiples of themselves are left
    out, because only their differences from nearer maxima could be part of a pair, and these are maxima themselves.

    The confidence is the mean correlation at the multiples: the share of the image's variance that repeats.

    Parameters
    ----------
    alpha
        Exponent of the sum, at least 1.
    overlap
        Share in (0, 1] of the tile's bounding box that the overlap at a multiple must cover.
    subpixel
        Fit the candidates, and finally the pair, to the peaks at their multiples, with sub-pixel precision.
    tolerance
        The highest correlation within this distance, px (a square), of each multiple counts: textures of varying
        geometry have broken peaks.
    prominence
        A candidate peak stands above the highest pass to a higher peak by at least this share of the highest peak's
        correlation. Bumps of noise along a ridge do not.
    peaks
        Number of candidates, the shortest, that are paired; None: all (the paper). Time grows with its square.
    reject
        ``"none"``: return a lattice if there are two candidates. ``"surrogate"``: report no lattice if the goodness
        does not exceed what the best pairs of phase-randomized copies of the image reach. If a ridge joins the peaks of
        the lattice, the mean along the ridge is removed from the image before the test, so that a grating is no
        lattice.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability that a phase-randomized copy is accepted as a lattice.

    References
    ----------
    .. [1] Diego Lopez Recas, Anna Hilsmann, Peter Eisert. "Near-Regular Texture Synthesis by Random Sampling and Gap
           Filling." Vision, Modeling, and Visualization (VMV 2011), The Eurographics Association, 2011.
    """

    alpha: float = 1.12
    overlap: float = 0.85
    subpixel: bool = True
    tolerance: int = 1
    prominence: float = 0.1
    peaks: int | None = 200
    reject: Literal["none", "surrogate"] = "surrogate"
    surrogates: int = 30
    false_alarms: float = 0.01

    version: ClassVar[str] = "2"
    masks: ClassVar[bool] = True
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "alpha": 1.12,
            "overlap": 0.85,
            "subpixel": False,
            "tolerance": 0,
            "prominence": 0.0,
            "peaks": None,
            "reject": "none",
        }
    }
    paper: ClassVar[str] = """@inproceedings{recas2011rsgf,
  author    = {Lopez Recas, Diego and Hilsmann, Anna and Eisert, Peter},
  title     = {Near-Regular Texture Synthesis by Random Sampling and Gap Filling},
  booktitle = {Vision, Modeling, and Visualization (VMV 2011)},
  editor    = {Eisert, Peter and Polthier, Konrad and Hornegger, Joachim},
  publisher = {The Eurographics Association},
  year      = {2011},
}"""

    def __post_init__(self) -> None:
        _check(self.alpha >= 1, f"alpha is {self.alpha}; give at least 1")
        _check(0 < self.overlap <= 1, f"overlap is {self.overlap}; give a share above 0, at most 1")
        _check(self.tolerance >= 0, f"tolerance is {self.tolerance}; give 0 or more px")
        _check(0 <= self.prominence < 1, f"prominence is {self.prominence}; give a share from 0 to below 1")
        _check(self.peaks is None or self.peaks >= 2, f"peaks is {self.peaks}; give at least 2, or none for all")
        check_test(self, _check)

    def detect(self, image: Image, known: Mask | None = None) -> Detection:
        """Return the lattice of ``image``; its origin is (0, 0), for the method finds no phase.

        Pixels that ``known`` ``(H, W)`` has False do not count, see ``consensus``. The test against chance sees them
        filled.

        Diagnostics: ``correlation`` (right half, with the candidates and the pair), ``goodness``, ``multiples`` (their
        number); with ``"surrogate"`` also ``relief``, ``tested_goodness`` (of the pair, without stripes),
        ``surrogate_goodness`` and ``limit``.

        Raises
        ------
        NoLatticeFound
            If the image is constant, if too few peaks are prominent, or, unless ``reject`` is ``"none"``, if the best
            pair is no better than chance or is a grating.
        """
        return detect_content(self._detect, *join_holes(self, image, known))

    def _detect(self, image: Image, known: Mask | None = None) -> Detection:
        """Return the lattice of an image that is not constant, of any range."""
        gamma = half_autocorrelation(image, known)
        best = self._search(gamma)
        if best is None:
            raise NoLatticeFound("no two peaks of the autocorrelation could generate a lattice that the image holds")
        detection = self._detection(gamma, best)
        return detection if self.reject == "none" else self._compare_with_surrogates(image, detection, best)

    def propose(self, gamma: Correlation) -> list[Points]:
        """Return the basis of the best pair, not yet fitted, ``(2, 2)``, without any test; nothing if there is none.

        Parameters
        ----------
        gamma
            The right half of an autocorrelation, ``(2H-1, W)``.
        """
        best = self._search(gamma)
        return [best.vectors] if best else []

    def _reach(self, gamma: Correlation) -> tuple[int, int]:
        """Return the largest lags at which a vector can itself be a valid multiple, whatever its tile."""
        width, height = gamma.shape[1], gamma.shape[0] // 2 + 1
        return min(int(width / (1 + self.overlap)), width - 4), min(int(height / (1 + self.overlap)), height - 4)

    def _candidates(self, gamma: Correlation) -> Points:
        """Return the vectors to be paired, ``(n, 2)``, in ascending length."""
        reach = self._reach(gamma)
        peaks = find_prominent_peaks(gamma, reach)
        prominent = peaks.prominences >= self.prominence * peaks.values.max(initial=0)
        lags = peaks.lags[prominent]
        lags = lags[np.argsort((lags**2).sum(1), kind="stable")[: self.peaks]]
        if not self.subpixel:
            return np.asarray(lags, np.float64)
        vectors = fit_multiples(gamma, subpixel(gamma, lags), reach)
        return np.asarray(vectors[np.argsort((vectors**2).sum(1), kind="stable")])

    def _search(self, gamma: Correlation) -> Pair | None:
        """Return the pair of candidates of the highest goodness; None if no pair has a positive goodness."""
        candidates = self._candidates(gamma)
        best = self._rate(gamma, candidates)
        return Pair(float(best[0]), best[1:5].reshape(2, 2), int(best[5]), candidates) if best[0] > 0 else None

    def _rate(self, gamma: Correlation, candidates: Points) -> NDArray[np.float64]:
        """Return goodness, vectors and number of multiples of the best pair, ``(6,)``."""
        surface = quantize_correlation(dilate(gamma, self.tolerance))
        return best_pair(surface, candidates, UNIT, self.alpha, self.overlap)

    def _detection(self, gamma: Correlation, best: Pair) -> Detection:
        """Return the lattice of the best pair, fitted, with its diagnostics."""
        first, second = fit_pair(gamma, best.vectors, self._reach(gamma)) if self.subpixel else best.vectors
        lattice = Lattice.from_basis((first, second)).oriented()
        mean = (best.goodness * best.multiples) ** (1 / self.alpha) / best.multiples
        surface = Surface(gamma, (0, gamma.shape[0] // 2), best.candidates, np.stack([first, second]))
        diagnostics = {"correlation": surface, "goodness": best.goodness, "multiples": best.multiples}
        return Detection(lattice, min(mean, 1.0), diagnostics)

    def _compare_with_surrogates(self, image: Image, detection: Detection, best: Pair) -> Detection:
        """Return the detection with the goodness of phase-randomized copies; raise if it is no better."""
        gamma = detection.diagnostics["correlation"].values
        ridge, part = find_ridge(gamma, detection.lattice, self._reach(gamma)), crop_for_test(image, detection.lattice)
        joined, kind = ridge.relief < JOINED, "lattice"
        if joined:
            part, kind = remove_stripes(part, ridge.direction), "lattice but for stripes along one direction"
        unchanged = not joined and part.shape == image.shape
        goodness = best.goodness if unchanged else float(self._rate(half_autocorrelation(part), best.vectors)[0])
        detection = replace(detection, diagnostics={**detection.diagnostics, "relief": ridge.relief})
        return reject_chance(
            self, detection, image, part, self._best_goodness, goodness, "goodness", f"the best {kind}"
        )

    def _best_goodness(self, image: NDArray[np.float32]) -> float:
        """Return the goodness of an image's best pair; 0 if it has none."""
        best = self._search(half_autocorrelation(image))
        return best.goodness if best else 0.0


@dataclass(frozen=True)
class Ridge:
    """The ridge of an autocorrelation that joins the peaks of a lattice.

    Parameters
    ----------
    relief
        The share of the peaks' height by which they stand above the ridge: near 0 for a grating, whose peaks are one
        ridge; about 1 if nothing joins them; more if the ridge runs through negative correlations.
    direction
        The lattice vector (x, y) px along which it runs.
    """

    relief: float
    direction: Vector


def find_ridge(gamma: Correlation, lattice: Lattice, reach: tuple[int, int]) -> Ridge:
    """Return the highest ridge of the autocorrelation folded by a lattice, without the surroundings of lag 0.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    lattice
        Its generating vectors; the origin does not matter.
    reach
        Largest lag along x and y, px; bounded by :data:`FURTHEST` or :data:`PERIODS`.
    """
    longest = float(np.abs(lattice.reduced().matrix).max())
    x_end, y_end = (min(end, max(FURTHEST, round(PERIODS * longest))) for end in reach)
    middle = gamma.shape[0] // 2
    right = gamma[middle - y_end : middle + y_end + 1, : x_end + 1]
    around = np.concatenate([right[::-1, :0:-1], right], 1)
    centered = Lattice(lattice.t1, lattice.t2, (x_end, y_end)).reduced()
    y, x = np.indices(around.shape)
    lags = np.stack([x - x_end, y - y_end], -1).astype(np.float64)
    others = np.asarray((np.abs(centered.wrap(lags) - lags) >= 0.5).any(-1))
    tile = fold(around[..., np.newaxis], centered, others).values[..., 0]
    level, *steps = highest_ridge(tile, np.argsort(-tile.ravel(), kind="stable"))
    direction = steps @ centered.matrix
    top = float(tile[0, 0])
    return Ridge(1 - float(level) / top if top > 0 else 0.0, (float(direction[0]), float(direction[1])))


def remove_stripes(image: Image, direction: Vector) -> NDArray[np.float32]:
    """Subtract from an image its mean along each line of a direction, ``(H, W, C)``, any range.

    Parameters
    ----------
    image
        :data:`~nrbench.imaging.convert.Image`.
    direction
        (x, y), any length above 0. Each pixel is shared between the two lines that it lies between.
    """
    y, x = np.indices(image.shape[:2])
    across = (y * direction[0] - x * direction[1]).ravel() / np.hypot(*direction) * LINES
    across -= across.min()
    line, share = np.floor(across).astype(np.intp), across % 1.0
    lines, shares = np.concatenate([line, line + 1]), np.concatenate([1 - share, share])
    counts = np.maximum(np.bincount(lines, shares), 1e-9)
    pixels = image.reshape(-1, image.shape[2])
    means = np.stack([np.bincount(lines, shares * np.tile(channel, 2)) / counts for channel in pixels.T], -1)
    stripes = (1 - share[:, np.newaxis]) * means[line] + share[:, np.newaxis] * means[line + 1]
    return np.asarray(image - stripes.reshape(image.shape), np.float32)
