"""Claims about patches that are laid in raster order: their spots and choice, quilting, and patch-based sampling."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import noise, places, synthesize

from nrbench.imaging.convert import Image, to_bytes
from nrbench.plugins.forms import Refused
from nrbench.synthesizers import patch_based
from nrbench.synthesizers.canvas.canvas import Box, Canvas, Patch, copy_patch, feather_weights
from nrbench.synthesizers.gap_filling.blocks import box_slices
from nrbench.synthesizers.matching.frame_matching import FrameMatcher, frame_mask
from nrbench.synthesizers.patch_based import PatchBased, ZoneTree
from nrbench.synthesizers.patch_laying.raster_order import RasterGrid, draw_within
from nrbench.synthesizers.quilting import Quilting


@settings(max_examples=40)
@given(st.integers(1, 50), st.integers(1, 50), st.integers(4, 20), st.data())
def test_spots_cover_the_output_once_and_overlap(height: int, width: int, size: int, data: st.DataObject) -> None:
    """Every pixel is covered, a spot finds its overlap covered and no more, and no line or column is superfluous."""
    overlap = data.draw(st.integers(1, max(size // 2, 1)))
    grid = RasterGrid((height, width), size, overlap)
    covered = np.zeros((height + size, width + size), bool)
    for spot in grid.spots():
        top, left = spot.window[0], spot.window[2]
        window = covered[box_slices(spot.window)]
        np.testing.assert_array_equal(window, frame_mask(spot.hole, size))
        window[:] = True
        assert top == 0 or top + overlap < height
        assert left == 0 or left + overlap < width
    assert covered[:height, :width].all()


def test_the_choice_is_uniform_among_what_fits() -> None:
    """Entries within the limit are drawn alike, others never; if nothing fits, all of the least entries are drawn."""
    errors = np.array([[5.0, 1.0], [2.0, 9.0]])
    rng = np.random.default_rng(0)
    counts = np.bincount([draw_within(errors, 2.0, rng) for _ in range(4000)], minlength=4)
    assert counts[0] == counts[3] == 0
    # Four standard deviations of a binomial of 4000 fair draws.
    assert abs(counts[1] - 2000) < 130
    assert {draw_within(np.array([4.0, 3.0, 3.0]), 1.0, rng) for _ in range(50)} == {1, 2}


@pytest.mark.parametrize(("left", "top"), list(itertools.product([False, True], repeat=2)))
def test_feathering_is_linear_from_the_border(left: bool, top: bool) -> None:
    """A pixel's weight is its distance from the nearest overlapped side, over the zone's width plus 1, at most 1."""
    weights = feather_weights(9, 3, (left, top, False, False))
    for y, x in itertools.product(range(9), repeat=2):
        assert weights[y, x] == min([4] + [x + 1] * left + [y + 1] * top)


@given(st.integers(0, 10_000), st.integers(1, 9))
def test_a_blend_is_the_rounded_weighted_mean(seed: int, zone: int) -> None:
    """A blend equals the exact mean to half a gray level, and equal pictures stay as they are."""
    rng = np.random.default_rng(seed)
    old, new = rng.integers(0, 256, (2, 4, 5, 3), dtype=np.uint8)
    weights = rng.integers(1, zone + 2, (4, 5)).astype(float)
    share = weights[..., np.newaxis] / (zone + 1)
    canvas, source = Canvas((4, 5), 3, np.uint8), np.ones((4, 5, 3), np.float32)
    canvas.place((0, 4, 0, 5), (old, source))
    canvas.blend((0, 4, 0, 5), (new, source), weights, zone + 1)
    assert np.abs(canvas.image - (share * new + (1 - share) * old)).max() <= 0.5 + 1e-9
    canvas.place((0, 4, 0, 5), (old, source))
    canvas.blend((0, 4, 0, 5), (old, source), weights, zone + 1)
    np.testing.assert_array_equal(canvas.image, old)


def test_the_source_of_a_feathered_pixel_has_the_largest_weight() -> None:
    """The source map equals a record of all weights of each pixel."""
    sample, grid = noise(30, 34), RasterGrid((30, 41), 12, 5)
    canvas = Canvas(grid.shape, 3, np.uint8, (12, 12))
    rng = np.random.default_rng(3)
    shares: list[np.ndarray] = []
    places = []
    for spot in grid.spots():
        place = (int(rng.integers(23)), int(rng.integers(19)))
        weights = feather_weights(12, 5, spot.sides)
        canvas.blend(spot.window, copy_patch(to_bytes(sample), place, (12, 12)), weights, 6)
        share = np.zeros((42, 53))
        share[box_slices(spot.window)] = weights / 6
        shares = [each * (1 - share) for each in shares] + [share]
        places.append((spot, place))
    image, source = canvas.output()
    every = np.stack(shares)[:, :30, :41]
    np.testing.assert_allclose(source[..., 2], every.max(0), rtol=1e-5)
    np.testing.assert_allclose(every.sum(0), 1, rtol=1e-6)
    second = np.sort(every, 0)[-2]
    for y, x in np.argwhere(every.max(0) > second + 1e-6):
        spot, (px, py) = places[int(every[:, y, x].argmax())]
        assert source[y, x, :2].tolist() == [px + x - spot.window[2], py + y - spot.window[0]]
    # A pixel of one patch alone is a copy.
    copied = source[..., 2] == 1
    x, y = source[copied][:, :2].astype(int).T
    np.testing.assert_array_equal(image[copied], sample[y, x])


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("hole", [(0, 10, 3, 10), (3, 10, 0, 10), (3, 10, 3, 10)])
def test_the_tree_finds_a_zone_that_is_in_the_sample(channels: int, hole: tuple[int, int, int, int]) -> None:
    """A patch whose hole is filled with something else is found first."""
    sample = noise(31, 37, channels)
    tree = ZoneTree(FrameMatcher(sample, 10), hole)
    for x, y in ((0, 0), (27, 21), (11, 4)):
        template = to_bytes(sample)[y : y + 10, x : x + 10].astype(np.float32)
        template[box_slices(hole)] = 99
        assert tree.find_nearest(template, 3)[0].tolist() == [x, y]


def test_without_error_the_tree_returns_the_nearest_of_its_components() -> None:
    """An exact search returns the order of brute force over the principal components; with an error it stays within."""
    sample, hole = noise(40, 40, 1, seed=5), (4, 12, 4, 12)
    matcher = FrameMatcher(sample, 12)
    tree = ZoneTree(matcher, hole)
    template = to_bytes(noise(12, 12, 1, seed=6)).astype(np.float32)
    weights = tree._components
    frame = np.where(frame_mask(hole, 12)[..., np.newaxis], template, 0)
    away = tree._products / 4096 - np.tensordot(weights, frame, 3) / 4096
    distances = np.sqrt((away**2).sum(1))
    exact = tree.find_nearest(template, 20)
    ranks = distances[exact[:, 1] * 29 + exact[:, 0]]
    # Points are rounded to quarters of a gray level in 16 dimensions.
    assert (ranks <= np.sort(distances)[:20] + 1).all()
    loose = tree.find_nearest(template, 20, 0.5)
    assert (distances[loose[:, 1] * 29 + loose[:, 0]] <= 1.5 * np.sort(distances)[:20] + 2).all()


def test_the_tree_returns_at_most_all_patches() -> None:
    """A search for more patches than the sample has returns each patch once, also if all are equal."""
    for sample in (noise(14, 17), np.full((14, 17, 3), 0.4, np.float32)):
        tree = ZoneTree(FrameMatcher(sample, 10), (3, 10, 0, 10))
        found = tree.find_nearest(np.full((10, 10, 3), 99, np.float32), 2**40)
        assert {tuple(place) for place in found.tolist()} == {(x, y) for x in range(8) for y in range(5)}
        assert len(found) == 40


def periodic(period: tuple[int, int], shape: tuple[int, int], channels: int = 3, seed: int = 0) -> Image:
    """Return a tile of noise of (rows, columns), repeated."""
    tile = noise(*period, channels, seed)
    return np.tile(tile, (shape[0] // period[0] + 1, shape[1] // period[1] + 1, 1))[: shape[0], : shape[1]]


@settings(max_examples=15)
@given(st.integers(6, 14), st.integers(0, 100), st.sampled_from([1, 3]))
def test_a_periodic_sample_is_continued_exactly(period: int, seed: int, channels: int) -> None:
    """With blocks of a period, the output of a sample with an integer period has this period, to the last bit."""
    sample = periodic((period, period), (3 * period, 4 * period), channels, seed)
    image = synthesize(Quilting(block=period), sample, (70, 61), seed=seed).image
    np.testing.assert_array_equal(image[period:], image[:-period])
    np.testing.assert_array_equal(image[:, period:], image[:, :-period])
    shifts = [np.roll(sample[:period, :period], (y, x), (0, 1)) for y in range(period) for x in range(period)]
    assert any(np.array_equal(image[:period, :period], shift) for shift in shifts)


def distances(
    method: Quilting | PatchBased, sample: Image, shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> list[tuple[float, float, float]]:
    """Return, for each patch but the first, its distance, the least of all places, and the overlap's RMS.

    Distances are root mean squares over the overlap.
    """
    quilted = isinstance(method, Quilting)
    size, overlap = (method.block, method.overlap) if quilted else (method.patch, method.zone)
    name, found, values = "place" if quilted else "blend", [], to_bytes(sample)
    original = getattr(Canvas, name)

    def join(canvas: Canvas, window: Box, patch: Patch, *rest: Any) -> None:
        y, x = np.indices((size, size))
        known = ((window[2] > 0) & (x < overlap)) | ((window[0] > 0) & (y < overlap))
        if known.any():
            old = canvas.image[canvas.pixels(window)][known].astype(float)
            windows = np.lib.stride_tricks.sliding_window_view(values, (size, size), (0, 1))
            every = np.sqrt(((np.moveaxis(windows, 2, -1)[:, :, known] - old) ** 2).mean((2, 3)))
            left, top = patch[1][0, 0, :2].astype(int)
            found.append((every[top, left], every.min(), np.sqrt((old**2).mean())))
        original(canvas, window, patch, *rest)

    monkeypatch.setattr(Canvas, name, join)
    synthesize(method, sample, shape)
    return found


@pytest.mark.parametrize("tolerance", [0.0, 0.1, 0.6])
def test_every_block_is_within_the_tolerance(tolerance: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The overlap error of each block is at most 1 + tolerance times the least one, by naive loops over all places."""
    found = distances(Quilting(9, 3, tolerance), noise(20, 23), (40, 40), monkeypatch)
    # A sample of noise continues no block exactly beyond its edge, so the least error is seldom 0.
    ratios = [distance / least for distance, least, _ in found if least > 0]
    assert len(ratios) > 20
    assert max(ratios) <= 1 + tolerance + 1e-9
    assert (max(ratios) > 1) == (tolerance > 0)


