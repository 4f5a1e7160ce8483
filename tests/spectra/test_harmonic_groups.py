import numpy as np
import pytest

from nrbench.spectra.harmonic_groups import is_supercell
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
