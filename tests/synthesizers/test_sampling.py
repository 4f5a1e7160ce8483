"""Claims about reading patches at fractional places, and about the places that a lattice makes equal."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from synthesis_cases import UPRIGHT
from turned_lattices import turned

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.synthesizers.lattice_places.equal_places import (
    EqualPlaces,
    nearby_pixels,
    nearest_pixels,
    pixel_grid,
    search_shape,
)
from nrbench.synthesizers.sample_reading.patches import Patches, round_places
from nrbench.synthesizers.sample_reading.quintic_kernels import PAD, quintic_at


def waves(x: np.ndarray, y: np.ndarray, period: float = 7.3) -> Image:
    """Return a smooth function of the place."""
    turn = 2 * math.pi / period
    return (0.5 + 0.2 * np.cos(turn * x) + 0.2 * np.cos(turn * (x + y) + 1))[..., np.newaxis].astype(np.float32)


def grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of pixels."""
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    return x, y


def test_whole_pixel_places_are_copies() -> None:
    """At whole pixels, up to rounding errors, a patch is an exact copy, and its map says so."""
    sample = quantize(np.random.default_rng(0).random((30, 40, 3), np.float32))
    patch, source = Patches(sample).cut_patch(np.array([5 + 1e-9, 7 - 1e-9]), (8, 9))
    np.testing.assert_array_equal(patch, sample[7:15, 5:14])
    x, y = grid(8, 9)
    np.testing.assert_array_equal(source, np.stack([x + 5, y + 7, np.ones((8, 9))], -1))


@pytest.mark.parametrize("place", [(6.5, 9.0), (6.25, 9.75), (0.5, 0.5), (-0.5, 20.5)])
def test_between_pixels_a_wave_keeps_its_place_and_height(place: tuple[float, float]) -> None:
    """At fractional places a smooth texture is interpolated to 0.2 gray levels, except near edges."""
    x, y = grid(60, 60)
    sample = waves(x, y)
    patch, _ = Patches(sample).cut_patch(np.array(place), (20, 20))
    px, py = grid(20, 20)
    truth = waves(px + place[0], py + place[1])
    inner = np.s_[8:, 8:]
    assert np.abs(patch - truth)[inner].max() < 0.2 / 255


def test_short_waves_are_not_blurred() -> None:
    """Half a pixel aside a wave of 4 px keeps more than 97 % of its height, where bilinear interpolation keeps 71 %."""
    x, _ = grid(64, 64)
    sample = (0.5 + 0.4 * np.cos(2 * math.pi * (x + 0.5) / 4))[..., np.newaxis].astype(np.float32)
    patch, _ = Patches(sample).cut_patch(np.array([20.5, 20.0]), (20, 20))
    assert np.ptp(patch) / 0.8 > 0.97


def test_all_readings_of_a_place_agree() -> None:
    """A patch has the same pixels if cut at once, in part, or point by point, also at the sample's edges."""
    sample = quantize(np.random.default_rng(1).random((25, 31, 3), np.float32))
    patches, place = Patches(sample), np.array([-0.375, 9.25])
    whole, source = patches.cut_patch(place, (15, 31))
    part, _ = patches.cut_patch(np.add(place, (4, 3)), (5, 6))
    np.testing.assert_allclose(part, whole[3:8, 4:10], atol=1e-6)
    points, their_source = patches.read_with_source(np.stack(grid(15, 31), -1) + place)
    np.testing.assert_allclose(points, whole, atol=2e-6)
    np.testing.assert_allclose(their_source, source, atol=1e-6)


def test_the_map_names_the_place_between_pixels() -> None:
    """Half a pixel outside, the place is the edge itself, and its weight is 1."""
    _, source = Patches(np.zeros((10, 12, 1), np.float32)).cut_patch(np.array([-0.5, 3.25]), (4, 12))
    assert source[0, 0].tolist() == [-0.5, 3.25, 1] and source[-1, -1].tolist() == [10.5, 6.25, 1]


