"""Claims about seams found by dynamic programming, from side to side and from corner to corner."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.synthesizers.seams.dynamic_seam import corner_seam, dynamic_seam

sizes = st.tuples(st.integers(1, 5), st.integers(1, 5))
seeds = st.integers(0, 10_000)


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


@given(sizes, seeds)
def test_no_path_is_cheaper(shape: tuple[int, int], seed: int) -> None:
    """The seam is a path, and costs no more than any other path."""
    error = np.random.default_rng(seed).integers(0, 4, shape).astype(float)
    seam = dynamic_seam(error)
    every = paths(*shape)
    assert tuple(seam) in every
    assert cost(error, seam) == min(cost(error, path) for path in every)


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


@pytest.mark.parametrize("error", [np.zeros((0, 3)), np.zeros((3, 0)), np.zeros(4), np.full((2, 2), np.nan)])
def test_no_seam_without_a_surface(error: NDArray[np.float64]) -> None:
    """Empty, one-dimensional and NaN surfaces are refused, with what to give."""
    with pytest.raises(BadInput, match="at least one row and one column"):
        dynamic_seam(error)


def staircases(rows: int, columns: int) -> list[list[tuple[int, int]]]:
    """List all paths right and down from the first pixel to the last that keep off the edges."""
    found = []
    for downs in itertools.combinations(range(rows + columns - 2), rows - 1):
        way = [(0, 0)]
        for step in range(rows + columns - 2):
            y, x = way[-1]
            way.append((y + 1, x) if step in downs else (y, x + 1))
        if all(
            (x > 0 or y < 2)
            and (y > 0 or x < 2)
            and (x < columns - 1 or y > rows - 3)
            and (y < rows - 1 or x > columns - 3)
            for y, x in way
        ):
            found.append(way)
    return found


@settings(max_examples=30)
@given(st.integers(3, 6), st.integers(3, 6), st.integers(0, 999))
def test_no_staircase_is_cheaper(rows: int, columns: int, seed: int) -> None:
    """No other path of right and down steps has a smaller sum."""
    difference = np.random.default_rng(seed).random((rows, columns))
    costs = [sum(difference[place] for place in way) for way in staircases(rows, columns)]
    assert corner_seam(difference)[1] == pytest.approx(min(costs))


@pytest.mark.parametrize("shape", [(3, 3), (3, 9), (12, 5), (20, 20)])
def test_edges_stay_with_their_owners(shape: tuple[int, int]) -> None:
    """The horizontal piece takes the whole first row, none of the first column below it; both reach the middle."""
    for seed in range(20):
        taken, _ = corner_seam(np.random.default_rng(seed).random(shape))
        assert taken[0].all() and not taken[1:, 0].any()
        assert taken[:-2, -1].all() and not taken[-1, :-2].any()


def test_the_cut_follows_where_nothing_differs() -> None:
    """The cut follows a path without differences at no cost, and separates the pixels above from those below."""
    difference = np.ones((8, 11))
    way = [(0, 0), (0, 1), (1, 1), (2, 1), (3, 1), (3, 2), *[(3, x) for x in range(3, 9)]]
    way += [(4, 8), (5, 8), (6, 8), (6, 9), (6, 10), (7, 10)]
    difference[tuple(np.array(way).T)] = 0
    taken, cost = corner_seam(difference)
    assert cost == 0
    assert taken[:3, 2:].all() and not taken[4:, :8].any()
