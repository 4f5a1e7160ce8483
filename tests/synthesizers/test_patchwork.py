import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.imaging.convert import quantize
from nrbench.synthesizers.patchwork.patchwork import Patchwork, Window, cut_least_seams
from nrbench.synthesizers.patchwork.patchwork_kernels import UNIT, link_choices
from nrbench.synthesizers.patchwork.translations import Features


def patchwork(
    rng: np.random.Generator, sample: tuple[int, int], output: tuple[int, int], channels: int = 3, **options: Any
) -> Patchwork:
    """Return an output, empty, of a sample of noise."""
    image = quantize(rng.random((*sample, channels), np.float32))
    return Patchwork(image, np.rint(image * 255).astype(np.int32), output, **options)


def cover(work: Patchwork, rng: np.random.Generator, size: tuple[int, int], count: int) -> None:
    """Lay random patches: over all of the output first, then anywhere."""
    height, width = work.shape
    starts = list(itertools.product(range(0, height, size[0]), range(0, width, size[1])))
    starts += [(int(rng.integers(height)), int(rng.integers(width))) for _ in range(count)]
    for top, left in starts:
        bottom, right = top + size[0], left + size[1]
        window = (top, bottom, left, right) if work.wrap else (top, min(bottom, height), left, min(right, width))
        work.lay(window, anywhere(work, rng, window), reach=int(rng.integers(4)))


def anywhere(work: Patchwork, rng: np.random.Generator, window: Window) -> tuple[int, int]:
    """Draw a place that holds a window."""
    height, width = work.sample.shape[:2]
    x, y = rng.integers(width - (window[3] - window[2]) + 1), rng.integers(height - (window[1] - window[0]) + 1)
    return int(x), int(y)


def step(features: Features, normalized: bool, one: Any, other: Any, axis: int) -> float:
    """Return what a change costs between two patches that show a link's first pixel at (x, y), by definition."""
    last = np.array(features.shape[1::-1]) - 1
    slopes = [np.gradient(features.astype(float), axis=k) for k in (1, 0)]
    apart, busy = 0.0, 0.0
    for ahead in (0, 1):
        ends = [np.clip(np.add(place, ahead * np.eye(2, dtype=int)[axis]), 0, last) for place in (one, other)]
        apart += float(np.linalg.norm(np.subtract(*(features[y, x].astype(float) for x, y in ends))))
        busy += sum(np.rint(UNIT * np.linalg.norm(slopes[axis][y, x])) / UNIT for x, y in ends)
    return apart**2 / (busy + 1) if normalized else apart


def seams_of(work: Patchwork) -> NDArray[np.float64]:
    """Return what all seams cost, from the map of sources alone."""
    costs = np.zeros((2, *work.shape))
    for axis, y, x in np.ndindex(2, *work.shape):
        v, u = y + axis, x + 1 - axis
        if not work.wrap and (v >= work.shape[0] or u >= work.shape[1]):
            continue
        there = work.origin[v % work.shape[0], u % work.shape[1]] - (1 - axis, axis)
        if (there != work.origin[y, x]).any():
            costs[axis, y, x] = step(work.features, work.normalized, work.origin[y, x], there, axis)
    return costs


@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize("channels", [1, 6])
def test_the_seams_kept_are_those_of_the_map(normalized: bool, wrap: bool, channels: int) -> None:
    """However patches were cut into each other, what seams cost is what the map of sources says, to the rounding."""
    rng = np.random.default_rng(1)
    work = patchwork(rng, (17, 15), (21, 26), channels, normalized=normalized, wrap=wrap)
    cover(work, rng, (7, 8), 20)
    np.testing.assert_allclose(work.seams / UNIT, seams_of(work), atol=0.5 / UNIT + 1e-9)
    assert work.cost == work.seams.sum() / UNIT > 0


@settings(max_examples=40, deadline=None)
@given(st.booleans(), st.booleans(), st.sampled_from([1, 3]), st.integers(0, 10**6))
def test_a_patch_over_what_is_known_never_makes_seams_cost_more(
    normalized: bool, wrap: bool, channels: int, seed: int
) -> None:
    """Wherever a patch is laid on a finished output, all seams together cost as much as before, or less."""
    rng = np.random.default_rng(seed)
    work = patchwork(rng, (14, 13), (18, 20), channels, normalized=normalized, wrap=wrap)
    cover(work, rng, (6, 5), 0)
    assert work.known.all()
    for _ in range(10):
        before, (top, left) = work.cost, rng.integers((12, 15))
        window = (int(top), int(top) + 6, int(left), int(left) + 5)
        if work.lay(window, anywhere(work, rng, window), int(rng.integers(9))) == 0:
            assert work.cost == before
        assert work.cost <= before


