"""Copies of a sample's elements: which instance each new element is, and how neighbors meet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray
from skimage.segmentation import watershed

from nrbench.plugins.forms import Shape

from ..canvas.canvas import FURTHER
from ..lattice_places.equal_places import CellTorus
from .element_colors import Table
from .element_map import WHOLE, ElementMap, Lag, Numbers
from .element_outlines import OUTLINE_REACH, ElementOutlines

_CORE = 0.97
"""Share from which a place belongs to its element; elsewhere copies meet along a seam."""
_MEETING = 0.05
"""Share from which an element is compared with another one that has this share too."""
_COMPARED = 64
"""Largest number of places at which the surroundings of two elements are compared."""
_MOST = 256
"""Largest number of instances of an element that are copied."""
_FIT = 4.0
"""Log-likelihood that the median misfit of two instances costs."""
_ALIKE = 0.5
"""How far, in standard deviations, the color of a new element differs from that of the one whose detail it copies."""
_EXACT = 0.02
"""The same for the crossings of a thread, which have one color."""
_EQUAL = 6.0
"""Log-likelihood that two copies of one instance beside each other cost."""
_AROUND: tuple[Lag, ...] = ((1, 0), (0, 1), (1, 1), (1, -1), (-1, 0), (0, -1), (-1, -1), (-1, 1))
_SWEEPS = 5
"""Times that each element is drawn again, given its neighbors."""
_EVEN = 0.7
"""Log-likelihood that an instance loses at each sweep for being drawn twice as often as the mean."""
_ORDER: Final = 3
"""Order of the splines by which copies are read at real-valued places."""
_SOFTNESS = 0.6
"""px, standard deviation of the Gaussian that softens seams."""


@dataclass(frozen=True, eq=False)
class ElementCopies:
    """A part of a sample from which elements are copied whole, each with what is around it.

    Parameters
    ----------
    elements
        The elements.
    rest
        ``(H, W, C)``: the sample; if colors are drawn, without its mean tile and the colors of its elements.
    outlines
        The outlines of its instances.
    own
        ``(E, I, J, C)``: the colors of the instances, on the box of :meth:`ElementMap.cells`, if ``rest`` holds them.
        Then no copied value leaves the range of the pixels around its place, and what surrounds an element takes the
        colors of its new neighbors. None: all colors are laid.
    """

    elements: ElementMap
    rest: NDArray[np.float64]
    outlines: ElementOutlines
    own: Table | None = None

    @cached_property
    def _corner(self) -> Numbers:
        """The first cell of the box of the sample's cells."""
        return np.asarray(self.elements.cells(self.rest.shape[:2])[0, 0])

    @cached_property
    def whole(self) -> list[Numbers]:
        """The cells in which the sample shows each element whole, ``(n, 2)`` each, at most 256."""
        cells = [np.argwhere(c.shown >= WHOLE) + self._corner for c in self.elements.mean_colors(self.rest)]
        return [c if len(c) <= _MOST else np.random.default_rng(0).permutation(c)[:_MOST] for c in cells]

    @cached_property
    def _splines(self) -> list[NDArray[np.float64]]:
        return [scipy.ndimage.spline_filter(plane, _ORDER, mode="mirror") for plane in np.moveaxis(self.rest, -1, 0)]

    @cached_property
    def _extremes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        filters = scipy.ndimage.minimum_filter, scipy.ndimage.maximum_filter
        low, high = (f(self.rest, (2, 2, 1), origin=(-1, -1, 0), mode="nearest") for f in filters)
        return low, high

    def _find_range(self, places: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the least and the largest value of the four pixels around each place (x, y), ``(n, C)`` each."""
        size = np.array(self.rest.shape[1::-1]) - 1
        x, y = np.floor(size - np.abs(size - np.abs(places))).astype(np.int64).clip(0, size).T
        return [extreme[y, x] for extreme in self._extremes]

    @cached_property
    def _misfits(self) -> list[tuple[int, int, Lag, NDArray[np.float64]]]:
        """The misfits of all instances of two elements at a lag where they meet, over what is usual for both.

        An instance of the first element and one of the second show the same places: the surroundings of the first are
        the second, and the other way around. Their misfit is the squared difference of what they show. It is taken over
        the medians of both instances, so that odd ones are drawn as often as others. Instances that are neighbors in
        the sample agree there; they are as good as the best quarter.
        """
        smooth = [scipy.ndimage.gaussian_filter(plane, 0.7) for plane in np.moveaxis(self.rest, -1, 0)]
        found = []
        for a, b, lag, places in self._find_meetings():
            shown = [
                self._read(smooth, cells, places - np.array(step))
                for cells, step in ((self.whole[a], (0, 0)), (self.whole[b], lag))
            ]
            misfit = scipy.spatial.distance.cdist(shown[0], shown[1], "sqeuclidean")
            neighbors = (self.whole[a][:, np.newaxis] + np.array(lag) == self.whole[b]).all(-1)
            misfit = np.where(neighbors, np.nan, misfit + 1e-9)
            usual = np.nanmedian(misfit, 1, keepdims=True) * np.nanmedian(misfit, 0) / np.nanmedian(misfit)
            misfit = np.where(neighbors, np.nanquantile(misfit / usual, 0.25), misfit / usual)
            found.append((a, b, lag, misfit))
        return found

    def _find_meetings(self) -> Iterator[tuple[int, int, Lag, NDArray[np.float64]]]:
        """Yield pairs of elements, the lag of the second one, and places that show both, from the first one's cell."""
        shares = self.outlines.shares
        v, u = self.elements.label.shape
        place = np.stack(np.meshgrid((np.arange(u) + 0.5) / u, (np.arange(v) + 0.5) / v), -1)
        pairs, places = [], []
        for r, s in itertools.permutations(range(len(shares.label)), 2):
            both = np.minimum(shares.share[r], shares.share[s]) > _MEETING
            lag = (shares.offset[s] - shares.offset[r])[both]
            pairs.append(np.column_stack([shares.label[r][both], shares.label[s][both], lag]))
            places.append(place[both] - shares.offset[r][both])
        found, number = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
        at, rng = np.concatenate(places), np.random.default_rng(0)
        for k, (a, b, i, j) in enumerate(found.tolist()):
            if (a, b, i, j) < (b, a, -i, -j):
                yield a, b, (i, j), rng.permutation(at[number.ravel() == k])[:_COMPARED]

    def _read(
        self, planes: Sequence[NDArray[np.float64]], cells: Numbers, places: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the values at places of cells, one row for each cell."""
        x, y = np.moveaxis(self.elements.lattice.from_cell(cells[:, np.newaxis] + places), -1, 0)
        read = [scipy.ndimage.map_coordinates(plane, [y, x], order=1, mode="mirror") for plane in planes]
        return np.concatenate(read, -1)

    def draw(
        self,
        shape: Shape,
        rng: np.random.Generator,
        colors: tuple[Table, Table] | None = None,
        torus: CellTorus | None = None,
        exact: Sequence[bool] = (),
    ) -> Numbers:
        """Return the cell of the sample from which each element of a picture is copied, ``(E, I, J, 2)``.

        The box of cells is that of :meth:`ElementMap.cells`. Elements are drawn in turn, a few times, given their
        neighbors (Gibbs sampling): those whose surroundings fit are more likely, neighbors are copied from different
        cells, and all instances are copied about equally often. With ``colors``, elements of similar colors are more
        likely: their detail goes with their color.

        Parameters
        ----------
        shape
            Of the picture.
        rng
            Draws the cells.
        colors
            The colors ``(E, I, J, C)`` of the sample's elements, and those of the picture's.
        torus
            The cells of a picture that repeats.
        exact
            For each element whether the nearest color is taken.
        """
        places = self.elements.cells(shape)
        box, equal = places.shape[:2], ... if torus is None else torus.find_equal(places)
        drawn = [rng.integers(len(cells), size=box)[equal] for cells in self.whole]
        bias = [np.zeros(len(cells)) for cells in self.whole]
        parities = [np.argwhere((np.indices(box) % 2 == np.reshape(p, (2, 1, 1))).all(0)).T for p in np.ndindex(2, 2)]
        for _, k in itertools.product(range(_SWEEPS), range(len(drawn))):
            for i, j in parities:
                likelihood = bias[k] + rng.gumbel(size=(len(i), len(bias[k])))
                if colors is not None:
                    likelihood -= self._compare_colors(k, colors[0][k], colors[1][k][i, j], bool(exact) and exact[k])
                likelihood -= self._weigh_neighbors(k, drawn, i, j)
                drawn[k][i, j] = likelihood.argmax(-1)
                drawn[k] = drawn[k][equal]
            count = np.bincount(drawn[k].ravel(), minlength=len(bias[k]))
            bias[k] -= _EVEN * np.log2((count + 1) / (count.mean() + 1))
        return np.stack([cells[number] for cells, number in zip(self.whole, drawn, strict=True)])

    def _read_own(self, k: Numbers, cells: Numbers) -> Table | float:
        """Return the colors that the rest holds of instances, ``(n, C)``."""
        if self.own is None:
            return 0.0
        at = np.clip(cells - self._corner, 0, np.array(self.own.shape[1:3]) - 1)
        return np.asarray(self.own[k, at[..., 0], at[..., 1]])

    def colors_of(self, drawn: Numbers) -> Table:
        """Return the colors of the elements that were drawn, ``(E, I, J, C)``."""
        return np.stack([np.asarray(self._read_own(np.array(k), cells)) for k, cells in enumerate(drawn)])

    def _compare_colors(self, k: int, own: Table, new: Table, exact: bool) -> NDArray[np.float64]:
        """Return minus the log-likelihoods ``(m, n)`` that m new colors belong to n whole instances of an element."""
        whole = own[tuple((self.whole[k] - self._corner).T)]
        apart = scipy.spatial.distance.cdist(new, whole, "sqeuclidean")
        width = _EXACT if exact else _ALIKE
        return np.asarray(apart / (2 * width**2 * max(float(whole.var(0).sum()), 1e-12)))

    def _weigh_neighbors(self, k: int, drawn: Sequence[Numbers], i: Numbers, j: Numbers) -> NDArray[np.float64]:
        """Return minus the log-likelihoods ``(m, n)`` of n instances of an element at m cells, given those around."""

        def near(b: int, lag: Lag) -> Numbers:
            return drawn[b].take(np.ravel_multi_index((i + lag[0], j + lag[1]), drawn[b].shape, mode="clip"))

        cost = np.zeros((len(i), len(self.whole[k])))
        for a, b, lag, misfit in self._misfits:
            if a == k:
                cost += _FIT * misfit.T[near(b, lag)]
            if b == k:
                cost += _FIT * misfit[near(a, (-lag[0], -lag[1]))]
        for lag in _AROUND:
            cost[np.arange(len(i)), near(k, lag)] += _EQUAL
        return cost

    def render(
        self,
        drawn: Numbers,
        shape: Shape,
        rows: slice = slice(None),
        colors: Table | None = None,
        strength: float = 1.0,
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return the copies at some rows of a picture, times ``strength``, with new colors inside their own outlines.

        Where elements meet, copies are joined along the watersheds of their likeness, which are the lines on which they
        differ least. The second array, ``(H, W, 4, 3)``, has the places (x, y) of the copies at each pixel and their
        weights, the largest first.
        """
        top, bottom, _ = rows.indices(shape[0])
        pad = math.ceil(6 * OUTLINE_REACH * self.elements.lattice.s) + 2
        size, corner = (bottom - top + 2 * pad, shape[1] + 2 * pad), self.elements.cells(shape)[0, 0]
        around = list(self.outlines.shares.within(size, (-pad, top - pad)))
        ranks = len(around)
        shares, index = np.zeros((ranks, *size)), np.zeros((3, ranks, *size), np.int64)
        flat_shares, flat_index = shares.reshape(ranks, -1), index.reshape(3, ranks, -1)
        pixels = [np.flatnonzero(at) for at, *_ in around]
        for rank, (_, share, label, cell) in enumerate(around):
            flat_shares[rank, pixels[rank]], flat_index[:, rank, pixels[rank]] = share, (label, *(cell - corner).T)
        row, column, _ = self.elements.places(size, (-pad, top - pad))
        copies = np.zeros((ranks, *size, self.rest.shape[2]))
        flat_copies = copies.reshape(ranks, -1, self.rest.shape[2])
        sources = np.zeros((max(ranks, FURTHER + 1), *size, 3), np.float32)
        last = np.array(self.rest.shape[1::-1]) - 1
        for rank, (at, (_, _, label, cell)) in enumerate(zip(pixels, around, strict=True)):
            step = drawn[label, *(cell - corner).T] - cell
            pixel = np.stack([at % size[1] - pad, at // size[1] + (top - pad)], -1)
            place = pixel + step @ self.elements.lattice.matrix
            # mirrored at the edges, as the splines are
            sources[rank].reshape(-1, 3)[at, :2] = last - np.abs(last - np.abs(place))
            copied = np.stack([strength * _interpolate(plane, place) for plane in self._splines], -1)
            if self.own is not None:
                copied = np.clip(copied, *self._find_range(place))
            if colors is not None:
                laid = np.zeros((len(place), self.rest.shape[2]))
                for other in range(ranks):
                    seen = np.flatnonzero(flat_shares[other, at] > 0)
                    k, i, j = flat_index[:, other, at[seen]]
                    source = step[seen] + np.stack([i, j], -1) + corner
                    color = colors[k, i, j] - self._read_own(k, source)
                    laid[seen] += self.outlines.read(k, source, place[seen])[:, np.newaxis] * color
                copied += laid * self.outlines.gain[row.ravel()[at], column.ravel()[at]]
            flat_copies[rank, at] = copied
        weight = _cut_seams(copies, shares, np.asarray(np.ravel_multi_index(tuple(index), drawn.shape[:3])))
        sources[:ranks, ..., 2], inner = weight, np.s_[:, pad : size[0] - pad, pad : size[1] - pad]
        parts = sources[inner]
        order = np.argsort(-parts[..., 2], axis=0, kind="stable")[: FURTHER + 1]
        shown = np.take_along_axis(parts, order[..., np.newaxis], 0)
        return np.asarray((copies[inner] * weight[*inner, np.newaxis]).sum(0)), np.moveaxis(shown, 0, 2)


def _interpolate(plane: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = places.T
    return np.asarray(scipy.ndimage.map_coordinates(plane, [y, x], order=_ORDER, mode="mirror", prefilter=False))


def _cut_seams(copies: NDArray[np.float64], shares: NDArray[np.float64], owner: Numbers) -> NDArray[np.float64]:
    """Return the weight of each copy at each pixel, ``(R, H, W)``.

    Parameters
    ----------
    copies
        ``(R, H, W, C)``.
    shares
        ``(R, H, W)``: the shares of the elements, 0 where there is no copy. The largest comes first.
    owner
        ``(R, H, W)``: number of the element.
    """
    apart = np.zeros(owner.shape[1:])
    for r, s in itertools.combinations(range(len(copies)), 2):
        apart = np.maximum(apart, np.square(copies[r] - copies[s]).sum(-1) * (shares[s] > 0))
    likeness = -scipy.ndimage.gaussian_filter(np.sqrt(apart), 0.8)
    basin = watershed(likeness, np.where(shares[0] > _CORE, owner[0] + 1, 0)) - 1  # type: ignore[no-untyped-call]
    basin = np.where(((basin == owner) & (shares > 0)).any(0), basin, owner[0])
    weight, around = np.zeros(owner.shape), np.pad(basin, 1, mode="edge")
    for y, x in np.ndindex(3, 3):
        shown = around[y : y + len(basin), x : x + basin.shape[1]]
        weight += math.exp(-((y - 1) ** 2 + (x - 1) ** 2) / (2 * _SOFTNESS**2)) * ((shown == owner) & (shares > 0))
    return np.asarray(weight / weight.sum(0))
