import numpy as np
import pytest

from nrbench.spectra.harmonic_groups import (
    SpectrumPeaks,
    are_near,
    find_fundamentals,
    is_supercell,
    off_line_evidence,
    propose_basis,
    select_spaced,
)
from nrbench.spectra.spectrum import Spectrum

SIDE, THREAD, INDEX = 144, 12, 3
LATTICE = np.array([(1 / THREAD, 0.0), (0.0, 1 / THREAD)])
WAVES = np.array([(k / (INDEX * THREAD), 0.0) for k in (1, 2, 4, 5, 7)])


def threads(colors: np.ndarray) -> Spectrum:
    """Return the spectrum of upright threads of the same profile, each with a color of its own."""
    profile = np.hanning(THREAD + 2)[1:-1]
    row = (colors[:, np.newaxis] * profile).ravel()
    return Spectrum(np.tile(row, (SIDE, 1))[..., np.newaxis])


@pytest.mark.parametrize("strength", [0.5, 0.1])
def test_a_larger_tile_is_believed(strength: float) -> None:
    """Every third thread is another, and chance adds little to it."""
    chance = 0.05 * strength * np.random.default_rng(0).standard_normal(SIDE // THREAD)
    assert is_supercell(threads(strength * np.tile([1.0, 0.0, 0.0], 4) + chance), WAVES, LATTICE)


def test_random_colors_are_no_larger_tile() -> None:
    """Though each offset shows in many waves: hardly one of two hundred draws passes."""
    draws = (np.random.default_rng(seed).standard_normal(SIDE // THREAD) for seed in range(200))
    assert sum(is_supercell(threads(colors - colors.mean()), WAVES, LATTICE) for colors in draws) <= 2


def test_too_little_beside_is_believed() -> None:
    """A tile repeated twice leaves no room between the places of its waves to compare them with."""
    spectrum = Spectrum(np.random.default_rng(0).standard_normal((24, 24, 1)))
    assert is_supercell(spectrum, np.array([(1 / 24, 0.0), (3 / 24, 0.0)]), np.array([(1 / 12, 0.0), (0.0, 1 / 12)]))


SIZE = np.array([128.0, 128.0])


def test_stripes_and_one_more_wave_are_no_lattice() -> None:
    """Harmonics of one fundamental with a wave off their line give one; with two more waves of a lattice, two."""
    places = [(0.0, 4.3 * k) for k in range(1, 7)] + [(9.1, 0.2), (2.0, 1.1)]
    stripes = SpectrumPeaks(np.array(places), np.full(8, 0.05), np.ones(8))
    pair = find_fundamentals(stripes)
    assert (
        pair is not None and off_line_evidence(pair, stripes.weights) == 0 and len(propose_basis(stripes).vectors) == 1
    )
    more = SpectrumPeaks(np.array([*places, (18.2, 4.7), (9.1, 4.5)]), np.full(10, 0.05), np.ones(10))
    assert len(propose_basis(more).vectors) == 2


def test_waves_along_one_line_do_not_lengthen_the_other_vector() -> None:
    """Of waves along one line, the vector beside the line stays as short as the places that were paired."""
    places = [(10.8, 1.5), (32.4, 4.5), (32.3, 4.4), (32.5, 4.6), (1.0, -26.4)]
    pair = find_fundamentals(SpectrumPeaks(np.array(places), np.full(5, 0.05), np.array([1.0, 0.4, 0.4, 0.4, 0.01])))
    assert pair is not None and np.abs(pair.vectors).max() < 1000
    assert np.linalg.matrix_rank(pair.orders[pair.explained]) == 1


def test_the_first_of_near_places_stays() -> None:
    """Of places that pixels cannot tell apart that of highest priority is kept, across the spectrum's border too."""
    f = np.array([(0.1, 0.2), (0.1, 0.203), (-0.1, -0.2), (0.4995, 0.1), (-0.4995, 0.1), (0.3, 0.3)])
    kept = select_spaced(f, np.array([1.0, 3, 2, 5, 4, 6]), SIZE)
    assert kept.tolist() == [5, 3, 1]
    assert are_near(f[:2], np.array([(-0.1, -0.2)]), SIZE).all() and not are_near(f[5:], f[:5], SIZE).any()
