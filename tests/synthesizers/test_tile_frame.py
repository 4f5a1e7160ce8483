import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.rectangular_tiles.tile_frame import (
    Rectangle,
    TileFrame,
    find_free_rectangle,
    find_tile_frame,
    find_upright_rectangle,
)
from nrbench.synthesizers.sampling.equal_places import pixel_grid

SHAPE = (128, 150, 3)


def pixels_of(frame: TileFrame) -> Points:
    """Return the pixels (x, y) of the scaled image."""
    return pixel_grid(*frame.shape[::-1]).astype(np.float64)


@settings(max_examples=40)
@given(st.floats(8, 40), st.floats(0, math.pi), st.floats(0.7, 1.4), st.floats(1.05, 2.1), st.sampled_from([0.02, 0.1]))
def test_periods_are_lattice_vectors_at_nearly_a_right_angle(
    length: float, turn: float, ratio: float, angle: float, tolerance: float
) -> None:
    """Whatever the lattice: it is refused, or the tile's sides are its vectors, nearly at right angles."""
    other = ratio * length
    lattice = Lattice(
        (length * math.cos(turn), length * math.sin(turn)),
        (other * math.cos(turn + angle), other * math.sin(turn + angle)),
    )
    try:
        frame = find_tile_frame(lattice, SHAPE, tolerance, scale_down=True)
    except Refused as refusal:
        assert "less than two periods" in refusal.reason or "larger than the sample" in refusal.reason
        return
    assert np.abs(lattice.wrap(frame.periods)).max() < 1e-6 * length
    assert abs(np.linalg.det(frame.periods)) == pytest.approx(frame.cells * lattice.area)
    lengths = np.hypot(*frame.periods.T)
    skew = abs(frame.periods[0] @ frame.periods[1]) / lengths.max()
    assert skew <= 2.1 * tolerance * lattice.s + 1e-6
    assert frame.size == (int(lengths[1] + 0.05), int(lengths[0] + 0.05))
    assert abs(frame.periods[0, 0]) >= abs(frame.periods[0, 1]) - 2 * tolerance * lattice.s - 1e-6
    assert (np.abs(frame.periods).sum(0) <= (150.05, 128.05)).all()


def test_the_scaled_image_covers_the_sample_and_no_more() -> None:
    """Its pixels lie on the sample up to its last row and column; turned, the corners of its box lie outside."""
    upright = find_tile_frame(Lattice((21.37, 0), (0, 18.81)), SHAPE, 0.1, scale_down=True)
    at = upright.to_sample(pixels_of(upright))
    assert upright.first == (0, 0) and upright.holds(pixels_of(upright), SHAPE).all()
    assert (np.array([149, 127]) - at[-1, -1] < upright.steps.max()).all()
    turned = find_tile_frame(Lattice((20, 6), (-6, 20)), SHAPE, 0.1, scale_down=True)
    inside = turned.holds(pixels_of(turned), SHAPE)
    assert inside.sum() == pytest.approx(149 * 127 / abs(np.linalg.det(turned.steps)), rel=0.01) and not inside.all()


def test_a_period_just_under_a_whole_number_is_that_number() -> None:
    """29.97 px are 30, not 29; 29.9 px are 29: what is measured no better does not shrink a tile by a pixel."""
    for period, pixels in ((29.97, 30), (29.9, 29), (30.0, 30), (30.9, 30)):
        assert find_tile_frame(Lattice((period, 0), (0, 20)), SHAPE, 0.1, scale_down=True).size == (20, pixels)


def test_without_scale_down_steps_are_pixels_long() -> None:
    """The tile keeps the sample's scale, turned or not."""
    for lattice in (Lattice((21.37, 0), (0, 18.81)), Lattice((20.2, 6.1), (-6.1, 20.2))):
        frame = find_tile_frame(lattice, SHAPE, 0.1, scale_down=False)
        assert np.hypot(*frame.steps.T) == pytest.approx((1, 1))
    upright = find_tile_frame(Lattice((21.37, 0), (0, 18.81)), SHAPE, 0.1, scale_down=False)
    np.testing.assert_allclose(upright.steps, np.eye(2), atol=1e-9)


def test_patterns_finer_than_two_pixels_are_refused() -> None:
    """A tile of a pixel's width shows nothing."""
    with pytest.raises(Refused, match="less than 2 px"):
        find_tile_frame(Lattice((1.5, 0), (0, 20)), SHAPE, 0.1, scale_down=True)


ENTRY = st.integers(-15, 15)
BASIS = st.tuples(ENTRY, ENTRY, ENTRY, ENTRY).filter(lambda e: abs(e[0] * e[3] - e[1] * e[2]) > 0)
HEXAGON = Lattice((20.0, 0.0), (10.0, 10 * math.sqrt(3)))


def size(rectangle: Rectangle) -> tuple[float, float]:
    """Return the lengths of the two sides, px."""
    w, h = np.hypot(*rectangle.sides.T)
    return float(w), float(h)


def residuals(rectangle: Rectangle, lattice: Lattice) -> Points:
    """Return each side less its lattice vector, px."""
    return np.asarray(rectangle.sides - rectangle.numbers @ lattice.matrix)


def error(rectangle: Rectangle, lattice: Lattice) -> float:
    """Return the length of the longer residual, px."""
    return float(np.hypot(*residuals(rectangle, lattice).T).max())


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
    found = find_upright_rectangle(lattice, limit=500)
    assert found is not None and error(found, lattice) < 1e-6
    assert size(found) == pytest.approx((det / math.gcd(q, s), det / math.gcd(p, r)))
    assert found.cells == pytest.approx(math.prod(size(found)) / det)