def test_the_first_block_comes_from_anywhere() -> None:
    """Over many streams the first block takes all places of a small sample."""
    sample = noise(10, 10)
    first = {tuple(places(synthesize(Quilting(8, 2), sample, (8, 8), seed=k), 8)[0, 0]) for k in range(80)}
    assert len(first) == 9


def test_an_automatic_overlap_is_a_sixth_of_the_block() -> None:
    """Leaving the overlap out equals giving a sixth."""
    sample = noise(50, 50)
    automatic, given_one = (synthesize(Quilting(24, overlap), sample, (80, 80)).image for overlap in (0, 4))
    np.testing.assert_array_equal(automatic, given_one)


SEARCHES = ["exhaustive", "kdtree"]


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("epsilon", [0.0, 0.3, 0.5])
def test_a_patch_fits_or_is_the_best(search: Any, epsilon: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each patch is within d_max. If none is, an exhaustive search takes the best one; there is always a patch."""
    monkeypatch.setattr(patch_based, "NEIGHBORS", 15)
    monkeypatch.setattr(patch_based, "SEARCH_ERROR", 0.0)
    method = PatchBased(9, 3, epsilon, search)
    found = distances(method, noise(24, 27, seed=2), (45, 45), monkeypatch)
    assert len(found) == 48
    for distance, least, power in found:
        assert distance <= max(epsilon * power, least) + 1e-9 or search == "kdtree"
    if epsilon == 0.5:
        assert any(distance > least + 1e-9 for distance, least, _ in found)
    if search == "kdtree":
        # The tree finds patches that are much better than the mean one, even where none fits.
        assert np.mean([distance / least for distance, least, power in found if least > epsilon * power] or [1]) < 1.15


def test_a_tree_that_finds_all_patches_misses_none_that_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the tree returns all patches, each drawn patch is within d_max, or the best of all if none is."""
    monkeypatch.setattr(patch_based, "NEIGHBORS", 16 * 19)
    method = PatchBased(9, 3, 0.5, "kdtree")
    found = [(*two, 0.5 * power) for *two, power in distances(method, noise(24, 27, seed=2), (45, 45), monkeypatch)]
    assert all(distance <= max(limit, least) + 1e-9 for distance, least, limit in found)
    assert any(least > limit for _, least, limit in found) and any(distance > least for distance, least, _ in found)


def test_all_patches_that_fit_are_drawn_alike() -> None:
    """Where every patch fits, the second one comes from anywhere."""
    sample = noise(10, 10, 1) * np.float32(0.1) + np.float32(0.5)
    method = PatchBased(8, 2, epsilon=1.0)
    made = [synthesize(method, sample, (8, 14), seed=k).source for k in range(120)]
    assert len({tuple(source[4, 10, :2]) for source in made if source is not None}) == 9


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_periodic_sample_is_continued_exactly_by_patches(search: Any, channels: int) -> None:
    """With patches of a period and epsilon 0, the output of a periodic sample has this period, to the last bit."""
    image = synthesize(PatchBased(11, 3, 0.0, search), periodic((11, 11), (33, 44), channels, 3), (60, 71)).image
    np.testing.assert_array_equal(image[11:], image[:-11])
    np.testing.assert_array_equal(image[:, 11:], image[:, :-11])


def test_feathering_blends_the_two_patches_of_a_zone() -> None:
    """Across the zone between two patches, the output is the linear mean of both, to half a gray level."""
    sample = noise(30, 30, 3, seed=4)
    made = synthesize(PatchBased(12, 4, epsilon=10.0), sample, (12, 20))
    first, second = (made.source[6, x, :2].astype(int) - (x, 6) for x in (2, 14))
    values = to_bytes(sample).astype(float)
    for x in range(8, 12):
        share = (x - 7) / 5
        old = values[first[1] : first[1] + 12, first[0] + x]
        new = values[second[1] : second[1] + 12, second[0] + x]
        assert np.abs(made.image[:, x] * 255 - (share * new + (1 - share) * old)).max() <= 0.5 + 1e-3


@pytest.mark.parametrize(
    ("method", "shape", "reason"),
    [
        (Quilting(block=31), (30, 60), "block <= 30"),
        (PatchBased(patch=31), (30, 60), "patch <= 30"),
        (Quilting(overlap=10), (15, 40), "overlap of 10 px; choose overlap <= 7, and leave block out"),
        (Quilting(block=20, overlap=10), (15, 40), "overlap of 10 px; choose overlap <= 7, and leave block out"),
        (PatchBased(), (9, 40), "zone of 8 px; choose zone <= 4, and leave patch out"),
    ],
)
def test_a_sample_that_is_too_small_is_refused_with_a_way_out(
    method: Quilting | PatchBased, shape: tuple[int, int], reason: str
) -> None:
    """The refusal says what would fit: the largest patch, or the widest overlap if no patch of the sample holds it."""
    with pytest.raises(Refused, match=reason):
        synthesize(method, noise(*shape), (64, 64))
