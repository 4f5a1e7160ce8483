"""Draw a lattice as SVG lines over its sample, sharp at any magnification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.lattice.geometry import Lattice, Points, Vector

MAX_LINES = 400
"""More lines would hide the picture."""


@dataclass(frozen=True)
class LatticeOverlay:
    """SVG paths in the pixel coordinates of the sample.

    Parameters
    ----------
    lines
        The lines of the lattice; empty if there are more than :data:`MAX_LINES`.
    arrows
        The two vectors of the lattice, as arrows from a lattice point near the middle.
    vectors
        The coordinates of the vectors in px, as text.
    """

    lines: str
    arrows: tuple[str, str]
    vectors: tuple[str, str]


def trace_lattice(lattice: Lattice, shape: tuple[int, int]) -> LatticeOverlay:
    """Return the lines of a lattice along its two vectors, over an image of ``shape`` (height, width)."""
    start = _nearest_point(lattice, _middle(shape) - lattice.matrix.sum(0) / 2)
    first, second = (_line(start, start + vector) for vector in lattice.matrix)
    vectors = (_describe_vector("t1", lattice.t1), _describe_vector("t2", lattice.t2))
    return LatticeOverlay(_lattice_lines(lattice, shape), (first, second), vectors)


def align_basis(lattice: Lattice, truth: Lattice | None, shape: tuple[int, int]) -> Lattice:
    """Return a detected lattice in the basis of the true one, through the true point nearest the middle of the image.

    Neither the origin nor the choice of basis of a detected lattice is an error. So drawn, the two lattices show how
    the detected lines drift from the true ones. A lattice that is not equivalent to the true one keeps its own reduced
    basis. Without a true lattice the origin stays.
    """
    if truth is None:
        return lattice.reduced()
    x, y = _nearest_point(truth, _middle(shape))
    change = np.rint(truth.matrix @ np.linalg.inv(lattice.matrix))
    basis = change @ lattice.matrix if abs(abs(np.linalg.det(change)) - 1) < 0.5 else lattice.reduced().matrix
    (ax, ay), (bx, by) = basis.tolist()
    return Lattice((ax, ay), (bx, by), (float(x), float(y)))


def _describe_vector(name: str, vector: Vector) -> str:
    return f"{name} = ({vector[0]:.2f}, {vector[1]:.2f})".replace("-", "−")


def _lattice_lines(lattice: Lattice, shape: tuple[int, int]) -> str:
    height, width = shape
    corners = [(x, y) for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)]
    cells = lattice.to_cell(corners)
    (u0, v0), (u1, v1) = cells.min(0), cells.max(0)
    along_u, along_v = np.arange(np.ceil(u0), np.floor(u1) + 1), np.arange(np.ceil(v0), np.floor(v1) + 1)
    if len(along_u) + len(along_v) > MAX_LINES:
        return ""
    ends = [((u, v0), (u, v1)) for u in along_u] + [((u0, v), (u1, v)) for v in along_v]
    return "".join(_line(*lattice.from_cell(pair)) for pair in ends)


def _line(start: Points, end: Points) -> str:
    return f"M{start[0]:.2f} {start[1]:.2f}L{end[0]:.2f} {end[1]:.2f}"


def _middle(shape: tuple[int, int]) -> Points:
    return np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])


def _nearest_point(lattice: Lattice, xy: Points) -> Points:
    return np.asarray(xy - lattice.wrap(xy - np.array(lattice.origin)))
