"""Claims about an output of patches cut along seams: the record of seams, whole patches, and feathering."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.imaging.convert import quantize
from nrbench.synthesizers.canvas.canvas import Window
from nrbench.synthesizers.patchwork.patchwork import (
    EntirePatch,
    Features,
    Patchwork,
    Placement,
    SeamHeat,
    Translations,
    WholePatches,
    draw_translation,
)
from nrbench.synthesizers.patchwork.patchwork_kernels import UNIT


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
        work.lay_patch(window, anywhere(work, rng, window))


def anywhere(work: Patchwork, rng: np.random.Generator, window: Window) -> tuple[int, int]:
    """Draw a place that holds a window."""
    height, width = work.sample.shape[:2]
    x, y = rng.integers(width - (window[3] - window[2]) + 1), rng.integers(height - (window[1] - window[0]) + 1)
    return int(x), int(y)


def origin(work: Patchwork) -> NDArray[np.int64]:
    """Return the (x, y) in the sample of each pixel of an output."""
    return work.origin((0, work.shape[0], 0, work.shape[1]))


def step(features: Features, normalized: bool, power: int, one: Any, other: Any, axis: int) -> float:
    """Return what a change costs between two patches that show a link's first pixel at (x, y), by definition."""
    last = np.array(features.shape[1::-1]) - 1
    slopes = [np.gradient(features.astype(float), axis=k) for k in (1, 0)]
    apart, busy = 0.0, 0.0
    for ahead in (0, 1):
        ends = [np.clip(np.add(place, ahead * np.eye(2, dtype=int)[axis]), 0, last) for place in (one, other)]
        apart += float(np.linalg.norm(np.subtract(*(features[y, x].astype(float) for x, y in ends))))
        busy += sum(np.rint(UNIT * np.linalg.norm(slopes[axis][y, x])) / UNIT for x, y in ends)
    scale = UNIT if normalized and power == 1 else 1
    return scale * apart**power / (busy + 1 if normalized else 1)


def seams_of(work: Patchwork) -> NDArray[np.float64]:
    """Return what all seams cost, from the map of sources alone."""
    costs, shown = np.zeros((2, *work.shape)), origin(work)
    for axis, y, x in np.ndindex(2, *work.shape):
        v, u = y + axis, x + 1 - axis
        if not work.wrap and (v >= work.shape[0] or u >= work.shape[1]):
            continue
        there = shown[v % work.shape[0], u % work.shape[1]] - (1 - axis, axis)
        if (there != shown[y, x]).any():
            costs[axis, y, x] = step(work.features, work.normalized, work.power, shown[y, x], there, axis)
    return costs


@pytest.mark.parametrize(("normalized", "power"), [(False, 1), (True, 1), (True, 2)])
@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize("channels", [1, 6])
def test_the_seams_kept_are_those_of_the_map(normalized: bool, power: int, wrap: bool, channels: int) -> None:
    """The recorded costs of seams equal, up to rounding, those computed from the source map alone."""
    rng = np.random.default_rng(1)
    work = patchwork(rng, (17, 15), (21, 26), channels, normalized=normalized, wrap=wrap, power=power)
    cover(work, rng, (7, 8), 20)
    np.testing.assert_allclose(work.seams / UNIT, seams_of(work), atol=0.5 / UNIT + 1e-9)
    assert work.cost == work.seams.sum() / UNIT > 0


