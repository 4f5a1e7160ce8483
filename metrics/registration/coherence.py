"""Phase coherence: whether the places of a picture match places of the sample that lie at one phase of the lattice.

Registration compares windows with the mean cell, which is vague where elements differ or few of them are shown. Here
each place of a picture is matched to the most similar place of the sample. Where the lattice is whole, its own phase
less that of the match is constant or changes smoothly; where the lattice breaks, it jumps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

from ..perception import limits
from ..perception.visible import Lab, SeenSample, smooth_plane
from .lattice_net import LatticeNet, Mask, Values, sum_boxes
from .lattice_nodes import (
    STRIPS,
    WIDEST,
    Field,
    LatticeNodes,
    Strips,
    choose_windows,
    explain_share,
    find_least,
    find_lengths,
)

_SCALES = (1, 2, 4, 8)
"""Standard deviations, px, of the Gaussians whose derivatives are features."""
_MOST_POINTS = 4096, 12544
"""Most points of the sample and of an output: every fourth pixel of 256 and of 448 px."""
_ROWS = 128
"""Number of points that are matched at once."""
_BINS = 16
"""Number of displacements along each vector at which votes are counted, before interpolation."""
_MOST_VOTES = 1 << 22
"""Number of places for votes that are held at a time."""
_ROUGHLY = 0.2
"""Largest departure in s of a node in its place before the limit is set."""


@dataclass(frozen=True)
class PointGrid:
    """Points of a picture at even steps.

    Parameters
    ----------
    shape
        Shape of the picture.
    step
        Distance of neighboring points, px.
    """

    shape: Shape
    step: int

    @classmethod
    def over(cls, lab: Lab, most: int) -> PointGrid:
        """Return the densest grid with at most about ``most`` points."""
        height, width = lab.shape[:2]
        return cls((height, width), max(1, int(np.ceil(np.sqrt(height * width / most)))))

    @cached_property
    def points(self) -> Points:
        """``(H, W, 2)``: (x, y) px."""
        y, x = (np.arange(self.step // 2, side, self.step, dtype=float) for side in self.shape)
        return np.stack(np.meshgrid(x, y), -1)

    def measure_features(self, lab: Lab) -> Values:
        """Return the local features of each point, ``(H W, C)``, less their mean.

        They are the first and second differences of L* at four scales, its mean at the coarsest one, and a* and b* at
        the three coarser ones.
        """
        (height, width), at = self.shape, np.s_[self.step // 2 :: self.step, self.step // 2 :: self.step]
        smooth, planes, done = list(np.moveaxis(lab[..., :3], -1, 0)), [], 0.0
        for scale in _SCALES:
            sigma, done = float(np.sqrt(scale**2 - done**2)), float(scale)
            smooth = [smooth_plane(plane, sigma) for plane in smooth]
            wide = np.pad(smooth[0], scale, mode="reflect")
            (a, b, c), (d, e, f), (g, h, i) = (
                [wide[y : y + height, x : x + width][at] for x in (0, scale, 2 * scale)] for y in (0, scale, 2 * scale)
            )
            planes += [(f - d) / 2, (h - b) / 2, f + d - 2 * e, h + b - 2 * e, (a + i - c - g) / 4]
            planes += [plane[at] for plane in smooth[1:] if scale > 1]
        features = np.stack([*planes, e], -1).reshape(-1, len(planes) + 1)
        return np.asarray(features - features.mean(0))


@dataclass(frozen=True)
class MatchedPicture(LatticeNodes):
    """A picture through which the lattice is followed by matches.

    The displacement of a window is the one for which most of its points vote, each vote being spread by a Gaussian. The
    mean votes of the windows around it decide where its own are undecided.

    Parameters
    ----------
    grid
        The points of the picture.
    moved
        ``(n, 2)``: phase of each point less that of its match, in cells.
    weight
        ``(n,)``: weight of its vote.
    """

    grid: PointGrid
    moved: Field
    weight: NDArray[np.float64]

    @cached_property
    def _fit(self) -> tuple[Field, Mask]:
        net, shape = self.net, 2 * self.net.cells
        half = 2 * net.to_cell(self.grid.points.reshape(-1, 2))
        row, column = np.moveaxis(np.clip(np.floor(half).astype(np.intp), 0, shape - 1), -1, 0)
        i, j = np.moveaxis(np.rint(self.moved * _BINS).astype(np.intp) % _BINS, -1, 0)
        block, blocks = row * shape[1] + column, int(shape.prod())
        place, rows = (block * _BINS + i) * _BINS + j, int(shape[0]) - 2 * self.size + 1
        step = max(_MOST_VOTES // int(shape[1] * _BINS**2), 1)
        bands = [(first, min(first + step, rows)) for first in range(0, rows, step)]
        found = np.concatenate([find_least(-self._count_votes(row, place, *band)) for band in bands])
        count = sum_boxes(np.bincount(block, minlength=blocks).reshape(shape).astype(float), 2 * self.size)
        return found, count > 0.9 * self.size**2 * net.area / self.grid.step**2

    def _count_votes(
        self, row: NDArray[np.intp], place: NDArray[np.intp], first: int, last: int
    ) -> NDArray[np.float64]:
        """Return the votes of the nodes from one row to another, of the points in rows of half cells."""
        net, width = self.net, 2 * int(self.net.cells[1])
        low, high = max(first - 1, 0), min(last + 1, 2 * int(net.cells[0]) - 2 * self.size + 1)
        above, below = low, high + 2 * self.size - 1
        near = (row >= above) & (row < below)
        shape = (below - above, width, _BINS**2)
        start, number = above * width * _BINS**2, (below - above) * width * _BINS**2
        votes = np.bincount(place[near] - start, self.weight[near], number).astype(float)
        sums = sum_boxes(votes.reshape(shape), 2 * self.size)
        sums += sum_boxes(np.pad(sums, ((1, 1), (1, 1), (0, 0)), mode="edge"), 3) / 9
        sums = sums[first - low : last - low]
        sigma = 2 / 3 * limits.GOOD_MATCH * net.s / np.linalg.norm(net.vectors, axis=1) * _BINS
        # As products with two matrices: ndimage takes each of many short lines alone.
        down, right = (ndimage.gaussian_filter1d(np.eye(_BINS), each, 0, mode="wrap") for each in sigma)
        return np.asarray(down @ (sums.reshape(*sums.shape[:2], _BINS, _BINS) @ right.T))


@dataclass(frozen=True, eq=False)
class SampleMatches:
    """A sample, to whose points those of other pictures are matched.

    A match is the point with the smallest squared distance of features, which are decorrelated and divided by the roots
    of their variances plus JND^2.

    Parameters
    ----------
    lab
        The sample as it is seen.
    net
        Its net.
    """

    lab: Lab
    net: LatticeNet

    @cached_property
    def grid(self) -> PointGrid:
        """The points."""
        return PointGrid.over(self.lab, _MOST_POINTS[0])

    @cached_property
    def _features(self) -> tuple[Values, Values]:
        """The decorrelated features, and the matrix that makes them."""
        features = self.grid.measure_features(self.lab)
        power, axes = np.linalg.eigh(np.cov(features.T))
        matrix = np.asarray(axes / np.sqrt(np.maximum(power, 0) + limits.JND**2), np.float32)
        return np.asarray(features @ matrix), matrix

    @cached_property
    def _own(self) -> NDArray[np.intp]:
        """The match of each point of the sample that lies at least ``APART`` s away."""
        height, width = self.grid.points.shape[:2]
        y, x = np.mgrid[1 - height : height, 1 - width : width] * self.grid.step
        near = sliding_window_view(np.hypot(x, y) < limits.APART * self.net.s, (height, width))[::-1, ::-1]
        return _find_nearest(self._features[0], self._features[0], near)

    @cached_property
    def right(self) -> NDArray[np.bool_]:
        """``(n,)``: whether the match of each point in the sample lies at its own phase, to within ``GOOD_MATCH`` s."""
        away = find_lengths(self._displace(self.grid, self._own), self.net.vectors)
        return np.asarray(away < limits.GOOD_MATCH * self.net.s)

    def prefers(self, basis: Points) -> bool:
        """Return whether matches lie at the points of the sample's lattice rather than at those of a denser one.

        If one of n points of the denser lattice is one of the sample's, a share of 1 / n of the matches beyond chance
        is expected there where the cell repeats, and all of them where it does not. The limit is the geometric mean.
        """
        moved = self._displace(self.grid, self._own) @ self.net.vectors @ np.linalg.inv(basis)
        denser = self.net.area / abs(float(np.linalg.det(basis)))
        near = float((find_lengths(moved, basis) < limits.GOOD_MATCH * self.net.s).mean()) - denser * self.chance
        return bool((self.right.mean() - self.chance) ** 2 * denser > max(near, 0.0) ** 2)

    @property
    def chance(self) -> float:
        """Share of matches that are right by chance."""
        return float(np.pi * (limits.GOOD_MATCH * self.net.s) ** 2 / self.net.area)

    @cached_property
    def trust(self) -> NDArray[np.float64]:
        """``(n,)``: weight of a match with each point: the share of right ones around it, beyond chance."""
        sigma = limits.GOOD_MATCH / 2 * self.net.s / self.grid.step
        share = ndimage.gaussian_filter(self.right.reshape(self.grid.points.shape[:2]).astype(float), sigma)
        return np.maximum(share - self.chance, 0).ravel()

    @cached_property
    def picture(self) -> MatchedPicture | None:
        """The sample itself, followed by matches with its other parts.

        None if it shows fewer than four cells, if its cells are too small for the steps of the grid, or if its places
        do not match at one phase of the lattice.
        """
        if self.net.shown < limits.FEWEST_CELLS or limits.GOOD_MATCH * self.net.s < self.grid.step / 2:
            return None
        if self.right.mean() < self.chance + limits.COHERENT:
            return None
        own, sides = self._place(self.grid, self._own), range(1, min(WIDEST, int(self.net.cells.min())) + 1)
        return next(iter(choose_windows(lambda size: [replace(own, size=size)], sides, True)), None)

    @cached_property
    def slip_limit(self) -> float:
        """Difference in s between two sides of a line beyond which they have slipped."""
        own = self.picture.slip.max(initial=0) if self.picture else 0
        return limits.LOOSE * max(limits.SLIP, limits.OF_SLIP * float(own))

    @cached_property
    def most_misplaced(self) -> float:
        """Share out of place that chance explains: by the strips of the sample, and by the number of its cells.

        If k of n cells are out of place, the next one is with a probability of (k + 1) / (n + 2), by Laplace's rule of
        succession. 1 if the sample cannot be followed.
        """
        if self.picture is None:
            return 1.0
        bad = self.picture.misplacement(self.slip_limit)
        shares = Strips.across(self.net.shape, STRIPS).share_out(bad, self.picture)
        return max(explain_share(shares, True), (self.net.shown * float(shares.mean()) + 1) / (self.net.shown + 2))

    def follow(self, lab: Lab, drift: Points | float = 0.0) -> MatchedPicture | None:
        """Follow the lattice, stretched and turned by a drift ``(2, 2)``, through an output by matches.

        None if it shows fewer than four cells, or if the sample cannot be followed.
        """
        shown = replace(self.net, shape=(lab.shape[0], lab.shape[1])).shown
        if self.picture is None or self.most_misplaced > limits.MOST_OWN or shown < limits.FEWEST_CELLS:
            return None
        rows, matrix = self._features
        grid = PointGrid.over(lab, _MOST_POINTS[1])
        matched = self._place(grid, _find_nearest(grid.measure_features(lab) @ matrix, rows), drift)
        matched = replace(matched, limit=self.picture.limit, size=self.picture.size)
        return matched if (matched.net.cells >= matched.size).all() and matched.valid.any() else None

    def _displace(self, grid: PointGrid, match: NDArray[np.intp], drift: Points | float = 0.0) -> Field:
        """Return the phase of each point, on the lattice moved by a drift, less that of its match, in cells."""
        own, matched = (points.reshape(-1, 2) for points in (grid.points, self.grid.points))
        return np.asarray((own @ np.linalg.inv(np.eye(2) + drift) - matched[match]) @ np.linalg.inv(self.net.vectors))

    def _place(self, grid: PointGrid, match: NDArray[np.intp], drift: Points | float = 0.0) -> MatchedPicture:
        net, moved = replace(self.net, shape=grid.shape, known=None).stretch(drift), self._displace(grid, match, drift)
        return MatchedPicture(net, _ROUGHLY, 1, grid, moved, self.trust[match])


@lru_cache(maxsize=2)
def match_sample(sample: SeenSample, lattice: Lattice) -> SampleMatches:
    """Return the matches of a sample."""
    return SampleMatches(sample.lab, LatticeNet(sample.shape, lattice.matrix, np.array(lattice.origin), sample.known))


def _find_nearest(rows: Values, others: Values, excluded: NDArray[np.bool_] | None = None) -> NDArray[np.intp]:
    """Return the index of the nearest of ``others`` to each of ``rows``.

    ``excluded``, ``(H, W, H, W)`` for rows ``(H W, C)``, holds the pairs that do not count.
    """
    # The largest product less half the power of the other is the smallest squared distance, in one multiplication.
    table = np.vstack([others.T, -(others**2).sum(1) / 2])
    rows = np.column_stack([rows, np.ones(len(rows), np.float32)])
    found, count = np.empty(len(rows), np.intp), excluded.shape[1] if excluded is not None else _ROWS
    for k, start in enumerate(range(0, len(rows), count)):
        likeness = rows[start : start + count] @ table
        if excluded is not None:
            np.copyto(likeness.reshape(excluded.shape[1:]), -np.inf, where=excluded[k])
        found[start : start + count] = likeness.argmax(1)
    return found
