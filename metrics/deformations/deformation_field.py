"""The displacement field of a tracked lattice, without its affine part, and what describes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape
from nrbench.tracking.tracker import Track

_AFFINE = 3
_LEAST_POINTS = 6
_PAIRS = 0.05


@dataclass(frozen=True)
class DeformationField:
    """Where lattice points were found.

    Parameters
    ----------
    lattice
        Where they belong.
    numbers
        ``(n, 2)``: their whole cell coordinates.
    places
        ``(n, 2)``: where they were found, (x, y) px.
    """

    lattice: Lattice
    numbers: NDArray[np.int64]
    places: Points

    @classmethod
    def of(cls, track: Track) -> DeformationField:
        """Return the field of an image's whole tiles."""
        return cls(track.lattice, track.numbers, track.found(track.numbers))

    def within(self, low: Points, high: Points) -> DeformationField:
        """Return the points found in an upright box, (x, y) px."""
        inside = ((self.places >= low) & (self.places < high)).all(1)
        return DeformationField(self.lattice, self.numbers[inside], self.places[inside])

    @cached_property
    def rest(self) -> Points:
        """``(n, 2)`` px: places less their best regular fit, an affine image of the whole numbers by least squares."""
        design = np.column_stack([self.numbers, np.ones(len(self.numbers))])
        return np.asarray(self.places - design @ np.linalg.lstsq(design, self.places, rcond=None)[0])

    @property
    def deviation(self) -> float:
        """Root mean square distance of the points from their best regular fit, px."""
        return math.sqrt(float((self.rest**2).sum() / len(self.rest)))

    @property
    def amplitude(self) -> float:
        """The same with three points' worth taken out for the fit, px: its mean square does not shrink with n."""
        return math.sqrt(float((self.rest**2).sum() / (len(self.rest) - _AFFINE)))

    @cached_property
    def correlation_length(self) -> float | None:
        """How far apart, px, displacements correlate by 1/e; None where they still do across the image."""
        distance, correlation = self._correlogram()
        below = np.flatnonzero(correlation <= 1 / math.e)
        if not len(below):
            return None
        far = int(below[0])
        (a, b), (high, low) = distance[far - 1 : far + 1], correlation[far - 1 : far + 1]
        return float(a + (b - a) * (high - 1 / math.e) / (high - low))

    def _correlogram(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances, px, from 0 on, and the mean correlation of displacements so far apart."""
        sums, counts, length = self._lags()
        use = counts >= _PAIRS * counts.max()
        ring = np.rint(length / (self.lattice.s / 2)).astype(np.intp)[use]
        pairs, products, reach = (
            np.bincount(ring, weights) for weights in (counts[use], sums[use], (length * counts)[use])
        )
        held = pairs > 0
        return reach[held] / pairs[held], products[held] / pairs[held] / (products[0] / pairs[0])

    def _lags(self) -> tuple[NDArray[np.float64], ...]:
        """Return, for every step from point to point, the sum of products, the number of pairs, and its length."""
        at = self.numbers - self.numbers.min(0)
        side = at.max(0) + 1
        table = np.zeros((3, *(2 * side)))
        table[0, *at.T], table[1:, *at.T] = 1, self.rest.T
        power = np.abs(np.fft.fft2(table)) ** 2
        counts, sums = np.rint(np.fft.ifft2(power[0]).real), np.fft.ifft2(power[1:].sum(0)).real
        steps = np.stack(np.meshgrid(*(np.fft.fftfreq(2 * n, 1 / (2 * n)) for n in side), indexing="ij"), -1)
        return sums, counts, np.hypot(*np.moveaxis(steps @ self.lattice.matrix, -1, 0))

    @cached_property
    def folded(self) -> float | None:
        """Share of whole cells that lie on their back: half of one has a negative Jacobian; None without any."""
        index = {(int(u), int(v)): n for n, (u, v) in enumerate(self.numbers)}
        corners = [
            [index[u, v], index[u + 1, v], index[u + 1, v + 1], index[u, v + 1]]
            for u, v in index
            if (u + 1, v) in index and (u, v + 1) in index and (u + 1, v + 1) in index
        ]
        if not corners:
            return None
        cells = self.places[np.array(corners)]
        turn = np.sign(np.linalg.det(self.lattice.matrix))
        halves = [_turned(cells[:, k], cells[:, (k + 1) % 4], cells[:, k - 1]) * turn for k in range(4)]
        return float((np.min(halves, 0) <= 0).mean())


def _turned(corner: Points, one: Points, other: Points) -> NDArray[np.float64]:
    """Return twice the signed area of the triangles at corners."""
    a, b = one - corner, other - corner
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def parts(field: DeformationField, image: Shape, shape: Shape) -> list[DeformationField]:
    """Return the field in boxes of ``shape`` about half a box apart, so that images of any size compare.

    An affine fit takes more from a small image than from a large one: of equally large parts it takes the same.
    Parts with fewer than 6 points are left out.
    """
    starts = [np.linspace(0, n - box, 1 + math.ceil(2 * (n - box) / box)) for n, box in zip(image, shape, strict=True)]
    boxes = [np.array([x, y]) - 0.5 for y in starts[0] for x in starts[1]]
    found = [field.within(box, box + shape[::-1]) for box in boxes]
    return [part for part in found if len(part.numbers) >= _LEAST_POINTS and _spread(part)]


def _spread(field: DeformationField) -> bool:
    """Return whether points lie on more than a line."""
    return bool(np.linalg.matrix_rank(field.numbers - field.numbers[0]) == 2)
