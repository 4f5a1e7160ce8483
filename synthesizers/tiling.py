"""A cheat: one tile, repeated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np
from scipy.signal import fftconvolve

from nrbench.imaging.door import Image
from nrbench.imaging.fold import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.gncc import Gncc
from nrbench.synthesis import Refused, Synthesis, Task, find_lattice
from nrbench.texture import Kind

from .splines import resampled

ASIDE: Final = (0.0011, 0.0007)
"""The cell's centre is moved by this, px, so that no pixel lies on its border, where rounding would choose a side."""


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
        ``"random"``: drawn uniformly, however odd.
    """

    tile: Literal["typical", "random"] = "typical"

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})
    version: ClassVar[str] = "2"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest one.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        found = find_lattice(task, Gncc())
        if found.lattice is None:
            raise Refused(f"no lattice found ({found.reason}): there is no tile to repeat")
        centres = whole_centres(found.lattice, task.sample.shape)
        typical = self.tile == "typical"
        centre = _typical(task.sample, found.lattice, centres) if typical else task.rng.choice(centres)
        lattice, aside = found.lattice, centre + ASIDE
        image, source = resampled(task, lambda pixels: aside + lattice.wrap(pixels - aside))
        return Synthesis(image, found.lattice, source, detection_seconds=found.seconds)


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
    grid = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    return np.stack(grid, -1).reshape(-1, 2).astype(np.float64)


def _typical(sample: Image, lattice: Lattice, centres: Points) -> Points:
    """Return the centre of the tile that differs least from the mean tile; of equal ones the first."""
    mean = fold(sample, lattice.reduced()).unfold(sample.shape[:2])
    departure = ((sample - mean) ** 2).sum(-1, dtype=np.float64)
    x, y = np.ceil(reach(lattice)).astype(int)
    around = np.stack(np.meshgrid(np.arange(-x, x + 1), np.arange(-y, y + 1)), -1) - np.array(ASIDE)
    inside = np.abs(lattice.wrap(around) - around).max(-1) < 1e-6
    total = fftconvolve(departure, inside[::-1, ::-1].astype(np.float64), mode="same")
    column, row = centres.astype(int).T
    return np.asarray(centres[np.argmin(np.round(total[row, column], 6))])
