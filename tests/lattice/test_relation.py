import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from turned_lattices import turned

from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error, relate

TRUTH = Lattice((27.3, 0.0), (13.65, 12.2), (4.0, 1.0))
SHAPE = (200, 300)
SHEAR = st.integers(-3, 3)


def times(change: object, offset: object = 0.0, lattice: Lattice = TRUTH) -> Lattice:
    """Return the lattice whose basis is an integer change of ``lattice``'s, plus an offset in px."""
    return Lattice.from_basis(np.array(change) @ lattice.matrix + offset)


@given(SHEAR, SHEAR, SHEAR)
def test_any_basis_of_the_truth_is_exact(i: int, j: int, k: int) -> None:
    """Every basis of the same lattice has error, angle and drift 0."""
    change = np.array([[1, i], [0, 1]]) @ [[1, 0], [j, 1]] @ [[1, k], [0, 1]]
    error = lattice_error(times(change), TRUTH, SHAPE)
    assert (error.label, error.index, error.k) == ("exact", 1.0, 1)
    assert error.vector == pytest.approx(0, abs=1e-9) and error.drift == pytest.approx(0, abs=1e-8)
    assert error.angle == pytest.approx(0, abs=1e-4) and error.area_ratio == pytest.approx(1)


@pytest.mark.parametrize("change", [[[2, 0], [0, 1]], [[1, 1], [1, -1]], [[1, 0], [5, 2]]])
def test_supercells_and_subcells_tell_their_index(change: object) -> None:
    """A supercell of 2 is one, and seen from it the truth is a subcell of 1/2."""
    above, below = lattice_error(times(change), TRUTH, SHAPE), lattice_error(TRUTH, times(change), SHAPE)
    assert (above.label, above.index, above.area_ratio) == ("supercell 2", 2.0, pytest.approx(2))
    assert (below.label, below.index, below.area_ratio) == ("subcell 1/2", 0.5, pytest.approx(0.5))
    assert above.vector == pytest.approx(0, abs=1e-9) and below.drift == pytest.approx(0, abs=1e-8)


def test_a_supercells_error_counts_for_the_true_vectors() -> None:
    """A vector of three periods that is off by 1.2 px is off by 0.4 px a period."""
    error = lattice_error(times([[3, 0], [0, 1]], [[1.2, 0], [0, 0]]), TRUTH, SHAPE)
    assert error.label == "supercell 3"
    assert error.vector == pytest.approx(0.4)


def test_drift_adds_up_over_the_shape() -> None:
    """1 % too long along x is 3 px over 300 px; a turn by 1 degree moves the far corner by its arc."""
    wider = Lattice((27.573, 0.0), (13.7865, 12.2))
    assert lattice_error(wider, TRUTH, SHAPE).drift == pytest.approx(3.0)
    error = lattice_error(turned(TRUTH, 1), TRUTH, SHAPE)
    assert error.angle == pytest.approx(1.0)
    assert error.drift == pytest.approx(2 * math.sin(math.radians(0.5)) * math.hypot(*SHAPE))


def test_random_lattices_are_wrong() -> None:
    """Of random lattices of similar size hardly any agrees with the truth in any way."""
    rng = np.random.default_rng(0)
    labels = []
    for _ in range(400):
        basis = rng.uniform(-40, 40, (2, 2))
        if abs(np.linalg.det(basis)) > 100:
            labels.append(lattice_error(Lattice.from_basis(basis), TRUTH, SHAPE).relation)
    assert labels.count("wrong") > 0.98 * len(labels)


def test_a_wrong_lattice_has_no_index_but_an_error() -> None:
    """The numbers of a wrong lattice compare the nearest bases."""
    error = lattice_error(Lattice((27.3, 0.0), (13.65, 20.0)), TRUTH, SHAPE)
    assert (error.label, error.index, error.k) == ("wrong", None, 0)
    assert error.vector == pytest.approx(7.8)


@st.composite
def pairs(draw: st.DrawFn) -> tuple[Lattice, Lattice]:
    """Draw a truth, often with equally short vectors, and a coarser, finer or equal estimate that is a little off."""
    leans = st.sampled_from([(0, 1), (0.5, math.sqrt(0.75)), (0.5, 0.6), (0.5, 1.5), (0, 1.7), (0.3, 1.2)])
    (lean, height), length = draw(leans), draw(st.floats(8, 40))
    truth = Lattice((length, 0.0), (lean * length, height * length))
    change = np.array(draw(st.sampled_from([((1, 0), (0, 1)), ((2, 0), (0, 1)), ((1, 1), (-1, 2)), ((1, 0), (1, 2))])))
    change = change if draw(st.booleans()) else np.linalg.inv(change)
    off = np.array([draw(st.floats(-0.6, 0.6)) for _ in range(4)]).reshape(2, 2)
    return times(change, off, truth), truth


UNIMODULAR = st.sampled_from(
    [((1, 0), (0, 1)), ((0, 1), (-1, 1)), ((2, 1), (1, 1)), ((1, -3), (0, -1)), ((1, 1), (0, 1))]
)


@given(pairs(), UNIMODULAR, UNIMODULAR, st.floats(-9, 9))
def test_neither_basis_nor_origin_matters(pair: tuple[Lattice, Lattice], one: object, two: object, x: float) -> None:
    """Every number is the same from other bases and origins of both, also where vectors are equally short."""
    found, true = pair
    error, again = (
        lattice_error(found, true, SHAPE),
        lattice_error(times(one, 0.0, found).shifted((x, 1.0)), times(two, 0.0, true).shifted((2.0, x)), SHAPE),
    )
    assert (again.label, again.index) == (error.label, error.index)
    assert again.vector == pytest.approx(error.vector, abs=1e-8) and again.drift == pytest.approx(error.drift, abs=1e-6)
    assert again.angle == pytest.approx(error.angle, abs=1e-5) and again.area_ratio == pytest.approx(error.area_ratio)


