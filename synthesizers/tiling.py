"""A cheat: one tile, repeated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final, Literal

import numpy as np
from scipy.signal import fftconvolve

from nrbench.detectors.gncc import Gncc
from nrbench.imaging.convert import Image
from nrbench.imaging.fold import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Kind, Refused, Synthesis, Task, require_lattice

from .sampling.equal_places import EqualPlaces, pixel_grid
from .sampling.patches import Patches, snapped
from .sampling.splines import resampled

ASIDE: Final = (0.0011, 0.0007)
"""The cell's centre is moved by this, px, so that no pixel lies on its border, where rounding would choose a side."""

_MARGIN = 8
"""px of the mean image around its tile, so that splines at the tile's edge do not feel the end."""


@dataclass(frozen=True)
class Tiling:
    """One tile of the sample, repeated on the lattice: keeps the lattice, loses all randomness.

    The tile is a Voronoi cell of the lattice, the shape with short seams, whole within the sample. Every output pixel
    shows the point of that cell that the lattice calls equal to it, so the output continues the sample's phase and
    nothing drifts; between pixels a spline of order 5 interpolates, and where the lattice is of whole pixels every
    pixel is a copy. Seams are left as they are.

    On perfectly regular textures it is no cheat. With no lattice given it finds one by ``gncc``.

    Parameters
    ----------
    tile
        ``"typical"``: the tile nearest to the mean of all (least mean squared difference), the cheat at its best;
        ``"random"``: drawn uniformly, however odd; ``"mean"``: the mean of all tiles, each shifted by the real-valued
        lattice and interpolated by the same spline, so that only what varies is blurred; no pixel is a copy.
    """

    tile: Literal["typical", "random", "mean"] = "typical"

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})
    version: ClassVar[str] = "2"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest one; the mean
        tile has none.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        lattice, seconds = require_lattice(task, Gncc(), "there is no tile to repeat")
        centres = whole_centres(lattice, task.sample.shape)
        if self.tile == "mean":
            return Synthesis(_mean_repeated(task, lattice), lattice, detection_seconds=seconds)
        typical = self.tile == "typical"
        centre = _typical(task.sample, lattice, centres) if typical else task.rng.choice(centres)
        aside = centre + ASIDE
        image, source = resampled(task, lambda pixels: aside + lattice.wrap(pixels - aside))
        return Synthesis(image, lattice, source, detection_seconds=seconds)


def _mean_repeated(task: Task, lattice: Lattice) -> Image:
    """Return the mean tile, repeated in the sample's phase."""
    middle = np.array(task.sample.shape[1::-1]) // 2
    around = np.ceil(reach(lattice)).astype(int) + _MARGIN
    corner = middle - around
    mean = mean_window(task.sample, lattice, corner, (int(2 * around[1] + 1), int(2 * around[0] + 1)))
    aside = middle + ASIDE
    image, _ = resampled(replace(task, sample=mean), lambda pixels: aside - corner + lattice.wrap(pixels - aside))
    return image


def mean_window(sample: Image, lattice: Lattice, corner: Points, shape: tuple[int, int]) -> Image:
    """Return a part of the periodic image that is the mean of the sample over its lattice.

    Parameters
    ----------
    sample
        ``(H, W, C)``; holds a whole tile.
    lattice
        Its vectors count.
    corner, shape
        The part's first pixel (x, y) in the sample, its height and width; it may lie outside.

    Returns
    -------
    Image
        Each pixel is the mean over all places of the sample that the lattice calls equal, interpolated by splines.
    """
    total, count = np.zeros((*shape, sample.shape[2])), np.zeros(shape)
    size, last = np.array(shape[::-1]), np.array(sample.shape[1::-1]) - 0.5
    room = sample.shape[0] + shape[0] - 1, sample.shape[1] + shape[1] - 1
    patches = Patches(sample)
    for place in snapped(EqualPlaces(lattice, room).of(corner + size - 1) - size + 1):
        left, top = np.maximum(np.ceil(-0.5 - place), 0).astype(int)
        right, bottom = np.minimum(np.floor(last - place).astype(int) + 1, size)
        if left < right and top < bottom:
            part = np.s_[top:bottom, left:right]
            total[part] += patches.cut(place + np.array([left, top]), (bottom - top, right - left))[0]
            count[part] += 1
    return np.asarray(total / np.maximum(count, 1)[..., np.newaxis], np.float32)


def reach(lattice: Lattice) -> tuple[float, float]:
    """Return how far, along x and y in px, the lattice's Voronoi cell reaches from its centre."""
    a, b = lattice.reduced().matrix
    corners = np.array([_circumcentre(p, q) for p, q in ((a, b), (a, a - b), (b, b - a))])
    x, y = np.abs(corners).max(0)
    return float(x), float(y)


def _circumcentre(p: Points, q: Points) -> Points:
    """Return the point equally far from 0, p and q: a corner of the cell."""
    return np.asarray(np.linalg.solve(2 * np.stack([p, q]), [p @ p, q @ q]))


def whole_centres(lattice: Lattice, shape: tuple[int, ...]) -> Points:
    """Return the (whole-pixel) centres (x, y) of all tiles that lie whole within the sample, ``(n, 2)``."""
    height, width = shape[:2]
    x, y = reach(lattice)
    low = np.ceil([x, y]).astype(int)
    high = np.floor([width - 1 - x, height - 1 - y]).astype(int)
    if (high < low).any():
        raise Refused(
            f"a tile takes {2 * x:.0f}x{2 * y:.0f} px, the sample is {width}x{height} px: it holds no whole tile"
        )
    width, height = high - low + 1
    return pixel_grid(width, height, *low).reshape(-1, 2).astype(np.float64)


def _typical(sample: Image, lattice: Lattice, centres: Points) -> Points:
    """Return the centre of the tile that differs least from the mean tile; of equal ones the first."""
    mean = fold(sample, lattice.reduced()).unfold(sample.shape[:2])
    departure = ((sample - mean) ** 2).sum(-1, dtype=np.float64)
    x, y = np.ceil(reach(lattice)).astype(int)
    around = pixel_grid(2 * x + 1, 2 * y + 1, -x, -y) - np.array(ASIDE)
    inside = np.abs(lattice.wrap(around) - around).max(-1) < 1e-6
    total = fftconvolve(departure, inside[::-1, ::-1].astype(np.float64), mode="same")
    column, row = centres.astype(int).T
    return np.asarray(centres[np.argmin(np.round(total[row, column], 6))])
