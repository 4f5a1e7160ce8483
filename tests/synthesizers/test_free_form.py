import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.lattice.geometry import Points
from nrbench.synthesizers.geometry.free_form import FreeForm, approximate, basis, refine


def scattered(seed: int = 0, spread: float = 1.0) -> Points:
    """Return the points of a square lattice of 18 px, moved a little."""
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(11)), -1).reshape(-1, 2) * 18.0
    return np.asarray(grid + np.random.default_rng(seed).normal(0, spread, grid.shape))


def smooth(points: Points) -> Points:
    """Return a displacement in waves of 90 px."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([3 * np.sin(2 * math.pi * x / 90) * np.cos(y / 20), 3 * np.cos(y / 14)], -1)


def test_the_points_are_moved_exactly() -> None:
    """The displacement at each given point is the given one, however wild, as long as no two points are too near."""
    points = scattered()
    moves = np.random.default_rng(1).normal(0, 5, points.shape)
    np.testing.assert_allclose(FreeForm.fit(points, moves, 12.0).at(points), moves, atol=1e-9)


def test_a_smooth_field_is_reproduced_between_the_points() -> None:
    """Between points five to a wave the error is under 5 % of the field (rms)."""
    points = scattered()
    fitted = FreeForm.fit(points, smooth(points), 12.0)
    between = np.random.default_rng(2).uniform(18, 180, (4000, 2))
    error = fitted.at(between) - smooth(between)
    assert np.sqrt((error**2).mean()) < 0.05 * np.sqrt((smooth(between) ** 2).mean())


@given(st.lists(st.floats(-0.1, 0.1), min_size=4, max_size=4), st.floats(-5, 5))
def test_affine_displacements_are_reproduced(slopes: list[float], shift: float) -> None:
    """An affine displacement comes back between the points to 0.15 px where it reaches up to 40 px."""
    points, matrix = scattered(), np.reshape(slopes, (2, 2))
    fitted = FreeForm.fit(points, points @ matrix + shift, 12.0)
    between = np.random.default_rng(3).uniform(18, 180, (500, 2))
    assert np.abs(fitted.at(between) - (between @ matrix + shift)).max() < 0.15


def test_refining_does_not_change_the_spline() -> None:
    """Control points of half the spacing give the same displacement everywhere."""
    controls = np.random.default_rng(0).normal(size=(7, 9, 2))
    coarse, fine = FreeForm(controls, np.zeros(2), 10.0), FreeForm(refine(controls), np.zeros(2), 5.0)
    points = np.random.default_rng(1).uniform(0, 40, (200, 2))
    np.testing.assert_allclose(fine.at(points), coarse.at(points), atol=1e-12)


def test_a_single_point_gets_the_control_points_of_least_norm() -> None:
    """Algorithm BA on one point is the pseudo-inverse of its 16 weights."""
    at, value = np.array([[13.0, 17.0]]), np.array([[2.0, -1.0]])
    controls = approximate(at, value, 10.0, (6, 6))
    across, down = basis(at / 10 - np.floor(at / 10))[0]
    weights = np.zeros((6, 6))
    weights[1:5, 1:5] = np.outer(down, across)
    expected = np.linalg.pinv(weights.reshape(1, -1)) @ value
    np.testing.assert_allclose(controls.reshape(-1, 2), expected, atol=1e-12)


@given(st.floats(0, 1))
def test_the_splines_add_up_to_one(t: float) -> None:
    """The four splines at any fraction of a step are a partition of unity."""
    assert basis(np.array(t)).sum() == pytest.approx(1)
