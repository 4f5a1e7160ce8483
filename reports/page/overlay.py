"""A lattice as lines over its sample, crisp at any size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nrbench.lattice.geometry import Lattice, Points, Vector

MOST_LINES = 400
"""More would cover the picture."""


@dataclass(frozen=True)
class Overlay:
    """SVG paths in the sample's pixel coordinates.

    Parameters
    ----------
    lines
        The lattice's lines; empty where there would be too many.
    vectors
        The two generating vectors, as arrows from a lattice point near the middle.
    words
        The vectors' coordinates in px.
    """

    lines: str
    vectors: tuple[str, str]
    words: tuple[str, str]


def overlay(lattice: Lattice, shape: tuple[int, int]) -> Overlay:
    """Return the lines of a lattice, along its vectors as they are, over an image of ``shape`` (height, width)."""
    start = _nearest_point(lattice, _middle(shape) - lattice.matrix.sum(0) / 2)
    arrows = tuple(_segment(start, start + vector) for vector in lattice.matrix)
    words = (_words("t1", lattice.t1), _words("t2", lattice.t2))
    return Overlay(_lines(lattice, shape), (arrows[0], arrows[1]), words)


def _words(name: str, vector: Vector) -> str:
    return f"{name} = ({vector[0]:.2f}, {vector[1]:.2f})".replace("-", "−")


def _lines(basis: Lattice, shape: tuple[int, int]) -> str:
    height, width = shape
    corners = [(x, y) for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)]
    cells = basis.to_cell(corners)
    (u0, v0), (u1, v1) = cells.min(0), cells.max(0)
    along_u, along_v = np.arange(np.ceil(u0), np.floor(u1) + 1), np.arange(np.ceil(v0), np.floor(v1) + 1)
    if len(along_u) + len(along_v) > MOST_LINES:
        return ""
    ends = [((u, v0), (u, v1)) for u in along_u] + [((u0, v), (u1, v)) for v in along_v]
    return "".join(_segment(*basis.from_cell(pair)) for pair in ends)


def _segment(start: Points, end: Points) -> str:
    return f"M{start[0]:.2f} {start[1]:.2f}L{end[0]:.2f} {end[1]:.2f}"


def _middle(shape: tuple[int, int]) -> Points:
    return np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])


def _nearest_point(lattice: Lattice, xy: Points) -> Points:
    return np.asarray(xy - lattice.wrap(xy - np.array(lattice.origin)))


def parsed(mapping: Mapping[str, Any] | None) -> Lattice | None:
    """Return the lattice that a record holds."""
    return Lattice.from_dict(dict(mapping)) if mapping else None


def beside(lattice: Lattice, truth: Lattice | None, shape: tuple[int, int]) -> Lattice:
    """Return a lattice as it is best compared with the true one: same basis where there is one, same starting point.

    The origin and the choice of basis of a lattice that a method found say nothing; what counts is how its lines drift
    from the true ones, here from the true point nearest the middle on.
    """
    if truth is None:
        return lattice.reduced()
    x, y = _nearest_point(truth, _middle(shape))
    change = np.rint(truth.matrix @ np.linalg.inv(lattice.matrix))
    basis = change @ lattice.matrix if abs(abs(np.linalg.det(change)) - 1) < 0.5 else lattice.reduced().matrix
    (ax, ay), (bx, by) = basis.tolist()
    return Lattice((ax, ay), (bx, by), (float(x), float(y)))
