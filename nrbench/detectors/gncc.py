"""RSGF's lattice detector: generalized normalized autocorrelation, and the pair of its peaks that explains most."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.goodness_kernels import best_pair
from nrbench.detectors.autocorrelation.peaks import UNIT, dilated, find_peaks, quantized, subpixel
from nrbench.detectors.autocorrelation.refinement import fit_multiples, fit_pair
from nrbench.detectors.autocorrelation.relief import find_ridge, without_stripes
from nrbench.detectors.chance.excerpt import excerpt
from nrbench.detectors.chance.surrogates import chance, upper_limit
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import Correlation, half_autocorrelation
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Detection, NoLatticeFound, Surface
from nrbench.streams import pixels_hash, stream

JOINED = 0.5
"""Below this relief a ridge joins the peaks enough for a grating alone to explain much of their height."""


class Pair(NamedTuple):
    """The best pair of candidates: its goodness, its vectors as rows (x, y) px, how many multiples count; and all."""

    goodness: float
    vectors: Points
    multiples: int
    candidates: Points


@dataclass(frozen=True)
class Gncc:
    """Generalized normalized autocorrelation: the pair of peaks at whose multiples the image repeats best.

    Every pair of candidate vectors is rated by its goodness: the correlations at the pair's multiples a v1 + b v2 on
    the right half-plane are summed, the sum (0 where negative) is raised to ``alpha`` and divided by the number of
    multiples. With equal mean more multiples win, that is the smaller tile. A multiple counts where the image and its
    shifted copy overlap in a rectangle that, laid on the tile's bounding box, covers ``overlap`` of it: by area, so
    that a sliver never counts, however long. A vector without any multiple that counts rules its pair out.

    The paper's own choice, ``gncc:subpixel=false,tolerance=0,prominence=0,reject=none``, takes vectors at whole pixels.
    Unless the periods are whole numbers, their multiples then miss the peaks, and supercells that happen to lie near
    whole pixels win. The defaults mend that.

    The confidence is the mean correlation at the multiples: the share of the image's variance that repeats.

    Parameters
    ----------
    alpha
        Exponent of the sum, at least 1.
    overlap
        Least share in (0, 1] of the tile's bounding box that a multiple's overlap must cover.
    subpixel
        Fit candidates, and at last the pair, to the peaks at their multiples, to fractions of a pixel.
    tolerance
        Around each multiple the highest correlation within this many px (a square) counts: textures whose geometry
        varies have broken peaks.
    prominence
        A candidate peak stands above the highest pass to a higher one by this share of the highest candidate: bumps of
        noise along a ridge do not.
    peaks
        Only so many candidates, the shortest, are paired.
    reject
        ``"none"``: answer wherever two candidates exist. ``"surrogate"``: no lattice where the goodness does not exceed
        what the best pairs of phase-randomized copies of the image reach. Where a ridge joins the lattice's peaks, the
        test is made on the image less its mean along the ridge, so that a grating is none.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability at which a phase-randomized copy would be taken for a lattice.
    """

    alpha: float = 1.12
    overlap: float = 0.85
    subpixel: bool = True
    tolerance: int = 1
    prominence: float = 0.1
    peaks: int = 200
    reject: Literal["none", "surrogate"] = "surrogate"
    surrogates: int = 30
    false_alarms: float = 0.01

    version: ClassVar[str] = "1"
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
        _check(self.peaks >= 2, f"peaks is {self.peaks}; give at least 2")
        _check(self.reject in ("none", "surrogate"), f"reject is {self.reject!r}; give none or surrogate")
        _check(self.surrogates >= 2, f"surrogates is {self.surrogates}; give at least 2")
        _check(0 < self.false_alarms < 1, f"false_alarms is {self.false_alarms}; give a probability, e.g. 0.01")

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``; its origin is (0, 0), the method finds no phase.

        Diagnostics: ``correlation`` (right half, with the candidates and the pair), ``goodness``, ``multiples`` (their
        number); where tested, ``relief``, ``tested_goodness`` (that of the pair, less stripes), ``surrogate_goodness``
        and ``limit``.

        Raises
        ------
        NoLatticeFound
            Where the image is constant, too few peaks stand out, or, unless ``reject`` is ``"none"``, the best pair is
            no better than chance or a grating.
        """
        if np.ptp(image, (0, 1)).max() == 0:
            raise NoLatticeFound("the image is constant: it has no texture")
        gamma = half_autocorrelation(image)
        best = self._search(gamma)
        if best is None:
            raise NoLatticeFound("no two peaks of the autocorrelation could generate a lattice that the image holds")
        found = self._detection(gamma, best)
        return found if self.reject == "none" else self._tested(image, found, best)

    def _reach(self, gamma: Correlation) -> tuple[int, int]:
        """Return the largest lags at which a vector can itself count as a multiple, whatever its tile."""
        width, height = gamma.shape[1], gamma.shape[0] // 2 + 1
        return min(int(width / (1 + self.overlap)), width - 4), min(int(height / (1 + self.overlap)), height - 4)

    def _candidates(self, gamma: Correlation) -> Points:
        """Return the vectors to be paired, ``(n, 2)``, in ascending length."""
        reach = self._reach(gamma)
        peaks = find_peaks(gamma, reach)
        prominent = peaks.prominences >= self.prominence * peaks.values.max(initial=0)
        lags = peaks.lags[prominent]
        lags = lags[np.argsort((lags**2).sum(1), kind="stable")[: self.peaks]]
        if not self.subpixel:
            return np.asarray(lags, np.float64)
        vectors = fit_multiples(gamma, subpixel(gamma, lags), reach)
        return np.asarray(vectors[np.argsort((vectors**2).sum(1), kind="stable")])

    def _search(self, gamma: Correlation) -> Pair | None:
        """Return the pair of candidates of the highest goodness; None where no pair has any."""
        surface, candidates = quantized(dilated(gamma, self.tolerance)), self._candidates(gamma)
        best = best_pair(surface, candidates, UNIT, self.alpha, self.overlap)
        return Pair(float(best[0]), best[1:5].reshape(2, 2), int(best[5]), candidates) if best[0] > 0 else None

    def _detection(self, gamma: Correlation, best: Pair) -> Detection:
        """Return the lattice of the best pair, fitted, with what led to it."""
        first, second = fit_pair(gamma, best.vectors, self._reach(gamma)) if self.subpixel else best.vectors
        lattice = Lattice.from_basis((first, second)).reduced()
        mean = (best.goodness * best.multiples) ** (1 / self.alpha) / best.multiples
        surface = Surface(gamma, (0, gamma.shape[0] // 2), best.candidates, np.stack([first, second]))
        diagnostics = {"correlation": surface, "goodness": best.goodness, "multiples": best.multiples}
        return Detection(lattice, min(mean, 1.0), diagnostics)

    def _tested(self, image: Image, found: Detection, best: Pair) -> Detection:
        """Return what was found, with what it was compared with, unless it is a grating or chance."""
        gamma, rng = found.diagnostics["correlation"].values, stream("detection", pixels_hash(image))
        ridge, part = find_ridge(gamma, found.lattice, self._reach(gamma)), excerpt(image, found.lattice)
        joined, kind = ridge.relief < JOINED, "lattice"
        if joined:
            part, kind = without_stripes(part, ridge.direction), "lattice but for stripes along one direction"
        whole = not joined and part.shape == image.shape
        reached = best.goodness if whole else self._goodness(half_autocorrelation(part), best.vectors)
        copies = chance(part, self._best_goodness, rng, self.surrogates)
        limit = upper_limit(copies, self.false_alarms)
        more = {"relief": ridge.relief, "tested_goodness": reached, "surrogate_goodness": copies, "limit": limit}
        found = replace(found, diagnostics={**found.diagnostics, **more})
        if reached <= limit:
            raise NoLatticeFound(
                f"the best {kind} (goodness {reached:.2f}) is no better than chance ({limit:.2f})", found
            )
        return found

    def _goodness(self, gamma: Correlation, vectors: Points) -> float:
        """Return the goodness of one pair."""
        return float(best_pair(quantized(dilated(gamma, self.tolerance)), vectors, UNIT, self.alpha, self.overlap)[0])

    def _best_goodness(self, image: NDArray[np.float32]) -> float:
        """Return the goodness of an image's best pair; 0 where it has none."""
        best = self._search(half_autocorrelation(image))
        return best.goodness if best else 0.0


_check = checker("gncc")
