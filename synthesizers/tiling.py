"""A baseline: one tile, repeated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Task

from .baselines.lattice_baseline import OFFSET, LatticeBaseline, half_extent, whole_cell_centers
from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import pixel_grid


@leaves_out
@dataclass(frozen=True)
class Tiling(LatticeBaseline):
    """One tile of the sample, repeated on the lattice: keeps the lattice, loses all randomness.

    The tile is a Voronoi cell of the lattice, the shape with short seams, and lies entirely within the sample. Every
    output pixel shows the equivalent point of that cell, so the output continues the sample's phase and nothing drifts.
    Between pixels a spline of order 5 interpolates; where the lattice vectors are whole pixels, every pixel is a copy.
    Seams are not blended.

    On perfectly regular textures it is a valid method rather than a baseline. Without a given lattice it finds one by
    ``gncc``.

    Parameters
    ----------
    tile
        ``"typical"``: the tile nearest to the mean of all tiles (least mean squared difference), the best single tile;
        ``"random"``: drawn uniformly.
    """

    tile: Literal["typical", "random"] = "typical"

    version: ClassVar[str] = "2"

    def find_tiles(self, task: Task, lattice: Lattice) -> tuple[Callable[[Points], Points], str]:
        """Return the point of the tile that each output pixel shows."""
        centers = whole_cell_centers(lattice, task.sample.shape)
        typical = self.tile == "typical"
        middle = (_typical_center(task.sample, lattice, centers) if typical else task.rng.choice(centers)) + OFFSET
        return lambda pixels: middle + lattice.wrap(pixels - middle), ""


def _typical_center(sample: Image, lattice: Lattice, centers: Points) -> Points:
    """Return the center of the tile that differs least from the mean tile; the first of equal ones."""
    mean = fold(sample, lattice.reduced()).unfold(sample.shape[:2])
    departure = ((sample - mean) ** 2).sum(-1, dtype=np.float64)
    x, y = np.ceil(half_extent(lattice)).astype(int)
    around = pixel_grid(2 * x + 1, 2 * y + 1, -x, -y) - np.array(OFFSET)
    inside = np.abs(lattice.wrap(around) - around).max(-1) < 1e-6
    total = _correlate(departure, inside.astype(np.float64))
    column, row = centers.astype(int).T
    return np.asarray(centers[np.argmin(np.round(total[row, column], 6))])


def _correlate(values: NDArray[np.float64], window: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of the values in a window of odd sides around each place; values outside count as 0.

    ``scipy.signal.fftconvolve`` gives the same values, but its import takes longer than the synthesis.
    """
    full = np.add(values.shape, window.shape) - 1
    fast = [scipy.fft.next_fast_len(int(side), real=True) for side in full]
    spectrum = scipy.fft.rfft2(values, fast) * scipy.fft.rfft2(window[::-1, ::-1], fast)
    top, left = (full - values.shape) // 2
    return np.asarray(scipy.fft.irfft2(spectrum, fast)[top:, left:][: values.shape[0], : values.shape[1]])
