"""Lattices that are followed through bent images, and what is reported of the deformation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.knit import Knit
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.displacement.deformation_field import Deformation, fit_homography, map_points, pixel_places
from nrbench.displacement.following import find_knots, follow_on, merit, probe
from nrbench.displacement.growth import Knots, Start, cell_covariance, grow_from, grow_on
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import fold, interpolate
from nrbench.lattice.geometry import Lattice, Points

MODELS: dict[str, Model] = {"weave": Weave(noise=0.03), "hexagon": Hexagon(color=0.3, noise=0.03, period=21.3)}
SIDE = 160
TILT = np.array([[1.0, 0.05, 0.0], [-0.03, 1.0, 0.0], [8e-4, 5e-4, 1.0]])
"""Homography from the picture to the plane: at opposite corners its scales differ by a factor of 1.5."""


def warped(model: Model, bend: float, seed: int) -> tuple[Image, Lattice, Points]:
    """Return a warped draw, its undisturbed lattice, and the true cell coordinates of each pixel."""
    drawn = replace(model, bend=bend).render((SIDE, SIDE), np.random.default_rng(seed))
    return quantize(drawn.image), drawn.lattice, drawn.lattice.to_cell(pixel_places(SIDE, SIDE) - drawn.displacement)


def tilted(model: Model, seed: int) -> tuple[Image, Lattice, Points]:
    """Return a draw in perspective, its lattice on the plane, and the true cell coordinates of each pixel."""
    plane = map_points(TILT, pixel_places(SIDE, SIDE))
    drawn = model.render((SIDE + 20, SIDE + 20), np.random.default_rng(seed))
    return quantize(interpolate(drawn.image, plane)), drawn.lattice, drawn.lattice.to_cell(plane)


def field_errors(found: Deformation, cells: Points) -> Points:
    """Return how far each knot was found from its true place, in s, up to a shift of the whole lattice."""
    at = found.places.T[::-1]
    true = np.stack([map_coordinates(plane, at, order=1, mode="nearest") for plane in np.moveaxis(cells, -1, 0)], -1)
    design = np.column_stack([found.cells, np.ones(len(true))])
    change = np.rint(np.linalg.lstsq(design, true, rcond=None)[0][:2])
    assert abs(np.linalg.det(change)) == pytest.approx(1)
    off = found.cells @ change - true
    off = (off - np.median(off, 0)) @ np.linalg.inv(change) @ found.lattice.matrix / found.lattice.s
    return np.asarray(np.hypot(*off.T))


def deformation(image: Image, lattice: Lattice) -> Deformation:
    """Return the deformation, which must be found."""
    knots = find_knots(image, lattice)
    return Deformation(image, knots)


@pytest.mark.parametrize("name", MODELS)
def test_warps_as_strong_as_bend_1_are_followed(name: str) -> None:
    """Slopes of 0.3 are followed from the undisturbed lattice: nearly no knot slips, half lie within 0.05 s."""
    image, lattice, cells = warped(MODELS[name], 1.0, 1)
    found = deformation(image, lattice)
    errors = field_errors(found, cells)
    assert np.median(errors) < 0.05 and (errors > 0.25).mean() < 0.03 and found.covered > 0.75
    assert found.bent and found.homography is None


@pytest.mark.parametrize("name", MODELS)
def test_a_plane_in_perspective_is_a_homography(name: str) -> None:
    """It is found within 0.03 s, and straightened the image repeats by one lattice, twice as well as before."""
    image, lattice, cells = tilted(MODELS[name], 2)
    found = deformation(image, lattice)
    assert found.bent and found.homography is not None and np.quantile(field_errors(found, cells), 0.9) < 0.04
    straight, mean = found.straighten()
    rest = np.square(straight - fold(straight, mean).unfold(straight.shape[:2])).mean()
    before = np.square(image - fold(image, lattice).unfold(image.shape[:2])).mean()
    assert rest < before / 2 and min(straight.shape[:2]) > 100


def test_a_homography_is_the_true_one_up_to_an_affine_map() -> None:
    """The plane is known up to affine maps, so the vanishing line, which they keep, is the test."""
    image, lattice, _ = tilted(MODELS["weave"], 3)
    matrix = deformation(image, lattice).homography
    # The line of the picture that maps to infinity: the last row of the map from the picture to the plane.
    line, true = np.linalg.inv(matrix)[2], TILT[2]
    assert line[:2] / line[2] == pytest.approx(true[:2] / true[2], rel=0.05)


@pytest.mark.parametrize("jitter", [0.0, 0.5])
def test_a_straight_image_is_not_bent(jitter: float) -> None:
    """Elements that move on their own share no displacement with their neighbors; the picture stays as it is."""
    drawn = Hexagon(jitter=jitter, period=21.3).render((SIDE, SIDE), np.random.default_rng(4))
    assert drawn.lattice is not None
    found = deformation(quantize(drawn.image), drawn.lattice)
    assert not found.bent and found.homography is None and found.smoothness < 0
    assert found.straighten()[0] is found.image


def test_the_mean_lattice_is_the_least_squares_fit() -> None:
    """The displacements have no affine part: they are orthogonal to constants and to both cell coordinates."""
    found = deformation(*warped(MODELS["hexagon"], 0.5, 5)[:2])
    design = np.column_stack([found.cells, np.ones(len(found.cells))])
    assert np.abs(design.T @ found.field).max() < 1e-6 * np.abs(design).sum()
    assert found.lattice.matrix == pytest.approx(found.lattice.reduced().matrix)


def test_knots_are_located_where_they_were_found() -> None:
    """Splines pass through the knots, and between two knots lie about their middle."""
    found = deformation(*warped(MODELS["weave"], 0.5, 6)[:2])
    points = found.lattice.from_cell(found.cells)
    assert np.abs(found.locate(points) - found.places).max() < 1e-6


def test_a_subcell_is_followed_on_from_a_supercell() -> None:
    """Given the knots of a supercell, the lattice itself is found in the same places."""
    image, lattice, cells = warped(MODELS["weave"], 0.25, 7)
    reduced = lattice.reduced()
    double = Lattice.from_basis(np.array([[2, 0], [0, 1]]) @ reduced.matrix)
    knots = find_knots(image, double)
    change = reduced.matrix @ np.linalg.inv(knots.mean_lattice().matrix)
    other = follow_on(image, knots, change)
    assert np.median(field_errors(Deformation(image, other), cells)) < 0.05
    assert merit(image, other) > merit(image, knots)


def test_a_wrong_lattice_is_not_followed_far() -> None:
    """The way of the true lattice scores at least twice that of a lattice that is a third longer."""
    image, lattice, _ = warped(MODELS["hexagon"], 0.0001, 8)
    middle = np.array([SIDE / 2, SIDE / 2])
    wrong = Lattice.from_basis(1.4 * lattice.reduced().matrix)
    assert probe(image, lattice, middle) > 2 * probe(image, wrong, middle)


def test_knots_that_were_not_found_continue_the_slopes() -> None:
    """On an affine grid, places of missing knots are exact."""
    rows, columns = 6, 7
    slopes = np.array([[20.0, 3.0], [-2.0, 15.0]])
    empty = Knots(
        (2.0, 2.0),
        (-3, 1),
        np.zeros((rows, columns, 2)),
        np.tile(slopes, (rows, columns, 1, 1)),
        np.ones((rows, columns)),
    )
    places = empty.cells @ slopes.T + (5.0, 9.0)
    correlation = np.zeros((rows, columns))
    correlation[2:4, 2:4] = 0.9
    knots = replace(empty, places=np.where(correlation[..., np.newaxis] > 0, places, 0.0), correlation=correlation)
    assert np.abs(knots.locate(knots.cells) - places).max() < 1e-9
    assert knots.area == pytest.approx(4 * abs(np.linalg.det(slopes)) / 4)
    assert np.abs(knots.mean_lattice().matrix - slopes.T).max() < 1e-9


def test_growth_needs_a_start_that_fits() -> None:
    """From a start half a cell off nothing is found, from one that fits nearly everything."""
    image, lattice, _ = warped(MODELS["weave"], 0.0001, 9)
    reduced = lattice.reduced()
    tile = fold(image, reduced)
    middle = reduced.from_cell(np.rint(reduced.to_cell((SIDE / 2, SIDE / 2))))
    cell = reduced.to_cell(middle)
    good = grow_from(image, Start(tile, cell, middle, reduced.matrix.T), (0.6,))
    off = grow_from(image, Start(tile, cell, middle + reduced.matrix.sum(0) / 2, reduced.matrix.T), (0.95,))
    assert good.area > 0.8 * SIDE**2 and off.known.sum() < good.known.sum() / 10


def test_a_start_that_fits_too_little_for_one_level_is_tried_at_the_next() -> None:
    """A first level that no place reaches changes nothing."""
    image, lattice, _ = warped(MODELS["weave"], 0.25, 9)
    reduced = lattice.reduced()
    middle = reduced.from_cell(np.rint(reduced.to_cell((SIDE / 2, SIDE / 2))))
    start = Start(fold(image, reduced), reduced.to_cell(middle), middle, reduced.matrix.T)
    one, other = (grow_from(image, start, levels, fine=False) for levels in ((0.5,), (0.9999, 0.5)))
    assert one.known.sum() > 40 and (one.correlation == other.correlation).all()


def test_the_lattice_is_followed_on_into_a_gap() -> None:
    """Knots that were taken away, of any part of the image, are found again where they were."""
    image, lattice, _ = warped(MODELS["hexagon"], 0.5, 10)
    knots = find_knots(image, lattice)
    rows, columns = knots.known.shape
    i, j = np.indices((rows, columns))
    gap = (np.abs(i - rows // 2) < rows // 5) & (np.abs(j - columns // 2) < columns // 5) | (i < 4)
    mean = knots.mean_lattice()
    tile = fold(interpolate(image, knots.locate(mean.to_cell(pixel_places(SIDE, SIDE)))), mean)
    found = grow_on(image, tile, replace(knots, correlation=np.where(gap, 0.0, knots.correlation)), (0.5,))
    before = dict(zip(map(tuple, knots.cells[knots.known & gap]), knots.places[knots.known & gap], strict=True))
    after = dict(zip(map(tuple, found.cells[found.known]), found.places[found.known], strict=True))
    again = [np.hypot(*(after[cell] - place)) / mean.s for cell, place in before.items() if cell in after]
    assert len(again) > 0.8 * len(before) > 20 and np.median(again) < 0.03


def test_a_bent_lattice_with_a_longer_vector_counts_as_bent() -> None:
    """The vectors of a knit are 1 and 1.3 s long, where displacements of knots one vector apart hardly correlate."""
    drawn = Knit(bend=0.5).render((224, 224), np.random.default_rng(1000))
    assert np.hypot(*drawn.lattice.reduced().t2) > 1.25 * drawn.lattice.s
    found = deformation(quantize(drawn.image), drawn.lattice)
    assert found.bent and found.smoothness > 15


@given(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3), st.floats(0.5, 2.0), st.floats(-30, 30))
@settings(max_examples=25)
def test_a_homography_is_fitted_exactly_despite_outliers(p: float, q: float, scale: float, shift: float) -> None:
    """Pairs of any homography give it back, though one pair in twelve is far off."""
    matrix = np.array([[scale, 0.1, shift], [-0.2, scale, 3.0], [p, q, 1.0]])
    points = np.random.default_rng(0).uniform(0, 200, (60, 2))
    images = map_points(matrix, points)
    images[::12] += (25.0, -40.0)
    found = fit_homography(points, images)
    assert map_points(found, points[1:12]) == pytest.approx(map_points(matrix, points[1:12]), abs=1e-5)


def test_too_few_pairs_have_no_homography() -> None:
    """Eight parameters are not fitted to four pairs."""
    points = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    assert fit_homography(points, points) is None


def test_the_window_does_not_depend_on_the_basis() -> None:
    """A cell's covariance does not depend on the basis; that of a square is s^2 / 12 along both axes."""
    square = Lattice((20.0, 0.0), (0.0, 20.0))
    np.testing.assert_allclose(cell_covariance(square), np.eye(2) * 400 / 12, rtol=0.01, atol=0.1)
    skew = Lattice((20.0, 0.0), (40.0, 20.0))
    np.testing.assert_allclose(cell_covariance(skew), cell_covariance(square), rtol=0.02, atol=0.2)