@given(st.floats(3, 30), st.floats(3, 30), st.floats(-30, 30), st.floats(0, 90), st.floats(0.05, 1.4))
def test_the_rectangle_is_the_smallest_within_tolerance(
    a: float, b: float, lean: float, angle: float, tolerance: float
) -> None:
    """Brute force over the vectors near each axis finds no shorter side; the residual keeps the tolerance."""
    lattice = turned(Lattice((a, 0), (lean, b)), angle)
    assume(lattice.s > 2.9)
    found = find_upright_rectangle(lattice, tolerance, 60)
    grid = np.array([(i, j) for i in range(-25, 26) for j in range(-25, 26) if (i, j) != (0, 0)])
    shortest = []
    for axis in (0, 1):
        vectors = grid @ lattice.reduced().matrix
        side, off = vectors[:, axis], np.abs(vectors[:, 1 - axis])
        sides = side[(off <= tolerance - 1e-6) & (side > 0) & (side <= 60 - 1e-6)]
        shortest.append(sides.min(initial=np.inf))
    assert found is not None or max(shortest) == np.inf
    if found is not None:
        width, height = size(found)
        assert width <= shortest[0] + 1e-6 and height <= shortest[1] + 1e-6
        assert error(found, lattice) <= tolerance + 1e-5 and max(width, height) <= 60 + 1e-6 and found.cells > 0


@given(st.integers(-3, 3), st.integers(-3, 3), st.floats(0, 90))
def test_the_rectangle_does_not_depend_on_the_basis(i: int, j: int, angle: float) -> None:
    """Another basis and origin give the same sides, by other integers for the same vectors."""
    lattice = turned(HEXAGON, angle)
    t1, t2 = (np.array([[1, i], [0, 1]]) @ [[1, 0], [j, 1]] @ lattice.matrix).tolist()
    other = Lattice(tuple(t1), tuple(t2), (3.0, 9.0))
    for search in (find_upright_rectangle, find_free_rectangle):
        ours, theirs = search(lattice, 0.7, 300), search(other, 0.7, 300)
        assert (ours is None) == (theirs is None)
        if ours is not None and theirs is not None:
            assert size(ours) == pytest.approx(size(theirs)) and ours.cells == theirs.cells
            np.testing.assert_allclose(np.abs(residuals(ours, lattice)), np.abs(residuals(theirs, other)), atol=1e-7)


def test_known_rectangles() -> None:
    """A brick lattice's is one brick by two courses; a hexagonal one's is s by the square root of 3 times s."""
    brick = find_upright_rectangle(Lattice((27.3, 0.0), (13.65, 12.2)))
    assert brick is not None and size(brick) == pytest.approx((27.3, 24.4)) and brick.cells == 2
    hexagon = find_upright_rectangle(HEXAGON)
    assert hexagon is not None and size(hexagon) == pytest.approx((20, 20 * math.sqrt(3)))


@pytest.mark.parametrize("angle", [0.0, 11.0, 45.0, 77.0])
def test_a_free_rectangle_turns_with_the_lattice(angle: float) -> None:
    """Of a rhombic lattice it is two cells, exactly, in any direction; of a square one it is the cell."""
    rhombic = find_free_rectangle(turned(Lattice((27.3, 0.0), (13.65, 12.2)), angle))
    square = find_free_rectangle(turned(Lattice((20.0, 0.0), (0.0, 20.0)), angle))
    assert rhombic is not None and sorted(size(rhombic)) == pytest.approx([24.4, 27.3]) and rhombic.cells == 2
    assert square is not None and size(square) == pytest.approx((20, 20)) and square.cells == 1
    assert abs(rhombic.sides[0] @ rhombic.sides[1]) < 1e-9


@given(BASIS)
@settings(max_examples=30)
def test_the_free_rectangle_is_no_larger_than_the_upright_one(basis: tuple[int, int, int, int]) -> None:
    """The upright rectangle is one of those that are compared."""
    lattice = Lattice(basis[:2], basis[2:])
    assume(lattice.s > 2)
    free, upright = find_free_rectangle(lattice, limit=250), find_upright_rectangle(lattice, limit=250)
    assume(upright is not None)
    assert free is not None and upright is not None
    assert math.prod(size(free)) <= math.prod(size(upright)) * (1 + 1e-6)


def test_where_there_is_none_none_is_returned() -> None:
    """A hexagonal lattice turned by 7 degrees has no upright rectangle but a free one; an odd one has neither."""
    assert find_upright_rectangle(turned(HEXAGON, 7)) is None
    assert find_free_rectangle(turned(HEXAGON, 7)) is not None
    assert find_free_rectangle(Lattice((20.0, 0.0), (math.pi, 23.0)), limit=300) is None
    assert find_upright_rectangle(HEXAGON, limit=30) is None


@pytest.mark.parametrize(
    ("tolerance", "limit", "hint"),
    [(10.0, 100.0, "half of s"), (-1.0, 100.0, "half of s"), (math.nan, 100.0, "half of s"), (1.0, 0.0, "above 0")],
)
def test_a_tolerance_is_less_than_half_a_period(tolerance: float, limit: float, hint: str) -> None:
    """A tolerance that any vector keeps, or no length to look at, is refused."""
    for search in (find_upright_rectangle, find_free_rectangle):
        with pytest.raises(BadInput, match=hint):
            search(HEXAGON, tolerance, limit)
