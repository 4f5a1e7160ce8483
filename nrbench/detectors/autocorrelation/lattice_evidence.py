"""The autocorrelation of an image as a smooth surface: how well the image agrees with itself at a lattice's vectors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.lattice_evidence_kernels import (
    climb_multiples,
    jets,
    list_multiples,
    rate_added_points,
)
from nrbench.imaging.correlation import Correlation
from nrbench.lattice.geometry import Points, hermite_matrices, reduce_bases, reduce_basis

REACH = 0.75
"""Lags up to this share of the image's sides are compared. At larger lags the overlap is too small."""
PAD = 4
"""Columns mirrored to the left of lag 0, for the spline."""
NEARBY = 0.25
"""The grain of a texture is computed from lags up to this share of the image's sides."""
MOST_LAGS = 2048
"""Number of lags that are read for each of many finer lattices: the mean of so many differs from that of all by 0.005
at most, and the cells of fine grain have a hundred times as many."""
MOST_FITTED = 2048
"""A basis is fitted to about this number of multiples if it has more than twice as many."""
NEAREST = 8
"""The fit starts from, and always includes, the multiples that are sums of up to this number of each vector."""
MARGIN = 0.02
"""Multiples within reach may move by this share of the image's sides while a basis is fitted."""
LINES = np.array([(1, 0, 1, 1), (0, 1, 1, -1)])
"""Columns: sums of the multiples (a, b) that are the same along lines of lags in four directions."""
SIZE_EXPONENT = 0.06
"""Of two similar lattices the smaller one has the higher merit."""
FEWEST_LAGS = 3
"""Least number of lags whose scatter tells a standard error."""
BY_LINES = 3.0
"""Standard errors from which an excess is compared with the scatter of lines, too."""
GROWTH = 1.7
"""Factor by which the radius of a fit grows at each step."""
STEPS = 14
"""Steps of a fit: enough to cross a hundred cells and to converge."""
INDICES = (2, 3, 5, 7, 11, 13)
"""Finer lattices of these indices are compared; other indices are reached in several steps."""
MAX_SHIFT = 0.2
"""A fit that moves a vector by more than this share of the shorter vector is rejected: it has followed other peaks."""


class Agreement(NamedTuple):
    """The correlations at a set of lags: their mean (-1 if there are none), variance and number."""

    mean: float
    variance: float
    lags: int


class Split(NamedTuple):
    """By how much the correlation at a supercell's multiples exceeds that at all other multiples of a lattice.

    Parameters
    ----------
    excess
        The difference of the two means; -1 if one of the two parts is empty.
    errors
        The excess in standard errors; 0 if they are not known. If it exceeds :data:`BY_LINES` standard errors of lags,
        the errors are those of lines of lags.
    """

    excess: float
    errors: float


