"""The compiled reduction of bases is that of the lattice."""

from __future__ import annotations

import numpy as np

from nrbench.lattice.geometry import Lattice, shortest_pair
from nrbench.lattice.reduction_kernels import reduce_bases


def test_many_bases_are_reduced_as_each_alone() -> None:
    """The bases reduced at once are those reduced one by one, to the bit, ties included."""
    rng = np.random.default_rng(0)
    bases = np.concatenate([rng.uniform(-40, 40, (200, 2, 2)), rng.integers(-9, 10, (400, 2, 2))])
    bases = bases[np.abs(np.linalg.det(bases)) > 0.5]
    np.testing.assert_array_equal(reduce_bases(bases, False), [shortest_pair(basis) for basis in bases])
    expected = [Lattice.from_basis(basis).reduced().matrix for basis in bases]
    np.testing.assert_array_equal(reduce_bases(bases, True), expected)


def test_parallel_vectors_are_reduced_to_one() -> None:
    """Of parallel vectors one is left, with a vector of length 0 or nearly 0."""
    (first, second) = reduce_bases(np.array([[(6.0, 3.0), (4.0, 2.0)]]), False)[0]
    assert min(np.hypot(*first), np.hypot(*second)) < 1e-9
