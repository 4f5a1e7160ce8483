"""Reflections and half turns that a sample's mean tile supports: more tiles for a tile set."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import fold
from nrbench.imaging.parabola import find_vertex
from nrbench.lattice.geometry import Lattice, Points

SUPPORTED: Final = 0.9
"""Correlation of the mean tile with its moved copy from which a symmetry counts as the texture's."""
LATTICE_SLACK: Final = 0.02
"""Share of s by which a moved lattice may differ from the lattice."""
MOVES: Final = {
    "half-turn": ((-1, 0), (0, -1)),
    "mirror-x": ((-1, 0), (0, 1)),
    "mirror-y": ((1, 0), (0, -1)),
    "quarter-turn": ((0, 1), (-1, 0)),
    "three-quarter-turn": ((0, -1), (1, 0)),
    "diagonal": ((0, 1), (1, 0)),
    "other-diagonal": ((0, -1), (-1, 0)),
}
"""What maps the pixel grid onto itself: the sample's (x, y) from the picture's, both from the middle of the image."""


class Picture(NamedTuple):
    """A sample, moved by one of its symmetries.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    matrix, offset
        The sample's pixel is ``matrix @ (x, y) + offset`` for the picture's pixel (x, y).
    lattice
        The sample's, its origin where the picture shows what the sample shows at its lattice's origin.
    """

    image: Image
    matrix: Points
    offset: Points
    lattice: Lattice


def upright(sample: Image, lattice: Lattice) -> Picture:
    """Return the sample as it is."""
    return Picture(sample, np.eye(2), np.zeros(2), lattice)


def pictures(sample: Image, lattice: Lattice) -> list[Picture]:
    """Return the sample, and every move of the pixel grid that the texture is symmetric under (section 4.4).

    A move counts that leaves the lattice what it is and whose mean tile, best aligned, correlates by at least
    :data:`SUPPORTED` with the sample's own. Quarter turns and diagonals need a square sample. Other rotations (of a
    hexagonal lattice by 60 degrees, of a turned one) would need another pixel grid and are left out.
    """
    found = [upright(sample, lattice)]
    height, width = sample.shape[:2]
    middle = (np.array([width, height]) - 1) / 2
    for numbers in MOVES.values():
        matrix = np.array(numbers, np.float64)
        if matrix[0, 0] == 0 and height != width:
            continue
        offset = middle - matrix @ middle
        moved = Lattice(tuple(matrix.T @ lattice.t1), tuple(matrix.T @ lattice.t2))
        if not lattice.is_equivalent(moved, LATTICE_SLACK * lattice.s):
            continue
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        at = np.rint(np.stack([x, y], -1) @ matrix.T + offset).astype(np.int64)
        image = np.ascontiguousarray(sample[at[..., 1], at[..., 0]])
        shift, correlation = _alignment(sample, image, lattice)
        if correlation >= SUPPORTED:
            found.append(Picture(image, matrix, offset, lattice.shifted((float(shift[0]), float(shift[1])))))
    return found


def _alignment(sample: Image, other: Image, lattice: Lattice) -> tuple[Points, float]:
    """Return by how much (x, y) px the other's mean tile is moved against the sample's, and how well they agree."""
    lattice = lattice.reduced()
    here, there = (_whitened(fold(image, lattice).values.astype(np.float64)) for image in (sample, other))
    spectra = np.conj(fft.rfft2(here, axes=(0, 1))) * fft.rfft2(there, axes=(0, 1))
    surface = fft.irfft2(spectra.sum(-1), here.shape[:2])
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    rows, columns = surface.shape
    v = row + find_vertex(*surface[[row - 1, row, (row + 1) % rows], column])[0]
    u = column + find_vertex(*surface[row, [column - 1, column, (column + 1) % columns]])[0]
    return np.array([u / columns, v / rows]) @ lattice.matrix, float(surface[row, column])


def _whitened(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the tile less its channels' means, of unit norm."""
    centred = values - values.mean((0, 1))
    return np.asarray(centred / max(float(np.sqrt((centred**2).sum())), 1e-12))
