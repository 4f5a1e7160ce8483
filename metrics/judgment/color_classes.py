"""Classes of element colors, as prints, checks and pixel art have them, and colors that belong to no class."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..perception import limits
from ..registration.coarse_plane import CoarsePlane
from ..registration.lattice_net import Mask, split_cells
from .texture_reference import TextureReference

Colors = NDArray[np.float64]
"""``(n, 3)``: departures of colors from the mean cell, in L*, a*, b*."""
_MOST_CLASSES = 8
_MOST_CELLS = 400
"""Largest number of cells from which classes are learned; every k-th one if there are more."""
_ROUNDS = 8
_FLOOR = (limits.JND / 2) ** 2


class PlaceClasses(NamedTuple):
    """The classes of colors at one place of the cell.

    Parameters
    ----------
    place
        Number of the place, row by row.
    centers
        ``(k, 3)``: the mean of each class.
    counts
        ``(k,)``: the cells of each class in the references.
    within
        Root mean square distance of the colors to the means of their classes.
    """

    place: int
    centers: Colors
    counts: NDArray[np.intp]
    within: float

    def measure_new(self, colors: Colors) -> float:
        """Return the share of colors that belong to no class, over the share that chance explains.

        The chance that a cell has a class that n cells do not show is about f1 / n, with the number f1 of classes that
        one cell shows; the variance of this estimate is (f1 + 2 f2) / n^2 (Good 1953). One cell in n is allowed beside
        it, and the scatter of the given colors.
        """
        if not len(colors):
            return 0.0
        reach = limits.DEVIATIONS * math.sqrt(self.within**2 + _FLOOR) + limits.JND
        new = (_square_distances(colors, self.centers).min(1) > reach**2).mean()
        once, twice = (int((self.counts == count).sum()) for count in (1, 2))
        chance = (1 + once + limits.DEVIATIONS * math.sqrt(once + 2 * twice)) / max(int(self.counts.sum()), 1)
        chance = min(chance, 1.0)
        return float(new / (chance + limits.DEVIATIONS * math.sqrt(chance * (1 - chance) / len(colors))))


@lru_cache(maxsize=2)
def learn_classes(reference: TextureReference) -> list[PlaceClasses]:
    """Return the classes at each place of the cell whose colors come in classes; empty for most textures."""
    planes = [CoarsePlane(fine, known, reference.net.samples) for fine, known in reference.departures]
    colors, known = (np.concatenate(parts) for parts in zip(*(_split_places(plane) for plane in planes), strict=True))
    found = [find_classes(colors[known[:, place], place], place) for place in range(known.shape[1])]
    return [classes for classes in found if classes is not None]


def measure_new_colors(reference: TextureReference, plane: CoarsePlane) -> float | None:
    """Return the share of cells with a color of no class, over the share that chance explains, at the worst place.

    It is None if the element colors of the references form no classes.

    Parameters
    ----------
    reference
        The texture.
    plane
        The residual of an output.
    """
    classes = learn_classes(reference)
    if not classes:
        return None
    colors, known = _split_places(plane)
    return max(each.measure_new(colors[known[:, each.place], each.place]) for each in classes)


def _split_places(plane: CoarsePlane) -> tuple[NDArray[np.float64], Mask]:
    """Return the colors of all cells at each place, ``(n, 64, 3)``, and which of them are known."""
    known = split_cells(plane.complete, (limits.PLACES, limits.PLACES)).reshape(-1, limits.PLACES**2)
    return plane.cells.reshape(*known.shape, 3).astype(np.float64), known


def find_classes(colors: Colors, place: int = 0) -> PlaceClasses | None:
    """Return the classes of colors; None unless they explain the colors decisively, and are tight and far apart.

    k = 2 to 8 classes of shares p_j, with one covariance W, are compared with one Gaussian of covariance C by the
    Bayesian information criterion (Schwarz 1978). With the floor F = (JND / 2)^2 of what is not seen, the gain is

        2 sum n_j ln p_j - n ln |W + F| + n ln |C + F| - 4 (k - 1) ln n.

    Colors that vary without classes gain nothing, because the shares cost as much as the smaller variance gains.

    Parameters
    ----------
    colors
        ``(n, 3)``.
    place
        Number of their place in the cell.
    """
    colors = colors[:: -(-len(colors) // _MOST_CELLS) or 1]
    if len(colors) < 4 or colors.var(0).sum() < limits.CLASS_GAP**2 * _FLOOR / len(colors):
        return None
    whole, best, found = _log_size(colors - colors.mean(0)), limits.DECISIVE, None
    for count in range(2, min(_MOST_CLASSES, len(colors) // 2) + 1):
        centers, labels = _cluster(colors, count)
        counts = np.bincount(labels, minlength=count)
        if not counts.all():
            break
        rest = colors - centers[labels]
        gain = 2 * (counts * np.log(counts / len(colors))).sum() + len(colors) * (whole - _log_size(rest))
        gain -= 4 * (count - 1) * math.log(len(colors))
        if gain > best:
            best, within = gain, math.sqrt((rest**2).sum(1).mean())
            gap = math.sqrt(_square_distances(centers, centers)[np.triu_indices(count, 1)].min())
            good = within <= limits.JND and gap > limits.CLASS_GAP * math.sqrt(within**2 + _FLOOR)
            found = PlaceClasses(place, centers, counts, within) if good else None
    return found


def _log_size(departures: Colors) -> float:
    """Return the logarithm of the determinant of the covariance of departures, with the floor added."""
    return float(np.linalg.slogdet(departures.T @ departures / len(departures) + _FLOOR * np.eye(3))[1])


def _cluster(colors: Colors, count: int) -> tuple[Colors, NDArray[np.intp]]:
    """Return the means of clusters and the number of each color's cluster, by k-means from colors far apart."""
    centers = colors[((colors - colors.mean(0)) ** 2).sum(1).argmax()][np.newaxis]
    while len(centers) < count:
        centers = np.concatenate([centers, colors[_square_distances(colors, centers).min(1).argmax()][np.newaxis]])
    for _ in range(_ROUNDS):
        labels = _square_distances(colors, centers).argmin(1)
        member = (labels[:, np.newaxis] == np.arange(count)).astype(np.float64)
        counts = np.maximum(member.sum(0), 1)
        centers = member.T @ colors / counts[:, np.newaxis]
    return centers, labels


def _square_distances(a: Colors, b: Colors) -> NDArray[np.float64]:
    return np.asarray(((a[:, np.newaxis] - b) ** 2).sum(-1))
