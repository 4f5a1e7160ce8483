"""Lattices that few strong waves of the spectrum show: fine screens, and those of several inks, superposed."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, crop_middle
from nrbench.imaging.correlation import find_vertex
from nrbench.lattice.geometry import Lattice, Points

SIDE = 512
"""px; side of the middle of the image whose waves are used."""
PEAKS, FEWEST_PERIODS = 40, 2.5
"""Number of the strongest peaks of the spectrum, and the least number of their periods in a side."""
MOST = 4
"""Largest number of lattices: a print has four inks."""
LEAST_CONCENTRATION = 0.7
"""Least share of the power of the spectrum that lies in these peaks."""
PARTNER, LEAST_SINE, MOST_RATIO = 0.2, 0.42, 2.0
"""The second wave of a lattice has at least this share of the energy of the first one, an angle to it of at least this
sine, and a length that differs by no more than this factor."""
SQUARE_OR_HEXAGONAL = 1.3
"""Factor by which such a pair of waves is preferred: waves of two screens, too, generate a lattice."""
MOST_ORDER, NEAR = 3, 0.6
"""Largest order of the harmonics of a lattice, and their largest distance from a peak, bins."""
LEAST_SHARE, LEAST_SUM, LEAST_SINGLE, MOST_SHARE = 0.04, 0.7, 0.8, 0.85
"""Shares of the energy of the peaks: the least of each lattice, of all, of a single one; the largest of several."""
MULTIPLES, NESTED = 4, 0.4
"""Two lattices are nested if up to this multiple of the waves of one lie this near, bins for each, to those of the
other."""


def find_wave_lattices(image: Image) -> list[Lattice]:
    """Return the lattices of an image whose strongest waves belong to one to four of them; else nothing.

    The strongest wave and a partner generate the first lattice, with the harmonics of both. The strongest wave that
    remains generates the next one. The waves of an image with one lattice, however large its cell, are those of one
    fine lattice of frequencies. Those of superposed lattices are not, and are few.

    Parameters
    ----------
    image
        ``(H, W, C)``.

    Returns
    -------
    list of Lattice
        The strongest first. No two are multiples of each other. A single one has nearly all of the energy.
    """
    image = crop_middle(image, SIDE)
    size = np.array(image.shape[1::-1], np.float64)
    waves, energies, concentration = _find_peaks(image)
    if concentration < LEAST_CONCENTRATION:
        return []
    total, found = energies.sum(), list[tuple[float, Points]]()
    while len(found) < MOST and energies.max(initial=0.0) >= LEAST_SHARE * total > 0:
        pair, harmonics = _find_lattice(waves, energies, size)
        share = energies[harmonics].sum() / total
        if share < LEAST_SHARE:
            break
        found.append((float(share), pair))
        energies = np.where(harmonics, 0.0, energies)
    separate: list[tuple[float, Points]] = []
    for share, pair in found:
        if not any(_are_nested(*both, size) for _, other in separate for both in ((pair, other), (other, pair))):
            separate.append((share, pair))
    shares = [share for share, _ in separate]
    if sum(shares) < LEAST_SUM or (len(shares) == 1 and shares[0] < LEAST_SINGLE):
        return []
    if shares[0] > MOST_SHARE:
        separate = separate[:1]
    return [Lattice.from_basis(np.linalg.inv(pair).T).oriented() for _, pair in separate]


def _find_peaks(image: Image) -> tuple[Points, NDArray[np.float64], float]:
    """Return frequencies, cycles/px, ``(n, 2)``, and energies of the strongest peaks, and their share of all power."""
    height, width = image.shape[:2]
    window = np.outer(np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1]).astype(np.float32)
    spectra = [scipy.fft.rfft2((plane - plane.mean()) * window) for plane in np.moveaxis(image, 2, 0)]
    power = scipy.fft.fftshift(sum(spectrum.real**2 + spectrum.imag**2 for spectrum in spectra), 0)
    energy = scipy.ndimage.uniform_filter(power, 3)
    rows, columns = np.nonzero(power == scipy.ndimage.maximum_filter(power, 5))
    y, x, end = rows - height // 2, columns, power.shape[1] - 1
    inside = (rows > 0) & (rows < height - 1) & (columns < end) & ((x > 0) | (y > 0))
    kept = np.flatnonzero(inside & (np.hypot(x, y) >= FEWEST_PERIODS))
    kept = kept[np.argsort(-energy[rows[kept], columns[kept]], kind="stable")[:PEAKS]]
    rows, columns, x, y = rows[kept], columns[kept], x[kept], y[kept]
    logs = np.log(power + 1e-12 * power.max() + 1e-30)
    along = find_vertex(logs[rows, np.abs(columns - 1)], logs[rows, columns], logs[rows, columns + 1])
    down = find_vertex(logs[rows - 1, columns], logs[rows, columns], logs[rows + 1, columns])
    places = np.stack([(x + np.where(x > 0, along, 0)) / width, (y + down) / height], 1)
    strongest = 9 * np.asarray(energy[rows, columns], np.float64)
    return places, strongest, float(strongest.sum() / (power.sum() + 1e-30))


def _find_lattice(waves: Points, energies: NDArray[np.float64], size: Points) -> tuple[Points, NDArray[np.bool_]]:
    """Return the strongest wave with its best partner, ``(2, 2)``, and which waves are their harmonics."""
    strongest = int(energies.argmax())
    first, length = waves[strongest], np.hypot(*waves[strongest])
    best, found = 0.0, (waves[[strongest, strongest]], np.zeros(len(waves), bool))
    for partner in np.flatnonzero(energies >= PARTNER * energies[strongest]):
        second = waves[partner]
        ratio = np.hypot(*second) / length
        sine = abs(first[0] * second[1] - first[1] * second[0]) / (length**2 * ratio)
        if sine < LEAST_SINE or not 1 / MOST_RATIO < ratio < MOST_RATIO:
            continue
        pair = np.stack([first, second])
        orders = np.rint(waves @ np.linalg.inv(pair))
        far = np.hypot(*((waves - orders @ pair) * size).T)
        harmonics = (np.abs(orders).max(1) <= MOST_ORDER) & (far < NEAR)
        regular = abs(ratio - 1) < 0.02 and (sine > 0.9995 or abs(sine - 0.866) < 0.02)
        gain = energies[harmonics].sum() * (SQUARE_OR_HEXAGONAL if regular else 1.0)
        if gain > best:
            best, found = gain, (pair, harmonics)
    return found


def _are_nested(pair: Points, other: Points, size: Points) -> bool:
    """Return whether a multiple of both waves of a pair lies at sums of those of another pair."""
    orders = pair @ np.linalg.inv(other)
    multiples = [multiple * orders for multiple in range(1, MULTIPLES + 1)]
    far = [np.hypot(*(((each - np.rint(each)) @ other) * size).T).max() for each in multiples]
    return bool((np.array(far) < NESTED * np.arange(1, MULTIPLES + 1) + 0.3).any())
