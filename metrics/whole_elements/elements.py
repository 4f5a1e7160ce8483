"""Windows around elements (bricks, threads, cans): where they lie in the cell, and what they show, coarsely."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values
from nrbench.imaging.parabola import find_vertex
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import Shape

from ..ncc.periodic import HALVES
from ..residual_tiles.tile_alignment import found_middles
from ..verdict.measurements import Look

SAMPLES = 7
"""Samples of a window along each of the lattice's vectors."""
_DENSE = 8
Bends = tuple[Points, Points]
"""Matrices ``(k, 2, 2)`` and shifts ``(k, 2)`` px."""


@dataclass(frozen=True)
class Windows:
    """Windows of one cell at one place of the cell, found where the image shows them.

    Parameters
    ----------
    middles
        ``(n, 2)``: their middles (x, y) px.
    values
        ``(n, SAMPLES, SAMPLES, C)``: what they show, smoothed to the distance of the samples.
    """

    middles: Points
    values: Values


class Cutter:
    """Cuts windows out of one image.

    Parameters
    ----------
    image
        The image.
    lattice
        Where its tiles belong.
    """

    def __init__(self, image: Image, lattice: Lattice) -> None:
        self.lattice, self.shape = lattice.canonical(), (image.shape[0], image.shape[1])
        self._image = _smoothed(image, float(np.sqrt(lattice.area)) / SAMPLES)
        self._found: tuple[cKDTree, Points] | None = None

    @classmethod
    def following(cls, look: Look, noise: Points) -> Cutter:
        """Return what cuts windows where the judge found the tiles that they belong to."""
        cutter, whole = cls(look.image, look.tiles.lattice), look.tiles.centers[look.tiles.whole]
        cutter._found = cKDTree(whole), found_middles(look, noise) - whole
        return cutter

    def cut(self, place: Points, samples: int = SAMPLES, cells: float = 1.0) -> Windows:
        """Return the windows whose middles are at a place of the cell (cell coordinates), those that lie inside."""
        at = _points(self.lattice, self.shape, (float(place[0]), float(place[1])))
        middles = at + self._offsets(at)
        reach = np.abs(self._steps(samples, cells)).reshape(-1, 2).max(0)
        inside = (middles >= reach).all(1) & (middles <= np.array(self.shape[::-1]) - 1 - reach).all(1)
        return Windows(middles[inside], self.around(middles[inside], samples, cells))

    def around(self, middles: Points, samples: int = SAMPLES, cells: float = 1.0, bends: Bends | None = None) -> Values:
        """Return windows around middles (x, y) px, ``(n, samples, samples, C)``; beyond the image its border goes on.

        Parameters
        ----------
        middles
            ``(n, 2)``: (x, y) px.
        samples, cells
            Of a window, along each of the lattice's vectors.
        bends
            Matrices and shifts (px), taken in turn, by which what the windows show is bent; None: not at all.
        """
        steps = self._steps(samples, cells)
        if bends is None:
            xy = middles[:, np.newaxis, np.newaxis] + steps
        else:
            turn = np.arange(len(middles)) % len(bends[0])
            xy = np.einsum("ijk,nkl->nijl", steps, bends[0][turn]) + (middles + bends[1][turn])[:, None, None]
        return _bilinear(self._image, np.clip(xy, 0, np.array(self.shape[::-1]) - 1))

    def _steps(self, samples: int, cells: float) -> Points:
        """Return where the samples of a window lie from its middle, (x, y) px."""
        steps = ((np.arange(samples) + 0.5) / samples - 0.5) * cells
        u, v = np.meshgrid(steps, steps)
        return np.asarray(np.stack([u, v], -1) @ self.lattice.matrix)

    def _offsets(self, at: Points) -> Points:
        """Return how far (x, y) px from where they belong the nearest tiles were found."""
        if self._found is None:
            return np.zeros_like(at)
        tree, offsets = self._found
        return np.asarray(offsets[tree.query(at)[1]])


