"""Claims about seams found by dynamic programming."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.synthesizers.seams.seam_kernels import cheapest_path

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
    seam = cheapest_path(error)
    every = paths(*shape)
    assert tuple(seam) in every
    assert cost(error, seam) == min(cost(error, path) for path in every)


def test_ties_are_broken_always_alike() -> None:
    """On a flat surface the seam is the straight line at the left."""
    np.testing.assert_array_equal(cheapest_path(np.zeros((6, 4))), np.zeros(6))


def test_forbidden_pixels_are_avoided() -> None:
    """A seam passes through the only gap in a wall of infinities."""
    error = np.ones((9, 7))
    error[4] = np.inf
    error[4, 5] = 100
    assert cheapest_path(error)[4] == 5
