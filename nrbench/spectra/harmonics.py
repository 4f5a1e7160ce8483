"""The regular part of a texture as waves of real frequencies: FFTM's analysis, and its evaluation at any size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.regular_part import find_regular_part
from nrbench.spectra.spectrum import Array, Planes, Spectrum
from nrbench.spectra.wave_fit import Waves, wave_sum
from nrbench.spectra.wave_search import find_waves, find_waves_analytic

Harmonic = Literal["free", "tied"]
Signal = Literal["real", "analytic"]
Channels = Literal["joint", "each"]
FALSE_ALARMS = 0.01
"""Probability that noise alone yields a wave."""
MOST_WAVES = 400
"""The largest number of waves."""
DOMINANT = 0.25
"""Waves of at least this share of the largest amplitude belong to the regular structure of equation 7. On walls of mild
departures, waves of bricks have 0.28 or more, those of chance 0.15 or less (running bond, color up to 0.2)."""


@dataclass(frozen=True)
class WaveAnalysis:
    """The waves of a picture: mean + sum of cosine cos(2 pi f r) + sine sin(2 pi f r), r = (x, y) px from pixel (0, 0).

    Parameters
    ----------
    frequencies
        ``(n, 2)``: (f_x, f_y) cycles/px, the strongest first; one of each pair f, -f. Components above half a cycle/px
        belong to waves that are aliased: at integer pixels they equal a wave of lower frequency.
    cosine, sine
        ``(n, C)``: amplitudes, in units of the planes.
    mean
        ``(C,)``.
    fundamentals
        ``(g, 2)`` cycles/px; for free waves, the frequencies themselves.
    orders
        ``(n, g)`` integers: ``frequencies = orders @ fundamentals``.
    groups
        The number of fundamentals, 1 or 2, of each group: two make a lattice of frequencies, one makes stripes. The
        groups follow each other in ``fundamentals``.
    share
        Share of the planes' variance, all channels together, that the waves explain, in [0, 1].
    """

    frequencies: Array
    cosine: Array
    sine: Array
    mean: Array
    fundamentals: Array
    orders: NDArray[np.int64]
    groups: tuple[int, ...]
    share: float

    @property
    def amplitudes(self) -> Array:
        """The waves' amplitudes, ``(n, C)``."""
        return np.hypot(self.cosine, self.sine)

    def evaluate(self, shape: tuple[int, int], offset: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Return the picture in a window at any place, ``(H, W, C)``, not clipped (equation 6 of the paper).

        Parameters
        ----------
        shape
            (height, width) px.
        offset
            (x, y) px of the window's first pixel, any real numbers.
        """
        return wave_sum(self.frequencies, self.cosine, self.sine, self.mean, shape, offset)


def lowest_period(frequencies: Array, amplitudes: Array, shape: tuple[int, int]) -> tuple[float | None, float | None]:
    """Return the size (width, height) px of a tile by the lowest frequency (Nicoll et al. 2005, equation 7, n = 1).

    The size is one over the components of the lowest frequency of the regular structure. The paper leaves open which
    waves belong to this structure, and what happens where a component is 0. Here they are the waves of at least a
    quarter of the largest amplitude, and each side takes the lowest of them that varies along it, by at least half a
    cycle over the picture. Where colors depart strongly, waves of chance are among them, and the tile is too large.

    Parameters
    ----------
    frequencies
        ``(n, 2)`` cycles/px.
    amplitudes
        ``(n, C)``; the largest of all channels counts.
    shape
        (height, width) px of the picture.

    Returns
    -------
    tuple
        A side is None if no frequency varies along it.

    Examples
    --------
    >>> lowest_period(np.array([[0.0, 0.1], [0.04, 0.05]]), np.ones((2, 1)), (128, 128))
    (25.0, 20.0)
    """
    strength = amplitudes.max(1, initial=0)
    frequencies = frequencies[strength >= DOMINANT * strength.max(initial=0)]
    order = np.argsort(np.hypot(*frequencies.T), kind="stable")
    sides: list[float | None] = []
    for axis in (0, 1):
        components = np.abs(frequencies[order, axis])
        varying = components[components * shape[1 - axis] >= 0.5]
        sides.append(1 / float(varying[0]) if len(varying) else None)
    return sides[0], sides[1]


def find_free_waves(
    planes: Planes,
    false_alarms: float = FALSE_ALARMS,
    threshold: float | None = None,
    most: int = MOST_WAVES,
    signal: Signal = "real",
) -> WaveAnalysis:
    """Return the waves of a picture, each frequency independent: Nicoll et al. 2005, section 3.

    Candidates are DFT coefficients above a threshold. Each is refined within a bin to the maximum of the fractional
    transform and subtracted, and all are fitted jointly by least squares
    (:func:`~nrbench.spectra.wave_search.find_waves`). A wave has the same frequency in all planes;
    :func:`find_channel_waves` analyzes each plane by itself.

    The method differs from the paper as follows. Real waves are fitted as cosine and sine instead of an analytic signal
    (``signal`` selects it), so that a wave and its mirror image do not interfere. The residual after a subtraction is
    computed in closed form instead of by another transform. All waves are fitted after each round instead of only at
    the end; this also replaces the alternating one-dimensional searches.

    Parameters
    ----------
    planes
        ``(H, W, C)``, any floating dtype; the paper takes YCbCr.
    false_alarms
        Probability in (0, 1) that noise alone yields a wave.
    threshold
        Least amplitude of a wave in at least one channel, in units of 1/255. None: the amplitude that noise exceeds
        anywhere with probability ``false_alarms``; the noise floor is measured in the spectrum.
    most
        The largest number of waves.
    signal
        ``"real"``: waves are searched as cosine and sine. ``"analytic"``: the paper's search for one complex wave after
        the other in the analytic signal, with one joint fit at the end. Waves with f_x within a few bins of 0 are
        misplaced by some hundredths of a bin, or are found as several waves; the joint fit corrects this and drops
        superfluous waves.

    Examples
    --------
    >>> y, x = np.indices((64, 64))
    >>> waves = find_free_waves(np.cos(2 * np.pi * (0.11 * x + 0.03 * y))[..., np.newaxis])
    >>> waves.frequencies.round(4)
    array([[0.11, 0.03]])
    """
    search = find_waves if signal == "real" else find_waves_analytic
    waves = search(Spectrum(planes), threshold, false_alarms, most).waves
    n = len(waves.frequencies)
    return _sort_by_power(waves, waves.frequencies, waves.frequencies, np.eye(n), (1,) * n, None)


def find_tied_waves(
    planes: Planes,
    false_alarms: float = FALSE_ALARMS,
    threshold: float | None = None,
    most: int = MOST_WAVES,
    signal: Signal = "real",
    given: Array | None = None,
) -> WaveAnalysis:
    """Return the waves of a picture, sorted into groups of harmonics.

    Frequencies are integer combinations of few fundamentals, which are fitted jointly, and weaker waves are searched at
    the other harmonics of the lattices (:func:`~nrbench.spectra.regular_part.find_regular_part`). With free
    frequencies, small errors make masks interfere far from the sample (figure 10); tied frequencies are exact
    multiples.

    Parameters
    ----------
    planes, false_alarms, threshold, most
        As for :func:`find_free_waves`.
    signal
        The signal in which the waves that propose the fundamentals are searched, as for :func:`find_free_waves`.
    given
        ``(2, 2)`` cycles/px: fundamentals of the first group, with an error of at most about 2 %.
    """
    part = find_regular_part(Spectrum(planes), threshold, false_alarms, most, signal == "analytic", given)
    f = part.orders @ part.fundamentals
    return _sort_by_power(part.waves, f, part.fundamentals, part.orders, part.groups, part.kept)


def find_channel_waves(
    find: Callable[[Planes, float], WaveAnalysis], planes: Planes, false_alarms: float = FALSE_ALARMS
) -> WaveAnalysis:
    """Return the waves of a picture of which every channel is analyzed separately, as in the paper.

    A wave of one channel has amplitude 0 in the others.

    Parameters
    ----------
    find
        The analysis of one channel, given its plane ``(H, W, 1)`` and its share of ``false_alarms``:
        :func:`find_free_waves` or :func:`find_tied_waves`, with further arguments bound by name.
    planes
        ``(H, W, C)``.
    false_alarms
        Probability in (0, 1) that noise alone yields a wave in any channel.
    """
    count = planes.shape[2]
    return _combine_channels([find(plane, false_alarms / count) for plane in np.split(planes, count, 2)], planes)


def _sort_by_power(
    waves: Waves,
    frequencies: Array,
    fundamentals: Array,
    orders: Array,
    groups: tuple[int, ...],
    kept: NDArray[np.bool_] | None,
) -> WaveAnalysis:
    """Return fitted waves with amplitudes about pixel (0, 0), the strongest first."""
    cosine, sine, mean = waves.origin_amplitudes(kept)
    order = np.argsort(-(cosine**2 + sine**2).sum(1), kind="stable")
    total = float(waves.spectrum.energy.sum())
    explained = waves.explained.sum() if kept is None else total - np.square(waves.subtract(kept)).sum()
    share = min(max(float(explained) / total, 0.0), 1.0) if total > 0 else 0.0
    integers = np.rint(orders[order]).astype(np.int64)
    return WaveAnalysis(frequencies[order], cosine[order], sine[order], mean, fundamentals, integers, groups, share)


def _combine_channels(parts: list[WaveAnalysis], planes: Planes) -> WaveAnalysis:
    """Return the waves of separately analyzed channels as those of one picture."""
    fundamentals = [part.fundamentals for part in parts]
    orders = np.zeros((sum(len(p.orders) for p in parts), sum(len(f) for f in fundamentals)), np.int64)
    amplitudes = np.zeros((2, len(orders), len(parts)))
    row = column = 0
    for channel, part in enumerate(parts):
        n, g = len(part.orders), len(part.fundamentals)
        orders[row : row + n, column : column + g] = part.orders
        amplitudes[:, row : row + n, channel] = part.cosine[:, 0], part.sine[:, 0]
        row, column = row + n, column + g
    frequencies = np.concatenate([part.frequencies for part in parts])
    mean, groups = np.concatenate([part.mean for part in parts]), sum((part.groups for part in parts), ())
    variances = planes.var((0, 1), dtype=np.float64)
    share = float(variances @ [part.share for part in parts]) / max(float(variances.sum()), 1e-300)
    strongest = np.argsort(-(amplitudes**2).sum((0, 2)), kind="stable")
    cosine, sine = amplitudes[:, strongest]
    return WaveAnalysis(
        frequencies[strongest], cosine, sine, mean, np.concatenate(fundamentals), orders[strongest], groups, share
    )
