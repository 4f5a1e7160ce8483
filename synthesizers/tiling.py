"""A baseline: one tile, repeated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Kind, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .baselines.voronoi_cell import OFFSET, half_extent, whole_cell_centers
from .sampling.equal_places import EqualPlaces, pixel_grid
from .sampling.patches import Patches, resample, round_places

_MARGIN = 8
"""px of the mean image around its tile, so that splines in the tile do not depend on the image's end."""


@dataclass(frozen=True)
class Tiling:
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
        ``"random"``: drawn uniformly; ``"mean"``: the mean of all tiles, each shifted by the real-valued lattice and
        interpolated by the same spline, so that only variation is blurred; no pixel is a copy.
    """

    tile: Literal["typical", "random", "mean"] = "typical"

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    finder: ClassVar[str] = "gncc"
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})
    version: ClassVar[str] = "2"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest pixel. The mean
        tile has no source map.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no tile to repeat")
        centers = whole_cell_centers(lattice, task.sample.shape)
        if self.tile == "mean":
            return Synthesis(_repeat_mean(task, lattice), lattice, detection_seconds=seconds)
        typical = self.tile == "typical"
        center = _typical_center(task.sample, lattice, centers) if typical else task.rng.choice(centers)
        middle = center + OFFSET
        image, source = resample(task, lambda pixels: middle + lattice.wrap(pixels - middle))
        return Synthesis(image, lattice, source, detection_seconds=seconds)


def _repeat_mean(task: Task, lattice: Lattice) -> Image:
    """Return the mean tile, repeated in the sample's phase."""
    center = np.array(task.sample.shape[1::-1]) // 2
    around = np.ceil(half_extent(lattice)).astype(int) + _MARGIN
    corner = center - around
    mean = _mean_window(task.sample, lattice, corner, (int(2 * around[1] + 1), int(2 * around[0] + 1)))
    middle = center + OFFSET
    image, _ = resample(replace(task, sample=mean), lambda pixels: middle - corner + lattice.wrap(pixels - middle))
    return image


def _mean_window(sample: Image, lattice: Lattice, corner: Points, shape: tuple[int, int]) -> Image:
    """Return a part of the periodic image that is the mean of the sample over its lattice.

    Each pixel is the mean over all equivalent places of the sample, interpolated by splines.

    Parameters
    ----------
    sample
        ``(H, W, C)``; holds a whole tile.
    lattice
        Its origin does not matter.
    corner, shape
        The part's first pixel (x, y) in the sample, which may lie outside, and the part's height and width.
    """
    total, count = np.zeros((*shape, sample.shape[2])), np.zeros(shape)
    size, last = np.array(shape[::-1]), np.array(sample.shape[1::-1]) - 0.5
    room = sample.shape[0] + shape[0] - 1, sample.shape[1] + shape[1] - 1
    patches = Patches(sample)
    for place in round_places(EqualPlaces(lattice, room).find_places(corner + size - 1) - size + 1):
        left, top = np.maximum(np.ceil(-0.5 - place), 0).astype(int)
        right, bottom = np.minimum(np.floor(last - place).astype(int) + 1, size)
        if left < right and top < bottom:
            part = np.s_[top:bottom, left:right]
            total[part] += patches.cut_patch(place + np.array([left, top]), (bottom - top, right - left))[0]
            count[part] += 1
    return np.asarray(total / np.maximum(count, 1)[..., np.newaxis], np.float32)


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
