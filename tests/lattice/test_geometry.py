"""The algebra of lattices: bases, wrapping, points, kinds, duals, supercells and subcells."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from turned_lattices import turned

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, hermite_matrices, integers_within, reduce_bases
from nrbench.lattice.relation import lattice_error

HEXAGONAL = Lattice((20.0, 0.0), (10.0, 10 * math.sqrt(3)))


@st.composite
def lattices(draw: st.DrawFn) -> Lattice:
    """Draw a lattice of moderate shape, in any direction, with any origin."""
    length, ratio = draw(st.floats(4, 40)), draw(st.floats(0.4, 2.5))
    degrees, angle = draw(st.floats(0, 360)), draw(st.floats(0.3, math.pi - 0.3))
    origin = draw(st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
    basis = length * np.array([(1, 0), (ratio * math.cos(angle), ratio * math.sin(angle))])
    return Lattice.from_basis(turned(Lattice.from_basis(basis), degrees).matrix, origin)


@st.composite
def unimodular(draw: st.DrawFn) -> np.ndarray:
    """Draw an integer matrix of determinant +-1: shears of either vector, and perhaps a swap."""
    i, j, k = (draw(st.integers(-3, 3)) for _ in range(3))
    matrix = np.array([[1, i], [0, 1]]) @ np.array([[1, 0], [j, 1]]) @ np.array([[1, k], [0, 1]])
    return matrix[::-1] if draw(st.booleans()) else matrix


def rebased(lattice: Lattice, change: np.ndarray, origin: tuple[float, float] = (0.0, 0.0)) -> Lattice:
    """Return the lattice of another basis."""
    return Lattice.from_basis(change @ lattice.matrix, origin)


@given(lattices(), unimodular())
def test_a_change_of_basis_changes_nothing(lattice: Lattice, change: np.ndarray) -> None:
    """Area, s, equivalence and dual do not depend on the basis or the origin."""
    other = rebased(lattice, change, (3.0, -1.0))
    assert other.area == pytest.approx(lattice.area)
    assert other.s == pytest.approx(lattice.s)
    assert lattice.is_equivalent(other) and other.is_equivalent(lattice)
    assert lattice.is_equivalent(lattice.reduced())
    assert other.dual().is_equivalent(lattice.dual(), 1e-9)


@given(lattices(), unimodular(), st.sampled_from([((2, 0), (0, 1)), ((1, 1), (1, -1)), ((1, 2), (1, 5))]))
def test_a_supercell_is_another_lattice(lattice: Lattice, change: np.ndarray, step: object) -> None:
    """A matrix of determinant 2 or 3 gives no equivalent lattice, seen from either side."""
    other = rebased(lattice, change @ np.array(step))
    assert not lattice.is_equivalent(other) and not other.is_equivalent(lattice)


def test_equivalence_has_a_tolerance_in_px() -> None:
    """A vector that is off by 0.5 px is the same within 0.6 px, and another within 0.4 px."""
    other = Lattice((20.0, 0.5), (10.0, 10 * math.sqrt(3)))
    assert HEXAGONAL.is_equivalent(other, 0.6) and not HEXAGONAL.is_equivalent(other, 0.4)


@given(lattices())
def test_the_reduced_basis_is_short_and_nearly_orthogonal(lattice: Lattice) -> None:
    """No integer combination is shorter than t1, and the angle lies between 60 and 90 degrees."""
    reduced = lattice.reduced()
    a, b = reduced.matrix
    steps = np.array([(i, j) for i in range(-3, 4) for j in range(-3, 4) if (i, j) != (0, 0)])
    assert np.hypot(*(steps @ reduced.matrix).T).min() == pytest.approx(np.hypot(*a))
    assert np.hypot(*a) <= np.hypot(*b) * (1 + 1e-9)
    angle = math.degrees(math.acos(np.clip(a @ b / np.hypot(*a) / np.hypot(*b), -1, 1)))
    assert 60 - 1e-4 <= angle <= 90 + 1e-4


KINDS = {
    Lattice((20, 0), (0, 20)): "square",
    Lattice((20, 0), (0, 30)): "rectangular",
    HEXAGONAL: "hexagonal",
    Lattice((20, 0), (10, 12)): "rhombic",
    Lattice((20, 0), (10, 30)): "rhombic",
}
TIED = [*KINDS]
"""Lattices with equally short vectors."""


@given(st.sampled_from(TIED), unimodular(), st.floats(0, 360))
def test_the_canonical_basis_is_the_lattices_own(lattice: Lattice, change: np.ndarray, degrees: float) -> None:
    """Lattices with equally short vectors have one canonical basis, whatever the basis given, and it is reduced."""
    given = turned(lattice, degrees)
    one, other = given.canonical(), rebased(given, change).canonical()
    np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*one.matrix.T), np.hypot(*given.reduced().matrix.T), rtol=1e-9)
    a, b = one.matrix
    assert one.is_equivalent(given) and -1e-6 <= a @ b <= a @ a / 2 + 1e-6


@given(
    st.sampled_from(TIED), unimodular(), st.integers(-9, 9), st.integers(-9, 9), st.integers(-4, 4), st.integers(-4, 4)
)
def test_ties_in_wrapping_are_the_lattices_own(
    lattice: Lattice, change: np.ndarray, i: int, j: int, a: int, b: int
) -> None:
    """Half vectors and centers of triangles wrap to one position from any basis and cell, which wraps to itself."""
    places = np.array([(0.5, 0), (0, 0.5), (0.5, 0.5), (1 / 3, 1 / 3), (2 / 3, 2 / 3), (a / 6, b / 6)])
    wrapped = lattice.wrap(places @ lattice.matrix)
    again = rebased(lattice, change).wrap((places + np.array([i, j])) @ lattice.matrix)
    np.testing.assert_allclose(again, wrapped, atol=1e-9)
    np.testing.assert_allclose(lattice.wrap(wrapped), wrapped, atol=1e-9)


def test_a_tie_goes_right_then_down() -> None:
    """The four corners of a square Voronoi cell wrap to the one at the lower right."""
    corners = [(10, 10), (-10, 10), (10, -10), (-10, -10)]
    np.testing.assert_allclose(Lattice((20, 0), (0, 20)).wrap(corners), [(10, 10)] * 4)


@pytest.mark.parametrize("lattice", [Lattice((2, 0), (0.7, 1e4)), Lattice((1e4, 3), (1e4 + 1.5, 1e4 + 2))])
def test_long_lattices_wrap_and_list_their_points(lattice: Lattice) -> None:
    """A wrapped displacement of 1e5 px differs by whole vectors, and all points of a 40 x 1000 strip are listed."""
    d = np.random.default_rng(0).uniform(-1e5, 1e5, (200, 2))
    wrapped = lattice.wrap(d)
    steps = (d - wrapped) @ np.linalg.inv(lattice.matrix)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    assert (np.hypot(*wrapped.T) <= lattice.covering_radius * (1 + 1e-9)).all()
    assert abs(len(lattice.points((40, 1000))) - 40_000 / lattice.area) <= 501


@given(lattices())
def test_the_dual_is_reciprocal(lattice: Lattice) -> None:
    """Its vectors give 1 with their own and 0 with the other, its area is the inverse, its dual the lattice."""
    dual = lattice.dual()
    np.testing.assert_allclose(dual.matrix @ lattice.matrix.T, np.eye(2), atol=1e-12)
    assert dual.area == pytest.approx(1 / lattice.area)
    np.testing.assert_allclose(dual.dual().matrix, lattice.matrix, rtol=1e-9, atol=1e-9)


@given(lattices())
def test_the_covering_radius_is_that_of_the_deepest_hole(lattice: Lattice) -> None:
    """No wrapped displacement is longer, some are nearly as long; displacements below s / 2 wrap to themselves."""
    u, v = np.mgrid[0:1:0.02, 0:1:0.02]
    away = np.hypot(*np.moveaxis(lattice.wrap(np.stack([u, v], -1) @ lattice.reduced().matrix), -1, 0))
    assert lattice.covering_radius * 0.93 < away.max() <= lattice.covering_radius * (1 + 1e-9)
    near = np.array([lattice.s / 2 * 0.99, 0.0])
    np.testing.assert_allclose(lattice.wrap(near), near, atol=1e-9)


@given(lattices(), st.floats(-200, 200), st.floats(-200, 200))
def test_wrap_lands_in_the_voronoi_cell(lattice: Lattice, x: float, y: float) -> None:
    """The wrapped displacement differs by a lattice vector, and no lattice point brings it nearer to zero."""
    wrapped = lattice.wrap((x, y))
    steps = (np.array([x, y]) - wrapped) @ np.linalg.inv(lattice.matrix)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    around = np.array([(i, j) for i in range(-4, 5) for j in range(-4, 5)]) @ lattice.reduced().matrix
    assert np.hypot(*wrapped) <= np.hypot(*(wrapped + around).T).min() + 1e-9


@given(lattices(), st.floats(-100, 100), st.floats(-100, 100))
def test_cell_coordinates_come_back(lattice: Lattice, x: float, y: float) -> None:
    """from_cell undoes to_cell, and the origin is cell coordinate (0, 0)."""
    np.testing.assert_allclose(lattice.from_cell(lattice.to_cell((x, y))), (x, y), atol=1e-8)
    np.testing.assert_allclose(lattice.to_cell(lattice.origin), 0, atol=1e-12)


@given(lattices())
def test_points_are_all_lattice_points_within_the_image(lattice: Lattice) -> None:
    """Brute force gives the same points."""
    assume(lattice.s > 3)
    shape = (37, 52)
    reduced = lattice.reduced()
    middle = np.rint(reduced.to_cell((25.5, 18)))
    xy = reduced.from_cell(middle + np.array([(i, j) for i in range(-16, 17) for j in range(-16, 17)]))
    depth = np.minimum(xy + 0.5, (51.5, 36.5) - xy).min(1)
    found = lattice.points(shape)
    near = np.hypot(*np.moveaxis(found[:, np.newaxis] - xy[depth > -1e-6], -1, 0)) < 1e-6
    assert near.any(1).all() and (depth > 1e-6).sum() <= len(found) <= (depth > -1e-6).sum()


@pytest.mark.parametrize(
    ("lattice", "kind"),
    [*KINDS.items(), (Lattice((20, 0), (6, 19.08)), "rhombic"), (Lattice((20, 0), (4, 30)), "parallelogram")],
)
@pytest.mark.parametrize("degrees", [0.0, 17.0, 109.0])
def test_the_kind_is_that_of_the_symmetry(lattice: Lattice, kind: str, degrees: float) -> None:
    """Known lattices have their Bravais class, in any basis and direction."""
    assert rebased(turned(lattice, degrees), np.array([[2, 1], [1, 1]])).kind == kind


@given(st.sampled_from(TIED), unimodular(), st.floats(-0.004, 0.004), st.floats(-0.004, 0.004))
def test_the_kind_survives_a_basis_and_a_small_move(lattice: Lattice, change: np.ndarray, x: float, y: float) -> None:
    """Moving one vector's tip by less than half the tolerance changes no kind, seen from any basis."""
    moved = lattice.matrix + np.array([(0, 0), (x, y)]) * lattice.s
    assert rebased(Lattice.from_basis(moved), change).kind == lattice.kind


