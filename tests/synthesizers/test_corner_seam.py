import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.synthesizers.seams.corner_seam import corner_seam


def staircases(rows: int, columns: int) -> list[list[tuple[int, int]]]:
    """List all ways right and down from the first pixel to the last that leave the edges to their owners."""
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


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 6), st.integers(3, 6), st.integers(0, 999))
def test_no_staircase_is_cheaper(rows: int, columns: int, seed: int) -> None:
    """Of all ways tried one by one none has a smaller sum."""
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
    """Along a planted way of no difference the cut costs nothing, and parts the pixels above from those below."""
    difference = np.ones((8, 11))
    way = [(0, 0), (0, 1), (1, 1), (2, 1), (3, 1), (3, 2), *[(3, x) for x in range(3, 9)]]
    way += [(4, 8), (5, 8), (6, 8), (6, 9), (6, 10), (7, 10)]
    difference[tuple(np.array(way).T)] = 0
    taken, cost = corner_seam(difference)
    assert cost == 0
    assert taken[:3, 2:].all() and not taken[4:, :8].any()
