"""The lattice: two generating vectors and an origin."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nrbench.errors import BadInput

Vector = tuple[float, float]
LatticeKind = Literal["parallelogram", "rectangular", "rhombic", "square", "hexagonal"]
Points = NDArray[np.float64]
"""``float64 (..., 2)``: (x, y) in px, or (u, v) in cells."""


@dataclass(frozen=True)
class Lattice:
    """All points ``origin + a t1 + b t2`` for integers a, b.

    Parameters
    ----------
    t1, t2
        Generating vectors (x, y) in px, x right, y down; real-valued, not parallel.
    origin
        One lattice point (x, y) in px, pixel centres at integers.

    Raises
    ------
    BadInput
        When a vector is zero, not finite, or parallel to the other.
    """

    t1: Vector
    t2: Vector
    origin: Vector = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("t1", "t2", "origin"):
            object.__setattr__(self, name, _vector(getattr(self, name), name))
        longest = max(math.hypot(*self.t1), math.hypot(*self.t2))
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

    def reduced(self) -> Lattice:
        """Return the same lattice in its Lagrange-Gauss basis: t1 shortest, t2 next, angle in [60, 90] degrees."""
        a, b = self.matrix
        if a @ a > b @ b:
            a, b = b, a
        while True:
            b = b - np.rint((a @ b) / (a @ a)) * a
            if b @ b >= a @ a * (1 - 1e-12):
                break
            a, b = b, a
        a, b = _right(a), _right(b)
        return Lattice(_pair(a), _pair(b if a @ b >= 0 or abs(a @ b) < 1e-9 * (a @ a) else -b), self.origin)

    @property
    def kind(self) -> LatticeKind:
        """The Bravais class, within 1 % of the vectors' lengths; see :meth:`classify`."""
        return self.classify()

    def classify(self, tolerance: float = 0.01) -> LatticeKind:
        """Return the Bravais class: the most symmetric one that a small move of the vectors would make exact.

        Parameters
        ----------
        tolerance
            How far the tip of a reduced vector may be off, as a fraction of that vector's length.
        """
        a, b = self.reduced().matrix
        short, long = float(np.hypot(*a)), float(np.hypot(*b))
        along, slack = float(a @ b) / short, tolerance * long
        equal, right, half = long - short <= slack, along <= slack, abs(along - short / 2) <= slack
        if right:
            return "square" if equal else "rectangular"
        if equal and half:
            return "hexagonal"
        return "rhombic" if equal or half else "parallelogram"

    def is_equivalent(self, other: Lattice, tolerance: float = 1e-6) -> bool:
        """Return whether both bases generate the same lattice, whatever the origins.

        Parameters
        ----------
        other
            The lattice compared with.
        tolerance
            How far, px, either of its reduced vectors may lie from the integer combination of this lattice's vectors
            that matches it (an integer matrix of determinant +-1).
        """
        mine, theirs = self.reduced().matrix, other.reduced().matrix
        change = np.rint(theirs @ np.linalg.inv(mine))
        error = np.hypot(*(theirs - change @ mine).T).max()
        return bool(abs(abs(np.linalg.det(change)) - 1) < 0.5 and error <= tolerance)

    def to_cell(self, xy: ArrayLike) -> Points:
        """Return cell coordinates (u, v) of points (x, y), shape ``(..., 2)``: ``xy = origin + u t1 + v t2``."""
        return np.asarray((np.asarray(xy, np.float64) - self.origin) @ self._inverse)

    def from_cell(self, uv: ArrayLike) -> Points:
        """Return points (x, y) of cell coordinates (u, v), shape ``(..., 2)``."""
        return np.asarray(np.asarray(uv, np.float64) @ self.matrix + self.origin)

    def wrap(self, displacement: ArrayLike) -> Points:
        """Return each displacement (x, y) modulo the lattice, as the representative nearest to zero.

        The nearest lattice vector of a reduced basis is among the nine around the rounded one, so the result lies in
        the Voronoi cell, not in the parallelogram. Shape ``(..., 2)``, px.
        """
        basis = self.reduced().matrix
        d = np.asarray(displacement, np.float64)
        d = d - np.rint(d @ np.linalg.inv(basis)) @ basis
        steps = np.array([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)], np.float64) @ basis
        candidates = d[..., np.newaxis, :] + steps
        nearest = np.argmin((candidates**2).sum(-1), -1)
        return np.asarray(np.take_along_axis(candidates, nearest[..., np.newaxis, np.newaxis], -2)[..., 0, :])

    def points(self, shape: tuple[int, int], margin: float = 0.0) -> Points:
        """Return all lattice points (x, y) within ``margin`` px of an image of ``shape``, as ``(n, 2)``."""
        height, width = shape
        low, high = -0.5 - margin, np.array([width, height]) - 0.5 + margin
        corners = self.to_cell([(low, low), (high[0], low), (low, high[1]), (high[0], high[1])])
        (u0, v0), (u1, v1) = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int)
        grid = np.stack(np.meshgrid(np.arange(u0, u1 + 1), np.arange(v0, v1 + 1), indexing="ij"), -1).reshape(-1, 2)
        xy = self.from_cell(grid)
        return xy[((xy >= low) & (xy < high)).all(1)]

    def shifted(self, offset: Vector) -> Lattice:
        """Return the lattice moved by ``offset`` (x, y) px: that of an image cropped at ``-offset``."""
        return Lattice(self.t1, self.t2, (self.origin[0] + offset[0], self.origin[1] + offset[1]))

    def as_dict(self) -> dict[str, list[float]]:
        """Return ``{"t1": [x, y], "t2": [x, y], "origin": [x, y]}``, ready for JSON."""
        return {"t1": list(self.t1), "t2": list(self.t2), "origin": list(self.origin)}

    @classmethod
    def from_dict(cls, mapping: dict[str, Any]) -> Lattice:
        """Rebuild a lattice from :meth:`as_dict`."""
        return cls(mapping["t1"], mapping["t2"], mapping.get("origin", (0.0, 0.0)))

    @classmethod
    def parse(cls, text: str) -> Lattice:
        """Read ``"x1,y1,x2,y2"``, the command line's form."""
        try:
            x1, y1, x2, y2 = (float(part) for part in text.split(","))
        except ValueError:
            raise BadInput(f"lattice {text!r}: give four numbers x1,y1,x2,y2 in px, e.g. 32,0,0,24") from None
        return cls((x1, y1), (x2, y2))


def _vector(value: Any, name: str) -> Vector:
    try:
        x, y = (float(part) for part in value)
    except (TypeError, ValueError):
        raise BadInput(f"lattice: {name} is {value!r}; give two numbers (x, y) in px") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise BadInput(f"lattice: {name} is {(x, y)}; give finite numbers")
    return x, y


def _pair(vector: Points) -> Vector:
    return float(vector[0]), float(vector[1])


def _right(vector: Points) -> Points:
    """Return the one of +-vector on the right half-plane (x > 0, or x = 0 and y > 0)."""
    return vector if (vector[0], vector[1]) > (0, 0) else -vector
