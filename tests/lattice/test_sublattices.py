import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from nrbench.errors import BadInput
from nrbench.lattice.comparison import lattice_error
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.sublattices import LARGEST, coarser, finer, hermite_form, hermite_matrices

ENTRY = st.integers(-LARGEST, LARGEST) | st.integers(-9, 9)
MATRIX = st.lists(st.lists(ENTRY, min_size=2, max_size=2), min_size=2, max_size=2)
LATTICE = Lattice((27.3, 1.0), (8.0, 12.2), (4.0, 1.0))
REBASED = Lattice((27.3 + 3 * 8.0, 1.0 + 3 * 12.2), (27.3 + 2 * 8.0, 1.0 + 2 * 12.2), (4.0, 1.0))


def exact(matrix: object) -> np.ndarray:
    """Return the matrix in Python's own integers, which do not overflow."""
    return np.array(np.asarray(matrix).tolist(), object)


def determinant(matrix: object) -> int:
    """Return it exactly."""
    (p, q), (r, s) = exact(matrix).tolist()
    return int(p * s - q * r)


@given(MATRIX)
def test_the_form_is_the_matrix_in_another_basis(matrix: list[list[int]]) -> None:
    """U has determinant +-1, U times the matrix is H, and H is triangular, positive and reduced; all exactly."""
    assume(determinant(matrix) != 0)
    form, change = hermite_form(matrix)
    assert abs(determinant(change)) == 1
    assert (exact(change) @ exact(matrix) == exact(form)).all()
    (a, b), (zero, d) = form.tolist()
    assert a > 0 and d > 0 and zero == 0 and 0 <= b < d


@given(MATRIX, st.integers(-5, 5), st.integers(-5, 5), st.booleans())
def test_the_form_is_the_same_from_every_basis(matrix: list[list[int]], i: int, j: int, swap: bool) -> None:
    """A change of the rows' basis leaves H alone."""
    assume(determinant(matrix) != 0)
    change = np.array([[1, i], [0, 1]]) @ np.array([[1, 0], [j, 1]])
    other = exact(change[::-1] if swap else change) @ exact(matrix)
    assume(abs(other).max() <= LARGEST)
    assert (hermite_form(other.tolist())[0] == hermite_form(matrix)[0]).all()


@pytest.mark.parametrize(
    ("matrix", "form"),
    [([[2, 0], [0, 3]], [[2, 0], [0, 3]]), ([[0, 1], [1, 0]], [[1, 0], [0, 1]]), ([[1, 1], [1, -1]], [[1, 1], [0, 2]])],
)
def test_known_forms(matrix: object, form: object) -> None:
    """A diagonal matrix is its own form, a swap is no change, and the checkerboard's is known."""
    assert hermite_form(matrix)[0].tolist() == form


@pytest.mark.parametrize(
    ("matrix", "hint"),
    [
        ([[1, 2], [2, 4]], "parallel"),
        ([[1, 0.5], [0, 1]], "whole numbers"),
        ([[1, math.nan], [0, 1]], "whole numbers"),
        ([[10**10, 0], [0, 1]], "whole numbers up to"),
        ([1, 2, 3], "2 x 2"),
        ("ab", "2 x 2"),
    ],
)
def test_no_form_without_a_whole_independent_matrix(matrix: object, hint: str) -> None:
    """Parallel rows, fractions, and what would overflow are refused."""
    with pytest.raises(BadInput, match=hint):
        hermite_form(matrix)  # type: ignore[arg-type]


@pytest.mark.parametrize("index", [1, 2, 3, 4, 5, 6, 7, 12, 30])
def test_there_are_as_many_forms_as_the_divisors_add_up_to(index: int) -> None:
    """Each is a fixed point of hermite_form, has the determinant, and occurs once."""
    forms = hermite_matrices(index)
    assert len(forms) == sum(d for d in range(1, index + 1) if index % d == 0)
    assert len({str(form.tolist()) for form in forms}) == len(forms)
    assert all(determinant(form) == index and (hermite_form(form)[0] == form).all() for form in forms)


@pytest.mark.parametrize("index", [0, -2, 2.0, True, "2"])
def test_an_index_is_a_count(index: object) -> None:
    """Anything but a whole number from 1 on is refused."""
    with pytest.raises(BadInput, match="1 or more"):
        hermite_matrices(index)  # type: ignore[arg-type]


@pytest.mark.parametrize("index", [1, 2, 3, 5, 7, 8])
@pytest.mark.parametrize("enlarged", [coarser, finer])
def test_every_lattice_of_an_index_comes_once_whatever_the_basis(index: int, enlarged: object) -> None:
    """They are pairwise different, and those of another basis are the same ones."""
    found, again = enlarged(LATTICE, index), enlarged(REBASED, index)
    same = np.array([[a.is_equivalent(b, 1e-7) for b in again] for a in found])
    assert len(found) == len(hermite_matrices(index))
    assert (same.sum(0) == 1).all() and (same.sum(1) == 1).all()
    assert all(lattice.origin == LATTICE.origin for lattice in found)


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


@pytest.mark.parametrize("index", [2, 3, 6])
def test_the_duals_of_the_coarser_are_the_finer_of_the_dual(index: int) -> None:
    """Each dual of a coarser lattice is one of the finer lattices of the dual, and all of them occur."""
    duals = [lattice.dual() for lattice in coarser(LATTICE, index)]
    wanted = finer(LATTICE.dual(), index)
    assert [sum(one.is_equivalent(other, 1e-10) for other in wanted) for one in duals] == [1] * len(wanted)


def test_long_thin_lattices_have_coarser_ones() -> None:
    """A lattice of 2 px by 10 000 px has its 30-fold ones, none refused for being nearly parallel."""
    assert len(coarser(Lattice((2.0, 0.0), (0.3, 1e4)), 30)) == 72
