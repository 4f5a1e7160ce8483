"""Compare an estimated lattice with the true one, and say how two lattices are related."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nrbench.lattice.geometry import Integers, Lattice, Points

Relation = Literal["exact", "supercell", "subcell", "wrong"]

CHANCE_RADIUS = 0.1
"""A vector matches a lattice point only within this distance, in s. Otherwise a fine lattice, of which any vector is
nearly a multiple, would match by chance. For two random vectors the probability is below 0.2 %."""
MOST_CELLS = 64
"""Largest number of cells in a cell for which two lattices count as related."""


@dataclass(frozen=True)
class LatticeError:
    """The comparison of an estimated lattice with the true one; origins are ignored.

    Parameters
    ----------
    relation
        ``exact``: the same lattice; ``supercell``: a cell of the estimate holds k true cells; ``subcell``: a true cell
        holds k cells of the estimate; ``wrong``: none of these.
    k
        Number of cells in a cell: 1 if exact, 0 if wrong.
    vector
        The largest error, px, of the estimate's vectors that match the reduced vectors of the truth: its basis after
        the integer change of basis that matches best (for a supercell, fractions of its vectors). There are two
        vectors, or three if a third one is as short as the second (rhombic, hexagonal).
    angle
        The largest angle, degrees in [0, 180], between these vectors and the true ones.
    area_ratio
        Area of the estimate's cell over that of the true cell.
    drift
        Distance, px, of the two lattices at one corner of the image if they are matched at the opposite corner (the
        larger of the two diagonals).
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
        """Number of true cells in a cell of the estimate: 1, k, or 1/k; None if wrong."""
        return {"exact": 1.0, "supercell": float(self.k), "subcell": 1 / max(self.k, 1)}.get(self.relation)


def lattice_error(
    estimate: Lattice, truth: Lattice, shape: tuple[int, int], tolerance: float = 1.0, share: float = 0.0
) -> LatticeError:
    """Compare an estimated lattice with the true one.

    If the estimate is a supercell of the truth, then the truth is a subcell of the estimate.

    Parameters
    ----------
    estimate, truth
        The two lattices; neither basis nor origin matters.
    shape
        (height, width) in px of the image over which ``drift`` accumulates.
    tolerance
        Largest error, px, of the reduced vectors of the finer lattice for any relation but ``wrong``. On small lattices
        a second bound holds: each reduced vector of the coarser lattice lies within :data:`CHANCE_RADIUS` times the
        smaller s of a point of the finer one.
    share
        The tolerance is at least this share of the smaller s. A lattice measured by hand on a photograph is known to
        about 1.5 px or 4 % of s, whichever is larger.

    Returns
    -------
    LatticeError
        If the relation is ``wrong``, the numbers compare the two reduced bases vector by vector.

    Examples
    --------
    >>> from nrbench.lattice.relation import lattice_error
    >>> from nrbench.lattice.geometry import Lattice
    >>> lattice_error(Lattice((40.0, 0.0), (0.0, 12.0)), Lattice((20.0, 0.0), (0.0, 12.0)), (128, 128)).label
    'supercell 2'
    """
    basis, true = estimate.canonical().matrix, truth.canonical().matrix
    allowed = max(tolerance, share * min(np.hypot(*basis[0]), np.hypot(*true[0])))
    k, matched = _match_nested(basis, true, allowed) or (0, _nearest_basis(basis, true))
    vectors, true_vectors = _shortest_combinations(true) @ matched, _shortest_combinations(true) @ true
    ratio = estimate.area / truth.area
    error, angle = _longest(vectors - true_vectors), _angle(vectors, true_vectors)
    return LatticeError(_relation(k, ratio), k, error, angle, ratio, _drift(matched, true, shape))