@settings(max_examples=60, deadline=None)
@given(st.tuples(st.integers(1, 3), st.integers(1, 4)), st.booleans(), st.integers(0, 10**6))
def test_the_cut_is_the_least_of_all_choices(shape: tuple[int, int], some: bool, seed: int) -> None:
    """With the metric cost, no other choice of the new pixels makes the seams cost less: by trying all."""
    rng = np.random.default_rng(seed)
    features = rng.integers(0, 256, (9, 9, 2)).astype(np.int32)
    slopes, origin = np.zeros((2, 9, 9), np.int32), rng.integers(0, 9, (*shape, 2))
    origin[:, ::2] = origin[0, 0]
    known = rng.random(shape) < 0.8 if some else np.ones(shape, bool)
    choices = link_choices(features, slopes, False, origin, known, int(rng.integers(5)), int(rng.integers(5)))

    def total(new: NDArray[np.bool_]) -> int:
        sides = ((new[:, :-1], new[:, 1:], choices[0, :, :, :-1]), (new[:-1], new[1:], choices[1, :, :-1]))
        return int(sum(np.choose(first * 2 + second, [*kept, 0 * kept[0]]).sum() for first, second, kept in sides))

    every = (np.array(bits, bool).reshape(shape) for bits in itertools.product([0, 1], repeat=shape[0] * shape[1]))
    allowed = [new for new in every if new[~known].all()]
    found = cut_least_seams(choices, np.zeros(shape, bool), ~known)
    assert found[~known].all()
    # Rounding may leave a triangle inequality short by one part of a gray level on each link.
    assert total(found) <= min(total(new) for new in allowed) + choices.shape[2] * choices.shape[3] * 2
    if (choices[:, 0] <= choices[:, 1] + choices[:, 2]).all():
        assert total(found) == min(total(new) for new in allowed)


@pytest.mark.parametrize("wrap", [False, True])
def test_every_pixel_is_the_copy_that_the_map_names(wrap: bool) -> None:
    """Nothing is blended, and nothing left out."""
    rng = np.random.default_rng(3)
    work = patchwork(rng, (20, 30), (33, 41), wrap=wrap)
    cover(work, rng, (9, 12), 30)
    image, source = work.result()
    x, y, weight = np.moveaxis(source, -1, 0)
    np.testing.assert_array_equal(image, work.sample[y.astype(int), x.astype(int)])
    assert (weight == 1).all() and work.known.all()


def test_patches_that_continue_each_other_have_no_seam() -> None:
    """Where patches of a periodic sample are laid in phase nothing costs anything, and the period goes on."""
    tile = quantize(np.random.default_rng(0).random((6, 7, 3), np.float32))
    sample = np.tile(tile, (4, 4, 1))
    work = Patchwork(sample, np.rint(sample * 255).astype(np.int32), (50, 60))
    for top, left in itertools.product(range(0, 50, 5), range(0, 60, 8)):
        place = (left % 7 + 7 * (left % 2), top % 6)
        work.lay((top, min(top + 8, 50), left, min(left + 11, 60)), place)
    assert work.cost == 0
    np.testing.assert_array_equal(work.result()[0], np.tile(tile, (9, 9, 1))[:50, :60])


def test_seams_across_the_edges_count_where_the_output_wraps() -> None:
    """One patch over all of an output meets itself at the edges: that costs only where edges meet."""
    rng = np.random.default_rng(0)
    for wrap in (False, True):
        work = patchwork(rng, (12, 12), (10, 10), wrap=wrap)
        for top, left in itertools.product((0, 5), (0, 5)):
            work.lay((top, top + 5, left, left + 5), (left, top))
        assert (work.seams[0, :, :-1] == 0).all() and (work.seams[1, :-1] == 0).all()
        assert bool(work.seams[0, :, -1].any() and work.seams[1, -1].any()) is wrap


def test_a_bad_patch_is_covered_and_a_good_one_stays() -> None:
    """A patch in the middle of a sample's copy is replaced where that copy reaches it: no seam is left."""
    rng = np.random.default_rng(5)
    for normalized in (False, True):
        work = patchwork(rng, (40, 40), (30, 30), normalized=normalized)
        work.lay((0, 30, 0, 30), (4, 6))
        work.origin[10:16, 12:20] = np.stack(np.meshgrid(np.arange(8), np.arange(6)), -1)
        work.seams[...] = np.rint(seams_of(work) * UNIT)
        assert work.cost > 0
        assert work.lay((11, 13, 14, 17), (18, 17), reach=20) == 48
        assert work.cost == 0
        assert work.lay((5, 25, 8, 28), (0, 0)) == 0


def test_a_patch_never_fills_more_than_its_window() -> None:
    """However far it reaches: beyond, only what is known changes."""
    rng = np.random.default_rng(2)
    work = patchwork(rng, (30, 30), (60, 60))
    work.lay((10, 30, 10, 30), (0, 0))
    work.lay((20, 40, 20, 40), (5, 5), reach=50)
    known = np.zeros((60, 60), bool)
    known[10:30, 10:30] = known[20:40, 20:40] = True
    np.testing.assert_array_equal(work.known, known)
