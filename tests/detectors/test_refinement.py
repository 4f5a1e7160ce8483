import numpy as np
import pytest

from nrbench.detectors.autocorrelation.peaks import fit_multiples, fit_pair

TRUE = np.array([[17.37, 3.62], [-4.18, 14.71]])
REACH = (150, 150)


def lattice_surface(noise: float = 0.0) -> np.ndarray:
    """Return the right half of a surface with a bump at each multiple of TRUE."""
    y, x = np.indices((2 * 256 - 1, 256)) - np.array([255, 0]).reshape(2, 1, 1)
    cells = np.stack([x, y], -1) @ np.linalg.inv(TRUE)
    off = (cells - np.rint(cells)) @ TRUE
    surface = np.exp(-(off**2).sum(-1) / 8)
    return (surface + noise * np.random.default_rng(0).standard_normal(surface.shape)).astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_multiples_make_a_vector_precise(noise: float) -> None:
    """From whole pixels, 0.7 px off, a vector is fitted to 0.02 px over its multiples."""
    fitted = fit_multiples(lattice_surface(noise), np.array([[17.0, 4.0], [13.0, 18.0]]), REACH)
    np.testing.assert_allclose(fitted, [TRUE[0], TRUE[0] + TRUE[1]], atol=0.02)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_pair_is_fitted_to_all_multiples(noise: float) -> None:
    """From whole pixels both vectors are fitted to 0.01 px."""
    fitted = fit_pair(lattice_surface(noise), np.array([[17.0, 4.0], [-4.0, 15.0]]), REACH)
    np.testing.assert_allclose(fitted, TRUE, atol=0.01)


def test_a_vector_without_peaks_stays_in_place() -> None:
    """Away from all peaks nothing is fitted by more than the search allows."""
    start = np.array([[9.0, 7.0]])
    assert np.abs(fit_multiples(lattice_surface(), start, REACH) - start).max() < 1.5


def test_a_pair_that_loses_its_peaks_is_returned() -> None:
    """On noise a pair of short vectors is not moved by more than a quarter of the shorter."""
    rng = np.random.default_rng(0)
    noise = rng.random((2 * 64 - 1, 64)).astype(np.float32)
    noise[63, 0] = 1
    pair = np.array([[1.6, 1.4], [-1.2, 2.3]])
    assert np.hypot(*(fit_pair(noise, pair, (40, 40)) - pair).T).max() <= np.hypot(1.6, 1.4) / 4