@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_no_other_part_of_a_patch_makes_the_seams_cost_less(seed: int, forced: bool) -> None:
    """Among many old seams, the part of a patch that is shown has the least total cost of all parts: by trying all."""
    rng = np.random.default_rng(seed)
    work = patchwork(rng, (9, 9), (4, 5))
    work.source[..., :2] = rng.choice(rng.integers(0, 9, (3, 2)), work.shape)
    work.known[:] = True
    work.seams[...] = np.rint(seams_of(work) * UNIT)
    before, pixel = work.source.copy(), (int(rng.integers(1, 3)), int(rng.integers(1, 4))) if forced else None
    place = rng.integers(5, size=2)
    y, x = np.indices((2, 3))
    patch, costs = np.stack([x, y], -1) + place, []
    for bits in itertools.product([False, True], repeat=6):
        new = np.array(bits).reshape(2, 3)
        if pixel is None or new[pixel[0] - 1, pixel[1] - 1]:
            work.source[1:3, 1:4, :2] = np.where(new[..., np.newaxis], patch, before[1:3, 1:4, :2])
            costs.append(seams_of(work).sum())
    work.source[...] = before
    work.lay_patch((1, 3, 1, 4), (int(place[0]), int(place[1])), forced_pixel=pixel)
    # Each of the 31 links is rounded to parts of a gray level.
    assert work.cost == pytest.approx(min(costs), abs=31 / UNIT)
    assert pixel is None or (work.source[pixel][:2] == np.subtract(pixel[::-1], (1, 1)) + place).all()


@pytest.mark.parametrize("wrap", [False, True])
def test_every_pixel_is_the_copy_that_the_map_names(wrap: bool) -> None:
    """Nothing is blended, and nothing left out."""
    rng = np.random.default_rng(3)
    work = patchwork(rng, (20, 30), (33, 41), wrap=wrap)
    cover(work, rng, (9, 12), 30)
    image, source = work.output()
    x, y, weight = np.moveaxis(source, -1, 0)
    np.testing.assert_array_equal(image, work.sample[y.astype(int), x.astype(int)])
    assert (weight == 1).all() and work.known.all()


def test_a_bad_patch_is_covered_and_a_good_one_stays() -> None:
    """A patch in the middle of a sample's copy is replaced where that copy reaches it: no seam is left."""
    rng = np.random.default_rng(5)
    for normalized in (False, True):
        work = patchwork(rng, (40, 40), (30, 30), normalized=normalized)
        work.lay_patch((0, 30, 0, 30), (4, 6))
        work.source[10:16, 12:20, :2] = np.stack(np.meshgrid(np.arange(8), np.arange(6)), -1)
        work.seams[...] = np.rint(seams_of(work) * UNIT)
        assert work.cost > 0
        assert work.lay_patch((0, 30, 0, 30), (4, 6)) == 48
        assert work.cost == 0
        assert work.lay_patch((5, 25, 8, 28), (0, 0)) == 0


def test_windows_at_extremes_cost_no_more_and_no_less_than_those_around() -> None:
    """Drawn windows are local minima of the cost of seams, or minima and maxima; both kinds are drawn."""
    rng = np.random.default_rng(4)
    work = patchwork(rng, (20, 20), (48, 54))
    cover(work, rng, (7, 8), 20)
    heat = SeamHeat(work, (12, 18))
    block = heat.block

    def cost(top: int, left: int) -> int:
        return int(work.seams[:, top : top + 12, left : left + 18].sum())

    kinds = set()
    for k in range(60):
        y0, y1, x0, x1 = heat.draw_extreme(rng, maxima=k % 2 == 1)
        assert (y1 - y0, x1 - x0) == (12, 18)
        near = [
            cost(top, left)
            for top in (y0 - block, y0, y0 + block)
            for left in (x0 - block, x0, x0 + block)
            if 0 <= top <= 48 - 12 and 0 <= left <= 54 - 18
        ]
        kind = "minimum" if cost(y0, x0) == min(near) else "maximum" if cost(y0, x0) == max(near) else "neither"
        kinds.add((k % 2 == 1, kind))
    assert kinds == {(False, "minimum"), (True, "minimum"), (True, "maximum")}


def gray_levels(
    rng: np.random.Generator | int, height: int, width: int, channels: int = 3, most: int = 255
) -> Features:
    """Return noise in whole gray levels."""
    return np.random.default_rng(rng).integers(0, most + 1, (height, width, channels)).astype(np.int32)