@dataclass(frozen=True)
class LatticeEvidence:
    """The autocorrelation of an image as a cubic spline surface.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    """

    gamma: Correlation

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the image."""
        return (self.gamma.shape[0] + 1) // 2, self.gamma.shape[1]

    @cached_property
    def _end(self) -> NDArray[np.float64]:
        height, width = self.shape
        return REACH * np.array([width - 1.0, height - 1.0])

    @cached_property
    def _spline(self) -> NDArray[np.float64]:
        mirrored = np.concatenate([self.gamma[::-1, PAD:0:-1], self.gamma], 1)
        return np.asarray(scipy.ndimage.spline_filter(mirrored, 3, np.float64))

    @cached_property
    def _known(self) -> dict[bytes, Agreement]:
        """The agreement at the multiples of each basis that was read. Several steps of a detector need that of one."""
        return {}

    def jets(self, lags: Points) -> NDArray[np.float64]:
        """Return value, gradient and second derivatives (xx, yy, xy) at lags ``(n, 2)``, as ``(n, 6)``."""
        on_right = np.where(lags[:, :1] < 0, -lags, lags)
        surface = jets(self._spline, on_right + np.array([PAD, self.shape[0] - 1.0]))
        surface[:, 1:3] *= np.where(lags[:, :1] < 0, -1, 1)
        return surface

    def multiples(self, basis: Points) -> NDArray[np.int64]:
        """Return the integers (a, b), ``(n, 2)``, of all lattice points a t1 + b t2 within reach.

        Lag 0 is left out; of each pair of opposite points one is returned.
        """
        return list_multiples(np.ascontiguousarray(basis), self._end)

    def spans_plane(self, basis: Points) -> bool:
        """Return whether the multiples of a basis within reach lie on more than one line through lag 0."""
        numbers = self.multiples(basis)
        return len(numbers) > 1 and bool((numbers @ (-numbers[0, 1], numbers[0, 0])).any())

    def overlaps(self, lags: Points) -> NDArray[np.float64]:
        """Return the area, px^2, in which the image and its copy shifted by each lag overlap."""
        height, width = self.shape
        return np.asarray((width - np.abs(lags[:, 0])) * (height - np.abs(lags[:, 1])))

    def agreement(self, basis: Points, coarser: Points | None = None) -> Agreement:
        """Return the correlation at a basis's multiples, each weighted by the overlap of the image with its copy.

        Parameters
        ----------
        basis
            Rows (x, y) px.
        coarser
            The basis of a coarser lattice, whose points are left out.
        """
        if coarser is not None:
            return self._read(basis[np.newaxis], np.linalg.inv(coarser), 0)[0]
        key = basis.tobytes()
        if key not in self._known:
            self._known[key] = self._read(basis[np.newaxis], np.zeros((2, 2)), 0)[0]
        return self._known[key]

    def agreements(self, bases: Points, coarser: Points) -> list[Agreement]:
        """Return :meth:`agreement` for many lattices ``(n, 2, 2)``, each without the points of the coarser one.

        Of more than about :data:`MOST_LAGS` lags a random sample is read, the same in each call.
        """
        return self._read(bases, np.linalg.inv(coarser), MOST_LAGS)

    def _read(self, bases: Points, cells: NDArray[np.floating[Any]], most: int) -> list[Agreement]:
        """Return the agreements; ``cells`` is the inverse of the coarser basis, or zero if there is none."""
        inverse = np.asarray(cells, np.float64)
        rows = rate_added_points(self._spline, np.ascontiguousarray(bases), inverse, self._end, PAD, most)
        return [Agreement(mean, variance, int(count)) for mean, variance, count in rows.tolist()]

    def split(self, basis: Points, changes: NDArray[np.int64]) -> list[Split]:
        """Compare the multiples of each coarser lattice with all other multiples of a basis.

        Parameters
        ----------
        basis
            Rows (x, y) px.
        changes
            ``(n, 2, 2)``: integer matrices H; the basis of a coarser lattice is H times ``basis``.
        """
        numbers = self.multiples(basis)
        lags = numbers @ basis
        values, weights = self.jets(lags)[:, 0], self.overlaps(lags)
        return [_split_lags(numbers, values, weights, change) for change in changes]

    def repeated(self, basis: Points) -> float:
        """Return the mean correlation at all multiples of a basis: the share of the variance that repeats."""
        return self.agreement(basis).mean

    def explained_variance_loo(self, basis: Points) -> float:
        """Return the share of the variance that is explained if each tile is predicted by all others (leave one out).

        With n tiles of which the share rho repeats, the mean of the n - 1 others explains rho - (1 - rho) / (n - 1).
        The mean correlation at all multiples estimates rho without the bias of a mean tile, to which each tile
        contributes itself. Return -1 if the image holds no more than two tiles.
        """
        rho, tiles = float(self.repeated(basis)), self.tiles(basis)
        return rho - (1 - rho) / (tiles - 1) if tiles > 2 else -1.0

    def merit(self, basis: Points) -> float:
        """Return the explained share of the variance, times the number of tiles to the power :data:`SIZE_EXPONENT`."""
        return float(self.explained_variance_loo(basis) * self.tiles(basis) ** SIZE_EXPONENT)

    @cached_property
    def grain(self) -> float:
        """Area, px^2: the sum of squared correlations over the lags up to a quarter of the image's sides."""
        height, width = self.shape
        down, across = int(NEARBY * height), int(NEARBY * width)
        near = self.gamma[height - 1 - down : height + down, : across + 1].astype(np.float64) ** 2
        return float(2 * near.sum() - near[:, 0].sum())

    def sigmas(self, basis: Points) -> float:
        """Return the mean correlation at a basis's multiples, in units of a spread like that of Bartlett's formula.

        The correlation of a random field at a far lag has the variance grain / overlap. The mean over lags further
        apart than a grain, weighted by overlap, has the variance grain / (sum of overlaps). The result is not a
        significance, because a lattice's own peaks add to the grain. ``benchmarks/consensus_calibration.py`` measures
        which values noise reaches.
        """
        lags = self.multiples(basis) @ basis
        total = float(self.overlaps(lags).sum())
        return self.repeated(basis) * float(np.sqrt(total / self.grain)) if total else 0.0

    def tiles(self, basis: Points) -> float:
        """Return the image's area in cells."""
        (ax, ay), (bx, by) = basis.tolist()
        return float(self.shape[0] * self.shape[1] / abs(ax * by - ay * bx))

    def fit(self, basis: Points) -> Points:
        """Return the reduced basis near the given one at whose multiples the mean correlation is highest.

        Newton's method on all multiples at once, from the nearest outward: a far multiple determines the basis more
        precisely, but can be identified only if the basis is already precise. If a vector moves too far
        (:data:`MAX_SHIFT`), the given basis is returned, reduced.
        """
        far = REACH * float(np.hypot(*self.shape))
        end = self._end * (1 + MARGIN / REACH)
        start = np.ascontiguousarray(basis)
        numbers = self.multiples(start)
        if len(numbers) > 2 * MOST_FITTED:
            spread = np.arange(len(numbers)) % (len(numbers) // MOST_FITTED) == 0
            numbers = numbers[spread | (np.abs(numbers) <= NEAREST).all(1)]
        fitted = climb_multiples(self._spline, numbers, start, end, far, PAD, GROWTH, STEPS)
        too_far = np.hypot(*(fitted - basis).T).max() > MAX_SHIFT * np.hypot(*basis.T).min()
        return reduce_basis(basis if too_far else fitted)


def finer_bases(basis: Points, indices: tuple[int, ...] = INDICES) -> Points:
    """Return the reduced bases of all finer lattices of these indices, ``(n, 2, 2)``, in that order."""
    return reduce_bases(_finer_changes(indices) @ basis)


@cache
def _finer_changes(indices: tuple[int, ...]) -> Points:
    return np.concatenate([hermite_matrices(index) / index for index in indices])


def highest_added(evidence: LatticeEvidence, basis: Points, indices: tuple[int, ...] = INDICES) -> float:
    """Return the highest mean correlation at the vectors that a finer lattice of these indices would add."""
    return max(added.mean for added in evidence.agreements(finer_bases(basis, indices), basis))


def _split_lags(
    numbers: NDArray[np.int64], values: NDArray[np.float64], weights: NDArray[np.float64], change: NDArray[np.int64]
) -> Split:
    """Return the split of correlations ``(n,)`` at the multiples ``(n, 2)`` of a lattice by a coarser one."""
    cells = numbers @ np.linalg.inv(change)
    inside = (np.abs(cells - np.rint(cells)) < 1e-6).all(1)
    fewest = min(np.count_nonzero(inside), np.count_nonzero(~inside))
    if not fewest:
        return Split(-1.0, 0.0)
    parts = np.zeros(len(values))
    excess = variance = 0.0
    for chosen, sign in ((inside, 1), (~inside, -1)):
        shares = weights[chosen] / weights[chosen].sum()
        mean = float(shares @ values[chosen])
        excess += sign * mean
        parts[chosen] = sign * shares * (values[chosen] - mean)
        variance += float(shares @ (values[chosen] - mean) ** 2) / np.count_nonzero(chosen)
    errors = excess / max(variance**0.5, 1e-6) if fewest >= FEWEST_LAGS else 0.0
    if errors > BY_LINES:
        errors = excess / max(_line_error(numbers, parts), 1e-6)
    return Split(excess, errors)


def _line_error(numbers: NDArray[np.int64], parts: NDArray[np.float64]) -> float:
    """Return the standard error of a sum of ``parts`` ``(n,)``, one for each multiple, for threads of any length.

    Threads or rows of one color reach through many tiles, so the correlations at the lags of one line, and at those of
    the opposite line, agree. The error is that of lines instead of lags, in the two directions where they scatter most.
    """
    single = float((parts**2).sum())
    by_line = []
    for line in np.abs(numbers @ LINES).T:
        sums = np.bincount(line, parts)
        count = len(np.unique(line))
        by_line.append(float((sums**2).sum()) * count / max(count - 1, 1))
    return float(np.sqrt(max(sum(sorted(by_line)[-2:]) - single, single)))
