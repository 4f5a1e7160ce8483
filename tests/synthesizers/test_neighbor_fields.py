"""Nearest patches: the search finds them, the mean of the patches found, and pyramids."""

import numpy as np
import pytest
from synthesis_cases import UPRIGHT, noise, waves

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.neighbor_fields.neighbor_field import NeighborField, make_grid
from nrbench.synthesizers.neighbor_fields.pyramid import list_resolutions, rescale, scale_shape


def nearest_distances(image: Image, other: Image, size: int) -> np.ndarray:
    """Return the squared distance of the nearest patch for each patch, by comparing all."""
    windows = [
        np.lib.stride_tricks.sliding_window_view(each, (size, size), (0, 1)).reshape(-1, size**2 * each.shape[2])
        for each in (image, other)
    ]
    return np.array([((windows[1] - patch) ** 2).sum(1).min() for patch in windows[0].astype(float)])


@pytest.mark.parametrize("spacing", [1, 4])
def test_a_crop_finds_itself(spacing: int) -> None:
    """Every patch of a crop of noise is found at its place, whatever the spacing of the patches."""
    sample = noise(40, 50)
    crop = sample[7:33, 9:48]
    field = NeighborField.draw(make_grid(crop.shape[:2], 8, spacing), 8, (40, 50), np.random.default_rng(0))
    field.search(crop, sample, np.random.default_rng(1), 20)
    expected = np.stack(np.meshgrid(field.grid[0] + 7, field.grid[1] + 9, indexing="ij"), -1)
    np.testing.assert_array_equal(field.matches, expected)
    np.testing.assert_array_equal(field.costs, 0)
    again = field.average(sample, crop.shape[:2], np.ones_like(field.costs), np.ones((8, 8), np.float32))
    np.testing.assert_allclose(again, crop, atol=1e-6)


def test_the_search_comes_near_the_nearest_patches() -> None:
    """On a texture with noise, costs are distances, and their mean is at most a tenth above that of the nearest."""
    rng = np.random.default_rng(2)
    picture = waves((60, 104), UPRIGHT) + 0.1 * rng.standard_normal((60, 104, 3)).astype(np.float32)
    image, sample = picture[:, :48], picture[:, 52:]
    exact = nearest_distances(image, sample, 7)
    field = NeighborField.draw(make_grid((60, 48), 7), 7, (60, 52), rng)
    field.search(image, sample, rng, 8)
    assert (field.costs.ravel() >= exact * (1 - 1e-4)).all()
    assert field.costs.mean() < 1.1 * exact.mean()


def test_no_search_worsens_a_match_and_factors_count() -> None:
    """A second search raises no cost, and places with a large factor are avoided."""
    sample, image, rng = noise(30, 30, seed=1), noise(30, 30, seed=2), np.random.default_rng(0)
    factors = np.ones((24, 24), np.float32)
    factors[:, :12] = 100
    field = NeighborField.draw(make_grid((30, 30), 7), 7, (30, 30), rng)
    field.search(image, sample, rng, 2, factors)
    before = field.costs.copy()
    field.search(image, sample, rng, 2, factors)
    assert (field.costs <= before).all()
    assert field.matches[..., 1].min() >= 12


def test_a_moved_field_keeps_its_matches() -> None:
    """At the double resolution, for smaller patches, all matches of a crop stay in place to a pixel."""
    field = NeighborField.draw(make_grid((20, 30), 8, 2), 8, (40, 50), np.random.default_rng(0))
    field.matches[:] = np.stack(np.meshgrid(field.grid[0] + 5, field.grid[1] + 3, indexing="ij"), -1)
    moved = field.move(make_grid((40, 60), 4), 4, (80, 100), 2.0)
    expected = np.stack(np.meshgrid(moved.grid[0] + 10, moved.grid[1] + 6, indexing="ij"), -1)
    np.testing.assert_array_equal(moved.matches, expected)


@pytest.mark.parametrize("factor", [0.75, 0.5, 4 / 3])
def test_rescaling_is_exact_in_scale(factor: float) -> None:
    """A smooth wave at another resolution is the wave of that resolution, at any pixel and whatever the shape."""
    y, x = np.mgrid[:61, :83]
    image = np.sin((x + 0.5) / 7 + (y + 0.5) / 9)[..., np.newaxis].astype(np.float32)
    shape = scale_shape((61, 83), factor)
    assert shape == (int(np.ceil(61 * factor)), int(np.ceil(83 * factor)))
    made = rescale(image, factor, shape)[..., 0]
    y, x = np.mgrid[: shape[0], : shape[1]]
    error = made - np.sin((x + 0.5) / factor / 7 + (y + 0.5) / factor / 9)
    assert np.abs(error[4:-4, 4:-4]).max() < 0.03


def test_resolutions_end_where_the_sample_or_a_patch_is_too_small() -> None:
    """They are powers of the ratio, and at the coarsest one the shorter side still has the least number of px."""
    assert list_resolutions((128, 200), 0.5, 32, 7) == [0.25, 0.5, 1]
    assert list_resolutions((128, 200), 0.5, 33, 7) == [0.5, 1]
    assert list_resolutions((9, 9), 0.75, 28, 9) == [1]
    with pytest.raises(Refused, match="8x9 px"):
        list_resolutions((9, 8), 0.75, 28, 9)