def output(shape: tuple[int, int], wrap: bool = False) -> Patchwork:
    """Return an output whose seams are written by hand."""
    return Patchwork(np.zeros((4, 4, 1), np.float32), np.zeros((4, 4, 1), np.int32), shape, wrap=wrap)


def indices(work: Patchwork, window: Window) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and the columns of a window."""
    return np.arange(*window[:2]) % work.shape[0], np.arange(*window[2:]) % work.shape[1]


@settings(max_examples=60)
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
    rows, columns = indices(work, window)
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
        rows, columns = indices(work, window)
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
        np.testing.assert_array_equal(heat._rated, heat._sum_windows(heat.costs * 0.5**heat.tries))


@settings(max_examples=60)
@given(
    st.tuples(st.integers(1, 23), st.integers(1, 23)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.tuples(st.integers(0, 3), st.integers(1, 4)),
    st.booleans(),
    st.integers(0, 99),
)
def test_ratings_are_the_sums_of_squared_differences_to_the_last_bit(
    shape: tuple[int, int], part: tuple[float, float], channels: tuple[int, int], everywhere: bool, seed: int
) -> None:
    """Fourier transforms give exactly the costs of a direct summation, for all windows, channels and known pixels."""
    rng = np.random.default_rng(seed)
    colors, total = channels[0], channels[0] + channels[1]
    height, width = (1 + int(share * (side - 1)) for share, side in zip(part, shape, strict=True))
    sample, window = (gray_levels(rng, *size, total, 1274) for size in (shape, (height, width)))
    known = rng.random((height, width)) < (2 if everywhere else 0.5)
    costs = np.zeros((shape[0] - height + 1, shape[1] - width + 1))
    for y, x in np.ndindex(costs.shape):
        squares = (sample[y : y + height, x : x + width].astype(np.int64) - window) ** 2
        costs[y, x] = squares[known, :colors].sum() + squares[..., colors:].sum()
    np.testing.assert_array_equal(Translations(sample, colors).compute_costs(window, known), costs)


def test_places_are_drawn_by_their_costs() -> None:
    """The share of a place's draws is its exp(-cost / scale) over that of all."""
    costs, rng = np.array([[0.0, 1.0], [2.0, 700.0]]), np.random.default_rng(0)
    found = [draw_translation(costs + 5, 2.0, rng) for _ in range(4000)]
    expected = np.exp(-costs / 2) / np.exp(-costs / 2).sum()
    for y, x in np.ndindex(2, 2):
        assert found.count((x, y)) / 4000 == pytest.approx(expected[y, x], abs=0.03)


def test_without_randomness_one_of_the_best_is_drawn() -> None:
    """At scale 0 every best place is drawn, and no other, be costs as large as they like."""
    costs, rng = np.array([[1e12, 3e9, 3e9], [3e9, 3e9 + 1, 1e15]]), np.random.default_rng(0)
    assert {draw_translation(costs, 0.0, rng) for _ in range(100)} == {(1, 0), (2, 0), (0, 1)}


SIZE = (5, 6)


@settings(max_examples=60)
@given(
    st.tuples(st.integers(1, 12), st.integers(1, 12)),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.sampled_from([1, 3]),
    st.sampled_from([0.0, 0.5, 1.0]),
    st.integers(0, 10**6),
)
def test_whole_patches_cost_what_brute_force_finds(
    sides: tuple[int, int], counts: tuple[int, int], channels: int, share: float, seed: int
) -> None:
    """Sums of squares and areas over partial overlaps equal those of a loop over all translations, exactly."""
    rng = np.random.default_rng(seed)
    (height, width), (rows, columns) = sides, counts
    patch = gray_levels(rng, height, width, channels)
    window = gray_levels(rng, height + rows - 1, width + columns - 1, channels)
    known = rng.random(window.shape[:2]) < share
    costs, areas = EntirePatch(patch, counts).compute_costs(window, known)
    for y, x in np.ndindex(counts):
        part = slice(y, y + height), slice(x, x + width)
        squares = ((window[part].astype(np.int64) - patch) ** 2).sum(-1)
        assert costs[y, x] == squares[known[part]].sum()
        assert areas[y, x] == known[part].sum()


