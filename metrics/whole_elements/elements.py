"""Cut windows around elements (bricks, threads, cans), and find where elements lie in the cell."""

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
from ..residual_tiles.tiles import find_middles
from ..verdict.measurements import Measurements

SAMPLES = 7
"""Samples of a window along each of the lattice's vectors."""
_DENSE = 8
"""Places tried along each of the lattice's vectors."""
Bends = tuple[Points, Points]
"""Matrices ``(k, 2, 2)`` and shifts ``(k, 2)`` px."""


@dataclass(frozen=True)
class Windows:
    """Windows of one cell, all at the same place of the cell.

    Parameters
    ----------
    middles
        ``(n, 2)``: their middles (x, y) px.
    values
        ``(n, SAMPLES, SAMPLES, C)``: their pixels, smoothed to the distance of the samples.
    """

    middles: Points
    values: Values

    def take(self, part: slice | NDArray[np.bool_]) -> Windows:
        """Return some of the windows."""
        return Windows(self.middles[part], self.values[part])


class Cutter:
    """Cuts windows out of an image.

    Parameters
    ----------
    image
        The image.
    lattice
        The lattice of its tiles.
    """

    def __init__(self, image: Image, lattice: Lattice) -> None:
        self.lattice, self.shape = lattice.canonical(), (image.shape[0], image.shape[1])
        size = max(round(float(np.sqrt(lattice.area)) / SAMPLES), 1)
        self._image = np.asarray(ndimage.uniform_filter(image, (size, size, 0), mode="reflect"), np.float32)
        self._tracked: tuple[cKDTree, Points] | None = None

    @classmethod
    def from_measurements(cls, measurements: Measurements, noise: Points) -> Cutter:
        """Return a cutter that follows the displacements of an image's tiles.

        Parameters
        ----------
        measurements
            The tiles of an image.
        noise
            2 x 2: covariance of tile offsets in images without displacements, px^2.
        """
        tiles = measurements.tiles
        cutter, whole = cls(measurements.image, tiles.lattice), tiles.centers[tiles.whole]
        cutter._tracked = cKDTree(whole), find_middles(measurements, noise) - whole
        return cutter

    def cut(self, place: Points, samples: int = SAMPLES, cells: float = 1.0) -> Windows:
        """Return all windows inside the image whose middles are at a place of the cell (cell coordinates)."""
        points = _points(self.lattice, self.shape, (float(place[0]), float(place[1])))
        offsets = np.zeros_like(points)
        if self._tracked is not None:
            tree, displacements = self._tracked
            offsets = displacements[tree.query(points)[1]]
        middles = points + offsets
        reach = np.abs(self._steps(samples, cells)).reshape(-1, 2).max(0)
        inside = (middles >= reach).all(1) & (middles <= np.array(self.shape[::-1]) - 1 - reach).all(1)
        return Windows(middles[inside], self.cut_around(middles[inside], samples, cells))

    def cut_around(
        self, middles: Points, samples: int = SAMPLES, cells: float = 1.0, bends: Bends | None = None
    ) -> Values:
        """Return windows around middles, ``(n, samples, samples, C)``; beyond the image its border is repeated.

        Parameters
        ----------
        middles
            ``(n, 2)``: (x, y) px.
        samples, cells
            Samples and size of a window along each of the lattice's vectors.
        bends
            Affine maps that bend the content of the windows, one for each window in turn; None: no bending.
        """
        steps = self._steps(samples, cells)
        if bends is None:
            xy = middles[:, np.newaxis, np.newaxis] + steps
        else:
            turn = np.arange(len(middles)) % len(bends[0])
            xy = np.einsum("ijk,nkl->nijl", steps, bends[0][turn]) + (middles + bends[1][turn])[:, None, None]
        return _bilinear(self._image, np.clip(xy, 0, np.array(self.shape[::-1]) - 1))

    def _steps(self, samples: int, cells: float) -> Points:
        """Return the samples' places (x, y) px relative to the middle of a window."""
        steps = ((np.arange(samples) + 0.5) / samples - 0.5) * cells
        u, v = np.meshgrid(steps, steps)
        return np.asarray(np.stack([u, v], -1) @ self.lattice.matrix)


@lru_cache(maxsize=8)
def _points(lattice: Lattice, shape: Shape, place: Vector) -> Points:
    """Return the points at a place of the cell; cached, because draws of one shape share them."""
    origin = lattice.from_cell(place)
    return Lattice(lattice.t1, lattice.t2, (float(origin[0]), float(origin[1]))).points(shape)


def subtract_mean(values: Values) -> NDArray[np.float64]:
    """Return windows ``(n, SAMPLES, SAMPLES, C)`` less their mean, ``(n, p)``."""
    flat = values.reshape(len(values), -1).astype(np.float64)
    return flat - flat.mean(0) if len(flat) else flat


def find_element_places(cutters: list[Cutter]) -> Points:
    """Return four places of the cell (cell coordinates) for windows around elements; the first is the anchor.

    The anchor is the place around which most of a window covaries with its middle: the middle of a whole element. It
    does not depend on the lattice's origin. The other places are half a cell away. Their windows show whole the parts
    that the first windows cut.
    """
    explained = np.sum([_explained_energy(cutter.cut(np.zeros(2), 2 * _DENSE, 2.0).values) for cutter in cutters], 0)
    row, column = (int(index) for index in np.unravel_index(int(np.argmax(explained)), explained.shape))
    rows, columns = explained.shape
    across = explained[[(row - 1) % rows, row, (row + 1) % rows], column]
    along = explained[row, [(column - 1) % columns, column, (column + 1) % columns]]
    vertex = np.array([find_vertex(*along)[0], find_vertex(*across)[0]])
    anchor = (np.array([column, row]) + 0.5 + vertex) / _DENSE - 0.5
    return np.asarray(anchor + np.array(HALVES))


def _explained_energy(values: Values) -> NDArray[np.float64]:
    """Return for each place of the cell the energy of the window around it that its middle explains.

    ``values`` are windows two cells wide. The windows include both ends of the cell.
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


def _bilinear(image: Image, xy: Points) -> Values:
    """Return the image at real-valued places ``(..., 2)`` inside it."""
    height, width, channels = image.shape
    low = np.minimum(np.floor(xy).astype(np.intp), (width - 2, height - 2))
    x, y = np.moveaxis((xy - low).astype(np.float32)[..., np.newaxis], -2, 0)
    flat, at = image.reshape(-1, channels), low[..., 1] * width + low[..., 0]
    top = flat[at] * (1 - x) + flat[at + 1] * x
    return np.asarray(top * (1 - y) + (flat[at + width] * (1 - x) + flat[at + width + 1] * x) * y)
