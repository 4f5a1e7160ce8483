from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.imaging.convert import quantize
from nrbench.synthesizers.patchwork.patchwork import Patchwork, Window
from nrbench.synthesizers.patchwork.translations import EntirePatch, Features
from nrbench.synthesizers.patchwork.whole_patches import Placement, WholePatches

SIZE = (5, 6)


def gray_levels(rng: np.random.Generator, height: int, width: int, channels: int = 3) -> Features:
    """Return noise in whole gray levels."""
    return rng.integers(0, 256, (height, width, channels)).astype(np.int32)


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

    patches.work.lay_patch = note  # type: ignore[method-assign]
    regions = fill(patches)
    assert patches.work.known.all()
    for (y0, y1, x0, x1), (top, bottom, left, right) in zip(regions, laid, strict=True):
        assert 0 <= top <= y0 < y1 <= bottom <= shape[0] and 0 <= left <= x0 < x1 <= right <= shape[1]
        assert (y1 - y0, x1 - x0) == SIZE
    assert (patches.work.origin >= 0).all() and (patches.work.origin < (18, 15)).all()


@pytest.mark.parametrize("placement", ["entire", "sub-patch"])
def test_a_copy_is_continued(placement: Placement) -> None:
    """Where a part of the sample is known, the least cost is 0, at the translation that continues it."""
    patches = whole_patches(placement, randomness=0.0)
    patches.work.lay_patch((10, 20, 10, 20), (4, 3))
    patches.cover_region((15, 20, 15, 21))
    assert patches.work.cost == 0
    np.testing.assert_array_equal(patches.work.origin[19, 20], (14, 12))


@pytest.mark.parametrize("placement", ["entire", "sub-patch"])
def test_costs_are_means_over_what_is_compared(placement: Placement) -> None:
    """C is the mean squared difference over the compared known pixels, for each translation that covers the region."""
    patches = whole_patches(placement, (30, 30), least_overlap=0.0)
    rng, (height, width) = np.random.default_rng(2), patches.colors.shape[:2]
    patches.work.origin = rng.integers(0, 15, (30, 30, 2))
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
        assert costs[row, column] == pytest.approx(squares[patches.work.known[a:b, c:d]].mean(), rel=1e-12)


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
    shown = {tuple(np.subtract((y, x), patches.work.origin[y, x, ::-1])) for y in range(13, 18) for x in range(14, 20)}
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
        x, y = patches.work.origin[15, 20]
        drawn.add((int(x), int(y)))
    assert drawn == {(x, y) for x in range(4) for y in range(4)}


def test_a_region_of_the_whole_sample_that_is_shown_already_stays() -> None:
    """If no translation is left, nothing changes."""
    patches = whole_patches("entire", (15, 18), size=(15, 18))
    patches.cover_region((0, 15, 0, 18))
    assert patches.cover_region((0, 15, 0, 18)) == 0
    assert patches.work.cost == 0