@dataclass(frozen=True)
class BasisChange:
    """How a basis of one lattice is made of the basis of another one: ``numerators @ reference / divisor``.

    Parameters
    ----------
    numerators
        ``((a, b), (0, d))``, integers: the Hermite normal form, which depends on the lattices and on the basis of the
        reference, and not on the basis of the other lattice.
    divisor
        1 for a supercell of the reference.
    """

    numerators: tuple[tuple[int, int], tuple[int, int]]
    divisor: int

    @property
    def index(self) -> float:
        """Number of cells of the reference in a cell of the lattice: 1 if both are the same lattice."""
        (a, _), (_, d) = self.numerators
        return a * d / self.divisor**2

    @property
    def name(self) -> str:
        """The relation in words.

        ``"the same"``; ``"double along t1"``, ``"half along t2"``, ``"x 3 along t2"``, ``"1/3 along t1 and t2"`` if
        only lengths differ; else ``"supercell x 2"`` or ``"subcell 1/2"``, with the number of cells in a cell, as for a
        checkerboard; ``"commensurate"`` if neither lattice contains the other.
        """
        (a, b), (_, d) = self.numerators
        if b == 0:
            first, second = (_name_factor(number, self.divisor) for number in (a, d))
            if first == second:
                return f"{first} along t1 and t2" if first else "the same"
            steps = [f"{name} along {axis}" for name, axis in ((first, "t1"), (second, "t2")) if name]
            return ", ".join(steps)
        if self.divisor == 1:
            return f"supercell x {a * d}"
        cells = self.divisor**2 / (a * d)
        return f"subcell 1/{round(cells)}" if self._is_finer else "commensurate"

    @property
    def _is_finer(self) -> bool:
        """Whether the lattice contains the reference: ``divisor`` times the inverse of ``numerators`` is whole."""
        (a, b), (_, d) = self.numerators
        return all(self.divisor * number % (a * d) == 0 for number in (a, b, d))


def relate(lattice: Lattice, reference: Lattice, tolerance: float = 1.0, share: float = 0.04) -> BasisChange | None:
    """Return how a lattice is made of the vectors of another one; None if it is not.

    Parameters
    ----------
    lattice, reference
        The two lattices. The result depends on the basis of ``reference``, whose vectors :attr:`BasisChange.name`
        calls t1 and t2. Origins are ignored.
    tolerance, share
        As for :func:`lattice_error`: largest error of the reduced vectors of the finer lattice, in px and in s.

    Notes
    -----
    Either lattice may contain the other, up to :data:`MOST_CELLS` cells in a cell. Else each vector may be doubled or
    halved.

    Examples
    --------
    >>> from nrbench.lattice.relation import relate
    >>> from nrbench.lattice.geometry import Lattice
    >>> wall = Lattice((40.0, 0.0), (0.0, 12.0))
    >>> relate(Lattice((20.0, 0.0), (0.0, 36.0)), wall).name
    'half along t1, x 3 along t2'
    >>> relate(Lattice((40.0, 12.0), (40.0, -12.0)), wall).name
    'supercell x 2'
    """
    allowed = max(tolerance, share * min(lattice.s, reference.s))
    basis, true = lattice.canonical().matrix, reference.canonical().matrix
    nested = _match_nested(basis, true, allowed)
    if nested is not None:
        k, finer = nested[0], lattice.area < reference.area
        if k > MOST_CELLS:
            return None
        divisor = k if finer else 1
        return _reduce_change(np.rint(divisor * basis @ np.linalg.inv(reference.matrix)).astype(np.int64), divisor)
    # Twice the one lattice lies within the other, and not farther apart than a chance match may be.
    double = Lattice.from_basis(2 * basis)
    common = _match_nested(double.matrix, true, allowed)
    if common is None or double.area < reference.area or common[0] > MOST_CELLS:
        return None
    return _reduce_change(np.rint(double.matrix @ np.linalg.inv(reference.matrix)).astype(np.int64), 2)


