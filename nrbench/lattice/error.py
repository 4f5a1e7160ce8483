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
        The larger error, px, of the two reduced vectors of the truth as the estimate would have them: its basis after
        the integer change of basis that matches best (in a supercell, fractions of its vectors).
    angle
        The larger angle, degrees in [0, 180], between those vectors and the true ones.
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


def lattice_error(estimate: Lattice, truth: Lattice, shape: tuple[int, int], tolerance: float = 1.0) -> LatticeError:
    """Compare an estimated lattice with the true one.

    Parameters
    ----------
    estimate, truth
        The two lattices; neither basis nor origin matters.
    shape
        (height, width) in px of the picture over which ``drift`` accumulates.
    tolerance
        The largest ``vector`` error, px, that still counts as the same lattice (or as a supercell, a subcell). On small
        lattices it is also bounded by :data:`CHANCE_RADIUS` times s of the finer of the two.

    Returns
    -------
    LatticeError
        Where the relation is ``wrong``, the numbers compare the two reduced bases, matched vector by vector.
    """
    found, true = estimate.reduced().matrix, truth.reduced().matrix
    k, matched = _nested(found, true)
    error = float(np.hypot(*(matched - true).T).max())
    if k == 0 or error > tolerance:
        k, matched = 0, _nearest_basis(found, true)
        error = float(np.hypot(*(matched - true).T).max())
    ratio = estimate.area / truth.area
    return LatticeError(_relation(k, ratio), k, error, _angle(matched, true), ratio, _drift(matched, true, shape))


def _relation(k: int, ratio: float) -> Relation:
    if k < 2:
        return "exact" if k else "wrong"
    return "supercell" if ratio > 1 else "subcell"


def _nested(found: Points, true: Points) -> tuple[int, Points]:
    """Return k and the true basis as ``found`` has it, where one lattice holds the other; else 0 and ``true``."""
    finer = abs(np.linalg.det(found)) < abs(np.linalg.det(true))
    fine, coarse = (found, true) if finer else (true, found)
    change = np.rint(coarse @ np.linalg.inv(fine))
    k = round(abs(float(np.linalg.det(change))))
    apart = np.hypot(*(coarse - change @ fine).T).max()
    if k == 0 or apart > CHANCE_RADIUS * np.hypot(*fine[0]):
        return 0, true
    return k, np.asarray(change @ found if finer else np.linalg.solve(change, found), np.float64)


def _nearest_basis(found: Points, true: Points) -> Points:
    """Return the basis of ``found``, among those near its reduced one, whose vectors are nearest to ``true``."""
    changes = np.array(list(itertools.product((-1, 0, 1), repeat=4)), np.float64).reshape(-1, 2, 2)
    bases = changes[np.abs(np.abs(np.linalg.det(changes)) - 1) < 0.5] @ found
    return np.asarray(bases[np.argmin(np.hypot(*np.moveaxis(bases - true, -1, 0)).max(1))])


def _angle(matched: Points, true: Points) -> float:
    cross = matched[:, 0] * true[:, 1] - matched[:, 1] * true[:, 0]
    return float(np.degrees(np.arctan2(np.abs(cross), (matched * true).sum(1))).max())


def _drift(matched: Points, true: Points, shape: tuple[int, int]) -> float:
    height, width = shape
    diagonals = np.array([(width, height), (width, -height)], np.float64)
    return float(np.hypot(*(diagonals @ np.linalg.solve(true, matched - true)).T).max())