def whole_patches(
    placement: Placement = "entire", shape: tuple[int, int] = (40, 50), seed: int = 0, **options: Any
) -> WholePatches:
    """Return an empty output of a sample of noise, 15 x 18 px."""
    rng = np.random.default_rng(seed)
    colors = gray_levels(rng, 15, 18)
    work = Patchwork(quantize((colors / 255).astype(np.float32)), colors, shape)
    given = {"randomness": 0.01, "least_overlap": 0.25, "margin": (2, 3), "size": SIZE} | options
    return WholePatches(work, colors, placement=placement, rng=rng, **given)


def guide_of(work: Patchwork) -> tuple[Features, Features]:
    """Return a guide of period 8 px, of an output and of its sample."""
    mask = np.tile(gray_levels(5, 8, 8), (40, 40, 1))
    return mask[: work.shape[0], : work.shape[1]], mask[: work.sample.shape[0], : work.sample.shape[1]]


@pytest.mark.parametrize("placement", ["entire", "sub-patch"])
def test_where_nothing_is_known_the_guide_alone_places(placement: Placement) -> None:
    """On an empty output the translations drawn are those in phase with the guide, all of them."""
    work = patchwork(np.random.default_rng(0), (32, 32), (40, 40))
    found = set()
    for seed in range(60):
        work.known[:] = False
        rng = np.random.default_rng(seed)
        WholePatches(work, work.features, (16, 16), placement, 0.01, 0.25, (0, 0), rng, guide_of(work)).cover_region(
            (3, 19, 5, 21)
        )
        found.add(tuple(work.source[3, 5, :2].tolist()))
    assert found == {(x, y) for x in (5, 13) for y in (3, 11)}


@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize("guided", [False, True])
def test_refining_never_makes_seams_cost_more_and_often_less(wrap: bool, guided: bool) -> None:
    """Pass by pass the cost of all seams falls or stays, and in the end it is less; forced pixels change the output."""
    costs = []
    for passes, forced in ((0, False), (1, False), (3, False), (1, True)):
        work = patchwork(np.random.default_rng(0), (40, 40), (64, 72), wrap=wrap)
        guide = guide_of(work) if guided else None
        rng = np.random.default_rng(1)
        made = WholePatches(work, work.features, (12, 12), "sub-patch", 0.05, 0.25, (2, 2), rng, guide)
        made.assemble_output(passes, lambda done: None, forced=forced)
        costs.append(work.cost)
    assert costs[0] >= costs[1] >= costs[2] and costs[2] < 0.995 * costs[0]
    assert costs[3] <= costs[0] and costs[3] != costs[1]


def fill(patches: WholePatches) -> list[Window]:
    """Cover regions until nothing is unknown, and return them."""
    regions = []
    while (region := patches.find_unknown()) is not None:
        regions.append(region)
        patches.cover_region(region)
    return regions


@pytest.mark.parametrize("placement", ["entire", "sub-patch", "random"])
@pytest.mark.parametrize("shape", [(40, 50), (7, 61), (5, 6)])
def test_regions_at_unknown_pixels_fill_the_output(placement: Placement, shape: tuple[int, int]) -> None:
    """The output becomes known, each patch covers its region, and every pixel comes from inside the sample."""
    patches = whole_patches(placement, shape)
    lay_patch, laid = patches.work.lay_patch, []

    def note(window: Window, place: tuple[int, int], **options: Any) -> int:
        laid.append(window)
        return lay_patch(window, place, **options)

    patches.work.lay_patch = note
    regions = fill(patches)
    assert patches.work.known.all()
    for (y0, y1, x0, x1), (top, bottom, left, right) in zip(regions, laid, strict=True):
        assert 0 <= top <= y0 < y1 <= bottom <= shape[0] and 0 <= left <= x0 < x1 <= right <= shape[1]
        assert (y1 - y0, x1 - x0) == SIZE
    shown = origin(patches.work)
    assert (shown >= 0).all() and (shown < (18, 15)).all()