@pytest.mark.parametrize(("along", "kind"), [(0.3, "rectangular"), (0.99, "rhombic"), (0.49, "rectangular")])
def test_a_long_lattice_is_of_the_nearer_kind(along: float, kind: str) -> None:
    """On 2 px by 300 px, 1 % of the longer vector allows either kind; the nearer one is returned."""
    assert Lattice((2.0, 0.0), (along, 300.0)).kind == kind


def test_the_kind_has_a_tolerance() -> None:
    """A square lattice that is off by 2 % is rectangular within 1 %, square within 3 %."""
    lattice = Lattice((20, 0), (0, 20.4))
    assert lattice.kind == "rectangular" and lattice.classify(0.03) == "square"


@pytest.mark.parametrize(
    ("t1", "t2", "hint"),
    [
        ((10, 0), (20, 0), "independent vectors"),
        ((0, 0), (0, 5), "independent vectors"),
        ((math.nan, 0), (0, 5), "finite numbers"),
        ((1e308, 0), (0, 1e308), "no image is so large"),
        ("ab", (0, 5), "two numbers"),
    ],
)
def test_no_lattice_without_two_directions(t1: object, t2: object, hint: str) -> None:
    """Parallel, zero or unreadable vectors are refused, saying what to give."""
    with pytest.raises(BadInput, match=hint):
        Lattice(t1, t2)


