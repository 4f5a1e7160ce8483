"""Where a tile set's lattice is anchored: what the paper places by hand."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import fold
from nrbench.lattice.geometry import Lattice, Points

from .frame import Frame
from .stock import room

Array = NDArray[np.float64]
By = Literal["quiet", "elements"]
ROOM: Final[dict[By, float]] = {"quiet": 0.8, "elements": 0.5}
"""An anchor leaves each set at least this share of the tiles that the best one leaves. A tile that is anchored some px
aside from an element cuts it: half the tiles are better than all of them cut."""
MOST: Final = 100
"""So many anchors, evenly spread from the cheapest to the dearest, are tried."""


def anchored(sample: Image, lattice: Lattice, frame: Frame, by: By) -> Lattice:
    """Return the lattice with its origin where a tile is best anchored (section 3.1, stage 1).

    Of the anchors that leave enough complete tiles, the cheapest one.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        Its lattice.
    frame
        The tiles' shape.
    by
        What an anchor costs: see :func:`border_costs` (``"quiet"``) and :func:`element_costs` (``"elements"``).
    """
    costs, anchors = border_costs(sample, lattice, frame) if by == "quiet" else element_costs(sample, lattice)
    order = np.argsort(costs, kind="stable")
    order = order[np.unique(np.linspace(0, len(order) - 1, MOST).astype(np.int64))]
    offsets = np.array(frame.distinct(lattice)) @ frame.steps
    counts = np.min([_counts(lattice, anchors[order] + offset, frame, sample) for offset in offsets], 0)
    return Lattice.from_basis(lattice.matrix, anchors[order[np.argmax(counts >= ROOM[by] * counts.max())]])


def border_costs(sample: Image, lattice: Lattice, frame: Frame) -> tuple[Array, Points]:
    """Return the mean gradient energy along the tiles' borders for each anchor, ``(n,)``, and the anchors.

    The borders are those of the minimum tiles of every set. The energy of every anchor is one circular correlation of
    the mean tile's gradients with the borders: O(n log n) for a tile of n px.
    """
    lattice = lattice.reduced()
    tile = fold(sample, lattice).values.astype(np.float64)
    rough = np.asarray(sum(((np.roll(tile, -1, axis) - tile) ** 2).sum(-1) for axis in (0, 1)))
    rows, columns = rough.shape
    uv = _borders(frame, 4 * max(rows, columns)) @ np.linalg.inv(lattice.matrix)
    at = np.floor(uv * (columns, rows) + 0.5).astype(np.int64) % (columns, rows)
    stamp = np.bincount(at[:, 1] * columns + at[:, 0], minlength=rough.size).reshape(rough.shape)
    costs = fft.irfft2(fft.rfft2(rough) * np.conj(fft.rfft2(stamp / len(uv))), rough.shape)
    return costs.ravel(), _anchors(rough.shape, lattice)


def element_costs(sample: Image, lattice: Lattice) -> tuple[Array, Points]:
    """Return how little the tiles differ around each anchor, ``(n,)``, and the anchors.

    Tiles differ where their variance is over half of its mean: a few tiles say where bricks are, but not which part of
    a brick varies most. The share of such places around an anchor counts, weighted by a Gaussian of s / 2 on the torus
    that the cell is, which is wide enough to feel both ends of a long brick: the middle of a brick is cheap, a joint is
    dear. Tiles of T then show elements whole, and seams can pass along the joints, where tiles differ least.
    """
    lattice = lattice.reduced()
    mean, square = (fold(image, lattice).values.astype(np.float64) for image in (sample, sample**2))
    variance = (square - mean**2).sum(-1)
    rows, columns = variance.shape
    numbers = np.meshgrid(fft.rfftfreq(columns, 1 / columns), fft.fftfreq(rows, 1 / rows))
    waves = np.stack(numbers, -1) @ np.linalg.inv(lattice.matrix).T
    smooth = np.exp(-((math.pi * lattice.s) ** 2) / 2 * (waves**2).sum(-1))
    spectrum = fft.rfft2((variance > variance.mean() / 2).astype(np.float64))
    return -fft.irfft2(spectrum * smooth, variance.shape).ravel(), _anchors(variance.shape, lattice)


def _anchors(shape: tuple[int, ...], lattice: Lattice) -> Points:
    """Return the places of the pixels of a cell's tile, ``(n, 2)``."""
    v, u = np.indices(shape)
    return lattice.from_cell(np.stack([u / shape[1], v / shape[0]], -1)).reshape(-1, 2)


def _borders(frame: Frame, count: int) -> Points:
    """Return points all along the borders of a minimum tile around (0, 0) and of the next ones in the row and below."""
    along, half = np.linspace(-0.5, 0.5, count, endpoint=False), np.full(count, 0.5)
    sides = np.concatenate([np.stack([along, half], -1), np.stack([half, along], -1)])
    border = np.concatenate([sides, -sides]) @ frame.core
    return np.concatenate([border + np.array(shift) @ frame.steps for shift in np.ndindex(2, 2)])


def _counts(lattice: Lattice, anchors: Points, frame: Frame, sample: Image) -> NDArray[np.int64]:
    """Return how many complete tiles the sample holds around the points of the lattice at each anchor, ``(n,)``."""
    low, high = room(frame, sample.shape)
    first, last = low - anchors.max(0), high - anchors.min(0)
    steps = Lattice(lattice.t1, lattice.t2).cell_numbers(
        (float(first[0]), float(first[1])), (float(last[0]), float(last[1]))
    )
    places = anchors[:, np.newaxis] + steps @ lattice.matrix
    return np.asarray(((places >= low) & (places <= high)).all(-1).sum(1))
