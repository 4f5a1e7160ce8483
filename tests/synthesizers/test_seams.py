import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.synthesizers.seams.dynamic_seam import dynamic_seam, seam_mask

sizes = st.tuples(st.integers(1, 5), st.integers(1, 5))
seeds = st.integers(0, 10_000)
patient = settings(deadline=None)
"""The first call loads a kernel."""


def paths(rows: int, columns: int) -> list[tuple[int, ...]]:
    """Return every 8-connected path."""
    return [
        path
        for path in itertools.product(range(columns), repeat=rows)
        if all(abs(a - b) <= 1 for a, b in itertools.pairwise(path))
    ]


def cost(error: NDArray[np.float64], path: NDArray[np.int64] | tuple[int, ...]) -> float:
    """Return the sum of errors along a path."""
    return float(error[np.arange(len(error)), np.array(path)].sum())


@patient
@given(sizes, seeds)
def test_no_path_is_cheaper(shape: tuple[int, int], seed: int) -> None:
    """The seam costs as little as the best of all paths, tried one by one, and is one of them."""
    error = np.random.default_rng(seed).integers(0, 4, shape).astype(float)
    seam = dynamic_seam(error)
    every = paths(*shape)
    assert tuple(seam) in every
    assert cost(error, seam) == min(cost(error, path) for path in every)


@patient
@given(sizes, seeds)
def test_a_seam_from_left_to_right_is_the_transpose(shape: tuple[int, int], seed: int) -> None:
    """On the transposed surface the seam costs what the best left-to-right path costs."""
    error = np.random.default_rng(seed).random(shape)
    seam = dynamic_seam(error.T)
    assert cost(error.T, seam) == pytest.approx(min(cost(error.T, path) for path in paths(*shape[::-1])))


def test_ties_are_broken_always_alike() -> None:
    """On a flat surface the seam is the straight line at the left."""
    np.testing.assert_array_equal(dynamic_seam(np.zeros((6, 4))), np.zeros(6))


def test_forbidden_pixels_are_avoided() -> None:
    """A seam passes through the only gap in a wall of infinities."""
    error = np.ones((9, 7))
    error[4] = np.inf
    error[4, 5] = 100
    assert dynamic_seam(error)[4] == 5


@patient
@given(sizes, seeds)
def test_a_cut_gives_each_pixel_to_one_side(shape: tuple[int, int], seed: int) -> None:
    """Without feather the mask is 1 from the path's column on, and 0 before it."""
    path = dynamic_seam(np.random.default_rng(seed).random(shape))
    mask = seam_mask(path, shape[1])
    np.testing.assert_array_equal(mask, np.arange(shape[1]) >= path[:, np.newaxis])


@patient
@given(sizes, seeds, st.floats(0.5, 6))
def test_a_feather_is_a_ramp_centred_on_the_cut(shape: tuple[int, int], seed: int, feather: float) -> None:
    """Feathered weights rise by 1 / feather a px where they are between 0 and 1, and pass 0.5 at the cut."""
    path = dynamic_seam(np.random.default_rng(seed).random(shape))
    mask = seam_mask(path, shape[1], feather)
    np.testing.assert_array_equal(mask >= 0.5, seam_mask(path, shape[1]) == 1)
    rise = np.diff(mask, axis=1)
    assert (rise >= 0).all()
    assert (rise <= 1 / feather + 1e-6).all()


@pytest.mark.parametrize("error", [np.zeros((0, 3)), np.zeros((3, 0)), np.zeros(4), np.full((2, 2), np.nan)])
def test_no_seam_without_a_surface(error: NDArray[np.float64]) -> None:
    """Empty, one-dimensional and NaN surfaces are refused, with what to give."""
    with pytest.raises(BadInput, match="at least one row and one column"):
        dynamic_seam(error)


def test_a_negative_feather_is_refused() -> None:
    """The error says what to choose."""
    with pytest.raises(BadInput, match="choose 0"):
        seam_mask(np.zeros(3, np.int64), 4, -1)