def _reduce_change(numerators: Integers, divisor: int) -> BasisChange:
    """Return the change in lowest terms and in Hermite normal form."""
    (a, b), (c, d) = numerators.tolist()
    while c:
        steps = a // c
        a, b, c, d = c, d, a - steps * c, b - steps * d
    a, b, d = (a, b, abs(d)) if a > 0 else (-a, -b, abs(d))
    b %= d
    common = math.gcd(a, b, d, divisor)
    return BasisChange(((a // common, b // common), (0, d // common)), divisor // common)


def _name_factor(numerator: int, divisor: int) -> str:
    """Return a ratio of lengths in words; empty for 1."""
    common = math.gcd(numerator, divisor)
    up, down = numerator // common, divisor // common
    names = {(1, 1): "", (2, 1): "double", (1, 2): "half"}
    return names.get((up, down), f"x {up}" if down == 1 else f"{up}/{down}")


def _relation(k: int, ratio: float) -> Relation:
    if k < 2:
        return "exact" if k else "wrong"
    return "supercell" if ratio > 1 else "subcell"


def _match_nested(basis: Points, true: Points, tolerance: float) -> tuple[int, Points] | None:
    """Return k and the estimate of the true basis if one lattice contains the other, else None."""
    finer = abs(np.linalg.det(basis)) < abs(np.linalg.det(true))
    fine, coarse = (basis, true) if finer else (true, basis)
    change = np.rint(coarse @ np.linalg.inv(fine))
    k = round(abs(float(np.linalg.det(change))))
    off = coarse - change @ fine
    apart = _longest(_shortest_combinations(coarse) @ off)
    if k == 0 or apart > CHANCE_RADIUS * min(np.hypot(*fine[0]), np.hypot(*coarse[0])):
        return None
    error = _longest(_shortest_combinations(fine) @ np.linalg.solve(change, off))
    if max(error, apart if k == 1 else 0.0) > tolerance:
        return None
    return k, np.asarray(change @ basis if finer else np.linalg.solve(change, basis), np.float64)


def count_cells(basis: Points, other: Points, tolerance: float) -> float:
    """Return the number of cells of one lattice in a cell of another: 1, k or 1/k; 0 if neither contains the other.

    A fast form of :func:`lattice_error` for reduced bases.

    Parameters
    ----------
    basis, other
        ``(2, 2)``, reduced, rows (x, y) px: the lattice of the large cell, and that of the cells that are counted.
    tolerance
        Largest error, px, of the vectors of the finer lattice.
    """
    # Plain numbers: the functions of numpy for matrices take thirty times as long for one of 2 x 2.
    fine, coarse = basis.ravel().tolist(), other.ravel().tolist()
    area, other_area = (a * d - b * c for a, b, c, d in (fine, coarse))
    finer = abs(area) < abs(other_area)
    if not finer:
        fine, coarse, area = coarse, fine, other_area
    (ax, ay, bx, by), (cx, cy, dx, dy) = fine, coarse
    m, n = round((cx * by - cy * bx) / area), round((cy * ax - cx * ay) / area)
    p, q = round((dx * by - dy * bx) / area), round((dy * ax - dx * ay) / area)
    index = m * q - n * p
    first = cx - m * ax - n * bx, cy - m * ay - n * by
    second = dx - p * ax - q * bx, dy - p * ay - q * by
    apart = max(math.hypot(*first), math.hypot(*second))
    shortest = min(math.hypot(*vector) for vector in ((ax, ay), (bx, by), (cx, cy), (dx, dy)))
    if index == 0 or apart > CHANCE_RADIUS * shortest:
        return 0.0
    # The errors of the vectors of the finer lattice: the inverse of the change, applied to those of the coarser one.
    first_error = math.hypot(q * first[0] - n * second[0], q * first[1] - n * second[1])
    second_error = math.hypot(m * second[0] - p * first[0], m * second[1] - p * first[1])
    k = abs(index)
    if max(first_error / k, second_error / k, apart if k == 1 else 0.0) > tolerance:
        return 0.0
    return 1 / k if finer else float(k)


def _shortest_combinations(basis: Points) -> Points:
    """Return the combinations of a canonical basis that are as short as its vectors: ``(2, 2)`` or ``(3, 2)``."""
    a, b = basis
    third = np.array([-1.0, 1.0])
    tied = (b - a) @ (b - a) <= b @ b * (1 + 1e-9)
    return np.vstack([np.eye(2), third]) if tied else np.eye(2)


def _nearest_basis(basis: Points, true: Points) -> Points:
    """Return the basis of the same lattice, among those near ``basis``, whose vectors are nearest to ``true``.

    Of bases with equal longest error the one of the least sum of squares is chosen, and of these the one with the
    greatest components, so that the result does not depend on the order of the candidates.
    """
    changes = np.array(list(itertools.product((-1, 0, 1), repeat=4)), np.float64).reshape(-1, 2, 2)
    bases = changes[np.abs(np.abs(np.linalg.det(changes)) - 1) < 0.5] @ basis
    squares = ((_shortest_combinations(true) @ (bases - true)) ** 2).sum(2)
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
