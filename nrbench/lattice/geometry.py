"""Two-dimensional lattices: bases, cell coordinates, points in a region, and lattices contained in one another."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nrbench.errors import BadInput

Integers = NDArray[np.int64]
Vector = tuple[float, float]
LatticeKind = Literal["parallelogram", "rectangular", "rhombic", "square", "hexagonal"]
LEAST_PERIOD = 2.0
"""px; the shortest period that pixels can show."""
Points = NDArray[np.float64]
"""``float64 (..., 2)``: (x, y) in px, or (u, v) in cells."""


LONGEST = 1e9
"""px; the longest vector of a lattice: squares and products of longer ones may overflow."""
SAME_LENGTH, SAME_ANGLE = 0.02, math.radians(3)
"""Lengths (as a share of the shortest one) and angles that differ by less count as equal when a basis is chosen."""
MOST_STEPS = 64
"""Most steps of a reduction. Each shortens a vector, and vectors up to :data:`LONGEST` need fewer."""


@dataclass(frozen=True)
class Lattice:
    """All points ``origin + a t1 + b t2`` for integers a, b.

    Parameters
    ----------
    t1, t2
        Generating vectors (x, y) in px, x right, y down; real-valued, not parallel.
    origin
        One lattice point (x, y) in px, pixel centers at integers: by convention the middle of an element. (0, 0) is
        also the origin of lattices whose phase is not known.

    Raises
    ------
    BadInput
        If a vector is zero, not finite, or parallel to the other.

    Examples
    --------
    >>> from nrbench import Lattice
    >>> weave = Lattice((30.0, 0.0), (15.0, 12.0))
    >>> weave.area
    360.0
    >>> weave.kind
    'rhombic'
    """

    t1: Vector
    t2: Vector
    origin: Vector = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("t1", "t2", "origin"):
            object.__setattr__(self, name, _check_vector(getattr(self, name), name))
        longest = max(math.hypot(*self.t1), math.hypot(*self.t2))
        if longest > LONGEST or math.hypot(*self.origin) > LONGEST**2:
            raise BadInput(
                f"lattice: t1 {self.t1}, t2 {self.t2}, origin {self.origin} are not in px; no image is so large"
            )
        if abs(self._determinant) <= 1e-6 * longest**2:
            raise BadInput(f"lattice: t1 {self.t1} and t2 {self.t2} are parallel or zero; give two independent vectors")

    @property
    def _determinant(self) -> float:
        return self.t1[0] * self.t2[1] - self.t1[1] * self.t2[0]

    @property
    def area(self) -> float:
        """Area of one cell in px^2."""
        return abs(self._determinant)

    @cached_property
    def matrix(self) -> Points:
        """The 2 x 2 matrix whose rows are t1 and t2."""
        return np.array([self.t1, self.t2], np.float64)

    @cached_property
    def _inverse(self) -> Points:
        return np.asarray(np.linalg.inv(self.matrix), np.float64)

    @property
    def s(self) -> float:
        """Length of the shortest lattice vector in px."""
        return math.hypot(*self.reduced().t1)

    @property
    def covering_radius(self) -> float:
        """Largest distance of a position from the nearest lattice point, px: circumradius of the reduced triangle."""
        a, b = self.reduced().matrix
        return float(np.hypot(*a) * np.hypot(*b) * np.hypot(*(b - a))) / (2 * self.area)

    def reduced(self) -> Lattice:
        """Return the same lattice in a Lagrange-Gauss basis: t1 shortest, t2 next, angle in [60, 90] degrees.

        If several vectors are equally short (square, rhombic, hexagonal), several bases are reduced, and the basis that
        is returned depends on the given one; see :meth:`canonical`.

        Returns
        -------
        Lattice
            It has the same origin.

        Examples
        --------
        >>> from nrbench.lattice.geometry import Lattice
        >>> Lattice((30.0, 1.0), (90.0, 15.0)).reduced()
        Lattice(t1=(0.0, 12.0), t2=(30.0, 1.0), origin=(0.0, 0.0))
        """
        return Lattice.from_basis(self._reduced, self.origin)

    @cached_property
    def _reduced(self) -> Points:
        return reduce_basis(self.matrix)

    def canonical(self) -> Lattice:
        """Return the same lattice in the one reduced basis that depends on the lattice alone.

        Of equally short vectors (to 1e-9 of their squares) the one with the smallest angle is chosen, measured from
        right (x) towards down (y). The angle of t1 is in [0, 180) degrees, and so is that of t2 unless the angle
        between them would be obtuse.

        Returns
        -------
        Lattice
            It has the same origin.
        """
        a, b = (_point_down(vector) for vector in _break_ties(*reduce_bases(self.matrix[np.newaxis], False)[0]))
        return Lattice.from_basis((a, -b if _is_obtuse(a, b) else b), self.origin)

    def oriented(self) -> Lattice:
        """Return the same lattice in the reduced basis in which detectors report it, which noise hardly changes.

        t1 points right and is nearer to the direction of x than t2 is. The basis is right-handed: from t1 to t2 is a
        turn like that from x to y (down), by 60 to 120 degrees. Lengths that differ by less than :data:`SAME_LENGTH`
        and angles that differ by less than :data:`SAME_ANGLE` count as equal. Of equal choices, t1 is the one that
        points most upwards, and t2 makes the smallest angle with it. So noisy copies of a square, rhombic or
        hexagonal lattice have one basis. Those of a lattice that lies just at one of these limits have two.

        Returns
        -------
        Lattice
            It has the same origin.

        Examples
        --------
        >>> from nrbench.lattice.geometry import Lattice
        >>> Lattice((12.0, 9.0), (-12.1, 8.9)).oriented()
        Lattice(t1=(12.1, -8.9), t2=(12.0, 9.0), origin=(0.0, 0.0))
        """
        a, b = self._reduced
        vectors = _point_right(np.stack([a, b, b - a, b + a]))
        slopes, squares = np.arctan2(vectors[:, 1], vectors[:, 0]), _dot(vectors, vectors)
        shortest, next_one = squares[:2] + 2 * SAME_LENGTH * squares[0]
        choices = []
        for i, j in itertools.permutations(np.flatnonzero(squares <= next_one), 2):
            t1, t2 = vectors[i], vectors[j]
            cross = t1[0] * t2[1] - t1[1] * t2[0]
            if abs(abs(cross) - self.area) < self.area / 2 and min(squares[i], squares[j]) <= shortest:
                choices.append((slopes[i], t1, t2 if cross > 0 else -t2))
        flattest = min(abs(slope) for slope, _, _ in choices) + SAME_ANGLE
        flat = [choice for choice in choices if abs(choice[0]) <= flattest]
        return Lattice.from_basis(min(flat, key=lambda choice: (choice[0], -choice[1] @ choice[2]))[1:], self.origin)

    def dual(self) -> Lattice:
        """Return the reciprocal lattice, in cycles per px: vectors d_i with ``d_i . t_j`` = 1 where i = j, else 0.

        Its points are the frequencies that a texture of this lattice can have. The dual of the dual is the lattice
        itself, with the origin at (0, 0). The dual of a supercell is finer than the dual of the lattice.

        Returns
        -------
        Lattice
            Its vectors are (x, y) in cycles per px.
        """
        return Lattice.from_basis(self._inverse.T)

    @property
    def kind(self) -> LatticeKind:
        """The Bravais class, within 1 % of the vectors' lengths; see :meth:`classify`."""
        return self.classify()

    def classify(self, tolerance: float = 0.01) -> LatticeKind:
        """Return the Bravais class: the most symmetric one that a small move of the vectors would make exact.

        Parameters
        ----------
        tolerance
            Largest move of the tip of a reduced vector, as a fraction of its length. If the lattice can become both
            rectangular and rhombic, the class that needs the smaller move is returned.

        Returns
        -------
        str
            ``"square"``, ``"rectangular"``, ``"hexagonal"``, ``"rhombic"`` or ``"parallelogram"``.
        """
        a, b = self.reduced().matrix
        short, long = float(np.hypot(*a)), float(np.hypot(*b))
        along, slack = float(a @ b) / short, tolerance * long
        equal, right, half = long - short <= slack, along <= min(slack, short / 4), short / 2 - along <= slack
        if right:
            return "square" if equal else "rectangular"
        if equal and half:
            return "hexagonal"
        return "rhombic" if equal or half else "parallelogram"

    def is_equivalent(self, other: Lattice, tolerance: float = 1e-6) -> bool:
        """Return whether both bases generate the same lattice; origins are ignored.

        Parameters
        ----------
        other
            The lattice compared with.
        tolerance
            Largest distance, px, of either of its reduced vectors from the integer combination of this lattice's
            vectors that matches it (an integer matrix of determinant +-1).

        Returns
        -------
        bool
            Whether an integer matrix of determinant +-1 turns one basis into the other.
        """
        mine, theirs = self.reduced().matrix, other.reduced().matrix
        change = np.rint(theirs @ np.linalg.inv(mine))
        error = np.hypot(*(theirs - change @ mine).T).max()
        return bool(abs(abs(np.linalg.det(change)) - 1) < 0.5 and error <= tolerance)

    def to_cell(self, xy: ArrayLike) -> Points:
        """Return cell coordinates (u, v) of points (x, y), shape ``(..., 2)``: ``xy = origin + u t1 + v t2``.

        Parameters
        ----------
        xy
            Points (x, y) px, shape ``(..., 2)``.

        Returns
        -------
        Points
            (u, v), shape ``(..., 2)``.
        """
        return np.asarray((np.asarray(xy, np.float64) - self.origin) @ self._inverse)

    def from_cell(self, uv: ArrayLike) -> Points:
        """Return points (x, y) of cell coordinates (u, v), shape ``(..., 2)``.

        Parameters
        ----------
        uv
            Cell coordinates (u, v), shape ``(..., 2)``.

        Returns
        -------
        Points
            (x, y) px, shape ``(..., 2)``.
        """
        return np.asarray(np.asarray(uv, np.float64) @ self.matrix + self.origin)

    def wrap(self, displacement: ArrayLike) -> Points:
        """Return each displacement (x, y) modulo the lattice, as the representative nearest to zero.

        The result, ``(..., 2)`` px, lies in the Voronoi cell. In a reduced basis the nearest lattice point is one of
        the four corners of the cell that holds the displacement. Of equally near representatives (to 1e-7 s) the
        rightmost is returned, then the lowest, so that the result depends on the lattice alone.

        Parameters
        ----------
        displacement
            (x, y) px, shape ``(..., 2)``.

        Returns
        -------
        Points
            (x, y) px, shape ``(..., 2)``.
        """
        d, basis = np.asarray(displacement, np.float64), self.reduced().matrix
        first, snap = np.floor(d @ np.linalg.inv(basis)), 1e-7 * np.hypot(*basis[0])
        candidates = np.stack([d - (first + corner) @ basis for corner in ((0, 0), (0, 1), (1, 0), (1, 1))])
        x, y = candidates[..., 0], candidates[..., 1]
        squares = x * x + y * y
        chosen = squares <= (np.sqrt(squares.min(0)) + snap) ** 2
        right = np.where(chosen, x, -np.inf)
        best = np.argmax(np.where(right >= right.max(0) - snap, y, -np.inf), 0)
        return np.asarray(np.take_along_axis(candidates, best[np.newaxis, ..., np.newaxis], 0)[0])

    def points(self, shape: tuple[int, int], margin: float = 0.0) -> Points:
        """Return all lattice points (x, y) within ``margin`` px of an image of ``shape``, as ``(n, 2)``.

        They are sorted by cell coordinates. Time grows with their number and does not depend on the basis.

        Parameters
        ----------
        shape
            (height, width) of the image, px.
        margin
            Largest distance of a point from the image, px.

        Returns
        -------
        Points
            (x, y) px, shape ``(n, 2)``.
        """
        height, width = shape
        low, high = -0.5 - margin, np.array([width, height]) - 0.5 + margin
        xy = self.from_cell(self.cell_numbers((low, low), (high[0], high[1])))
        return xy[((xy >= low) & (xy < high)).all(1)]

    def cell_numbers(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.int64]:
        """Return the integer cell coordinates (u, v) of all lattice points in a box, and of some just outside.

        ``int64 (n, 2)``, sorted; ``low`` and ``high`` are the box's corners (x, y), px.

        Parameters
        ----------
        low, high
            Corners (x, y) of the box, px.

        Returns
        -------
        NDArray
            ``int64 (n, 2)``, sorted.
        """
        basis = self.reduced().matrix
        change = np.rint(basis @ self._inverse).astype(np.int64)
        found = integers_within(basis, np.subtract(low, self.origin), np.subtract(high, self.origin)) @ change
        return np.asarray(found[np.lexsort((found[:, 1], found[:, 0]))])

    def shifted(self, offset: ArrayLike) -> Lattice:
        """Return the lattice moved by ``offset`` (x, y) px: the lattice of an image cropped at ``-offset``.

        Parameters
        ----------
        offset
            (x, y) px.

        Returns
        -------
        Lattice
            It has the same vectors.
        """
        return Lattice.from_basis(self.matrix, np.add(self.origin, offset))

    @property
    def numbers(self) -> list[float]:
        """The numbers that :meth:`parse` takes: x1, y1, x2, y2, and x, y of the origin unless it is (0, 0)."""
        return [*self.t1, *self.t2, *(self.origin if self.origin != (0.0, 0.0) else ())]

    def as_dict(self) -> dict[str, list[float]]:
        """Return ``{"t1": [x, y], "t2": [x, y], "origin": [x, y]}``, ready for JSON.

        Returns
        -------
        dict
            Lists of two numbers by name.
        """
        return {"t1": list(self.t1), "t2": list(self.t2), "origin": list(self.origin)}

    @classmethod
    def from_basis(cls, basis: ArrayLike, origin: ArrayLike = (0.0, 0.0)) -> Lattice:
        """Return a lattice from arrays: ``basis`` is ``(2, 2)``, rows t1 and t2 (x, y) px; ``origin`` (x, y) px.

        Parameters
        ----------
        basis
            ``(2, 2)``, rows t1 and t2, each (x, y) px.
        origin
            (x, y) px.

        Returns
        -------
        Lattice
            The lattice of these vectors.
        """
        (x1, y1), (x2, y2) = np.asarray(basis, np.float64)
        x, y = np.asarray(origin, np.float64)
        return cls((x1, y1), (x2, y2), (x, y))

    @classmethod
    def from_dict(cls, mapping: dict[str, Any]) -> Lattice:
        """Return the lattice of a mapping from :meth:`as_dict`.

        Parameters
        ----------
        mapping
            It has the keys ``t1`` and ``t2``, and may have ``origin``.

        Returns
        -------
        Lattice
            The lattice that the mapping was made of.
        """
        return cls(mapping["t1"], mapping["t2"], mapping.get("origin", (0.0, 0.0)))

    @classmethod
    def parse(cls, text: str) -> Lattice:
        """Return a lattice from ``"x1,y1,x2,y2"`` or ``"x1,y1,x2,y2,x,y"``, the formats of the command line.

        (x, y) is the origin; without it, the origin is (0, 0).

        Parameters
        ----------
        text
            Numbers in px, joined by commas.

        Returns
        -------
        Lattice
            The lattice of these numbers.

        Raises
        ------
        BadInput
            If the text is not four or six numbers, or the lattice repeats in less than 2 px.
        """
        try:
            x1, y1, x2, y2, *origin = (float(part) for part in text.split(","))
            x, y = origin or (0.0, 0.0)
        except ValueError:
            raise BadInput(
                f"lattice {text!r}: give four numbers x1,y1,x2,y2 in px, e.g. 32,0,0,24, "
                "or six, x1,y1,x2,y2,x,y, with the origin"
            ) from None
        return require_visible(cls((x1, y1), (x2, y2), (x, y)), text)

    def with_known_origin(self) -> Lattice:
        """Return the lattice with an origin other than (0, 0), which methods take as unknown: with t1 in its place.

        Returns
        -------
        Lattice
            The same points.

        Examples
        --------
        >>> Lattice((28, 0), (14, 12), (0, 0)).with_known_origin().origin
        (28.0, 0.0)
        """
        return self if any(self.origin) else self.shifted(self.t1)


