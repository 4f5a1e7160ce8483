import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.metrics.verdict.windows import RegisteredWindows, find_consensus, fit_drift

LATTICE = Lattice((20.0, 3.0), (-4.0, 17.0))


def make_windows(displacement: np.ndarray, rows: int, columns: int) -> RegisteredWindows:
    """Return windows of 30 px, 15 px apart, with given displacements."""
    y, x = np.meshgrid(15 * np.arange(rows), 15 * np.arange(columns), indexing="ij")
    corners = np.stack([x.ravel(), y.ravel()], -1)
    return RegisteredWindows(
        LATTICE, (30, 30), (rows, columns), corners, LATTICE.wrap(displacement), np.ones(len(corners))
    )


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
