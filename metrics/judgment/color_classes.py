"""Classes of element colors, as prints, checks and pixel art have them, and colors that belong to no class."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.distance import cdist

from ..perception import limits
from ..registration.coarse_plane import CoarsePlane
from ..registration.lattice_net import Mask, split_cells
from .element_kernels import cluster_colors
from .texture_reference import TextureReference

Colors = NDArray[np.float64]
"""``(n, 3)``: departures of colors from the mean cell, in L*, a*, b*."""
_MOST_CLASSES = 8
_MOST_CELLS = 400
"""Largest number of cells from which classes are learned; every k-th one if there are more."""
_LEAST_ELEMENTS = 12
"""Fewer elements may lack a class of a print by chance."""
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
    step
        (1, 0), (0, 1), (1, 1) or (1, -1): cells (i, j) with equal sums of i and j times it show one element, a thread;
        (0, 0) if each cell shows its own.
    """

    place: int
    centers: Colors
    counts: NDArray[np.intp]
    within: float
    step: tuple[int, int] = (0, 0)

    def measure_new(self, colors: Colors, cells: NDArray[np.intp]) -> float:
        """Return the share of cells whose color belongs to no class, over the share that chance explains.

        The chance that a cell has a class that n cells do not show is about f1 / n, with the number f1 of classes that
        one cell shows; the variance of this estimate is (f1 + 2 f2) / n^2 (Good 1953). One cell in n is allowed beside
        it, and the scatter of the given elements.

        Parameters
        ----------
        colors, cells
            ``(n, 3)`` and ``(n, 2)``: colors, and the numbers (i, j) of their cells.
        """
        if not len(colors):
            return 0.0
        reach = limits.DEVIATIONS * math.sqrt(self.within**2 + _FLOOR) + limits.JND
        new = (_square_distances(colors, self.centers).min(1) > reach**2).mean()
        once, twice = (int((self.counts == count).sum()) for count in (1, 2))
        chance = (1 + once + limits.DEVIATIONS * math.sqrt(once + 2 * twice)) / max(int(self.counts.sum()), 1)
        chance = min(chance, 1.0)
        count = len(np.unique(cells @ np.array(self.step))) if any(self.step) else len(cells)
        return float(new / (chance + limits.DEVIATIONS * math.sqrt(chance * (1 - chance) / count)))


@lru_cache(maxsize=2)
def learn_classes(reference: TextureReference) -> list[PlaceClasses]:
    """Return the classes at each place of the cell whose colors come in classes; empty for most textures.

    Where two elements meet, a place has a class for each pair of their colors, of which a sample shows few; and where
    an element meets the ground, its colors change with half a pixel. So a place counts only if no place within two
    around it has fewer classes, or classes whose colors differ visibly more.
    """
    parts = [_split_places(CoarsePlane(*each, reference.net.samples)) for each in reference.shown]
    sides = (limits.PLACES, limits.PLACES)
    found, number, spread = [], np.full(sides, _MOST_CLASSES + 1), np.zeros(sides)
    for place in range(limits.PLACES**2):
        step, colors = _gather_elements(
            [(values[known[..., place], place], np.argwhere(known[..., place])) for values, known in parts]
        )
        classes = find_classes(colors)
        if classes is not None:
            found.append(classes._replace(place=place, step=step))
            centers = classes.centers
            number.flat[place], spread.flat[place] = len(centers), _square_distances(centers, centers).mean()
    least, most = ndimage.minimum_filter(number, 5, mode="wrap"), ndimage.maximum_filter(spread, 5, mode="wrap")
    inner = (number == least) & (spread >= (1 - limits.TOLERANCE) * most)
    return [classes for classes in found if inner.flat[classes.place]]


