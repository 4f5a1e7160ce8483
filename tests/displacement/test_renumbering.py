"""Parts of a followed lattice that are whole vectors off are found, and numbered again."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from nrbench.datasets_procedural.brick import Brick
from nrbench.displacement.following import find_knots
from nrbench.displacement.growth import Knots
from nrbench.displacement.renumbering import renumber, similarity
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice, Points

SIDE = 176
ROWS, COLUMNS = 25, 29
FIRST = (-3, 5)


def bent_knots() -> Knots:
    """Return knots, two for each vector, on a lattice of 20 px that is bent by waves 5 s long."""
    u, v = np.meshgrid(np.arange(COLUMNS) + FIRST[0], np.arange(ROWS) + FIRST[1])
    u, v = u / 2, v / 2
    phase = 2 * np.pi / 5
    places = 20 * np.stack([u + 0.2 * np.sin(phase * v), v + 0.2 * np.sin(phase * u)], -1)
    slopes = np.zeros((ROWS, COLUMNS, 2, 2))
    slopes[..., 0, 0] = slopes[..., 1, 1] = 20
    slopes[..., 0, 1], slopes[..., 1, 0] = 4 * phase * np.cos(phase * v), 4 * phase * np.cos(phase * u)
    return Knots((2.0, 2.0), FIRST, places, slopes, np.full((ROWS, COLUMNS), 0.9))


def slipped(knots: Knots, shift: tuple[int, int], border: int) -> Knots:
    """Return knots of which those beyond a diagonal have places ``shift`` vectors off, behind a fault."""
    i, j = np.indices(knots.known.shape)
    beyond, fault = i + j > border + 1, np.abs(i + j - border) <= 1
    places = knots.places.copy()
    # What lies whole vectors away has the same content; the neighbors in the image have other numbers.
    places[beyond] = (knots.places + knots.slopes @ np.array(shift, float))[beyond]
    return replace(knots, places=places, correlation=np.where(fault, 0.6, 0.9))


def test_consistent_knots_keep_their_numbers() -> None:
    """However low a band of correlations across the image is, nothing is off."""
    knots = bent_knots()
    assert renumber(knots) is None
    assert renumber(slipped(knots, (0, 0), 36)) is None
    assert renumber(replace(knots, correlation=np.zeros_like(knots.correlation))) is None


SHIFTS = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (1, -1)]
"""Those by which a corner beyond a diagonal does not move away from it: parts more than 2 s apart are not compared."""


@given(st.sampled_from(SHIFTS), st.integers(33, 44))
@settings(max_examples=20)
def test_a_slipped_corner_gets_its_numbers_back(shift: tuple[int, int], border: int) -> None:
    """Away from the fault, and on an undeformed lattice, each place then has the numbers that belong to it."""
    knots = bent_knots()
    u, v = np.moveaxis(knots.cells, -1, 0)
    straight = replace(knots, places=20 * np.stack([u, v], -1), slopes=np.tile(20 * np.eye(2), (ROWS, COLUMNS, 1, 1)))
    found = renumber(slipped(straight, shift, border))
    assert np.abs(found.places - 20 * found.cells)[found.known].max() < 1e-9
    assert found.known.sum() > 0.5 * ROWS * COLUMNS


def test_parts_far_from_all_others_are_left_out() -> None:
    """A corner that no knot connects with the rest may have any numbers; another one that slipped is corrected."""
    knots = bent_knots()
    i, j = np.indices(knots.known.shape)
    apart, gap = i + j < 6, (i + j >= 6) & (i + j < 18)
    both = slipped(knots, (-1, 0), 40)
    found = renumber(replace(both, correlation=np.where(gap, 0.0, both.correlation)))
    left = {tuple(place) for place in found.places[found.known].tolist()}
    assert not left & {tuple(place) for place in both.places[apart].tolist()}


def test_slopes_that_turn_around_tell_nothing() -> None:
    """Where the slopes of two parts are opposite, no distance in cells can be measured: no part counts as off."""
    knots = bent_knots()
    column = np.arange(COLUMNS)
    slopes = np.where((column > 14)[:, np.newaxis, np.newaxis], -knots.slopes, knots.slopes)
    correlation = np.where(column == 14, 0.6, knots.correlation)
    assert renumber(replace(knots, slopes=slopes, correlation=correlation)) is None
    assert renumber(replace(knots, slopes=slopes)) is None


def test_a_part_between_the_knots_of_the_others_is_left_out() -> None:
    """With knots two vectors apart, a part that is five vectors off has no numbers. It is left out, not misplaced."""
    u, v = np.meshgrid(2.0 * np.arange(12), 2.0 * np.arange(10))
    places = 20 * np.stack([u, v], -1)
    places[:, 6:] += (-100, 0)  # five vectors: the part lies so near that it is compared
    slopes = np.tile(20 * np.eye(2), (10, 12, 1, 1))
    found = renumber(Knots((0.5, 0.5), (0, 0), places, slopes, np.full((10, 12), 0.9)))
    assert {tuple(place) for place in found.places[found.known].tolist()} <= {
        tuple(p) for p in places[:, :6].reshape(-1, 2)
    }
    assert np.abs(found.places - 20 * found.cells)[found.known].max() < 1e-9


def test_knots_on_one_line_are_not_renumbered() -> None:
    """They have no mean lattice. Neither do no knots at all."""
    knots = bent_knots()
    row = np.arange(ROWS)[:, np.newaxis] == 12
    line = replace(knots, correlation=np.where(row, knots.correlation, 0.0))
    assert knots.spans_plane and not line.spans_plane
    assert not replace(knots, correlation=0 * knots.correlation).spans_plane
    assert renumber(line) is None and similarity(line, (300, 300)) == 0


def test_the_similarity_is_a_mean_over_the_image() -> None:
    """Knots over half of the image have half the correlation; twice as many in the same place do not have more."""
    u, v = np.meshgrid(np.arange(20.0), np.arange(10.0))
    places = 10 * np.stack([u, v], -1) + 5
    slopes = np.tile(10 * np.eye(2), (10, 20, 1, 1))
    knots = Knots((1.0, 1.0), (0, 0), places, slopes, np.full((10, 20), 0.8))
    assert similarity(knots, (100, 200)) == pytest.approx(0.8)
    assert similarity(knots, (200, 200)) == pytest.approx(0.4, abs=0.03)
    twice = replace(
        knots,
        places=np.concatenate([places, places], 1),
        slopes=np.concatenate([slopes, slopes], 1),
        correlation=np.full((10, 40), 0.8),
    )
    assert similarity(twice, (100, 200)) == pytest.approx(0.8)
    assert similarity(replace(knots, correlation=np.zeros((10, 20))), (100, 200)) == 0


def warped_brick(seed: int) -> tuple[Image, Lattice, Points]:
    """Return a strongly warped wall, its undisturbed lattice, and the true cell coordinates of each pixel."""
    drawn = Brick(bend=1.0).render((SIDE, SIDE), np.random.default_rng(seed))
    points = np.stack(np.meshgrid(np.arange(SIDE, dtype=float), np.arange(SIDE, dtype=float)), -1)
    return quantize(drawn.image), drawn.lattice, drawn.lattice.to_cell(points - drawn.displacement)


@pytest.mark.parametrize("seed", [7, 8, 10, 15, 16])
def test_strongly_warped_walls_are_followed_without_slips(seed: int) -> None:
    """Rows of bricks look alike, so that a lattice that follows the strongest places first slips by a row. Few do."""
    image, lattice, cells = warped_brick(seed)
    knots = find_knots(image, lattice)
    places, found = knots.places[knots.known], knots.cells[knots.known]
    at = places.T[::-1]
    true = np.stack([map_coordinates(plane, at, order=1, mode="nearest") for plane in np.moveaxis(cells, -1, 0)], -1)
    change = np.rint(knots.mean_lattice().matrix @ np.linalg.inv(lattice.matrix))
    assert abs(np.linalg.det(change)) == pytest.approx(1)
    off = found @ change - true
    off = (off - np.median(off, 0)) @ lattice.matrix / lattice.s
    assert (np.hypot(*off.T) > 0.4).mean() < 0.05