@pytest.mark.parametrize("placement", ["entire", "sub-patch"])
def test_a_copy_is_continued(placement: Placement) -> None:
    """Where a part of the sample is known, the least cost is 0, at the translation that continues it."""
    patches = whole_patches(placement, randomness=0.0)
    patches.work.lay_patch((10, 20, 10, 20), (4, 3))
    patches.cover_region((15, 20, 15, 21))
    assert patches.work.cost == 0
    np.testing.assert_array_equal(patches.work.source[19, 20, :2], (14, 12))


@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("placement", ["entire", "sub-patch"])
def test_costs_are_means_over_what_is_compared(placement: Placement, guided: bool) -> None:
    """C is the mean squared difference over the compared known pixels, for each translation that covers the region.

    A guide is compared at all pixels. For sub-patches the mean of both is over these.
    """
    patches = whole_patches(placement, (30, 30), least_overlap=0.0)
    patches.guide = guide_of(patches.work) if guided else None
    rng, (height, width) = np.random.default_rng(2), patches.colors.shape[:2]
    patches.work.source[..., :2] = rng.integers(0, 15, (30, 30, 2))
    patches.work.known = rng.random((30, 30)) < 0.6
    y0, y1, x0, x1 = region = (14, 19, 1, 7)
    costs = patches._rate_translations(region)
    assert costs.shape == (height - 5 + 1, width - 6 + 1)
    compared = (y0 - 2, y1 + 2, 0, x1 + 3)
    for row, column in np.ndindex(costs.shape):
        top, left = y1 - height + row, x1 - width + column
        inside = (max(top, 0), min(top + height, 30), max(left, 0), min(left + width, 30))
        assert inside[0] <= y0 and inside[1] >= y1 and inside[2] <= x0 and inside[3] >= x1
        if placement == "sub-patch":
            covered = top <= compared[0] and compared[1] <= top + height and left <= 0 and compared[3] <= left + width
            if not covered:
                assert costs[row, column] == np.inf
                continue
            inside = compared
        a, b, c, d = inside
        shown = patches.work.read(patches.colors, inside).astype(np.int64)
        squares = ((patches.colors[a - top : b - top, c - left : d - left] - shown) ** 2).sum(-1)
        known, expected = patches.work.known[a:b, c:d], squares[patches.work.known[a:b, c:d]].mean()
        if patches.guide is not None:
            there, here = patches.guide[0][a:b, c:d], patches.guide[1][a - top : b - top, c - left : d - left]
            apart = ((here - there) ** 2).sum(-1)
            expected += apart.mean()
            if placement == "sub-patch":
                expected = (squares[known].sum() + apart.sum()) / known.size
        assert costs[row, column] == pytest.approx(expected, rel=1e-12)


def test_small_overlaps_are_not_considered() -> None:
    """Translations whose overlap is less than the least share of the largest one have an infinite cost."""
    patches = whole_patches(least_overlap=0.5)
    patches.work.lay_patch((0, 15, 0, 18), (0, 0))
    costs = patches._rate_translations((0, 5, 18, 24))
    areas = np.outer(np.arange(5, 16), np.arange(12, -1, -1))
    np.testing.assert_array_equal(np.isfinite(costs), areas >= 0.5 * areas.max())


