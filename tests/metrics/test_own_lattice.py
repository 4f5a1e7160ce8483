import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.metrics.verdict.windows import RegisteredWindows, displace_lattice, fit_drift, fit_own_lattice

LATTICE = Lattice((20.0, 3.0), (-4.0, 17.0), (2.0, 1.0))
_SMALL = st.floats(-0.04, 0.04)


def make_windows(true: Lattice, drift: np.ndarray, rows: int = 14, columns: int = 16) -> RegisteredWindows:
    """Return the windows of an image whose content has drifted."""
    y, x = np.meshgrid(15 * np.arange(rows), 15 * np.arange(columns), indexing="ij")
    corners = np.stack([x.ravel(), y.ravel()], -1)
    bare = RegisteredWindows(
        true, (30, 30), (rows, columns), corners, np.zeros((len(corners), 2)), np.ones(len(corners))
    )
    displacement = true.wrap(bare.centers @ drift.T + (3.0, -2.0))
    return RegisteredWindows(true, (30, 30), (rows, columns), corners, displacement, bare.structure)


@settings(max_examples=25)
@given(_SMALL, _SMALL, _SMALL, _SMALL)
def test_the_lattice_of_a_drifted_image_is_found(a: float, b: float, c: float, d: float) -> None:
    """The least-squares lattice is the true one displaced by the drift: its points map back onto true points."""
    drift = np.array([[a, b], [c, d]])
    windows = make_windows(LATTICE, drift)
    own = fit_own_lattice(windows, fit_drift(windows))
    assert own is not None and own.followers == 1
    at = own.lattice.points((200, 240))
    back = at - (at @ drift.T + (3.0, -2.0))
    assert np.abs(LATTICE.wrap(back - LATTICE.origin)).max() < 0.02


def test_vectors_and_area_are_those_of_the_stretch() -> None:
    """A stretch of 3 % gives an error of 3 % of the vectors and 6 % of the area. Long vectors are then not exact."""
    long = Lattice((60.0, 0.0), (0.0, 50.0))
    windows = make_windows(long, np.eye(2) * (1 - 1 / 1.03))
    own = fit_own_lattice(windows, fit_drift(windows))
    assert own is not None
    error = own.error(long, (240, 240))
    assert error is not None and error.relation == "wrong"
    assert error.vector == pytest.approx(1.8, abs=0.02)
    assert error.area_ratio == pytest.approx(1.03**2, abs=1e-3)


def test_scattered_windows_share_no_lattice() -> None:
    """A lattice on which few windows lie is not compared."""
    rng, windows = np.random.default_rng(0), make_windows(LATTICE, np.zeros((2, 2)))
    torn = RegisteredWindows(
        *list(vars(windows).values())[:4], LATTICE.wrap(rng.uniform(-40, 40, (224, 2))), np.ones(224)
    )
    own = fit_own_lattice(torn, fit_drift(torn))
    assert own is not None and own.followers < 0.5
    assert own.error(LATTICE, (200, 200)) is None


def test_two_windows_have_no_lattice() -> None:
    """Fewer than 3 x 3 windows have no lattice of their own."""
    assert fit_own_lattice(make_windows(LATTICE, np.zeros((2, 2)), rows=2), np.zeros((2, 2))) is None


def test_without_drift_only_the_origin_changes() -> None:
    """Without drift a lattice keeps its vectors, and its origin is displaced by the constant."""
    assert displace_lattice(LATTICE, np.zeros((2, 2)), np.array([1.5, -2.0])) == LATTICE.shifted((1.5, -2.0))
