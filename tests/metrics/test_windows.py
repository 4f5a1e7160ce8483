"""What registered windows share: a displacement, an affine drift, and a lattice of their own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.metrics.verdict.windows import (
    RegisteredWindows,
    displace_lattice,
    find_consensus,
    fit_drift,
    fit_own_lattice,
)

LATTICE = Lattice((20.0, 3.0), (-4.0, 17.0), (2.0, 1.0))


def make_windows(displacement: np.ndarray, rows: int, columns: int, lattice: Lattice = LATTICE) -> RegisteredWindows:
    """Return windows of 30 px, 15 px apart, with given displacements."""
    y, x = np.meshgrid(15 * np.arange(rows), 15 * np.arange(columns), indexing="ij")
    corners = np.stack([x.ravel(), y.ravel()], -1)
    displacement, structure = lattice.wrap(displacement), np.ones(len(corners))
    return RegisteredWindows(lattice, (30, 30), (rows, columns), corners, displacement, structure)


@settings(max_examples=40)
@given(st.floats(-40, 40), st.floats(-40, 40), st.integers(0, 100))
def test_the_consensus_is_the_common_displacement(x: float, y: float, seed: int) -> None:
    """The consensus is the displacement that most windows share, for any phase and with outliers."""
    rng = np.random.default_rng(seed)
    displacement = np.array([x, y]) + 0.2 * rng.standard_normal((60, 2))
    displacement[:15] += rng.uniform(-10, 10, (15, 2))
    off = LATTICE.wrap(find_consensus(LATTICE.wrap(displacement), LATTICE) - (x, y))
    assert np.hypot(*off) < 0.35


def test_the_consensus_of_two_halves_is_one_of_them() -> None:
    """If two halves are out of step by 0.2 s, the consensus is the displacement of one half, not the mean."""
    displacement = np.repeat([[0.0, 0.0], [4.0, 0.0]], [30, 31], 0)
    phase = find_consensus(displacement, LATTICE)
    assert min(np.hypot(*phase), np.hypot(*(phase - [4, 0]))) < 0.2


@settings(max_examples=15)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_an_affine_drift_over_many_cells_is_unwrapped(a: float, b: float, c: float, d: float) -> None:
    """The affine part is measured even if it amounts to many cells across the image."""
    matrix = np.array([[a, b], [c, d]])
    bare = make_windows(np.zeros((300, 2)), 15, 20)
    drifted = make_windows(bare.centers @ matrix.T + [3.0, -7.0], 15, 20)
    np.testing.assert_allclose(fit_drift(drifted), matrix, atol=2e-3)


def test_one_wrong_window_does_not_displace_a_neighborhood() -> None:
    """One wrong window does not change the median of 3 x 3 windows; a displaced block does."""
    displacement = np.zeros((48, 2))
    displacement[20] = [8, 0]
    assert make_windows(displacement, 6, 8).neighborhoods().max() < 0.01
    block = np.zeros((6, 8, 2))
    block[:4, :4] = [0, 6]
    assert make_windows(block.reshape(-1, 2), 6, 8).neighborhoods().max() * LATTICE.s == pytest.approx(6, abs=0.1)


_SMALL = st.floats(-0.04, 0.04)


def make_drifted(true: Lattice, drift: np.ndarray, rows: int = 14, columns: int = 16) -> RegisteredWindows:
    """Return the windows of an image whose content has drifted."""
    bare = make_windows(np.zeros((rows * columns, 2)), rows, columns, true)
    return make_windows(bare.centers @ drift.T + (3.0, -2.0), rows, columns, true)


@settings(max_examples=25)
@given(_SMALL, _SMALL, _SMALL, _SMALL)
def test_the_lattice_of_a_drifted_image_is_found(a: float, b: float, c: float, d: float) -> None:
    """The least-squares lattice is the true one displaced by the drift: its points map back onto true points."""
    drift = np.array([[a, b], [c, d]])
    windows = make_drifted(LATTICE, drift)
    own = fit_own_lattice(windows, fit_drift(windows))
    assert own is not None and own.followers == 1
    at = own.lattice.points((200, 240))
    back = at - (at @ drift.T + (3.0, -2.0))
    assert np.abs(LATTICE.wrap(back - LATTICE.origin)).max() < 0.02


def test_vectors_and_area_are_those_of_the_stretch() -> None:
    """A stretch of 3 % gives an error of 3 % of the vectors and 6 % of the area. Long vectors are then not exact."""
    long = Lattice((60.0, 0.0), (0.0, 50.0))
    windows = make_drifted(long, np.eye(2) * (1 - 1 / 1.03))
    own = fit_own_lattice(windows, fit_drift(windows))
    assert own is not None
    error = own.error(long, (240, 240))
    assert error is not None and error.relation == "wrong"
    assert error.vector == pytest.approx(1.8, abs=0.02)
    assert error.area_ratio == pytest.approx(1.03**2, abs=1e-3)


def test_scattered_windows_share_no_lattice() -> None:
    """A lattice on which few windows lie is not compared."""
    rng, windows = np.random.default_rng(0), make_drifted(LATTICE, np.zeros((2, 2)))
    torn = RegisteredWindows(
        *list(vars(windows).values())[:4], LATTICE.wrap(rng.uniform(-40, 40, (224, 2))), np.ones(224)
    )
    own = fit_own_lattice(torn, fit_drift(torn))
    assert own is not None and own.followers < 0.5
    assert own.error(LATTICE, (200, 200)) is None


def test_two_windows_have_no_lattice() -> None:
    """Fewer than 3 x 3 windows have no lattice of their own."""
    assert fit_own_lattice(make_drifted(LATTICE, np.zeros((2, 2)), rows=2), np.zeros((2, 2))) is None


def test_without_drift_only_the_origin_changes() -> None:
    """Without drift a lattice keeps its vectors, and its origin is displaced by the constant."""
    assert displace_lattice(LATTICE, np.zeros((2, 2)), np.array([1.5, -2.0])) == LATTICE.shifted((1.5, -2.0))