@lru_cache(maxsize=8)
def _points(lattice: Lattice, shape: Shape, place: Vector) -> Points:
    """Return the points at a place of the cell; kept, since draws of one shape share them."""
    origin = lattice.from_cell(place)
    return Lattice(lattice.t1, lattice.t2, (float(origin[0]), float(origin[1]))).points(shape)


def departures(values: Values) -> NDArray[np.float64]:
    """Return windows ``(n, SAMPLES, SAMPLES, C)`` less their mean, ``(n, p)``."""
    flat = values.reshape(len(values), -1).astype(np.float64)
    return flat - flat.mean(0) if len(flat) else flat


def slope(mean: Values, lattice: Lattice) -> NDArray[np.float64]:
    """Return the squared gradient per px of a mean window ``(SAMPLES, SAMPLES, C)``, which wraps round."""
    step = SAMPLES / 2
    along, across = ((np.roll(mean, -1, axis) - np.roll(mean, 1, axis)) * step for axis in (1, 0))
    gradient = np.stack([along, across], -1).astype(np.float64) @ np.linalg.inv(lattice.matrix).T
    return np.asarray((gradient**2).sum(-1))


def places(cutters: list[Cutter]) -> Points:
    """Return the places (cell coordinates) of windows around elements, ``(4, 2)``; the first is the anchor.

    The anchor is the place around which most of a window varies with its middle: that of a whole element. Where the
    lattice's origin lies in a tile is chance, and does not matter. The other places are half a cell away, where the
    parts that the first windows leave out are seen whole.
    """
    explained = np.sum([_explained(cutter.cut(np.zeros(2), 2 * _DENSE, 2.0).values) for cutter in cutters], 0)
    row, column = np.unravel_index(int(np.argmax(explained)), explained.shape)
    anchor = (np.array([column, row]) + 0.5 + _peak(explained, int(row), int(column))) / _DENSE - 0.5
    return np.asarray(anchor + np.array(HALVES))


def _explained(values: Values) -> NDArray[np.float64]:
    """Return, for each place of the cell, how much of the window around it goes with its middle.

    ``values`` are windows two cells wide. Both ends of the cell are included once.
    """
    half, centered = _DENSE // 2, values - values.mean(0)
    total = np.zeros((_DENSE, _DENSE))
    for channel in np.moveaxis(centered.astype(np.float64), -1, 0):
        covariance = np.tensordot(channel, channel, (0, 0)) / max(len(channel), 1)
        for row in range(_DENSE):
            for column in range(_DENSE):
                y, x = row + half, column + half
                around = covariance[y, x, y - half : y + half + 1, x - half : x + half + 1]
                total[row, column] += (around**2).sum() / (covariance[y, x, y, x] + 1e-6)
    return total


def _peak(surface: NDArray[np.float64], row: int, column: int) -> Points:
    """Return how far (x, y) the top of the parabola through the neighbors is from the highest sample, at most half."""
    rows, columns = surface.shape
    across = surface[[(row - 1) % rows, row, (row + 1) % rows], column]
    along = surface[row, [(column - 1) % columns, column, (column + 1) % columns]]
    return np.array([find_vertex(*along)[0], find_vertex(*across)[0]])


def _smoothed(image: Image, spacing: float) -> Image:
    size = max(round(spacing), 1)
    return np.asarray(ndimage.uniform_filter(image, (size, size, 0), mode="reflect"), np.float32)


def _bilinear(image: Image, xy: Points) -> Values:
    """Return the image at real-valued places ``(..., 2)`` inside it."""
    height, width, channels = image.shape
    low = np.minimum(np.floor(xy).astype(np.intp), (width - 2, height - 2))
    x, y = np.moveaxis((xy - low).astype(np.float32)[..., np.newaxis], -2, 0)
    flat, at = image.reshape(-1, channels), low[..., 1] * width + low[..., 0]
    top = flat[at] * (1 - x) + flat[at + 1] * x
    return np.asarray(top * (1 - y) + (flat[at + width] * (1 - x) + flat[at + width + 1] * x) * y)
