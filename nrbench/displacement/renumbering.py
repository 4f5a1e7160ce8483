"""Find the parts of a followed lattice whose numbers are whole vectors off, and number them again.

A lattice that is followed around a place where the image is strained too much to be followed through comes back with
the right numbers. One that is followed through such a place may slip by whole vectors. The places behind it are right,
and only the numbers are wrong. In between lies a fault, where knots are crowded together or torn apart, and where the
mean tile does not fit the image.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.lattice.geometry import Points

from .growth import Knots

_FAULTLESS: Final = 0.95
"""Correlation, over the median, of knots that do not lie in a fault."""
_TORN = 0.12
"""Distance, in s, between the places of neighbors and those that their slopes predict, above which they lie in one."""
_LEAST_PART = 5
"""Least number of knots of a part."""
_NEAR = 2.0
"""Distance, in s, within which the knots of one part tell the numbers of those of another one."""
_ALIKE = 0.1
"""Area of the mean of the cells at two knots, over that of the larger cell, below which their slopes differ too much to
measure a distance: slopes may turn around on the way through an image."""
_READ_STEP = 0.25
"""Distance, in s, of the points of the image at which the similarity is measured."""
_BELONGS = 0.75
"""Largest distance, in steps of the grid along each vector, of a point from the knot to which it belongs."""


def renumber(knots: Knots) -> Knots | None:
    """Return the knots that do not lie in a fault, numbered such that neighbors in the image have neighboring numbers.

    Knots that are well correlated form parts; within a part, neighbors on the grid are neighbors in the image. The
    largest part keeps its numbers. For each other part, all pairs of a knot of it and a knot of the parts before it
    that lie near each other in the image vote. The vote of a pair is the whole number of vectors by which the numbers
    differ from the distance in the image, measured by the mean slopes of both knots; near pairs weigh more. Many pairs
    are needed because the slopes change much at a fault.

    Returns
    -------
    Knots or None
        Fewer knots than were given: faults, parts smaller than 5 knots, and parts that are far from all others are left
        out, since the lattice can be followed into them again. None if there is no part whose numbers are off.
    """
    if not knots.spans_plane:
        return None
    labels, number = _parts(knots)
    sizes = np.bincount(labels[labels > 0], minlength=number + 1)
    waiting = [int(part) for part in np.argsort(-sizes, kind="stable") if sizes[part] >= _LEAST_PART]
    if len(waiting) < 2:
        return None
    shifts, are_off = {waiting.pop(0): np.zeros(2, np.int64)}, False
    near = _NEAR * knots.mean_lattice().s
    index = np.argwhere(labels > 0)
    owner = labels[labels > 0]
    places, slopes, cells = (values[labels > 0] for values in (knots.places, knots.slopes, knots.cells))
    while waiting:
        numbered = np.flatnonzero(np.isin(owner, list(shifts)))
        tree = scipy.spatial.KDTree(places[numbered])
        for part in waiting:
            own = np.flatnonzero(owner == part)
            pairs = tree.sparse_distance_matrix(scipy.spatial.KDTree(places[own]), near, output_type="coo_matrix")
            if pairs.nnz:
                break
        else:
            break
        waiting.remove(part)
        one, other = numbered[pairs.row], own[pairs.col]
        measured, alike = _cells_apart(places[other] - places[one], slopes[one], slopes[other])
        if not alike.any():
            continue
        shift = np.array([shifts[int(label)] for label in owner[one]])
        off = np.rint(measured - (cells[other] - cells[one] - shift)).astype(np.int64)
        voted = _most_voted(off[alike], 1 / np.maximum(pairs.data[alike], 1e-6) ** 2)
        # If knots are several vectors apart, those of a part that is one vector off lie between those of the others.
        if (voted * knots.parts % 1 == 0).all():
            shifts[part] = voted
        are_off |= bool(voted.any())
    if not are_off:
        return None
    kept = np.isin(owner, list(shifts))
    moved = np.array([shifts[int(label)] for label in owner[kept]])
    return _moved(knots, index[kept], np.rint(moved * knots.parts).astype(np.int64)[:, ::-1])


def similarity(knots: Knots, shape: tuple[int, int]) -> float:
    """Return the mean over an image of the correlation of the knot to which each point belongs, 0 where there is none.

    Unlike the area of the cells this does not count twice what lies in a fold. 0 if the knots do not span the plane.
    """
    if not knots.spans_plane:
        return 0.0
    step = max(1, int(_READ_STEP * knots.mean_lattice().s))
    x, y = np.meshgrid(np.arange(step // 2, shape[1], step), np.arange(step // 2, shape[0], step))
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    nearest = scipy.spatial.KDTree(knots.places[knots.known]).query(points)[1]
    off = (points - knots.places[knots.known][nearest])[..., np.newaxis]
    steps = np.linalg.solve(knots.slopes[knots.known][nearest], off)[..., 0] * knots.parts
    belongs = (np.abs(steps) <= _BELONGS).all(1)
    return float((knots.correlation[knots.known][nearest] * belongs).mean())


def _parts(knots: Knots) -> tuple[NDArray[np.int64], int]:
    """Return the part of each knot, from 1 on, 0 if it may lie in a fault, and the number of parts."""
    level = _FAULTLESS * float(np.median(knots.correlation[knots.known]))
    labels, number = scipy.ndimage.label((knots.correlation >= level) & ~_torn(knots), np.ones((3, 3)))
    return np.asarray(labels, np.int64), int(number)


def _torn(knots: Knots) -> NDArray[np.bool_]:
    """Return which knots lie elsewhere than their slopes and those of a neighbor on the grid say."""
    torn = np.zeros(knots.known.shape, np.bool_)
    lattice = knots.mean_lattice()
    for one, other in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        both = knots.known[one] & knots.known[other]
        apart = knots.places[other][both] - knots.places[one][both]
        measured, alike = _cells_apart(apart, knots.slopes[one][both], knots.slopes[other][both])
        off = measured - (knots.cells[other][both] - knots.cells[one][both])
        far = ~alike | (np.hypot(*(off @ lattice.matrix).T) > _TORN * lattice.s)
        torn[one][both] |= far
        torn[other][both] |= far
    return torn


def _cells_apart(apart: Points, one: Points, other: Points) -> tuple[Points, NDArray[np.bool_]]:
    """Return the distances of pairs of knots in cells, measured by the mean slopes of both.

    Parameters
    ----------
    apart
        ``(n, 2)`` px: the distances in the image.
    one, other
        ``(n, 2, 2)`` px: the slopes of both knots.

    Returns
    -------
    Points
        ``(n, 2)``; 0 if the slopes differ too much.
    NDArray[np.bool_]
        ``(n,)``: whether they do not.
    """
    mean = (one + other) / 2
    area, areas = np.linalg.det(mean), np.linalg.det([one, other])
    alike = area * np.sign(areas[0]) > _ALIKE * np.abs(areas).max(0)
    found = np.zeros_like(apart)
    found[alike] = np.linalg.solve(mean[alike], apart[alike][..., np.newaxis])[..., 0]
    return found, alike


def _most_voted(votes: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the row with the greatest weight."""
    rows, which = np.unique(votes, axis=0, return_inverse=True)
    return np.asarray(rows[np.argmax(np.bincount(which.ravel(), weights))])


def _moved(knots: Knots, index: NDArray[np.int64], moves: NDArray[np.int64]) -> Knots:
    """Return some knots with other numbers; where two meet, the better correlated one.

    Parameters
    ----------
    knots
        All knots.
    index
        ``(n, 2)``: rows and columns of those to keep.
    moves
        ``(n, 2)``: by how many rows and columns each moves.
    """
    target = index + moves
    low = target.min(0)
    target = target - low
    correlation = np.zeros(target.max(0) + 1)
    places, slopes = np.zeros((*correlation.shape, 2)), np.zeros((*correlation.shape, 2, 2))
    order = np.argsort(knots.correlation[tuple(index.T)], kind="stable")
    to, source = tuple(target[order].T), tuple(index[order].T)
    # The last assignment to a place counts.
    correlation[to], places[to], slopes[to] = knots.correlation[source], knots.places[source], knots.slopes[source]
    first = (knots.first[0] + int(low[1]), knots.first[1] + int(low[0]))
    return replace(knots, first=first, places=places, slopes=slopes, correlation=correlation)
