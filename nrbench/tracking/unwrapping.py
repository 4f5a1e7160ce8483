"""Unwrapping: from displacements that are known modulo a lattice to a field that is continuous."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking.unwrapping_kernels import grow

LABELS = 16
"""Displacements that are tried along each vector of a cell."""
STIFFNESS = 1.5
"""What a step of s between neighbors costs, in correlation: one of 0.15 s costs 0.03, one of 0.5 s costs 0.4."""
_SWEEPS = 2
Surfaces = NDArray[np.float32]
"""``(rows, columns, LABELS, LABELS)``: at each node the correlation at displacement (i t1 + j t2) / LABELS."""


def unwrap(surfaces: Surfaces, lattice: Lattice) -> Points:
    """Return the displacement of each node, ``(rows, columns, 2)`` as (x, y) px: continuous, not modulo the lattice.

    Grown from the node of the highest peak, always the highest among those beside what is known: each node takes the
    displacement that its own surface and the mean of its known neighbors agree on best (:data:`STIFFNESS`). Then every
    node is asked again, with all its neighbors known, twice.

    Parameters
    ----------
    surfaces
        Correlations by displacement.
    lattice
        Reduced.
    """
    side = np.arange(LABELS) / LABELS
    steps = lattice.wrap(np.stack(np.meshgrid(side, side, indexing="ij"), -1) @ lattice.matrix)
    costs = STIFFNESS * (steps**2).sum(-1) / lattice.s**2
    trust = np.maximum(surfaces.max((2, 3)), 1e-3).astype(np.float64) ** 2
    return grow(np.ascontiguousarray(surfaces, np.float32), trust, steps, costs, lattice.matrix, _SWEEPS)
