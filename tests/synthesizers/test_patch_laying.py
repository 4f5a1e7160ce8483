"""Claims about patches in raster order: their spots, the choice of one, feathering, and the tree of boundary zones."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import noise

from nrbench.imaging.convert import to_bytes
from nrbench.synthesizers.gap_filling.blocks import box_slices
from nrbench.synthesizers.gap_filling.matching import FrameMatcher, frame_mask
from nrbench.synthesizers.patch_laying.raster_canvas import (
    RasterCanvas,
    RasterGrid,
    blend,
    draw_within,
    feather_weights,
)
from nrbench.synthesizers.patch_laying.zone_tree import ZoneTree


@settings(max_examples=40)
@given(st.integers(1, 50), st.integers(1, 50), st.integers(4, 20), st.data())
def test_spots_cover_the_output_once_and_overlap(height: int, width: int, size: int, data: st.DataObject) -> None:
    """Every pixel is covered, a spot finds its overlap covered and no more, and no line or column is superfluous."""
    overlap = data.draw(st.integers(1, max(size // 2, 1)))
    grid = RasterGrid((height, width), size, overlap)
    covered = np.zeros((height + size, width + size), bool)
    for spot in grid.spots():
        window = covered[spot.y : spot.y + size, spot.x : spot.x + size]
        np.testing.assert_array_equal(window, frame_mask(grid.hole(spot.left, spot.top), size))
        window[:] = True
        assert spot.y == 0 or spot.y + overlap < height
        assert spot.x == 0 or spot.x + overlap < width
    assert covered[:height, :width].all()


def test_the_choice_is_uniform_among_what_fits() -> None:
    """Entries within the limit are drawn alike; others are never drawn."""
    errors = np.array([[5.0, 1.0], [2.0, 9.0]])
    rng = np.random.default_rng(0)
    counts = np.bincount([draw_within(errors, 2.0, rng) for _ in range(4000)], minlength=4)
    assert counts[0] == counts[3] == 0
    # Four standard deviations of a binomial of 4000 fair draws.
    assert abs(counts[1] - 2000) < 130


def test_there_is_always_a_choice() -> None:
    """If nothing fits, the least entries are drawn, all of them."""
    rng = np.random.default_rng(0)
    assert {draw_within(np.array([4.0, 3.0, 3.0]), 1.0, rng) for _ in range(50)} == {1, 2}


@pytest.mark.parametrize(("left", "top"), list(itertools.product([False, True], repeat=2)))
def test_feathering_is_linear_from_the_border(left: bool, top: bool) -> None:
    """A pixel's weight is its distance from the nearest overlapped side, over the zone's width plus 1, at most 1."""
    weights = feather_weights(9, 3, left, top)
    for y, x in itertools.product(range(9), repeat=2):
        assert weights[y, x] == min([4] + [x + 1] * left + [y + 1] * top)


@given(st.integers(0, 10_000), st.integers(1, 9))
def test_a_blend_is_the_rounded_weighted_mean(seed: int, zone: int) -> None:
    """A blend equals the exact mean to half a gray level, and equal pictures stay as they are."""
    rng = np.random.default_rng(seed)
    old, new = rng.integers(0, 256, (2, 4, 5, 3), dtype=np.uint8)
    weights = rng.integers(1, zone + 2, (4, 5))
    share = weights[..., np.newaxis] / (zone + 1)
    assert np.abs(blend(old, new, weights, zone) - (share * new + (1 - share) * old)).max() <= 0.5 + 1e-9
    np.testing.assert_array_equal(blend(old, old, weights, zone), old)


def test_the_source_of_a_feathered_pixel_has_the_largest_weight() -> None:
    """The source map equals a record of all weights of each pixel."""
    sample, grid = noise(30, 34), RasterGrid((30, 41), 12, 5)
    canvas = RasterCanvas(sample, grid)
    rng = np.random.default_rng(3)
    shares: list[np.ndarray] = []
    places = []
    for spot in grid.spots():
        place = (int(rng.integers(23)), int(rng.integers(19)))
        canvas.join_by_feathering(spot, place)
        share = np.zeros(canvas.image.shape[:2])
        share[canvas.window(spot)] = feather_weights(12, 5, spot.left, spot.top) / 6
        shares = [each * (1 - share) for each in shares] + [share]
        places.append((spot, place))
    image, source = canvas.result()
    every = np.stack(shares)[:, :30, :41]
    np.testing.assert_allclose(source[..., 2], every.max(0), rtol=1e-5)
    np.testing.assert_allclose(every.sum(0), 1)
    second = np.sort(every, 0)[-2]
    for y, x in np.argwhere(every.max(0) > second + 1e-6):
        spot, (px, py) = places[int(every[:, y, x].argmax())]
        assert source[y, x, :2].tolist() == [px + x - spot.x, py + y - spot.y]
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