def test_the_command_lines_form_is_checked() -> None:
    """Too few numbers are refused, with an example."""
    for text, hint in (("1,2,3", "x1,y1,x2,y2"), ("30,0,0,20,5", "or six")):
        with pytest.raises(BadInput, match=hint):
            Lattice.parse(text)


@pytest.mark.parametrize("text", ["32,0,0,24", "32.5,-1,2,24,7.25,3"])
def test_the_command_lines_form_holds_the_origin(text: str) -> None:
    """Four numbers are the vectors, six also the origin; ``numbers`` gives them back, and so does the mapping."""
    lattice = Lattice.parse(text)
    assert Lattice.from_dict(lattice.as_dict()) == lattice
    assert lattice.numbers == [float(part) for part in text.split(",")]
    assert lattice.origin == ((7.25, 3.0) if text.count(",") == 5 else (0.0, 0.0))


CORNER = st.floats(-25, 25)
SIZE = st.floats(0, 30)


@given(st.floats(3, 30), st.floats(0, 0.5), st.floats(1, 3), st.floats(0, 360), CORNER, CORNER, SIZE, SIZE)
def test_every_point_in_the_box_is_found_once(
    length: float, lean: float, ratio: float, degrees: float, x: float, y: float, w: float, h: float
) -> None:
    """Brute force gives the same integers; points outside the box are outside by a rounding error of the step."""
    basis = turned(Lattice((length, 0), (length * lean, length * ratio)), degrees).matrix
    low, high = np.array([x, y]), np.array([x + w, y + h])
    integers = {tuple(numbers) for numbers in integers_within(basis, low, high).tolist()}
    assert len(integers) == len(integers_within(basis, low, high))
    grid = np.array([(i, j) for i in range(-35, 36) for j in range(-35, 36)])
    depth = np.minimum(grid @ basis - low, high - grid @ basis).min(1)
    assert {tuple(numbers) for numbers in grid[depth > 1e-9].tolist()} <= integers
    assert integers <= {tuple(numbers) for numbers in grid[depth > -1e-4].tolist()}


