"""The displacements of a lattice that was followed through a picture: their size, correlation length, and folds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from nrbench.displacement.following import find_knots
from nrbench.displacement.growth import Knots
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

from .lattice_net import Mask

_AFFINE = 3
"""Points whose displacements an affine fit explains completely."""
_LEAST_PAIRS = 0.05
"""Pairs of nodes at a lag, relative to the most frequent lag, below which the lag is ignored."""


def follow_lattice(image: Image, lattice: Lattice) -> Knots | None:
    """Return where the points of a lattice lie in an image; None if they are not found.

    The lattice is followed from the best of several starts. The last answers are kept, because two metrics need them,
    and many outputs have one sample.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The lattice; its origin does not matter.
    """
    return _follow(np.ascontiguousarray(image, np.float32).tobytes(), image.shape, lattice)


@lru_cache(maxsize=4)
def _follow(pixels: bytes, shape: tuple[int, ...], lattice: Lattice) -> Knots | None:
    return find_knots(np.frombuffer(pixels, np.float32).reshape(shape), lattice, most_starts=1)


@dataclass(frozen=True)
class NodeField:
    """Where the nodes of a lattice, lattice points and points between them, lie in a picture.

    Parameters
    ----------
    vectors
        ``(2, 2)`` px: the steps from node to node along both axes of the arrays, as rows.
    s
        Length of the shortest lattice vector, px.
    places
        ``(R, C, 2)`` px: (x, y) of each node on the lattice.
    moved
        ``(R, C, 2)`` px: displacement of each node.
    known
        ``(R, C)``: the nodes that were found.
    covered
        Share of the picture in which nodes were found.
    """

    vectors: Points
    s: float
    places: Points
    moved: Points
    known: Mask
    covered: float = 1.0

    @classmethod
    def of(cls, image: Image, lattice: Lattice) -> NodeField | None:
        """Follow a lattice through an image; None if it cannot be followed."""
        knots = follow_lattice(image, lattice)
        if knots is None:
            return None
        mean = knots.mean_lattice()
        places, found = (values.swapaxes(0, 1) for values in (mean.from_cell(knots.cells), knots.places))
        known = knots.known.T
        vectors = mean.matrix / np.array(knots.parts)[:, np.newaxis]
        moved = np.where(known[..., np.newaxis], found - places, 0)
        covered = min(knots.area / math.prod(image.shape[:2]), 1.0)
        return cls(vectors, mean.s, places, moved, known, covered)

    @property
    def extent(self) -> Shape:
        """Height and width, px, of the box that the known nodes span: a little less than the picture."""
        places = self.places[self.known]
        width, height = np.ptp(places, axis=0) if len(places) else (0, 0)
        return int(height), int(width)

    def parts(self, shape: Shape) -> list[NodeField]:
        """Return the field in upright boxes of ``shape`` that cover the known nodes and overlap by about half.

        An affine fit removes more from a small field than from a large one, but the same from parts of equal size.
        """
        first, last = self.places[self.known].min(0)[::-1], self.places[self.known].max(0)[::-1]
        starts = [
            np.linspace(low, max(high - box, low), 1 + max(math.ceil(2 * (high - low - box) / max(box, 1)), 0))
            for low, high, box in zip(first, last, shape, strict=True)
        ]
        boxes = [np.array([x, y]) for y in starts[0] for x in starts[1]]
        end = np.array(shape[::-1]) + 0.5
        inside = [((self.places >= low) & (self.places < low + end)).all(-1) for low in boxes]
        return [replace(self, known=self.known & part) for part in inside]

    @cached_property
    def rest(self) -> Points:
        """``(n, 2)`` px: displacements of the known nodes less their affine part; empty for fewer than four."""
        places, moved = self.places[self.known], self.moved[self.known]
        if len(places) <= _AFFINE:
            return np.empty((0, 2))
        design = np.column_stack([places - places.mean(0), np.ones(len(places))])
        return np.asarray(moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0])

    @property
    def deviation(self) -> float:
        """Root mean square distance of the nodes from their best regular fit, px."""
        return math.sqrt(float((self.rest**2).sum() / max(len(self.rest), 1)))

    @property
    def amplitude(self) -> float:
        """Unbiased root mean square distance from the best regular fit, px: the sum is divided by n - 3."""
        return math.sqrt(float((self.rest**2).sum() / max(len(self.rest) - _AFFINE, 1)))

    @cached_property
    def correlation_length(self) -> float | None:
        """Distance, px, at which displacements correlate by 1/e; None if they correlate by more everywhere."""
        sums, counts, length = self._lags()
        use = counts >= _LEAST_PAIRS * counts.max()
        ring = np.rint(length / (self.s / 4)).astype(np.intp)[use]
        weights = (counts[use], sums[use], (length * counts)[use])
        pairs, products, reach = (np.bincount(ring, each) for each in weights)
        held = pairs > 0
        distance, correlation = reach[held] / pairs[held], products[held] / pairs[held] / (products[0] / pairs[0])
        below = np.flatnonzero(correlation <= 1 / math.e)
        if not len(below):
            return None
        far = int(below[0])
        (a, b), (high, low) = distance[far - 1 : far + 1], correlation[far - 1 : far + 1]
        return float(a + (b - a) * (high - 1 / math.e) / (high - low))

    def _lags(self) -> tuple[NDArray[np.float64], ...]:
        """Return for each lag between nodes the sum of products, the number of pairs, and the length of the lag."""
        side = np.array(self.known.shape)
        table = np.zeros((3, *(2 * side)))
        at = np.argwhere(self.known).T
        table[0, *at], table[1:, *at] = 1, self.rest.T
        power = np.abs(np.fft.fft2(table)) ** 2
        counts, sums = np.rint(np.fft.ifft2(power[0]).real), np.fft.ifft2(power[1:].sum(0)).real
        steps = np.stack(np.meshgrid(*(np.fft.fftfreq(2 * n, 1 / (2 * n)) for n in side), indexing="ij"), -1)
        return sums, counts, np.hypot(*np.moveaxis(steps @ self.vectors, -1, 0))

    @cached_property
    def folded(self) -> float | None:
        """Share of folded cells (negative Jacobian at a corner); None if no whole cell was found."""
        corners = [np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]]
        whole = np.all([self.known[corner] for corner in corners], 0)
        if not whole.any():
            return None
        cells = np.stack([(self.places + self.moved)[corner][whole] for corner in corners], 1)
        one, other = np.roll(cells, -1, 1) - cells, np.roll(cells, 1, 1) - cells
        areas = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
        return float(((areas * np.sign(np.linalg.det(self.vectors))).min(1) <= 0).mean())