def test_places_are_rounded_far_below_what_shows() -> None:
    """Rounding moves a place by less than a hundredth of a pixel."""
    places = np.random.default_rng(2).random((100, 2)) * 500
    assert np.abs(round_places(places) - places).max() < 0.01


@pytest.mark.parametrize("channels", [1, 3])
def test_it_is_the_spline_of_scipy(channels: int) -> None:
    """At any points, also far outside, values equal scipy's spline of order 5, mirrored at the edges."""
    rng = np.random.default_rng(0)
    image = rng.random((11, 17, channels))
    planes = [ndimage.spline_filter(plane, 5, mode="mirror") for plane in np.moveaxis(image, 2, 0)]
    padded = np.pad(np.stack(planes, -1), ((PAD, PAD), (PAD, PAD), (0, 0)), "reflect")
    points = np.concatenate([rng.uniform(-40, 60, (500, 2)), rng.integers(-2, 20, (50, 2))])
    expected = [
        ndimage.map_coordinates(plane, points.T[::-1], order=5, mode="mirror", prefilter=False) for plane in planes
    ]
    np.testing.assert_allclose(quintic_at(padded, points), np.stack(expected, -1), atol=2e-6)


coordinate = st.floats(-3000, 3000)


def test_room_counts_the_places_wholly_inside() -> None:
    """A 60 px patch has 69 places along 128 px, and none where it does not fit."""
    assert search_shape(60, (128, 100)) == (69, 41)
    assert min(search_shape(60, (128, 50))) < 1


def test_all_equal_places_are_found_and_no_others() -> None:
    """On an upright whole-pixel lattice the candidates are the places of equal remainder."""
    places = nearest_pixels(EqualPlaces(Lattice((30, 0), (0, 24)), (69, 69)).find_places((95.0, 200.0)), (69, 69))
    assert sorted(map(tuple, places.tolist())) == [(x, y) for x in (5, 35, 65) for y in (8, 32, 56)]


@given(coordinate, coordinate, st.floats(0, 90))
def test_places_are_equal_by_the_lattice_and_round_into_the_room(x: float, y: float, degrees: float) -> None:
    """For any rotated lattice each place differs by a lattice vector and is inside, and none is missing."""
    lattice = turned(UPRIGHT, degrees)
    places = EqualPlaces(lattice, (69, 89)).find_places((x, y))
    np.testing.assert_allclose(lattice.wrap(places - (x, y)), 0, atol=1e-8)
    pixels = nearest_pixels(places, (69, 89))
    assert len(pixels) == len(places)
    assert ((pixels >= 0) & (pixels < (89, 69))).all()
    assert len(places) == pytest.approx(69 * 89 / lattice.area, abs=8)


@given(coordinate, coordinate, st.floats(0, 4))
def test_around_equals_brute_force(x: float, y: float, tolerance: float) -> None:
    """Nearby pixels are all those within the tolerance, each once, and always the nearest one."""
    lattice = Lattice((7.3, 1.1), (-2.2, 6.1))
    room = (19, 23)
    centers = EqualPlaces(lattice, room, max(tolerance, 0.5)).find_places((x, y))
    found = nearby_pixels(centers, tolerance, room)
    rows, columns = np.indices(room)
    everywhere = np.stack([columns, rows], -1).reshape(-1, 1, 2)
    near = (np.abs(everywhere - centers) <= max(tolerance, 0.5) + 1e-9).all(-1).any(1)
    assert sorted(map(tuple, found.tolist())) == sorted(map(tuple, everywhere[near, 0].tolist()))


def test_a_pixel_grid_counts_x_then_y_from_its_first_pixel() -> None:
    """Pixels are listed row by row, x before y."""
    assert pixel_grid(3, 2, -1, 7).tolist() == [[[-1, 7], [0, 7], [1, 7]], [[-1, 8], [0, 8], [1, 8]]]
    assert pixel_grid(0, 2).shape == (2, 0, 2)