LATTICE = Lattice((27.3, 1.0), (8.0, 12.2), (4.0, 1.0))
REBASED = Lattice((27.3 + 3 * 8.0, 1.0 + 3 * 12.2), (27.3 + 2 * 8.0, 1.0 + 2 * 12.2), (4.0, 1.0))


def coarser(lattice: Lattice, index: int) -> list[Lattice]:
    """Return the supercells of an index."""
    return [Lattice.from_basis(basis) for basis in reduce_bases(hermite_matrices(index) @ lattice.matrix)]


def finer(lattice: Lattice, index: int) -> list[Lattice]:
    """Return the subcells of an index."""
    return [Lattice.from_basis(basis) for basis in reduce_bases(hermite_matrices(index) @ lattice.matrix / index)]


@pytest.mark.parametrize("index", [1, 2, 3, 5, 7, 8])
@pytest.mark.parametrize("enlarged", [coarser, finer])
def test_every_lattice_of_an_index_comes_once_whatever_the_basis(index: int, enlarged: object) -> None:
    """As many as the divisors add up to are pairwise different, and those of another basis are the same ones."""
    lattices, again = enlarged(LATTICE, index), enlarged(REBASED, index)
    same = np.array([[a.is_equivalent(b, 1e-7) for b in again] for a in lattices])
    assert len(lattices) == sum(d for d in range(1, index + 1) if index % d == 0)
    assert (same.sum(0) == 1).all() and (same.sum(1) == 1).all()


