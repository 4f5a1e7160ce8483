"""How far an estimated lattice is from the true one."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nrbench.lattice.geometry import Lattice, Points

Relation = Literal["exact", "supercell", "subcell", "wrong"]

CHANCE_RADIUS = 0.1
"""A vector counts as a lattice point only within this many s of one, so that a fine lattice (of which any vector is
nearly a multiple) is no match by chance: for two random vectors the odds are below 0.2 %."""


@dataclass(frozen=True)
class LatticeError:
    """The comparison of an estimate with the truth; origins are left out.

    Parameters
    ----------
    relation
        ``exact``: the same lattice; ``supercell``: the estimate's cell is k true cells; ``subcell``: the true cell is k
        of the estimate's; ``wrong``: none of these.
    k
        Cells in a cell: 1 where exact, 0 where wrong.
    vector
        The largest error, px, of the reduced vectors of the truth as the estimate would have them: its basis after
        the integer change of basis that matches best (in a supercell, fractions of its vectors). There are two of them,
        or three where the second has an equal (rhombic, hexagonal).
    angle
        The largest angle, degrees in [0, 180], between those vectors and the true ones.
    area_ratio
        Area of the estimate's cell over that of the true cell.
    drift
        px that the two lattices, matched at one corner of the picture, are apart at the opposite corner (the worse
        of the two diagonals).
    """

    relation: Relation
    k: int
    vector: float
    angle: float
    area_ratio: float
    drift: float

    @property
    def label(self) -> str:
        """``"exact"``, ``"supercell 2"``, ``"subcell 1/2"`` or ``"wrong"``."""
        return {"supercell": f"supercell {self.k}", "subcell": f"subcell 1/{self.k}"}.get(self.relation, self.relation)

    @property
    def index(self) -> float | None:
        """Cells of the truth in a cell of the estimate: 1, k, or 1/k; None where wrong."""
        return {"exact": 1.0, "supercell": float(self.k), "subcell": 1 / max(self.k, 1)}.get(self.relation)


def lattice_error(
    estimate: Lattice, truth: Lattice, shape: tuple[int, int], tolerance: float = 1.0, share: float = 0.0
) -> LatticeError:
    """Compare an estimated lattice with the true one.

    The relation is mutual: where the estimate is a supercell of the truth, the truth is a subcell of the estimate.

    Parameters
    ----------
    estimate, truth
        The two lattices; neither basis nor origin matters.
    shape
        (height, width) in px of the picture over which ``drift`` accumulates.
    tolerance
        The largest error, px, of the finer one's reduced vectors that still counts as the same lattice (or as a
        supercell, a subcell). On small lattices it is also bounded: no reduced vector of the coarser one may be further
        than :data:`CHANCE_RADIUS` times the smaller s from a point of the finer one.
    share
        Counts too: an error up to this share of the smaller s, where that is more than ``tolerance``. A lattice
        measured by hand on a photograph is known to about 1.5 px or 4 % of s, whichever is larger.

    Returns
    -------
    LatticeError
        Where the relation is ``wrong``, the numbers compare the two reduced bases, matched vector by vector.
    """
    found, true = estimate.canonical().matrix, truth.canonical().matrix
    allowed = max(tolerance, share * min(np.hypot(*found[0]), np.hypot(*true[0])))
    nested = _nested(found, true, allowed)
    k, matched = nested or (0, _nearest_basis(found, true))
    wanted, had = _equals(true) @ true, _equals(true) @ matched
    ratio = estimate.area / truth.area
    drift = _drift(matched, true, shape)
    return LatticeError(_relation(k, ratio), k, _longest(had - wanted), _angle(had, wanted), ratio, drift)


def _relation(k: int, ratio: float) -> Relation:
    if k < 2:
        return "exact" if k else "wrong"
    return "supercell" if ratio > 1 else "subcell"


def _nested(found: Points, true: Points, tolerance: float) -> tuple[int, Points] | None:
    """Return k and the true basis as ``found`` has it, where one lattice holds the other; else None."""
    finer = abs(np.linalg.det(found)) < abs(np.linalg.det(true))
    fine, coarse = (found, true) if finer else (true, found)
    change = np.rint(coarse @ np.linalg.inv(fine))
    k = round(abs(float(np.linalg.det(change))))
    off = coarse - change @ fine
    apart = _longest(_equals(coarse) @ off)
    if k == 0 or apart > CHANCE_RADIUS * min(np.hypot(*fine[0]), np.hypot(*coarse[0])):
        return None
    error = _longest(_equals(fine) @ np.linalg.solve(change, off))
    if max(error, apart if k == 1 else 0.0) > tolerance:
        return None
    return k, np.asarray(change @ found if finer else np.linalg.solve(change, found), np.float64)


def _equals(basis: Points) -> Points:
    """Return the integers of a canonical basis's vectors, ``(2, 2)``, and of a third as short as the second: (3, 2)."""
    a, b = basis
    third = np.array([-1.0, 1.0])
    tied = (b - a) @ (b - a) <= b @ b * (1 + 1e-9)
    return np.vstack([np.eye(2), third]) if tied else np.eye(2)


def _nearest_basis(found: Points, true: Points) -> Points:
    """Return the basis of ``found``, among those near its reduced one, whose vectors are nearest to ``true``.

    Of bases equally near by the longest error, that of the least sum of squares; of those, the one of the greatest
    components: what is returned does not depend on the order of the candidates.
    """
    changes = np.array(list(itertools.product((-1, 0, 1), repeat=4)), np.float64).reshape(-1, 2, 2)
    bases = changes[np.abs(np.abs(np.linalg.det(changes)) - 1) < 0.5] @ found
    squares = ((_equals(true) @ (bases - true)) ** 2).sum(2)
    nearness = np.stack([squares.sum(1), squares.max(1)]) / squares.max()
    keys = np.vstack([-bases.reshape(-1, 4).T / np.abs(bases).max(), nearness])
    return np.asarray(bases[np.lexsort(np.round(keys, 10))[0]])


def _longest(vectors: Points) -> float:
    return float(np.hypot(*vectors.T).max())


def _angle(matched: Points, true: Points) -> float:
    cross = matched[:, 0] * true[:, 1] - matched[:, 1] * true[:, 0]
    return float(np.degrees(np.arctan2(np.abs(cross), (matched * true).sum(1))).max())


def _drift(matched: Points, true: Points, shape: tuple[int, int]) -> float:
    height, width = shape
    diagonals = np.array([(width, height), (width, -height)], np.float64)
    return float(np.hypot(*(diagonals @ np.linalg.solve(true, matched - true)).T).max())
