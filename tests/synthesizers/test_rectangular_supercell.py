import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.synthesizers.rectangular_tiles.rectangular_supercell import free_rectangle, upright_rectangle

ENTRY = st.integers(-15, 15)
BASIS = st.tuples(ENTRY, ENTRY, ENTRY, ENTRY).filter(lambda e: abs(e[0] * e[3] - e[1] * e[2]) > 0)
HEXAGON = Lattice((20.0, 0.0), (10.0, 10 * math.sqrt(3)))


def turned(lattice: Lattice, degrees: float) -> Lattice:
    """Return the lattice turned about the origin."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    t1, t2 = (lattice.matrix @ [[c, s], [-s, c]]).tolist()
    return Lattice(tuple(t1), tuple(t2))


@given(BASIS)
def test_a_whole_numbered_lattice_has_its_exact_rectangle(basis: tuple[int, int, int, int]) -> None:
    """Its width is the determinant over the gcd of the y components, its height likewise."""
    p, q, r, s = basis
    det = abs(p * s - q * r)
    lattice = Lattice((p, q), (r, s))
    found = upright_rectangle(lattice, limit=500)
    assert found is not None and found.error < 1e-6
    assert found.size == pytest.approx((det / math.gcd(q, s), det / math.gcd(p, r)))
    assert found.cells == pytest.approx(found.size[0] * found.size[1] / det)


@given(st.floats(3, 30), st.floats(3, 30), st.floats(-30, 30), st.floats(0, 90), st.floats(0.05, 1.4), st.booleans())
def test_the_rectangle_is_the_smallest_within_tolerance(
    a: float, b: float, lean: float, angle: float, tolerance: float, whole: bool
) -> None:
    """Brute force over the vectors near each axis finds no shorter side; the residual keeps the tolerance."""
    lattice = turned(Lattice((a, 0), (lean, b)), angle)
    assume(lattice.s > 2.9)
    found = upright_rectangle(lattice, tolerance, 60, whole)
    grid = np.array([(i, j) for i in range(-25, 26) for j in range(-25, 26) if (i, j) != (0, 0)])
    shortest = []
    for axis in (0, 1):
        vectors = grid @ lattice.reduced().matrix
        side = np.rint(vectors[:, axis]) if whole else vectors[:, axis]
        error = np.hypot(side - vectors[:, axis], vectors[:, 1 - axis])
        sides = side[(error <= tolerance - 1e-6) & (side > 0) & (side <= 60 - 1e-6)]
        shortest.append(sides.min(initial=np.inf))
    assert found is not None or max(shortest) == np.inf
    if found is not None:
        assert found.size[0] <= shortest[0] + 1e-6 and found.size[1] <= shortest[1] + 1e-6
        assert found.error <= tolerance + 1e-5 and max(found.size) <= 60 + 1e-6 and found.cells > 0
        assert not whole or found.size == tuple(np.rint(found.size))


@given(st.integers(-3, 3), st.integers(-3, 3), st.floats(0, 90))
def test_the_rectangle_does_not_depend_on_the_basis(i: int, j: int, angle: float) -> None:
    """Another basis and origin give the same sides, by other integers for the same vectors."""
    lattice = turned(HEXAGON, angle)
    t1, t2 = (np.array([[1, i], [0, 1]]) @ [[1, 0], [j, 1]] @ lattice.matrix).tolist()
    other = Lattice(tuple(t1), tuple(t2), (3.0, 9.0))
    for search in (upright_rectangle, free_rectangle):
        ours, theirs = search(lattice, 0.7, 300), search(other, 0.7, 300)
        assert (ours is None) == (theirs is None)
        if ours is not None and theirs is not None:
            assert ours.size == pytest.approx(theirs.size) and ours.cells == theirs.cells
            np.testing.assert_allclose(np.abs(ours.residuals), np.abs(theirs.residuals), atol=1e-7)


def test_known_rectangles() -> None:
    """A brick lattice's is one brick by two courses; a hexagonal one's is s by the square root of 3 times s."""
    brick = upright_rectangle(Lattice((27.3, 0.0), (13.65, 12.2)))
    assert brick is not None and brick.size == pytest.approx((27.3, 24.4)) and brick.cells == 2
    hexagon = upright_rectangle(HEXAGON)
    assert hexagon is not None and hexagon.size == pytest.approx((20, 20 * math.sqrt(3)))


def test_whole_sides_cost_tolerance() -> None:
    """34.64 px rounded to 35 is off by 0.36 px: found within 0.4 px, a multiple of it within 0.3 px."""
    near = upright_rectangle(HEXAGON, 0.4, whole=True)
    nearer = upright_rectangle(HEXAGON, 0.3, whole=True)
    assert near is not None and near.size == (20, 35) and near.error == pytest.approx(0.359, abs=1e-3)
    assert nearer is not None and nearer.size == (20, 69) and nearer.error == pytest.approx(0.282, abs=1e-3)


def test_the_fitted_lattice_has_the_rectangle_for_a_period() -> None:
    """A hexagonal lattice turned by 7 degrees, fitted to its rectangle within 1 px, repeats with it exactly."""
    lattice = turned(HEXAGON, 7)
    found = upright_rectangle(lattice, 1.0)
    assert found is not None and found.error > 0.01
    fitted = found.fitted()
    np.testing.assert_allclose(fitted.wrap(found.sides), 0, atol=1e-9)
    assert fitted.is_equivalent(lattice, found.error) and not fitted.is_equivalent(lattice)


@pytest.mark.parametrize("angle", [0.0, 11.0, 45.0, 77.0])
def test_a_free_rectangle_turns_with_the_lattice(angle: float) -> None:
    """Of a rhombic lattice it is two cells, exactly, in any direction; of a square one it is the cell."""
    rhombic = free_rectangle(turned(Lattice((27.3, 0.0), (13.65, 12.2)), angle))
    square = free_rectangle(turned(Lattice((20.0, 0.0), (0.0, 20.0)), angle))
    assert rhombic is not None and sorted(rhombic.size) == pytest.approx([24.4, 27.3]) and rhombic.cells == 2
    assert square is not None and square.size == pytest.approx((20, 20)) and square.cells == 1
    assert abs(rhombic.sides[0] @ rhombic.sides[1]) < 1e-9


@given(BASIS)
@settings(max_examples=30)
def test_the_free_rectangle_is_no_larger_than_the_upright_one(basis: tuple[int, int, int, int]) -> None:
    """The upright rectangle is one of those that are compared."""
    lattice = Lattice(basis[:2], basis[2:])
    assume(lattice.s > 2)
    free, upright = free_rectangle(lattice, limit=250), upright_rectangle(lattice, limit=250)
    assume(upright is not None)
    assert free is not None and upright is not None
    assert math.prod(free.size) <= math.prod(upright.size) * (1 + 1e-6)


def test_where_there_is_none_none_is_returned() -> None:
    """A hexagonal lattice turned by 7 degrees has no upright rectangle but a free one; an odd one has neither."""
    assert upright_rectangle(turned(HEXAGON, 7)) is None
    assert free_rectangle(turned(HEXAGON, 7)) is not None
    assert free_rectangle(Lattice((20.0, 0.0), (math.pi, 23.0)), limit=300) is None
    assert upright_rectangle(HEXAGON, limit=30) is None


@pytest.mark.parametrize(
    ("tolerance", "limit", "hint"),
    [(10.0, 100.0, "half of s"), (-1.0, 100.0, "half of s"), (math.nan, 100.0, "half of s"), (1.0, 0.0, "above 0")],
)
def test_a_tolerance_is_less_than_half_a_period(tolerance: float, limit: float, hint: str) -> None:
    """A tolerance that any vector keeps, or no length to look at, is refused."""
    for search in (upright_rectangle, free_rectangle):
        with pytest.raises(BadInput, match=hint):
            search(HEXAGON, tolerance, limit)
