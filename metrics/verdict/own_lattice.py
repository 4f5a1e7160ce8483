"""The output's own lattice: the least-squares lattice of its windows' displacements, no detector asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.lattice.comparison import LatticeError, lattice_error
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

from .window_registration import RegisteredWindows, affine_residuals

LEAST_FOLLOWERS = 0.5
"""Share of the windows that must follow one lattice for it to be the output's."""


@dataclass(frozen=True)
class OwnLattice:
    """A lattice, and how many windows lie on it.

    Parameters
    ----------
    lattice
        In the output's coordinates.
    followers
        Share of the windows within 0.04 s of it, in [0, 1].
    """

    lattice: Lattice
    followers: float

    def error(self, truth: Lattice, shape: Shape) -> LatticeError | None:
        """Return the comparison with the true lattice; None where too few windows follow this one."""
        return lattice_error(self.lattice, truth, shape) if self.followers >= LEAST_FOLLOWERS else None


def own_lattice(placement: RegisteredWindows, drift: Points) -> OwnLattice | None:
    """Return the lattice on which the output's content lies; None where there are fewer than 3 x 3 windows.

    The content at x came from x - d(x), with ``d = drift @ x + constant`` fitted by least squares to the windows; so a
    lattice point p of the periodic image is found at ``(1 - drift)^-1 (p + constant)``.
    """
    if min(placement.grid) < 3:
        return None
    _, inside, constant = affine_residuals(placement, drift)
    return OwnLattice(moved(placement.lattice, drift, constant), float(inside.mean()))


def moved(lattice: Lattice, drift: Points, constant: Points) -> Lattice:
    """Return where a lattice's points are found in an image whose content has moved by ``drift @ x + constant``."""
    matrix = spread(drift)
    t1, t2, origin = (matrix @ np.asarray(v) for v in (lattice.t1, lattice.t2, np.add(lattice.origin, constant)))
    return Lattice((t1[0], t1[1]), (t2[0], t2[1]), (origin[0], origin[1]))


def spread(drift: Points) -> Points:
    """Return the 2 x 2 matrix that takes places in the periodic image to where they are found: ``(1 - drift)^-1``."""
    return np.asarray(np.linalg.inv(np.eye(2) - drift), np.float64)
