"""Where tiles are cut, and how much their edges count, so that what is left of them is no misalignment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice, Points

from ..ncc.periodic import TOLERANCE
from ..verdict.measurements import Look

_ALIGNMENT = 0.4
"""Pixels by which an aligned tile may still be off: what edges then differ by is not held against it."""
_LEAST_NOISE = 0.03
_CHANCE = 1.5
"""Covariances of right images' offsets exceed those of the references by up to this factor by chance."""


def aligned_middles(look: Look, references: tuple[Look, ...]) -> Points:
    """Return the middles (x, y) px of the whole tiles, moved only as far as the references do not explain, ``(n, 2)``.

    As :func:`found_middles`, but the offset of the window around a tile, too, counts only for what it exceeds the noise
    of the references' offsets. So tiles of a right image are cut exactly on the lattice, as those of fresh draws are.
    """
    noise = [np.concatenate(parts) for parts in zip(*map(_offsets, references), strict=True)]
    moved = look.tiles.centers[look.tiles.whole]
    for own, right in zip(_offsets(look), noise, strict=True):
        moved = moved + own @ _shrinkage(_covariance(own), _covariance(right), _CHANCE).T
    return moved


def found_middles(look: Look, noise: Points) -> Points:
    """Return the middles (x, y) px of the whole tiles where they were found, ``(n, 2)``.

    A tile's place is that of the window around it, plus as much of its own offset from there as exceeds the noise of
    such offsets: Wiener's filter, with the signal's covariance as what is left of the offsets' less the noise's.
    """
    whole = look.tiles.whole
    around, own = _offsets(look)
    keep = _shrinkage(_covariance(own), noise)
    return np.asarray(look.tiles.centers[whole] + around + own @ keep.T)


def offset_noise(looks: tuple[Look, ...]) -> Points:
    """Return the covariance in px^2 of tiles' own offsets in images whose tiles are where they should be."""
    return _covariance(np.concatenate([_offsets(look)[1] for look in looks]))


def _offsets(look: Look) -> tuple[Points, Points]:
    """Return for each whole tile the offset of the window around it, where that is in place, and its own from there."""
    tiles, placement = look.tiles, look.placement
    nearest = placement.nearest(tiles.centers[tiles.whole])
    inside = placement.misplacement[nearest] <= TOLERANCE
    around = placement.offsets[nearest] * inside[:, np.newaxis]
    return around, tiles.offsets[tiles.whole] - around


def _covariance(offsets: Points) -> Points:
    return offsets.T @ offsets / max(len(offsets), 1) + _LEAST_NOISE**2 * np.eye(2)


def _shrinkage(total: Points, noise: Points, chance: float = 1.0) -> Points:
    """Return the matrix that keeps of an offset what exceeds the noise, where it does so by more than ``chance``."""
    values, vectors = np.linalg.eigh(noise)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    back = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(back @ total @ back)
    return np.asarray(root @ axes @ np.diag(np.where(ratio > chance, 1 - 1 / ratio, 0.0)) @ axes.T @ back)


def interior_weights(mean: Values, energy: float, lattice: Lattice) -> NDArray[np.float32]:
    """Return weights ``(V, U)`` that spare edges: 1 where the mean tile is flat.

    An edge that is off by the remaining misalignment differs by gradient times that; where this exceeds the departures
    themselves the pixel counts for less.

    Parameters
    ----------
    mean
        ``(V, U, C)``: the mean tile.
    energy
        Mean squared departure from it.
    lattice
        Its cell is the tile.
    """
    steep = ndimage.maximum_filter(_slope(mean, lattice), 3, mode="wrap")
    return np.asarray(1 / (1 + steep * _ALIGNMENT**2 / max(energy, 1e-9)), np.float32)


def _slope(tile: Values, lattice: Lattice) -> Values:
    """Return the squared gradient of a tile per px, mean over channels."""
    rows, columns = tile.shape[:2]
    along = (np.roll(tile, -1, 1) - np.roll(tile, 1, 1)) * columns / 2
    across = (np.roll(tile, -1, 0) - np.roll(tile, 1, 0)) * rows / 2
    gradient = np.stack([along, across], -1) @ np.linalg.inv(lattice.matrix).T
    return np.asarray((gradient**2).sum(-1).mean(-1), np.float32)
