import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.imaging.convert import quantize
from nrbench.synthesizers.patchwork.patchwork import PatchPlacer, Patchwork, SeamHeat, scan_lines
from nrbench.synthesizers.patchwork.translations import Features


def whole(height: int, width: int, seed: int = 0) -> Features:
    """Return noise, whole gray levels."""
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.int32)


def placement(
    colors: Features, shape: tuple[int, int], randomness: float = 0.01, guided: bool = False, wrap: bool = False
) -> PatchPlacer:
    """Return an empty output, guided by a mask of period 8 both in the sample and beyond, or not."""
    work = Patchwork(quantize((colors / 255).astype(np.float32)), colors, shape, wrap=wrap)
    mask = np.tile(whole(8, 8, 5), (40, 40, 1))
    guide = (mask[: shape[0], : shape[1]], mask[: len(colors), : colors.shape[1]]) if guided else None
    return PatchPlacer(work, colors, randomness, np.random.default_rng(1), guide)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.integers(1, 60), st.integers(1, 60)),
    st.tuples(st.integers(1, 20), st.integers(1, 20)),
    st.tuples(st.floats(0.1, 1), st.floats(0.1, 1)),
    st.booleans(),
)
def test_scan_lines_cover_the_output(
    shape: tuple[int, int], size: tuple[int, int], share: tuple[float, float], wrap: bool
) -> None:
    """Every pixel is in a window, no window is larger than asked, and without wrapping none leaves the output."""
    step = max(1, int(size[0] * share[0])), max(1, int(size[1] * share[1]))
    covered = np.zeros(shape, bool)
    for y0, y1, x0, x1 in scan_lines(shape, size, step, wrap):
        assert 0 < y1 - y0 <= size[0] and 0 < x1 - x0 <= size[1]
        assert wrap or (y1 <= shape[0] and x1 <= shape[1])
        covered[np.ix_(np.arange(y0, y1) % shape[0], np.arange(x0, x1) % shape[1])] = True
    assert covered.all()


def test_where_nothing_is_known_the_guide_alone_places() -> None:
    """On an empty output the patches drawn are those in phase with the guide, all of them."""
    found = set()
    for seed in range(60):
        made = placement(whole(32, 32), (40, 40), guided=True)
        PatchPlacer(made.work, made.colors, 0.01, np.random.default_rng(seed), made.guide).cover((3, 19, 5, 21))
        found.add(tuple(made.work.origin[3, 5]))
    assert found == {(x, y) for x in (5, 13) for y in (3, 11)}


def test_what_is_known_is_continued() -> None:
    """Without randomness a patch goes on where the sample does, when the sample shows it."""
    made = placement(whole(40, 40), (30, 30), randomness=0.0)
    made.work.lay((0, 15, 0, 15), (2, 7))
    made.cover((5, 25, 5, 25))
    assert made.work.cost == 0
    np.testing.assert_array_equal(made.work.origin[24, 24], (26, 31))


@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize("guided", [False, True])
def test_improving_never_makes_seams_cost_more_and_often_less(wrap: bool, guided: bool) -> None:
    """Step by step the cost of all seams falls or stays, and in the end it is less."""
    made = placement(whole(40, 40), (64, 72), randomness=0.05, guided=guided, wrap=wrap)
    for window in scan_lines(made.work.shape, (16, 16), (12, 12), wrap):
        made.cover(window)
    costs = [made.work.cost]
    heat = SeamHeat(made.work, (16, 16))
    for _ in range(40):
        made.improve(heat)
        costs.append(made.work.cost)
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < 0.995 * costs[0]


def test_the_same_stream_places_the_same() -> None:
    """All randomness is the generator's."""
    maps = []
    for _ in range(2):
        made = placement(whole(30, 30), (40, 40), randomness=0.5)
        for window in scan_lines((40, 40), (12, 12), (9, 9), False):
            made.cover(window)
        maps.append(made.work.origin)
    np.testing.assert_array_equal(*maps)


def test_a_flat_sample_takes_any_place() -> None:
    """Where all places are equal all are drawn, and no seam costs anything."""
    made = placement(np.full((20, 20, 1), 100, np.int32), (30, 30))
    for window in scan_lines((30, 30), (8, 8), (6, 6), False):
        made.cover(window)
    assert made.work.cost == 0
    assert len(np.unique(made.work.origin[::8, ::8].reshape(-1, 2), axis=0)) > 8
