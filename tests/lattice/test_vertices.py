"""Vertices: how many of the true ones were found, for lattices that are right, moved, too coarse, too fine, or bent."""

import numpy as np
import pytest

from nrbench import texture
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.vertices import Vertex, displace_vertices, fit_lattice, lay_vertices, match_vertices

LATTICE = Lattice((20.0, 1.0), (9.0, 15.0), (3.0, 4.0))
SHAPE = (200, 240)
TRUTH = lay_vertices(LATTICE, SHAPE, 30)


def points(lattice: Lattice) -> Points:
    """Return the points of a lattice in the image."""
    return lattice.points(SHAPE)


def listed(places: Points) -> list[Vertex]:
    """Return vertices at places; their numbers do not matter."""
    return [Vertex(0, 0, x, y) for x, y in places.tolist()]


@pytest.mark.parametrize(
    ("found", "recall", "precision"),
    [
        (LATTICE, 1, 1),
        (LATTICE.shifted((7.3, -5.1)), 1, 1),
        (Lattice((29.0, 16.0), (20.0, 1.0), (60.0, 5.0)), 1, 1),
        (Lattice((40.0, 2.0), (9.0, 15.0)), 1 / 2, 1),
        (Lattice((10.0, 0.5), (9.0, 15.0)), 1, 1 / 2),
        (Lattice((20.0, 1.0), (3.0, 5.0)), 1, 1 / 3),
    ],
)
def test_shares_of_regular_lattices(found: Lattice, recall: float, precision: float) -> None:
    """Any shift and basis is right; a supercell of k cells has the recall 1 / k, a subcell the precision 1 / k."""
    match = match_vertices(lay_vertices(found, SHAPE), TRUTH, SHAPE)
    assert (match.recall, match.precision) == (pytest.approx(recall, abs=0.03), pytest.approx(precision, abs=0.03))
    assert match.error == pytest.approx(0, abs=1e-5)


def test_planted_faults() -> None:
    """Vertices that are lost lower the recall; those moved by half a cell, or found twice, lower the precision."""
    found = points(LATTICE)
    middle = np.flatnonzero(((found > 40) & (found < 150)).all(1))[:10]
    lost = match_vertices(listed(np.delete(found, middle, 0)), TRUTH, SHAPE)
    judged = round(10 / (1 - (lost.recall or 0)))
    assert lost.precision == 1 and len(found) * 0.7 < judged < len(found)
    moved = found.copy()
    moved[middle] += np.array(LATTICE.t1) / 2
    assert match_vertices(listed(moved), TRUTH, SHAPE)[:2] == (
        pytest.approx(1 - 10 / judged),
        pytest.approx(1 - 10 / judged),
    )
    twice = match_vertices(listed(np.concatenate([found, found[middle]])), TRUTH, SHAPE)
    assert twice.recall == 1 and twice.precision == pytest.approx(judged / (judged + 10))
    nothing = match_vertices((), TRUTH, SHAPE)
    assert nothing == (0, None, None)


@pytest.mark.parametrize("change", [((1, 0), (0, 1)), ((0, 1), (1, 0)), ((1, 5), (0, -1))])
def test_numbers_of_the_truth_may_be_in_any_basis(change: tuple[tuple[int, int], ...]) -> None:
    """Rows and columns that are exchanged, reversed or sheared give the same shares."""
    truth = lay_vertices(Lattice.from_basis(np.array(change) @ LATTICE.matrix, LATTICE.origin), SHAPE, 30)
    found = listed(points(LATTICE) + np.random.default_rng(0).normal(0, 2, (len(points(LATTICE)), 2)))
    assert match_vertices(found, truth, SHAPE) == pytest.approx(match_vertices(found, TRUTH, SHAPE), abs=1e-4)


@pytest.mark.parametrize("bend", [0.3, 1.0])
def test_vertices_of_a_bent_model_lie_where_its_content_has_moved(bend: float) -> None:
    """The displacement at a vertex leads back to the lattice, and a shift of half a cell of a bent lattice is free."""
    drawn = texture("brick", shape=(128, 160), seed=3, bend=bend)
    truth = displace_vertices(drawn.lattice, drawn.displacement)
    inside = [each for each in truth if 0 <= each.x <= 159 and 0 <= each.y <= 127]
    ideal = drawn.lattice.from_cell([(each.column, each.row) for each in inside])
    moved = np.array([drawn.displacement[round(each.y), round(each.x)] for each in inside])
    assert np.hypot(*(np.array(inside)[:, 2:] - moved - ideal).T).max() < 0.5
    half = displace_vertices(drawn.lattice.shifted(np.array(drawn.lattice.t1) / 2), drawn.displacement)
    match = match_vertices(half, truth, (128, 160))
    assert match.recall == match.precision == 1 and match.error is not None and match.error < 0.03


def test_the_mean_lattice() -> None:
    """The lattice of vertices is that which laid them, numbered as they are."""
    assert fit_lattice(TRUTH).is_equivalent(LATTICE)
    assert fit_lattice(TRUTH).t1 == pytest.approx(LATTICE.t1)