@pytest.mark.parametrize("placement", ["entire", "sub-patch", "random"])
def test_what_is_shown_is_not_laid_again(placement: Placement) -> None:
    """In a known region the translation that it shows is never drawn, however well it fits."""
    patches = whole_patches(placement, randomness=0.0)
    fill(patches)
    patches.work.lay_patch((12, 20, 13, 25), (3, 4), forced_pixel=(15, 18))
    region = (13, 18, 14, 20)
    costs = patches._rate_translations(region)
    shown = {tuple(np.subtract((y, x), patches.work.source[y, x, 1::-1])) for y in range(13, 18) for x in range(14, 20)}
    for row, column in np.ndindex(costs.shape):
        if (18 - 15 + row, 20 - 18 + column) in shown:
            assert costs[row, column] == np.inf
    assert np.isfinite(costs).any()


def test_random_placement_draws_every_translation_that_covers_the_region() -> None:
    """The translations drawn are all that cover a region, and no others."""
    patches = whole_patches("random", (40, 50), size=(12, 15))
    drawn = set()
    for _ in range(300):
        patches.work.known[:] = False
        patches.cover_region((15, 27, 20, 35))
        x, y = patches.work.source[15, 20, :2]
        drawn.add((int(x), int(y)))
    assert drawn == {(x, y) for x in range(4) for y in range(4)}


def test_a_region_of_the_whole_sample_that_is_shown_already_stays() -> None:
    """If no translation is left, nothing changes."""
    patches = whole_patches("entire", (15, 18), size=(15, 18))
    patches.cover_region((0, 15, 0, 18))
    assert patches.cover_region((0, 15, 0, 18)) == 0
    assert patches.work.cost == 0


def two_patches(shape: tuple[int, int], seed: int = 0, channels: int = 3) -> Patchwork:
    """Return an output of a copy of the sample and, from column 9 on, another one."""
    rng = np.random.default_rng(seed)
    sample = quantize(rng.random((20, 30, channels), np.float32))
    work = Patchwork(sample, np.rint(sample * 255).astype(np.int32), shape)
    work.lay_patch((0, shape[0], 0, 9), (1, 2))
    work.lay_patch((0, shape[0], 9, shape[1]), (4, 5))
    return work


def blended(work: Patchwork, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, by definition, what the patches around each pixel weigh, and the mean of what they show there."""
    reach, (height, width) = math.ceil(2 * sigma), work.shape
    image, share = np.zeros((*work.shape, work.sample.shape[2])), np.zeros(work.shape)
    for y, x in np.ndindex(work.shape):
        weights: dict[tuple[int, int], float] = {}
        for j, i in np.ndindex(2 * reach + 1, 2 * reach + 1):
            v, u = y + j - reach, x + i - reach
            if 0 <= v < height and 0 <= u < width:
                column, row = origin(work)[v, u] + (x - u, y - v)
                if 0 <= row < work.sample.shape[0] and 0 <= column < work.sample.shape[1]:
                    weight = math.exp(-((j - reach) ** 2 + (i - reach) ** 2) / (2 * sigma**2))
                    weights[row, column] = weights.get((row, column), 0.0) + weight
        image[y, x] = sum(weight * work.sample[place] for place, weight in weights.items()) / sum(weights.values())
        share[y, x] = max(weights.values()) / sum(weights.values())
    return image, share


@pytest.mark.parametrize("sigma", [0.4, 1.0, 1.7])
@pytest.mark.parametrize("channels", [1, 3])
def test_seams_are_blended_as_defined(sigma: float, channels: int) -> None:
    """Image and weights equal those computed pixel by pixel from the definition."""
    work = two_patches((12, 20), channels=channels)
    image, source, _ = work.feathered(sigma)
    expected, share = blended(work, sigma)
    np.testing.assert_allclose(image, expected, atol=1e-6)
    np.testing.assert_allclose(source[..., 2], share, atol=1e-6)


def test_the_source_is_the_patch_of_the_largest_weight() -> None:
    """On either side of a straight seam the source map names the patch of that side."""
    work = two_patches((12, 20))
    np.testing.assert_array_equal(work.feathered(1.5)[1][..., :2], origin(work))
