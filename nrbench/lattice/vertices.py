"""The vertices of a lattice as it lies in an image, bent or not, and how many of the true ones were found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points

TOLERANCE: Final = 0.2
"""Largest distance, in s, of a found vertex from the true one: a lattice of another phase then hits one of eight."""
LEAST_VERTICES: Final = 4
"""Number of vertices of a cell: fewer do not tell a lattice."""
_MOST_SHIFTS = 400
"""Number of found vertices, at most, from which the shift of the whole lattice is taken."""
_STEPS = 30
"""Number of steps in which a displaced vertex is located. Each halves its error where waves are as short as allowed."""


class Vertex(NamedTuple):
    """A point of a lattice in an image.

    Parameters
    ----------
    row, column
        Its number along t2 and along t1.
    x, y
        px, pixel centers at integers.

    Examples
    --------
    >>> from nrbench import Vertex
    >>> Vertex(0, 1, x=27.5, y=3.0).column
    1
    """

    row: int
    column: int
    x: float
    y: float


class VertexMatch(NamedTuple):
    """How many vertices were found, and how exactly; see :func:`match_vertices`.

    Parameters
    ----------
    recall
        Share of the true vertices that were found; None if there is none.
    precision
        Share of the found vertices that are true; None if none was found.
    error
        Median distance of the found vertices that are true, in s; None if there is none.
    """

    recall: float | None
    precision: float | None
    error: float | None


def list_vertices(cells: NDArray[Any], places: Points) -> tuple[Vertex, ...]:
    """Return vertices of whole cell coordinates (u, v), ``(n, 2)``, at places (x, y) px, ``(n, 2)``."""
    rows = zip(cells.tolist(), places.tolist(), strict=True)
    return tuple(Vertex(round(v), round(u), x, y) for (u, v), (x, y) in rows)


def lay_vertices(lattice: Lattice, shape: tuple[int, int], margin: float = 0.0) -> tuple[Vertex, ...]:
    """Return the points of a regular lattice in an image of ``shape``, or within ``margin`` px of it."""
    places = lattice.points(shape, margin)
    return list_vertices(np.rint(lattice.to_cell(places)), places)


def displace_vertices(lattice: Lattice, displacement: NDArray[np.float32]) -> tuple[Vertex, ...]:
    """Return the points of a lattice where the content of an image has moved to.

    Parameters
    ----------
    lattice
        The lattice of the undisturbed image.
    displacement
        ``(H, W, 2)``: displacement (x, y) px of the content at each pixel, as of a
        :class:`~nrbench.plugins.forms.Texture`. It continues unchanged beyond the border.
    """
    shape = displacement.shape[:2]
    ideal = lattice.points(shape, 2 * float(np.abs(displacement).max()) + lattice.covering_radius)
    planes = np.moveaxis(displacement.astype(np.float64), -1, 0)
    places = ideal
    for _ in range(_STEPS):
        at = places.T[::-1]
        moved = [scipy.ndimage.map_coordinates(plane, at, order=1, mode="nearest") for plane in planes]
        places = ideal + np.stack(moved, -1)
    return list_vertices(np.rint(lattice.to_cell(ideal)), places)


def fit_lattice(vertices: Sequence[Vertex]) -> Lattice:
    """Return the lattice, origin included, whose points lie nearest to vertices (least squares): t1 joins columns.

    Raises
    ------
    BadInput
        If the vertices lie on one line.
    """
    table = np.array(vertices, np.float64)
    fit = np.linalg.lstsq(np.column_stack([table[:, 1::-1], np.ones(len(table))]), table[:, 2:], rcond=None)[0]
    return Lattice.from_basis(fit[:2], fit[2])


def find_grid_fault(vertices: Sequence[Vertex]) -> str:
    """Return why vertices are no grid in which each cell has the same sense of rotation; empty if they are one."""
    if len(vertices) < LEAST_VERTICES:
        return f"has {len(vertices)} vertices, at least {LEAST_VERTICES} are needed"
    at = {(vertex.row, vertex.column): vertex for vertex in vertices}
    senses = dict[float, Vertex]()
    for (row, column), one in at.items():
        for i, j in ((1, 1), (-1, -1)):
            across, down = at.get((row, column + j)), at.get((row + i, column))
            if across and down:
                area = (across.x - one.x) * (down.y - one.y) - (across.y - one.y) * (down.x - one.x)
                senses.setdefault(np.sign(round(area)), one)
    if not senses:
        return "no vertex has a neighbor in its row and one in its column"
    places = " and ".join(f"row {one.row}, column {one.column}" for one in senses.values())
    return f"the cells at {places} are flat or turned over" if len(senses) > 1 or 0 in senses else ""


def match_vertices(found: Sequence[Vertex], truth: Sequence[Vertex], shape: tuple[int, int]) -> VertexMatch:
    """Compare found vertices with true ones.

    The rule: cell coordinates are interpolated between the true vertices (Clough and Tocher), so that distances are in
    units of the local cell: a distance of 1 s is that of the mean lattice, whose shorter vector s is. One shift of the
    whole lattice is free, because any point of a cell may be its vertex; the shift under which most found vertices are
    true is used. A true vertex is found if a found one then lies within :data:`TOLERANCE` of it. Each true vertex
    counts once, so the second vertex that is found at it is wrong. Numbers of found vertices do not matter. A vertex
    whose place, before or after the shift, is not in the image or within the tolerance of its border is not judged.

    Thus a supercell of k cells has the recall 1 / k, and a subcell 1 / k the precision 1 / k.

    Parameters
    ----------
    found, truth
        The found vertices, and the true ones, which do not lie on one line. Fewer than four are not compared.
    shape
        Height and width of the image, px.

    References
    ----------
    .. [1] M. Park, K. Brocklehurst, R. T. Collins, Y. Liu, "Deformed lattice detection in real-world images using
           mean-shift belief propagation", IEEE PAMI 31(10), 2009. They report the share of labeled vertices that are
           found; the tolerance and the free shift here are those of nrbench.
    """
    if len(truth) < LEAST_VERTICES or not found:
        return VertexMatch(None if len(truth) < LEAST_VERTICES else 0.0, None, None)
    points = np.array(found, np.float64)[:, 2:]
    table, given = np.array(truth, np.float64), fit_lattice(truth)
    mean, places = given.reduced(), table[:, 2:]
    numbers = np.rint(table[:, 1::-1] @ np.linalg.inv(np.rint(mean.matrix @ np.linalg.inv(given.matrix))))
    cells = _locate_cells(points, numbers, places, mean)
    shift = _common_shift(cells, mean)
    nearest = np.rint(cells - shift)
    off = np.hypot(*((cells - shift - nearest) @ mean.matrix).T) / mean.s
    known = {cell: index for index, cell in enumerate(map(tuple, numbers.tolist()))}
    index = np.array([known.get(cell, -1) for cell in map(tuple, nearest.tolist())], np.intp)
    hit = (index >= 0) & (off <= TOLERANCE)
    hits = np.zeros(len(places), np.bool_)
    hits[index[hit]] = True
    true = _lie_inside(places, shape, mean) & _lie_inside(places + shift @ mean.matrix, shape, mean)
    judged = _lie_inside(points, shape, mean) & _lie_inside(points - (cells - nearest) @ mean.matrix, shape, mean)
    return VertexMatch(
        float(hits[true].mean()) if true.any() else None,
        len(np.unique(index[hit & judged])) / int(judged.sum()) if judged.any() else None,
        float(np.median(off[hit])) if hit.any() else None,
    )


def _locate_cells(found: Points, numbers: Points, places: Points, mean: Lattice) -> Points:
    """Return the cell coordinates of points; beyond the outermost vertices the mean lattice continues."""
    nearest = scipy.spatial.KDTree(places).query(found)[1]
    beyond = numbers[nearest] + (found - places[nearest]) @ np.linalg.inv(mean.matrix)
    within = scipy.interpolate.CloughTocher2DInterpolator(places, numbers)(found)
    return np.where(np.isnan(within), beyond, within)


def _common_shift(cells: Points, mean: Lattice) -> Points:
    """Return the shift, in cells, under which most points lie near whole cell coordinates."""
    shifts = cells[:: max(1, len(cells) // _MOST_SHIFTS)]
    apart = cells - shifts[:, np.newaxis]
    near = np.hypot(*np.moveaxis((apart - np.rint(apart)) @ mean.matrix, -1, 0)) <= TOLERANCE * mean.s
    best = int(near.sum(1).argmax())
    inner = (apart - np.rint(apart))[best][near[best]]
    shift = shifts[best] + inner.mean(0)
    return np.asarray(shift - np.rint(shift))


def _lie_inside(points: Points, shape: tuple[int, int], mean: Lattice) -> NDArray[np.bool_]:
    """Return which points lie in an image, and farther from its border than the tolerance."""
    margin, size = TOLERANCE * mean.s - 0.5, np.array(shape[::-1])
    return np.asarray(((points >= margin) & (points <= size - 1 - margin)).all(-1))
