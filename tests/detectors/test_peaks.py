import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.detectors.autocorrelation.peaks import (
    climb,
    dilate,
    find_prominent_peaks,
    fit_multiples,
    fit_pair,
    subpixel,
    values_at,
)

SHAPE = (60, 60)


def bumps(*centers: tuple[float, float, float], width: float = 2.0) -> np.ndarray:
    """Return the right half of a symmetric surface: 1 at the origin, and bumps of given lag (x, y) and height."""
    height, columns = SHAPE
    y, x = np.indices((2 * height - 1, columns)) - np.array([height - 1, 0]).reshape(2, 1, 1)
    surface = np.exp(-(x**2 + y**2) / (2 * width**2))
    for sign in (1, -1):
        for cx, cy, top in centers:
            surface += top * np.exp(-((x - sign * cx) ** 2 + (y - sign * cy) ** 2) / (2 * width**2))
    return surface.astype(np.float32)


def test_peaks_are_found_with_value_and_prominence() -> None:
    """Three separate bumps are three peaks, each as prominent as it is high, the origin left out."""
    peaks = find_prominent_peaks(bumps((20, 5, 0.8), (12, -20, 0.5), (0, 18, 0.4)), (40, 40))
    strong = peaks.values > 0.1
    assert {tuple(lag) for lag in peaks.lags[strong].tolist()} == {(20, 5), (12, -20), (0, 18)}
    np.testing.assert_allclose(peaks.prominences[strong], peaks.values[strong], atol=0.02)


def test_a_bump_on_a_slope_is_a_peak_of_little_prominence() -> None:
    """A shoulder next to a higher peak stands out by its height above the pass between them."""
    surface = bumps((20, 0, 0.8), (26, 0, 0.5))
    peaks = find_prominent_peaks(surface, (40, 40))
    shoulder = peaks.lags.tolist().index([26, 0])
    along = surface[SHAPE[0] - 1, 20:27]
    assert peaks.prominences[shoulder] == pytest.approx(peaks.values[shoulder] - along.min(), abs=1e-4)


def test_a_ridge_across_the_left_edge_is_one() -> None:
    """A pass that leads through the left half-plane counts: the mirrored pixel is the neighbor."""
    peaks = find_prominent_peaks(bumps((2, 20, 0.5), (6, -22, 0.6), width=3.0), (40, 40))
    assert peaks.prominences[peaks.lags.tolist().index([2, 20])] < 0.1


def test_prominences_agree_with_brute_force() -> None:
    """On random surfaces every prominence is what flooding from the top gives."""
    rng = np.random.default_rng(0)
    right = rng.random((21, 11)).astype(np.float32)
    right[11:, 0] = right[9::-1, 0] = np.sort(right[11:, 0])
    right[17, 0] = right[3, 0] = 2
    peaks = find_prominent_peaks(np.pad(right, ((3, 3), (0, 3)), constant_values=-1), (9, 9))
    whole = np.concatenate([right[::-1, :0:-1], right], 1)
    assert [0, 7] in peaks.lags.tolist()
    for lag, value, prominence in zip(peaks.lags, peaks.values, peaks.prominences, strict=True):
        assert prominence == pytest.approx(_flooded(whole, (lag[1] + 10, lag[0] + 10), value), abs=1e-6)


def _flooded(surface: np.ndarray, start: tuple[int, int], value: float) -> float:
    """Return how far one must descend from ``start`` to reach higher ground, on the surface glued to its mirror."""
    from scipy.ndimage import label

    for level in np.sort(surface.ravel())[::-1]:
        if level > value:
            continue
        labels, _ = label(surface >= level, np.ones((3, 3)))
        if surface[labels == labels[start]].max() > value + 1e-7:
            return value - float(level)
    return value - float(surface.min())


@given(st.floats(-0.49, 0.49), st.floats(-0.49, 0.49))
def test_peaks_are_located_to_a_fraction_of_a_pixel(dx: float, dy: float) -> None:
    """The vertex of a smooth bump is found within 0.05 px, from its lag or from a pixel beside it."""
    surface = bumps((20 + dx, 7 + dy, 0.8))
    np.testing.assert_allclose(subpixel(surface, np.array([[20, 7]])), [[20 + dx, 7 + dy]], atol=0.05)
    found, values = climb(surface, np.array([[20.6 + dx, 6.4 + dy], [-20.6 - dx, -6.4 - dy]]))
    np.testing.assert_allclose(found, [[20 + dx, 7 + dy], [-20 - dx, -7 - dy]], atol=0.05)
    assert values[0] == values[1] == values_at(surface, np.array([20, 7]))


def test_dilation_sees_both_half_planes() -> None:
    """The highest value within a pixel is found across the left edge too."""
    rng = np.random.default_rng(0)
    right = rng.random((2 * 20 - 1, 20)).astype(np.float32)
    right[20:, 0] = right[18::-1, 0]
    whole = np.concatenate([right[::-1, :0:-1], right], 1)
    expected = max(whole[y, x] for y in (29, 30, 31) for x in (18, 19, 20))
    assert dilate(right, 1)[30, 0] == expected
    assert dilate(right, 0) is right


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
def test_multiples_make_vectors_precise(noise: float) -> None:
    """From whole pixels, 0.7 px off, a vector is fitted to 0.02 px over its multiples, and a pair to 0.01 px."""
    surface = lattice_surface(noise)
    fitted = fit_multiples(surface, np.array([[17.0, 4.0], [13.0, 18.0]]), REACH)
    np.testing.assert_allclose(fitted, [TRUE[0], TRUE[0] + TRUE[1]], atol=0.02)
    np.testing.assert_allclose(fit_pair(surface, np.array([[17.0, 4.0], [-4.0, 15.0]]), REACH), TRUE, atol=0.01)


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