def require_visible(lattice: Lattice, given: object) -> Lattice:
    """Return a lattice as it is, or raise :class:`BadInput` if it repeats in less than 2 px.

    Parameters
    ----------
    lattice
        The lattice.
    given
        The form in which the user gave it, for the message.
    """
    if lattice.s < LEAST_PERIOD:
        raise BadInput(f"lattice {given!r}: repeats every {lattice.s:g} px; pixels show no period under 2 px")
    return lattice


def reduce_basis(basis: ArrayLike) -> Points:
    """Return the basis of :meth:`Lattice.reduced`, ``(2, 2)``, of one basis, without checks."""
    return np.asarray(reduce_bases(np.asarray(basis, np.float64)[np.newaxis])[0])


def reduce_bases(bases: Points, acute: bool = True) -> Points:
    """Return the bases of :meth:`Lattice.reduced` of many lattices at once, ``(n, 2, 2)``, the shorter vectors first.

    Parameters
    ----------
    bases
        ``(n, 2, 2)``, rows (x, y). The vectors may be parallel or 0.
    acute
        Turn the vectors to the right, and to make no obtuse angle.
    """
    a, b = bases[:, 0], bases[:, 1]
    swap = (_dot(a, a) > _dot(b, b))[:, np.newaxis]
    for _ in range(MOST_STEPS):
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        square = _dot(a, a)
        b = b - np.rint(_dot(a, b) / np.maximum(square, 1e-300))[:, np.newaxis] * a
        swap = (_dot(b, b) < square * (1 - 1e-12))[:, np.newaxis]
        if not swap.any():
            break
    if acute:
        a, b = _point_right(a), _point_right(b)
        b = np.where(_is_obtuse(a, b)[:, np.newaxis], -b, b)
    return np.stack([a, b], 1)


