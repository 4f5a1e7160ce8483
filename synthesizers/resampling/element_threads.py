"""The threads of a sample: which instances of its elements have one color, by the likelihood of their colors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice

from ..lattice_places.equal_places import CellTorus
from .element_map import InstanceColors, Lag, Numbers, correlate

_LAGS = [(i, j) for i in (0, 1, 2) for j in (-2, -1, 0, 1, 2) if (i, j) > (0, 0) and math.gcd(i, j) == 1]
"""The turns that a thread may have, in cells."""
_EVIDENCE = 1.0
"""Least evidence for threads in all elements: log10 of the ratio of likelihoods."""
_RATIOS = (0.0, 1 / 9, 3 / 7, 1.0, 7 / 3, 9.0)
"""Variances common along a thread, over the other variance of colors; the first one is that without threads."""
_STAINED = (0.25, 0.5, 0.75)
"""Shares of the variance, beside threads, that may lie in stains."""
_STAIN_REACHES = (2.0, 6.0)
"""Distances, in s, at which the correlation of a stain may be 1 / e."""
_MOST = 100
"""Largest number of instances of an element that are compared, those in the middle."""
_LINKED = (0.5, 1.0)
"""Different elements whose colors correlate at a lag by a + b / sqrt(pairs) are one thread."""
_LINKED_THREADS = (0.2, 1.0)
"""The same for the mean colors of threads of different elements, which run along the same turn."""


@dataclass(frozen=True)
class ElementThread:
    """What an element is a part of: the instances that have one color.

    Parameters
    ----------
    first
        The element whose colors the thread takes.
    base
        Cell of the instance that lies in thread (0, 0).
    turn
        Lag in cells after which the thread shows the same element again; (0, 0) if it never does.
    torus
        The threads of an output that repeats; None if it does not.
    """

    first: int
    base: Lag = (0, 0)
    turn: Lag = (0, 0)
    torus: CellTorus | None = None

    def number(self, cell: Numbers) -> Numbers:
        """Return the two numbers of the thread that the instance of each cell is a part of, ``(..., 2)``."""
        number: Numbers = cell - np.array(self.base)
        if self.torus is not None:
            return self.torus.wrap(number)
        if self.turn == (0, 0):
            return number
        axis = int(np.argmax(np.abs(self.turn)))
        turns = np.floor_divide(number[..., axis], self.turn[axis])
        return np.asarray(number - turns[..., np.newaxis] * np.array(self.turn))


def link_threads(colors: Sequence[InstanceColors], lattice: Lattice) -> list[ElementThread]:
    """Return the thread of each element: which of its instances, and which other elements, have one color.

    First, each element may have a turn, the lag along which its instances agree (:func:`find_turns`). Then elements
    that do not have different turns are linked at a lag, the closest first, if the colors of their instances, or their
    mean colors along the turn of one of them, correlate. Few pairs agree by chance, so that they have to agree more.

    Parameters
    ----------
    colors
        The colors of the elements.
    lattice
        Its basis spans the cells.
    """
    threads = [ElementThread(k, turn=turn) for k, turn in enumerate(find_turns(colors, lattice))]
    links = [
        (_compare(colors[a], colors[b], (i, j), max(threads[a].turn, threads[b].turn)), a, b, (i, j))
        for a, b in itertools.combinations(range(len(threads)), 2)
        for i, j in itertools.product((-1, 0, 1), repeat=2)
    ]
    for _, a, b, lag in sorted((link for link in links if link[0] >= 0), reverse=True):
        one, other = threads[a], threads[b]
        turn = max(one.turn, other.turn)
        if one.first == other.first or min(one.turn, other.turn) not in ((0, 0), turn):
            continue
        shift = (one.base[0] + lag[0] - other.base[0], one.base[1] + lag[1] - other.base[1])
        for k, thread in enumerate(threads):
            if thread.first == other.first:
                base = (thread.base[0] + shift[0], thread.base[1] + shift[1])
                threads[k] = ElementThread(one.first, base, turn)
            elif thread.first == one.first:
                threads[k] = replace(thread, turn=turn)
    return threads


def _compare(one: InstanceColors, other: InstanceColors, lag: Lag, turn: Lag) -> float:
    """Return by how much the correlation of two elements, or of their threads along a turn, exceeds its limit."""
    cells = np.concatenate([np.argwhere(one.known), np.argwhere(other.known) - lag])
    number = _group(ElementThread(0, turn=turn).number(cells))
    values = np.concatenate([one.values[one.known], other.values[other.known]])
    half = np.repeat([0, 1], [one.known.sum(), other.known.sum()])
    sums = np.zeros((2, number.max(initial=0) + 1, values.shape[1] + 1))
    np.add.at(sums, (half, number), np.column_stack([values, np.ones(len(values))]))
    both = sums[:, (sums[..., -1] > 0).all(0)]
    (r, pairs), (least, chance) = correlate(*both[..., :-1] / both[..., -1:]), _LINKED_THREADS if any(turn) else _LINKED
    return r - least - chance / math.sqrt(max(pairs, 1))


def _group(numbers: Numbers) -> Numbers:
    """Return which rows are equal, as a number of each."""
    return np.asarray(np.unique(numbers, axis=0, return_inverse=True)[1].ravel())


def find_turns(colors: Sequence[InstanceColors], lattice: Lattice) -> list[Lag]:
    """Return the turn of each element; (0, 0) for none.

    Either no element of a texture has threads, or each has some with probability 1/2. Then all turns are as frequent,
    or one or two alone occur; this choice is integrated over. The evidence for threads is log10 of the ratio of
    likelihoods. It is a sum over the elements, so that little of each is enough where all agree. If it is large enough,
    each element has the most probable of its turns and none.
    """
    likely = 10 ** np.clip([compare_turns(color, lattice) for color in colors], -300, 300)
    one, other = np.triu_indices(len(_LAGS))
    few = (np.eye(len(_LAGS))[one] + np.eye(len(_LAGS))[other]) / 2
    frequency = np.concatenate([np.full_like(few, 1 / len(_LAGS)), few])
    ratio = 0.5 + 0.5 * likely @ frequency.T
    evidence = np.log10(ratio).sum(0) - math.log10(len(frequency))
    most = evidence.max()
    if most + math.log10((10 ** (evidence - most)).sum()) < _EVIDENCE:
        return [(0, 0)] * len(colors)
    weight = 10 ** (evidence - most) / ratio
    turn = likely * (weight @ frequency)
    none = weight.sum(1)
    return [_LAGS[int(row.argmax())] if row.max() > own else (0, 0) for row, own in zip(turn, none, strict=True)]


def compare_turns(color: InstanceColors, lattice: Lattice) -> NDArray[np.float64]:
    """Return log10 of the likelihood of threads along each lag over that of no threads.

    The colors are Gaussian. Their variance is made up of a share common along a thread, stains, whose correlation falls
    exponentially with the distance, and a rest that is independent. The shares and the reach of stains are integrated
    over grids; stains have the probability 1/2. The mean and the variance of the colors are integrated as well: the
    likelihood is the restricted one of a random effects model (Patterson and Thompson 1971). The channels are as
    many as the eigenvalues of their covariance amount to.

    Parameters
    ----------
    color
        The colors of one element; with fewer than four instances all lags are 0.
    lattice
        Its basis spans the cells.
    """
    cells, values = np.argwhere(color.known), color.values[color.known]
    if len(cells) < 4:
        return np.zeros(len(_LAGS))
    places = (cells - cells.mean(0)) @ lattice.matrix / lattice.s
    middle = np.argsort((places**2).sum(1), kind="stable")[:_MOST]
    cells, values, places = cells[middle], values[middle], places[middle]
    contrasts = scipy.linalg.helmert(len(cells))
    values = contrasts @ values
    covariance = values.T @ values
    channels = np.trace(covariance) ** 2 / max(float((covariance**2).sum()), 1e-30)
    groups = np.stack([_group(ElementThread(0, turn=lag).number(cells)) for lag in _LAGS])
    common = contrasts @ (groups[:, :, np.newaxis] == groups[:, np.newaxis]) @ contrasts.T
    apart = scipy.spatial.distance.cdist(places, places)
    stains = [contrasts @ np.exp(-apart / reach) @ contrasts.T for reach in _STAIN_REACHES]
    own = np.eye(len(values))
    others = [own, *((1 - share) * own + share * stain for stain in stains for share in _STAINED)]
    found = np.array([[_likelihoods(values, other + ratio * common) for ratio in _RATIOS] for other in others])
    prior = np.array([0.5] + [0.5 / (len(others) - 1)] * (len(others) - 1))[:, np.newaxis, np.newaxis]
    none, *threads = scipy.special.logsumexp(channels * (found - found[0, 0, 0]), 0, b=prior)
    return np.asarray((scipy.special.logsumexp(threads, 0) - math.log(len(threads)) - none) / math.log(10))


def _likelihoods(values: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the log-likelihood a channel of values ``(n, C)`` for covariances ``(..., n, n)`` of unknown scale."""
    square = (values * np.linalg.solve(covariance, values)).sum((-2, -1))
    return np.asarray(-(np.linalg.slogdet(covariance)[1] + len(values) * np.log(np.maximum(square, 1e-12))) / 2)