@given(pairs(), st.floats(0.3, 20))
def test_lengths_scale_and_relations_do_not(pair: tuple[Lattice, Lattice], scale: float) -> None:
    """Everything enlarged, tolerance and shape too, the errors in px are enlarged and the rest stays."""
    large = [Lattice(*(tuple(row) for row in (scale * lattice.matrix).tolist())) for lattice in pair]
    shape = (200, 300)
    error, again = lattice_error(*pair, shape), lattice_error(large[0], large[1], shape, scale)
    assert again.label == error.label and again.angle == pytest.approx(error.angle, abs=1e-5)
    assert again.vector == pytest.approx(scale * error.vector, abs=1e-7)
    assert again.drift == pytest.approx(error.drift, abs=1e-6)


@pytest.mark.parametrize("lean", [0.0, 0.5])
def test_an_estimate_with_other_shortest_vectors_is_matched(lean: float) -> None:
    """Of nearly square and nearly hexagonal lattices the reduced bases differ by more than the lattices do."""
    height = math.sqrt(1 - lean * lean)
    truth = Lattice((20.0, 0.0), (20.02 * lean, 20.02 * height))
    for off in np.random.default_rng(0).uniform(-0.05, 0.05, (50, 2, 2)):
        error = lattice_error(times(np.eye(2), off, truth), truth, SHAPE)
        assert error.label == "exact" and error.vector <= 0.15 and error.angle < 0.5


@pytest.mark.parametrize(
    ("side", "off", "limits", "label"),
    [
        (27.3, 0.9, (), "exact"),
        (27.3, 1.1, (), "wrong"),
        (7.0, 0.6, (), "exact"),  # a twelfth of a period
        (7.0, 0.9, (), "wrong"),  # an eighth of a period
        (50.0, 1.8, (1.5, 0.0), "wrong"),
        (50.0, 1.8, (1.5, 0.04), "exact"),
        (50.0, 2.1, (1.5, 0.04), "wrong"),
        (20.0, 1.4, (1.5, 0.04), "exact"),
    ],
)
def test_the_tolerance_is_in_px_and_in_shares_of_s(
    side: float, off: float, limits: tuple[float, ...], label: str
) -> None:
    """It is 1 px and shrinks on small lattices; a share of s counts where it is more, as 2 px on 50 px are 4 %."""
    true, found = (Lattice((length, 0.0), (0.0, side)) for length in (side, side + off))
    error = lattice_error(found, true, SHAPE, *limits)
    assert error.label == label and error.vector == pytest.approx(off)


@pytest.mark.parametrize(
    ("change", "name", "index"),
    [
        ([[1, 0], [0, 1]], "the same", 1),
        ([[2, 0], [0, 1]], "double along t1", 2),
        ([[1, 0], [0, 0.5]], "half along t2", 0.5),
        ([[1, 0], [0, 3]], "x 3 along t2", 3),
        ([[1 / 3, 0], [0, 1 / 3]], "1/3 along t1 and t2", 1 / 9),
        ([[2, 0], [0, 2]], "double along t1 and t2", 4),
        ([[1, 1], [1, -1]], "supercell x 2", 2),
        ([[0.5, 0.5], [0.5, -0.5]], "subcell 1/2", 0.5),
        ([[0.5, 0], [0, 2]], "half along t1, double along t2", 1),
        ([[1.5, 0], [0, 1]], "3/2 along t1", 1.5),
        ([[0.5, 0.5], [0, 3]], "commensurate", 1.5),
    ],
)
@pytest.mark.parametrize("shear", [[[1, 0], [0, 1]], [[1, 2], [0, 1]], [[0, 1], [1, 3]]])
def test_the_relation_of_two_lattices_has_a_name(change: object, name: str, index: float, shear: object) -> None:
    """The name and the index depend on the lattice and not on its basis, and small errors do not matter."""
    found = relate(times(np.array(shear) @ change, [[0.02, 0.01], [-0.01, 0.02]]), TRUTH)
    assert (found.name, found.index) == (name, pytest.approx(index))


@given(st.integers(1, 5), st.integers(0, 4), st.integers(1, 5), SHEAR, SHEAR)
def test_a_relation_gives_the_lattice_back(a: int, b: int, d: int, i: int, j: int) -> None:
    """Numerators times the reference over the divisor generate the lattice, for supercells and for subcells."""
    shear = np.array([[1, i], [0, 1]]) @ [[1, 0], [j, 1]]
    for change in (np.array([[a, b], [0, d]]), np.array([[a, b], [0, d]]) / (a * d)):
        lattice = times(shear @ change)
        found = relate(lattice, TRUTH)
        basis = np.array(found.numerators) @ TRUTH.matrix / found.divisor
        assert Lattice.from_basis(basis).is_equivalent(lattice, 1e-6)


def test_unrelated_lattices_have_no_relation() -> None:
    """A lattice turned by 20 degrees, and one 7 % longer, are not made of the other's vectors."""
    assert relate(turned(TRUTH, 20), TRUTH) is None
    assert relate(times([[1.07, 0], [0, 1]]), TRUTH) is None