@pytest.mark.parametrize("index", [2, 3, 5, 7])
def test_coarser_and_finer_are_each_others(index: int) -> None:
    """A coarser lattice is a supercell, a finer one a subcell, and among the coarser of a finer one is the lattice."""
    for lattice in coarser(LATTICE, index):
        assert lattice.area == pytest.approx(index * LATTICE.area)
        assert lattice_error(lattice, LATTICE, (100, 100)).label == f"supercell {index}"
        assert sum(other.is_equivalent(LATTICE) for other in finer(lattice, index)) == 1
    for lattice in finer(LATTICE, index):
        assert lattice_error(lattice, LATTICE, (100, 100)).label == f"subcell 1/{index}"
        assert sum(other.is_equivalent(LATTICE) for other in coarser(lattice, index)) == 1


def test_many_bases_are_reduced_as_each_alone() -> None:
    """The bases reduced at once are those reduced one by one, to the bit, ties included."""
    rng = np.random.default_rng(0)
    bases = np.concatenate([rng.uniform(-40, 40, (200, 2, 2)), rng.integers(-9, 10, (400, 2, 2))])
    bases = bases[np.abs(np.linalg.det(bases)) > 0.5]
    expected = [Lattice.from_basis(basis).reduced().matrix for basis in bases]
    np.testing.assert_array_equal(reduce_bases(bases), expected)
    plain = np.array([reduce_bases(basis[np.newaxis], False)[0] for basis in bases])
    np.testing.assert_array_equal(reduce_bases(bases, False), plain)
    np.testing.assert_array_equal(np.abs(plain), np.abs(expected))


def test_parallel_vectors_are_reduced_to_one() -> None:
    """Of parallel vectors one is left, with a vector of length 0 or nearly 0."""
    (first, second) = reduce_bases(np.array([[(6.0, 3.0), (4.0, 2.0)]]), False)[0]
    assert min(np.hypot(*first), np.hypot(*second)) < 1e-9


@pytest.mark.parametrize("lattice", TIED)
def test_noise_does_not_turn_the_reported_basis(lattice: Lattice) -> None:
    """Of any basis and direction, noise of 0.1 px in the vectors leaves the basis that detectors report, in 98 %."""
    rng, kept = np.random.default_rng(0), []
    for degrees in (0.0, 30.0, 45.0, *rng.uniform(0, 180, 77)):
        given = turned(lattice, degrees)
        known = given.oriented().matrix
        for change in ([[1, 0], [0, 1]], [[0, 1], [-1, 2]], [[-1, -1], [2, 1]]):
            basis = Lattice.from_basis(change @ (given.matrix + rng.normal(0, 0.1, (2, 2)))).oriented().matrix
            kept.append(np.abs(basis - known).max() < 1)
            assert np.linalg.det(basis) > 0 and basis[0, 0] > 0
    assert np.mean(kept) > 0.98


def test_the_reported_basis_is_right_handed() -> None:
    """t1 is the flattest short vector, t2 the other one; of equally flat ones t1 points up."""
    assert Lattice((0, 12), (30, 1)).oriented().matrix.tolist() == [[30, 1], [0, 12]]
    assert Lattice((24, 22), (24, -22)).oriented().matrix.tolist() == [[24, -22], [24, 22]]
    assert Lattice((20, 0), (-10, 17.3)).oriented().matrix.tolist() == [[20, 0], [10, 17.3]]
