import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.synthesizers.sampling.equal_places import (
    EqualPlaces,
    nearby_pixels,
    nearest_pixels,
    pixel_grid,
    search_shape,
)

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
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    lattice = Lattice((21.37 * c, 21.37 * s), (-18.81 * s, 18.81 * c))
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