def _point_right(vectors: Points) -> Points:
    """Return each vector ``(n, 2)`` or its negative: the one on the right half-plane (x > 0, or x = 0 and y > 0)."""
    x, y = vectors[:, :1], vectors[:, 1:]
    return np.where((x < 0) | ((x == 0) & (y <= 0)), -vectors, vectors)


def _is_obtuse(a: Points, b: Points) -> NDArray[np.bool_]:
    """Return whether the angle between two vectors is obtuse, by more than a rounding error; ``(..., 2)`` each."""
    return np.asarray(_dot(a, b) < -1e-9 * _dot(a, a))


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    """Return the dot products of pairs of vectors ``(..., 2)``; a sum over their axis takes twice as long."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def _break_ties(a: Points, b: Points) -> tuple[Points, Points]:
    """Return the shortest vector and the next one; of equally short vectors, those with the smallest angles."""
    third = b - a if a @ b >= 0 else b + a
    short, long = (square * (1 + 1e-9) for square in sorted((a @ a, b @ b)))
    near = sorted((v for v in (a, b, third) if v @ v <= long), key=_line_angle)
    first = next(v for v in near if v @ v <= short)
    second = next(v for v in near if v is not first)
    return first, second


def _line_angle(vector: Points) -> float:
    """Return the angle of the line along a vector, from right (x) towards down (y), in [0, pi)."""
    angle = math.atan2(vector[1], vector[0]) % math.pi
    return angle if angle < math.pi - 1e-9 else 0.0


def _check_vector(value: Any, name: str) -> Vector:
    try:
        x, y = (float(part) for part in value)
    except (TypeError, ValueError):
        raise BadInput(f"lattice: {name} is {value!r}; give two numbers (x, y) in px") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise BadInput(f"lattice: {name} is {(x, y)}; give finite numbers")
    return x, y


def _point_down(vector: Points) -> Points:
    """Return ``vector`` or its negative: the one whose angle from right towards down is in [0, pi), up to rounding."""
    return vector if abs(math.atan2(vector[1], vector[0]) - _line_angle(vector)) < 1 else -vector


def hermite_matrices(index: int) -> Integers:
    """Return all integer matrices of a determinant in Hermite normal form, as ``int64 (n, 2, 2)``.

    ``H @ basis`` are the bases of the coarser lattices of this index (supercells), ``H @ basis / index`` those of the
    finer ones (subcells), each lattice once: a finer lattice, enlarged ``index`` times, is a coarser one. n is the sum
    of the divisors of ``index``: 3 for 2, 4 for 3, 6 for 5.

    Parameters
    ----------
    index
        Ratio of the cell areas, 1 or more.

    Examples
    --------
    >>> from nrbench.lattice.geometry import hermite_matrices
    >>> hermite_matrices(2).tolist()
    [[[2, 0], [0, 1]], [[1, 0], [0, 2]], [[1, 1], [0, 2]]]
    """
    divisors = [d for d in range(1, index + 1) if index % d == 0]
    return np.array([((index // d, b), (0, d)) for d in divisors for b in range(d)], np.int64)


def integers_within(basis: ArrayLike, low: ArrayLike, high: ArrayLike) -> Integers:
    """Return the integers (i, j) whose points ``i a + j b`` lie in a box, and a few that lie just outside.

    Parameters
    ----------
    basis
        ``(2, 2)``, rows a and b (x, y). It should be reduced; otherwise there are many rows with few points each.
    low, high
        Corners (x, y) of the box.

    Returns
    -------
    Integers
        ``int64 (n, 2)``, each once. They may include points that lie outside by up to 1e-6 of a step: test the points.
        Time and memory grow with the numbers of points in the box and of rows that cross it, not with the square of its
        longer side.
    """
    (a, b), (lower, upper) = np.asarray(basis, np.float64), np.array([low, high], np.float64)
    corners = np.array([(x, y) for x in (lower[0], upper[0]) for y in (lower[1], upper[1])])
    rows = (corners @ np.linalg.inv([a, b]))[:, 1]
    j = np.arange(np.ceil(rows.min() - 1e-6), np.floor(rows.max() + 1e-6) + 1)
    first, last = _clip_rows(a, j[:, np.newaxis] * b, lower, upper)
    first, last = np.ceil(first - 1e-6), np.floor(last + 1e-6)
    return _list_rows(first.astype(np.int64), np.maximum(last - first + 1, 0).astype(np.int64), j.astype(np.int64))


def _clip_rows(
    a: NDArray[np.float64], starts: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the first and last real i at which each line ``start + i a`` is in the box; last < first if none."""
    first, last = np.full(len(starts), -np.inf), np.full(len(starts), np.inf)
    length = float(np.hypot(*a))
    for axis in (0, 1):
        if abs(a[axis]) > 1e-12 * length:
            ends = (np.array([low[axis], high[axis]])[:, np.newaxis] - starts[:, axis]) / a[axis]
            first, last = np.maximum(first, ends.min(0)), np.minimum(last, ends.max(0))
        else:
            slack = 1e-6 * length
            outside = (starts[:, axis] < low[axis] - slack) | (starts[:, axis] > high[axis] + slack)
            last[outside] = -np.inf
    missed = last < first - 1e-5
    return np.where(missed, 0.0, first), np.where(missed, -1.0, last)


def _list_rows(first: Integers, counts: Integers, j: Integers) -> Integers:
    """Return ``(i, j)`` for ``counts`` values of i from ``first`` on, row by row."""
    before = np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([np.repeat(first, counts) + np.arange(len(before)) - before, np.repeat(j, counts)], 1)
