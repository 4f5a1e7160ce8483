"""Lattices that are turned about their origin."""

import math

from nrbench.lattice.geometry import Lattice


def turned(lattice: Lattice, degrees: float) -> Lattice:
    """Return the lattice turned from x to y, its origin at (0, 0)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return Lattice.from_basis(lattice.matrix @ [[c, s], [-s, c]])
