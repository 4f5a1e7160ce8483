"""Whether waves between the places of a lattice prove a larger tile, or are what elements have in common by chance."""

from __future__ import annotations

import numpy as np
from scipy import stats

from nrbench.spectra.dirichlet import Array
from nrbench.spectra.harmonic_fit import Waves
from nrbench.spectra.spectrum import Spectrum

SUPERCELL_CHANCE = 1e-3
"""Probability with which colors drawn at random are taken for a larger tile, for each that is tried."""
FEWEST_SUMS = 3
"""Sums beside that the test needs: of fewer it would tell only what no texture shows."""


def is_supercell(spectrum: Spectrum, frequencies: Array, fundamentals: Array) -> bool:
    """Return whether waves stand out of what lies beside them between the places of a lattice.

    Elements that depart from a lattice each by themselves, as threads do that have a color each, have a spectrum that
    repeats with the lattice of frequencies: however many waves lie at one offset from its places, they are one number,
    drawn at random, that shows again and again. So the waves of the strongest offset are compared, summed, with the
    same sums a bin and more beside them, on the line that leads to the next place: for random colors the ratio has the
    F distribution of 2 and twice as many degrees of freedom as there are sums beside. A tile that is repeated only
    twice leaves too few of them, and is believed.

    Parameters
    ----------
    spectrum
        Of what the lattice's own waves leave of a picture.
    frequencies
        ``(n, 2)`` cycles/px: the waves, whole combinations of the larger tile's fundamentals.
    fundamentals
        ``(2, 2)`` cycles/px: the lattice's.
    """
    waves, size = Waves(spectrum, frequencies), spectrum.size
    offsets = _offsets_from_lattice(frequencies, fundamentals, size)
    powers = (np.abs(waves.modelled(frequencies)) ** 2).sum(1)
    alike = np.hypot(*np.moveaxis((offsets[:, np.newaxis] - offsets) * size, 2, 0)) < 0.5
    strongest = alike[np.argmax(alike @ powers)]
    offset = offsets[strongest][0] * size
    length = float(np.hypot(*offset))
    steps = np.arange(1, max(int(length), 2))
    if 2 * len(steps) < FEWEST_SUMS:
        return True
    beside = np.concatenate([steps, -steps])[:, np.newaxis] * offset / length / size
    places = frequencies[strongest] + beside[:, np.newaxis]
    sums = (np.abs(waves.residual(places.reshape(-1, 2))) ** 2).sum(1).reshape(len(beside), -1).sum(1)
    ratio = float(powers[strongest].sum() / max(float(sums.mean()), 1e-300))
    return ratio > float(stats.f.isf(SUPERCELL_CHANCE, 2, 2 * len(beside)))


def _offsets_from_lattice(frequencies: Array, fundamentals: Array, size: Array) -> Array:
    """Return the shortest frequencies that differ from these, or their mirror images, by places of a lattice."""
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) @ fundamentals
    numbers = frequencies @ np.linalg.inv(fundamentals)
    rests = ((numbers - np.floor(numbers)) @ fundamentals)[:, np.newaxis] - corners
    nearest = np.hypot(*np.moveaxis(rests * size, 2, 0)).argmin(1)
    rest = np.take_along_axis(rests, nearest[:, np.newaxis, np.newaxis], 1)[:, 0]
    mirrored = (rest[:, 0] < -1e-9) | ((np.abs(rest[:, 0]) <= 1e-9) & (rest[:, 1] < 0))
    return np.asarray(np.where(mirrored[:, np.newaxis], -rest, rest))
