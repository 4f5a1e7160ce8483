"""The lattice from the waves of a texture: their fundamentals, and the lattice dual to these (detector ``frdft``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import skimage
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.pixel_structure import detect_content
from nrbench.detectors.autocorrelation.surrogates import check_test, reject_chance
from nrbench.errors import checker
from nrbench.imaging.convert import Image, crop_middle
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import Detection, NoLatticeFound, Surface
from nrbench.spectra.harmonic_groups import FINALISTS, Basis, collect_peaks, find_fundamentals, off_line_evidence
from nrbench.spectra.harmonics import find_channel_waves, find_free_waves, lowest_period
from nrbench.spectra.spectrum import Spectrum
from nrbench.spectra.wave_fit import FrequencyFit, fit_frequencies
from nrbench.spectra.wave_search import WaveDetection, find_waves

WINDOW = 1024
"""px a side: of larger images the middle is analyzed, which bounds time and memory."""
TESTED = 256
"""px a side of the middle that the test against chance analyzes, or :data:`PERIODS` periods where these are longer."""
PERIODS = 10.0
SHORTLIST = 6
"""Number of pairs of fundamentals that the test fits."""
STRONGEST = 24
"""Number of waves that the test searches. Weaker waves have small weights."""


class FoundBasis(NamedTuple):
    """The fundamentals found in an image.

    Parameters
    ----------
    detection
        The waves.
    order
        Their numbers, the strongest first: the order of ``basis``.
    basis
        The fundamentals, in bins.
    surplus
        Evidence of the waves beyond those that any two fundamentals explain; see :func:`surplus`.
    """

    detection: WaveDetection
    order: NDArray[np.intp]
    basis: Basis
    surplus: float


@dataclass(frozen=True)
class Frdft:
    """Fractional frequencies: the coarsest lattice of frequencies that explains the waves of the texture.

    The paper finds the waves (section 3.1; here :func:`~nrbench.spectra.wave_search.find_waves`) and computes the size
    of a tile from the lowest of them (equation 7). That is correct if the lowest wave is present and lies on an axis.
    Here all waves are used. A wave at an integer combination of two fundamentals is evidence for them. The evidence is
    stronger if such a frequency is less probable by chance, and is weighted by the wave's energy. A finer lattice of
    frequencies (a larger tile) is chosen only if it explains waves that a coarser one does not. Low waves may be
    missing. The fundamentals are then fitted to the image, all explained waves jointly. The lattice is their dual. Its
    origin is where both fundamental waves have their crest; it is unknown if one of them is not among the waves.

    ``preset=paper`` is the analysis of the paper: the waves of the analytic signal above an amplitude of 2/255, in each
    channel of YCbCr by itself, and an upright tile by equation 7
    (:func:`~nrbench.spectra.harmonics.lowest_period`). The paper tries thresholds of 0.5, 1, 2 and 5 (table 1) and does
    not say which it uses.

    The confidence is the share of the image's variance, all channels together, that the lattice's waves explain.

    Only the middle of images of more than 1024 px a side is analyzed; periods of more than about 600 px are not found.

    Parameters
    ----------
    threshold
        Least amplitude of a wave, units of 1/255; 0: automatic, what noise reaches with probability ``false_alarms``.
    waves
        Number of the strongest waves that are used.
    tolerance
        Standard deviation of a wave from its lattice point, in bins (cycles in the image's side), in addition to the
        wave's own standard error.
    reject
        ``"none"``: return a lattice if the waves have two directions. ``"surrogate"``: report no lattice if its surplus
        evidence (:func:`surplus`) does not exceed that of phase-randomized copies of the image. This evidence does not
        depend on the waves' energies. They decide which lattice is returned; the waves' frequencies decide whether
        there is a lattice. A grating has no surplus evidence, even with one stray wave, nor do two waves without
        harmonics. Image and copies are analyzed by the same shorter search: 24 waves, in one pass, of the image's
        middle (256 px a side or ten periods).
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability at which noise is taken for a wave, and a phase-randomized copy for a lattice.
    tile
        ``"all"``: the lattice on which all waves agree. ``"lowest"``: the upright rectangle of the lowest wave.

    References
    ----------
    .. [1] Alexander Nicoll, Jan Meseth, Gero Müller, Reinhard Klein. "Fractional Fourier Texture Masks: Guiding
           Near-Regular Texture Synthesis." Computer Graphics Forum 24(3), 2005.
    """

    threshold: float = 0.0
    waves: int = 60
    tolerance: float = 0.05
    reject: Literal["none", "surrogate"] = "surrogate"
    surrogates: int = 12
    false_alarms: float = 0.01
    tile: Literal["all", "lowest"] = "all"

    version: ClassVar[str] = "3"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {"threshold": 2.0, "waves": 400, "reject": "none", "tile": "lowest"}
    }
    paper: ClassVar[str] = """@inproceedings{nicoll2005fftm,
  author    = {Nicoll, Alexander and Meseth, Jan and M{\\"u}ller, Gero and Klein, Reinhard},
  title     = {Fractional Fourier Texture Masks: Guiding Near-Regular Texture Synthesis},
  journal   = {Computer Graphics Forum},
  volume    = {24},
  number    = {3},
  year      = {2005},
}"""

    def __post_init__(self) -> None:
        _check(self.threshold >= 0, f"threshold is {self.threshold}; give 0 (automatic) or an amplitude in 1/255")
        _check(self.waves >= 2, f"waves is {self.waves}; give at least 2")
        _check(self.tolerance > 0, f"tolerance is {self.tolerance}; give bins above 0, e.g. 0.05")
        _check(self.tile in ("all", "lowest"), f"tile is {self.tile!r}; give all or lowest")
        check_test(self, _check)

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``.

        With tile ``"lowest"`` the only diagnostic is ``frequencies``, and the origin is unknown. Else diagnostics are
        ``spectrum`` (log magnitude; its peaks are the waves, its vectors the fundamentals, in bins),
        ``frequencies`` ``(n, 2)`` cycles/px of all waves, ``explained`` (which of them the lattice explains),
        ``surplus`` (the evidence); where tested, ``tested_surplus`` (that of the shorter search), ``surrogate_surplus``
        (the same of the copies) and ``limit``.

        Raises
        ------
        NoLatticeFound
            If the image is constant, or has fewer than two waves, or if all waves lie along one direction. Unless
            ``reject`` is ``"none"``, also if the best lattice is no better than chance.
        """
        return detect_content(self._detect, image)

    def _detect(self, image: Image) -> Detection:
        """Return the lattice of an image that is not constant, of any range."""
        middle = crop_middle(image, WINDOW)
        if self.tile == "lowest":
            detection = self._read_lowest(middle)
            return detection if self.reject == "none" else self._test(image, detection)
        candidate = self._search(middle)
        top, left = ((whole - part) // 2 for whole, part in zip(image.shape[:2], middle.shape[:2], strict=True))
        detection = _fit_lattice(candidate, (left, top))
        return detection if self.reject == "none" else self._test(image, detection)

    def propose(self, image: NDArray[np.float32]) -> list[Points]:
        """Return the basis that the strongest waves of an image explain, ``(2, 2)``; nothing if there is none.

        This is the search of the test against chance: few waves, in one pass, no joint fit at the end.

        Parameters
        ----------
        image
            ``(H, W, C)``.
        """
        try:
            candidate = self._search(image, quick=True)
        except NoLatticeFound:
            return []
        if not abs(np.linalg.det(candidate.basis.vectors)):
            return []
        frequencies = candidate.basis.vectors / candidate.detection.waves.spectrum.size
        return [np.asarray(np.linalg.inv(frequencies).T)]

    def _read_lowest(self, image: Image) -> Detection:
        """Return the upright tile of an image by equation 7 of the paper."""
        planes = skimage.color.rgb2ypbpr(image.astype(np.float64)) if image.shape[2] == 3 else image.astype(np.float64)
        find = partial(find_free_waves, threshold=self.threshold or None, most=self.waves, signal="analytic")
        waves = find_channel_waves(find, planes, self.false_alarms)
        shape = image.shape[:2]
        width, height = lowest_period(waves.frequencies, waves.amplitudes, (shape[0], shape[1]))
        if width is None or height is None:
            raise NoLatticeFound(f"no wave of the image varies along {'x' if width is None else 'y'}")
        lattice = Lattice((width, 0.0), (0.0, height)).oriented()
        return Detection(lattice, min(max(waves.share, 0.0), 1.0), {"frequencies": waves.frequencies})

    def _search(self, image: NDArray[np.float32], quick: bool = False) -> FoundBasis:
        """Return the fundamentals of an image; raise :class:`NoLatticeFound` if it has none.

        The quick search is that of the test: of fewer waves, in one pass, with fewer fits.
        """
        waves, finalists = (min(self.waves, STRONGEST), SHORTLIST) if quick else (self.waves, FINALISTS)
        spectrum = Spectrum(image.astype(np.float64))
        detection = find_waves(spectrum, self.threshold or None, self.false_alarms, waves, quick)
        order = np.argsort(-detection.waves.powers.sum(1), kind="stable")
        if len(order) < 2:
            raise NoLatticeFound(f"the image has {len(order)} waves above its noise; a lattice has at least two")
        peaks = collect_peaks(detection, order, self.tolerance)
        basis = find_fundamentals(peaks, finalists)
        if basis is None or np.linalg.matrix_rank(basis.orders[basis.explained]) < 2:
            raise NoLatticeFound("the waves of the image have one direction only: a grating has no lattice")
        return FoundBasis(detection, order, basis, surplus(basis, peaks.weights))

    def _test(self, image: Image, detection: Detection) -> Detection:
        """Return a detection with the evidence of the copies; raise if its own is not higher."""
        longest = float(abs(detection.lattice.matrix).max())
        part = crop_middle(image, max(TESTED, min(round(PERIODS * longest), WINDOW)))
        return reject_chance(self, detection, part, part, self._quick_surplus, self._quick_surplus(part), "surplus")

    def _quick_surplus(self, image: NDArray[np.float32]) -> float:
        """Return the evidence of an image's best lattice by the shorter search; 0 if it has none."""
        try:
            return self._search(image, quick=True).surplus
        except NoLatticeFound:
            return 0.0


def surplus(basis: Basis, weights: NDArray[np.float64]) -> float:
    """Return the unweighted evidence beyond what any two fundamentals and any line of waves explain; at least 0.

    It is the smaller of two sums: over all explained waves but the two of most evidence, and over the explained waves
    that are not on the line of most evidence, without the best of them.

    Parameters
    ----------
    basis
        Fundamentals of n waves. Waves that they do not explain are not counted.
    weights
        ``(n,)``: the weights of the waves' evidence, by which it is divided.
    """
    evidence = (basis.evidence / weights)[basis.explained]
    beyond = evidence.sum() - np.sort(evidence)[-2:].sum()
    return float(max(min(beyond, off_line_evidence(basis, weights)), 0.0))


def _fit_lattice(candidate: FoundBasis, start: Vector) -> Detection:
    """Return the dual of the fundamentals, fitted to the image; ``start`` is the (x, y) of the analyzed part."""
    detection, basis = candidate.detection, candidate.basis
    spectrum = detection.waves.spectrum
    orders = basis.orders[basis.explained]
    fit = fit_frequencies(spectrum, basis.vectors / spectrum.size, orders)
    crest = _origin(fit, orders)
    origin = (0.0, 0.0) if crest is None else np.add(crest, start)
    lattice = Lattice.from_basis(np.linalg.inv(fit.fundamentals).T, origin).oriented()
    share = float(fit.waves.explained.sum() / spectrum.energy.sum())
    diagnostics = {
        "spectrum": _surface(detection, fit.fundamentals * spectrum.size),
        "frequencies": detection.waves.frequencies[candidate.order],
        "explained": basis.explained,
        "surplus": candidate.surplus,
    }
    return Detection(lattice, min(max(share, 0.0), 1.0), diagnostics, has_origin=crest is not None)


def _origin(fit: FrequencyFit, orders: Points) -> Vector | None:
    """Return where both fundamental waves have their crest, in the channel where each is strongest.

    Return None if one of them is not among the waves.
    """
    phases = []
    for unit in ((1.0, 0.0), (0.0, 1.0)):
        at = np.flatnonzero((np.abs(orders) == unit).all(1))
        if not len(at):
            return None
        wave = at[0]
        p, q = (amplitude[1 + wave] for amplitude in fit.waves.amplitudes)
        strongest = int(np.argmax(p**2 + q**2))
        phases.append(np.arctan2(q[strongest], p[strongest]) * orders[wave].sum())
    center = (fit.waves.spectrum.size - 1) / 2
    x, y = center + np.linalg.solve(fit.fundamentals, np.array(phases) / (2 * np.pi))
    return float(x), float(y)


def _surface(detection: WaveDetection, vectors: Points) -> Surface:
    """Return the log magnitude of the spectrum with the waves and the fundamentals, frequency 0 in the middle."""
    spectrum = detection.waves.spectrum
    height, width = spectrum.shape
    magnitude = np.sqrt((np.abs(spectrum.bins) ** 2).sum(0))
    negative = magnitude[-np.arange(height) % height][:, 1 : (width + 1) // 2][:, ::-1]
    full = np.concatenate([negative, magnitude], 1)
    values = np.log1p(np.roll(full, height // 2, 0) / max(float(np.median(magnitude)), 1e-12))
    return Surface(values, (negative.shape[1], height // 2), detection.waves.frequencies * spectrum.size, vectors)


_check = checker("frdft")
