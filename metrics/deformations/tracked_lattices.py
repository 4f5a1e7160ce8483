"""Displacement fields of sample, output and fresh draws, measured by tracking their lattice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again, Observation, Shape
from nrbench.tracking.tracker import MeanTile, Track, track_tiles

from ..judgment.examination import examine
from ..judgment.texture_reference import FIRST_DRAW

LEAST_POINTS = 9
"""Lattice points that an image must hold for its lattice to be measured."""
LEAST_CORRELATION = 0.5
"""Correlation with the mean tile, in its colors, below which a tile counts as not found."""
LEAST_TRACKED = 0.5
"""Share of tiles that must be found."""
_LARGEST = 320
"""Largest side of a fresh draw that is tracked, px."""
_AFFINE = 3
"""Points whose displacements an affine fit explains completely."""
_LEAST_PART = 6
"""Lattice points that a part of an image must hold."""
_LEAST_PAIRS = 0.05
"""Pairs of points at a lag, relative to the most frequent lag, below which the lag is ignored."""


@dataclass(frozen=True)
class Tracks:
    """One lattice, tracked through sample and output.

    Parameters
    ----------
    sample, output
        The tracks.
    tile
        The mean tile that was tracked in the output.
    again
        Fresh draws; None if there are none.
    """

    sample: Track
    output: Track
    tile: MeanTile
    again: Again | None

    @cached_property
    def fresh(self) -> tuple[Track, ...]:
        """The track of a fresh draw of the output's shape, at most 320 px a side; () without fresh draws."""
        height, width = (min(side, _LARGEST) for side in self.output.image.shape[:2])
        draw = self.again((height, width), FIRST_DRAW) if self.again else None
        return () if draw is None else (track_tiles(quantize(draw.image), self.output.lattice, self.tile),)

    @property
    def obstacle(self) -> str:
        """Why nothing can be measured; empty if something can."""
        for name, track in (("sample", self.sample), ("output", self.output)):
            number, share = len(track.numbers), track.tracked_share(LEAST_CORRELATION)
            if number < LEAST_POINTS:
                return f"not measured: the {name} holds {number} whole tiles, at least {LEAST_POINTS} are needed"
            if share < LEAST_TRACKED:
                return f"not measured: the tile was found at only {share:.0%} of the places in the {name}"
        return ""


def track_images(observation: Observation) -> Tracks | str:
    """Return the tracks of sample and output, or the reason why there are none.

    The mean tile that is tracked is that of the ideal image if the truth has one, else that of the sample. Call it
    through :meth:`~nrbench.plugins.forms.Observation.shared`, so that metrics of one observation share the tracks.
    """
    known, truth = examine(observation).known_lattice, observation.truth
    if known.lattice is None:
        return known.reason
    # The same lattice in the truth's own basis: the basis decides the last bits of a track.
    lattice = (truth.lattice if truth is not None and truth.lattice is not None else known.lattice).reduced()
    ideal = truth.ideal if truth is not None else None
    first = MeanTile.of(observation.sample if ideal is None else ideal, lattice)
    if first.flat:
        return "not applicable: the mean tile is flat"
    sample = track_tiles(observation.sample, lattice, first)
    tile = sample.tile.unweighted() if ideal is None else first
    return Tracks(sample, track_tiles(observation.output, lattice, tile), tile, observation.again)


@dataclass(frozen=True)
class DeformationField:
    """Places of the lattice points in an image.

    Parameters
    ----------
    lattice
        The undisturbed lattice.
    numbers
        ``(n, 2)``: cell coordinates of the points, integers.
    places
        ``(n, 2)``: places of the points in the image, (x, y) px.
    """

    lattice: Lattice
    numbers: NDArray[np.int64]
    places: Points

    @classmethod
    def of(cls, track: Track) -> DeformationField:
        """Return the field of an image's whole tiles."""
        return cls(track.lattice, track.numbers, track.locate(track.numbers))

    def parts(self, image: Shape, shape: Shape) -> list[DeformationField]:
        """Return the field in upright boxes of ``shape`` that cover an image and overlap by about half.

        An affine fit removes more from a small image than from a large one, but the same from parts of equal size.
        Parts with fewer than 6 points, or with points on one line, are left out.
        """
        starts = [
            np.linspace(0, n - box, 1 + math.ceil(2 * (n - box) / box)) for n, box in zip(image, shape, strict=True)
        ]
        fields = []
        for y in starts[0]:
            for x in starts[1]:
                low = np.array([x, y]) - 0.5
                inside = ((self.places >= low) & (self.places < low + shape[::-1])).all(1)
                numbers = self.numbers[inside]
                if len(numbers) >= _LEAST_PART and np.linalg.matrix_rank(numbers - numbers[0]) == 2:
                    fields.append(DeformationField(self.lattice, numbers, self.places[inside]))
        return fields

    @cached_property
    def rest(self) -> Points:
        """``(n, 2)`` px: places less their best regular fit, an affine image of the numbers by least squares."""
        design = np.column_stack([self.numbers, np.ones(len(self.numbers))])
        return np.asarray(self.places - design @ np.linalg.lstsq(design, self.places, rcond=None)[0])

    @property
    def deviation(self) -> float:
        """Root mean square distance of the points from their best regular fit, px."""
        return math.sqrt(float((self.rest**2).sum() / len(self.rest)))

    @property
    def amplitude(self) -> float:
        """Unbiased root mean square distance from the best regular fit, px: the sum is divided by n - 3."""
        return math.sqrt(float((self.rest**2).sum() / (len(self.rest) - _AFFINE)))

    @cached_property
    def correlation_length(self) -> float | None:
        """Distance, px, at which displacements correlate by 1/e; None if they correlate by more everywhere."""
        distance, correlation = self._correlogram()
        below = np.flatnonzero(correlation <= 1 / math.e)
        if not len(below):
            return None
        far = int(below[0])
        (a, b), (high, low) = distance[far - 1 : far + 1], correlation[far - 1 : far + 1]
        return float(a + (b - a) * (high - 1 / math.e) / (high - low))

    def _correlogram(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances, px, from 0 on, and the mean correlation of displacements at each."""
        sums, counts, length = self._lags()
        use = counts >= _LEAST_PAIRS * counts.max()
        ring = np.rint(length / (self.lattice.s / 2)).astype(np.intp)[use]
        pairs, products, reach = (
            np.bincount(ring, weights) for weights in (counts[use], sums[use], (length * counts)[use])
        )
        held = pairs > 0
        return reach[held] / pairs[held], products[held] / pairs[held] / (products[0] / pairs[0])

    def _lags(self) -> tuple[NDArray[np.float64], ...]:
        """Return for each lag between points the sum of products, the number of pairs, and the length of the lag."""
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
        """Share of folded cells (negative Jacobian at a corner); None if no whole cell was tracked."""
        index = {(int(u), int(v)): n for n, (u, v) in enumerate(self.numbers)}
        corners = [
            [index[u, v], index[u + 1, v], index[u + 1, v + 1], index[u, v + 1]]
            for u, v in index
            if (u + 1, v) in index and (u, v + 1) in index and (u + 1, v + 1) in index
        ]
        if not corners:
            return None
        cells = self.places[np.array(corners)]
        one, other = np.roll(cells, -1, 1) - cells, np.roll(cells, 1, 1) - cells
        areas = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
        return float(((areas * np.sign(np.linalg.det(self.lattice.matrix))).min(1) <= 0).mean())