def _gather_elements(parts: list[tuple[Colors, NDArray[np.intp]]]) -> tuple[tuple[int, int], Colors]:
    """Return the colors of the elements at a place of some pictures: of all cells, or the means of lines of cells.

    Cells along a line, in one of four directions, show one element, a thread, if nobody sees that they differ. The
    direction is returned, too.
    """
    found, best, step = np.concatenate([own for own, _ in parts]), limits.JND**2, (0, 0)
    for each in ((1, 0), (0, 1), (1, 1), (1, -1)):
        means, rest = [np.zeros((0, 3))], 0.0
        for own, cells in parts:
            line = cells[:, 0] * each[0] + cells[:, 1] * each[1]
            line -= line.min(initial=0)
            held = np.bincount(line)[:, np.newaxis]
            sums = np.bincount((3 * line[:, np.newaxis] + np.arange(3)).ravel(), own.ravel()).reshape(-1, 3)
            average = sums / np.maximum(held, 1)
            means.append(average[held[:, 0] > 0])
            rest += float(((own - average[line]) ** 2).sum())
        lines = np.concatenate(means)
        free = sum(len(own) for own, _ in parts) - len(lines)
        if free > 0 and rest / free < best:
            best, step, found = rest / free, each, lines
    return step, found


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
    values, known = _split_places(plane)
    ratios = [
        each.measure_new(values[known[..., each.place], each.place], np.argwhere(known[..., each.place]))
        for each in classes
    ]
    return max(ratios, default=None)


def _split_places(plane: CoarsePlane) -> tuple[NDArray[np.float64], Mask]:
    """Return the colors of all cells at each place, ``(N1, N2, 64, 3)``, and which of them are known."""
    known = split_cells(plane.complete, (limits.PLACES, limits.PLACES))
    known = known.reshape(*known.shape[:2], -1)
    return plane.cells.reshape(*known.shape, 3).astype(np.float64), known


def find_classes(colors: Colors) -> PlaceClasses | None:
    """Return the classes of colors; None unless they explain the colors decisively, and are tight and far apart.

    k = 2 to 8 classes of shares p_j, with one covariance W, are compared with one Gaussian of covariance C by the
    Bayesian information criterion (Schwarz 1978). With the floor F = (JND / 2)^2 of what is not seen, the gain is

        2 sum n_j ln p_j - n ln |W + F| + n ln |C + F| - 4 (k - 1) ln n.

    Colors that vary without classes gain nothing, because the shares cost as much as the smaller variance gains.

    Parameters
    ----------
    colors
        ``(n, 3)``.
    """
    colors = np.ascontiguousarray(colors[:: -(-len(colors) // _MOST_CELLS) or 1])
    if len(colors) < _LEAST_ELEMENTS or colors.var(0).sum() < limits.CLASS_GAP**2 * _FLOOR / len(colors):
        return None
    away = colors - colors.mean(0)
    whole, first, best, found = _log_size(away), int((away**2).sum(1).argmax()), limits.DECISIVE, None
    for count in range(2, min(_MOST_CLASSES, len(colors) // 2) + 1):
        centers, labels, counts = cluster_colors(colors, first, count, _ROUNDS)
        if not counts.all():  # fewer different colors than clusters
            break
        rest = colors - centers[labels]
        gain = 2 * (counts * np.log(counts / len(colors))).sum() + len(colors) * (whole - _log_size(rest))
        gain -= 4 * (count - 1) * math.log(len(colors))
        if found is not None and gain < best:
            break
        if gain > best:
            best, within = gain, math.sqrt((rest**2).sum(1).mean())
            gap = math.sqrt(_square_distances(centers, centers)[np.triu_indices(count, 1)].min())
            good = within <= limits.JND and gap > limits.CLASS_GAP * math.sqrt(within**2 + _FLOOR)
            found = PlaceClasses(0, centers, counts, within) if good else None
    return found


def _log_size(departures: Colors) -> float:
    """Return the logarithm of the determinant of the covariance of departures, with the floor added."""
    return float(np.linalg.slogdet(departures.T @ departures / len(departures) + _FLOOR * np.eye(3))[1])


def _square_distances(a: Colors, b: Colors) -> NDArray[np.float64]:
    return np.asarray(cdist(a, b, "sqeuclidean"))
