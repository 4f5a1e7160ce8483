"""Coarser and finer lattices by integer matrices in Hermite normal form."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.lattice.comparison import lattice_error
from nrbench.lattice.geometry import Lattice, hermite_matrices, shortest_pair

LATTICE = Lattice((27.3, 1.0), (8.0, 12.2), (4.0, 1.0))
REBASED = Lattice((27.3 + 3 * 8.0, 1.0 + 3 * 12.2), (27.3 + 2 * 8.0, 1.0 + 2 * 12.2), (4.0, 1.0))


def coarser(lattice: Lattice, index: int) -> list[Lattice]:
    """Return the supercells of an index."""
    return [Lattice.from_basis(shortest_pair(basis)) for basis in hermite_matrices(index) @ lattice.matrix]


def finer(lattice: Lattice, index: int) -> list[Lattice]:
    """Return the subcells of an index."""
    return [Lattice.from_basis(shortest_pair(basis)) for basis in hermite_matrices(index) @ lattice.matrix / index]


@pytest.mark.parametrize("index", [1, 2, 3, 4, 5, 6, 7, 12, 30])
def test_there_are_as_many_forms_as_the_divisors_add_up_to(index: int) -> None:
    """Each form has the determinant, is triangular, positive and reduced, and occurs once."""
    forms = hermite_matrices(index)
    assert len(forms) == sum(d for d in range(1, index + 1) if index % d == 0)
    assert len({str(form.tolist()) for form in forms}) == len(forms)
    for (a, b), (zero, d) in forms.tolist():
        assert a * d == index and a > 0 and d > 0 and zero == 0 and 0 <= b < d


@pytest.mark.parametrize("index", [0, -2, 2.0, True, "2"])
def test_an_index_is_a_count(index: object) -> None:
    """Anything but a whole number from 1 on is refused."""
    with pytest.raises(BadInput, match="1 or more"):
        hermite_matrices(index)  # type: ignore[arg-type]


@pytest.mark.parametrize("index", [1, 2, 3, 5, 7, 8])
@pytest.mark.parametrize("enlarged", [coarser, finer])
def test_every_lattice_of_an_index_comes_once_whatever_the_basis(index: int, enlarged: object) -> None:
    """They are pairwise different, and those of another basis are the same ones."""
    lattices, again = enlarged(LATTICE, index), enlarged(REBASED, index)
    same = np.array([[a.is_equivalent(b, 1e-7) for b in again] for a in lattices])
    assert len(lattices) == len(hermite_matrices(index))
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


@pytest.mark.parametrize("index", [2, 3, 6])
def test_the_duals_of_the_coarser_are_the_finer_of_the_dual(index: int) -> None:
    """Each dual of a coarser lattice is one of the finer lattices of the dual, and all of them occur."""
    duals = [lattice.dual() for lattice in coarser(LATTICE, index)]
    expected = finer(LATTICE.dual(), index)
    assert [sum(one.is_equivalent(other, 1e-10) for other in expected) for one in duals] == [1] * len(expected)


def test_long_thin_lattices_have_coarser_ones() -> None:
    """A lattice of 2 px by 10 000 px has its 30-fold ones, none refused for being nearly parallel."""
    assert len(coarser(Lattice((2.0, 0.0), (0.3, 1e4)), 30)) == 72
