import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.synthesizers.patchwork.patchwork import Patchwork, SeamHeat


def output(shape: tuple[int, int], wrap: bool = False) -> Patchwork:
    """Return an output whose seams are written by hand."""
    return Patchwork(np.zeros((4, 4, 1), np.float32), np.zeros((4, 4, 1), np.int32), shape, wrap=wrap)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.integers(3, 50), st.integers(3, 50)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.booleans(),
    st.integers(0, 999),
)
def test_the_one_seam_that_costs_is_in_the_window(
    shape: tuple[int, int], share: tuple[float, float], wrap: bool, seed: int
) -> None:
    """Wherever it lies, in windows of any size; without wrapping the window is inside the output."""
    work, rng = output(shape, wrap), np.random.default_rng(seed)
    size = 1 + int(share[0] * (shape[0] - 1)), 1 + int(share[1] * (shape[1] - 1))
    y, x = int(rng.integers(shape[0])), int(rng.integers(shape[1]))
    work.seams[rng.integers(2), y, x] = 16
    window = SeamHeat(work, size).find_worst()
    rows, columns = work.pixels(window)
    assert (window[1] - window[0], window[3] - window[2]) == size
    assert wrap or (window[0] >= 0 and window[1] <= shape[0] and window[2] >= 0 and window[3] <= shape[1])
    block = SeamHeat(work, size).block
    assert np.abs(rows - y).min() < block and np.abs(columns - x).min() < block


@pytest.mark.parametrize("wrap", [False, True])
def test_where_trying_is_in_vain_others_have_their_turn(wrap: bool) -> None:
    """A seam that stays costs half as much with each try, so that all are tried in the end; the worst most often."""
    work = output((60, 60), wrap)
    work.seams[0, 50, 50], work.seams[1, 10, 8], work.seams[1, 9, 52] = 900, 700, 100
    heat, found = SeamHeat(work, (12, 12)), []
    for _ in range(12):
        window = heat.find_worst()
        rows, columns = work.pixels(window)
        found.append([50 in rows and 50 in columns, 10 in rows and 8 in columns, 9 in rows and 52 in columns])
        heat.update(window)
    assert found[0] == [True, False, False] and found[1] == [False, True, False]
    first, second, third = np.sum(found, 0)
    assert first >= second >= third >= 1


@pytest.mark.parametrize("wrap", [False, True])
def test_what_a_try_changes_is_summed_again(wrap: bool) -> None:
    """After seams in a window and around it have changed, the sums are as if made anew."""
    work, rng = output((43, 51), wrap), np.random.default_rng(0)
    heat = SeamHeat(work, (12, 14))
    for _ in range(20):
        heat.find_worst()
        top, left = int(rng.integers(43 if wrap else 31)), int(rng.integers(51 if wrap else 37))
        rows, columns = work.pixels((top, top + 12, left, left + 14))
        work.seams[:, rows, columns] = rng.integers(0, 99, (2, 12, 14))
        heat.update((top, top + 12, left, left + 14))
        np.testing.assert_array_equal(heat.costs, SeamHeat(work, (12, 14)).costs)
