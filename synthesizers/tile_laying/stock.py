"""The tiles that a sample holds, and the choice among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points

from ..sampling.subpixel import Fractions
from .choice_kernels import best_move, nearest_places
from .frame import Frame
from .tile_kernels import absolute_differences

Difference = Literal["mean", "sum"]
MOST = 48
"""So many tiles of a set, evenly spread, are compared with one another for the threshold."""


class Overlap(NamedTuple):
    """What stands under a tile.

    Parameters
    ----------
    values
        ``uint8 (n, C)``, one row a pixel.
    runs
        ``(r, 3)``: unbroken pieces of the values, laid flat: first one, how many, and where the tile's own first is,
        from the tile's middle on.
    """

    values: NDArray[np.uint8]
    runs: NDArray[np.int64]

    @classmethod
    def of(cls, values: NDArray[np.uint8], steps: NDArray[np.int64]) -> Overlap:
        """Return the overlap of some pixels, ``(n, C)``, that the tile's stand ``steps`` ``(n,)`` from its middle."""
        channels = values.shape[1]
        first = np.flatnonzero(np.diff(steps, prepend=steps[:1] - 2 * channels) != channels)
        lengths = np.diff(first, append=len(steps))
        return cls(values, np.stack([first * channels, lengths * channels, steps[first]], -1))


class Cuts(NamedTuple):
    """Tiles cut around whole pixels: copy of the source ``(n,)``, pixel (x, y) ``(n, 2)``, true middle ``(n, 2)``."""

    copy: NDArray[np.int64]
    pixel: NDArray[np.int64]
    middle: Points

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Cuts:
        """Return some of them."""
        return Cuts(self.copy[chosen], self.pixel[chosen], self.middle[chosen])


@dataclass(frozen=True, eq=False)
class Stock:
    """The maximum tiles of a sample that are complete.

    Parameters
    ----------
    frame
        Their shape.
    source
        The copies of the sample, upright and mirrored ones, that tiles are cut from.
    lattices
        The lattice of each picture of the source, anchored at a tile's middle.
    """

    frame: Frame
    source: Fractions
    lattices: tuple[Lattice, ...]

    def middles(self, i: int, j: int) -> tuple[NDArray[np.int64], Points]:
        """Return picture and middle (x, y) of every complete tile like the one at row step i and column step j.

        With i and j even that is the set T; see :meth:`~nrbench.synthesizers.tile_laying.frame.Frame.distinct` for the others.
        """
        offset = np.array([i % 2, j % 2]) @ self.frame.steps
        found = [complete(lattice.shifted(tuple(offset)), self.frame, self.source.shape) for lattice in self.lattices]
        pictures = np.repeat(np.arange(len(found)), [len(points) for points in found])
        return pictures, np.concatenate(found)

    def cut(self, pictures: NDArray[np.int64], middles: Points) -> Cuts:
        """Return the tiles around the nearest places that the copies have, those that lie wholly inside.

        Where rounding leaves none inside, all of them, moved inwards by less than a pixel.
        """
        height, width, _ = self.source.shape
        found = nearest_places(np.ascontiguousarray(middles), self.source.parts, self.frame.box, height, width)
        copy, pixel, inside = found[:, 0], found[:, 1:3], found[:, 3] == 1
        if not inside.any():
            (left, top), (right, bottom) = self.frame.box
            pixel = np.clip(pixel, (-left, -top), (width - 1 - right, height - 1 - bottom))
            copy, inside = np.zeros_like(copy), ~inside
        return Cuts(copy + pictures * self.source.parts**2, pixel, middles).take(inside)

    def differences(self, overlap: Overlap, cuts: Cuts) -> NDArray[np.int64]:
        """Return the sum of absolute differences over the overlap, channels added, of each tile (step 3)."""
        return absolute_differences(overlap.values.ravel(), overlap.runs, self.source.values, self._flat(cuts))

    def registered(self, overlap: Overlap, cut: Cuts, radius: float) -> Cuts:
        """Return the one tile moved, by at most ``radius`` px from its true middle, to where it correlates best.

        Normalized cross-correlation over the overlap, each channel's mean taken out (step 4).
        """
        source, (x, y) = self.source, cut.pixel[0]
        picture, part = divmod(int(cut.copy[0]), source.parts**2)
        here = np.array([x + part % source.parts / source.parts, y + part // source.parts / source.parts])
        values, first = overlap.values.ravel(), picture * source.parts**2
        found = best_move(
            values,
            overlap.runs,
            source.values,
            *source.shape,
            source.parts,
            here,
            cut.middle[0],
            radius,
            self.frame.box,
            first,
        )
        return Cuts(found[:1], found[np.newaxis, 1:], cut.middle)

    def _flat(self, cuts: Cuts) -> NDArray[np.int64]:
        _, width, channels = self.source.shape
        flat = np.empty((len(cuts.copy), 2), np.int64)
        flat[:, 0], flat[:, 1] = cuts.copy, (cuts.pixel[:, 1] * width + cuts.pixel[:, 0]) * channels
        return flat

    def threshold(self, quantile: float, difference: Difference) -> float:
        """Return the least threshold at which each tile of the sample has candidates among the others.

        Two tiles of a set (upright and unmoved) are compared over what a tile overlaps with when all before it are
        laid: its left and its upper half. For each tile the quantile of its differences from the others is taken; of
        these, the largest. With one quantile over all pairs, only its own continuation would follow the oddest tile,
        and the sample be copied on and on. Infinite where no set holds two.
        """
        steps, found = self._usual_overlap(), []
        for number in self.frame.distinct(self.lattices[0]):
            pictures, middles = self.middles(*number)
            cuts = self.cut(pictures[pictures == 0], middles[pictures == 0])
            cuts = cuts.take(np.unique(np.linspace(0, len(cuts.copy) - 1, MOST).astype(np.int64)))
            for n, (copy, first) in enumerate(self._flat(cuts)):
                values = self.source.values[copy][first + steps[:, np.newaxis] + np.arange(self.source.shape[2])]
                others = np.delete(self.differences(Overlap.of(values, steps), cuts), n)
                found += [float(np.quantile(others, quantile))] if len(others) else []
        return max(found, default=np.inf) / (len(steps) if difference == "mean" else 1)

    def _usual_overlap(self) -> NDArray[np.int64]:
        """Return the steps, from a tile's middle, of the pixels in its left and its upper half."""
        _, width, channels = self.source.shape
        rows, columns = self.frame.grid
        x, y, row, column, _ = self.frame.pixels.T
        covered = (row < rows / 2) | (column < columns / 2)
        return np.asarray((y * width + x)[covered] * channels)


def complete(lattice: Lattice, frame: Frame, shape: tuple[int, ...]) -> Points:
    """Return the lattice points (x, y) around which a tile lies inside the pixels' areas of an image of ``shape``."""
    low, high = room(frame, shape)
    points = lattice.points((shape[0], shape[1]))
    return np.asarray(points[((points >= low) & (points <= high)).all(1)])


def room(frame: Frame, shape: tuple[int, ...]) -> tuple[Points, Points]:
    """Return the least and the greatest middle (x, y) of a tile inside the pixels' areas of an image of ``shape``."""
    return frame.reach - 0.5 - 1e-6, np.array([shape[1], shape[0]]) - 0.5 + 1e-6 - frame.reach
