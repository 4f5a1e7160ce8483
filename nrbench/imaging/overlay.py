"""A lattice drawn over its image."""

from __future__ import annotations

import numpy as np
from skimage.draw import line_aa

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

COLOR = (1.0, 0.1, 0.6)
"""sRGB; rare in brick, cloth and tile."""


def overlay(image: Image, lattice: Lattice) -> Image:
    """Return the image in color with the lattice's cells drawn over it, anti-aliased, one pixel wide.

    Parameters
    ----------
    image
        Any :data:`~nrbench.imaging.convert.Image`.
    lattice
        In the image's coordinates; its reduced basis is drawn.
    """
    canvas = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image.copy()
    basis = lattice.reduced()
    corners = basis.points((image.shape[0], image.shape[1]), margin=2 * float(np.abs(basis.matrix).max()))
    for vector in basis.matrix:
        for start in corners:
            _draw(canvas, start, start + vector)
    return canvas


def _draw(canvas: Image, start: Points, end: Points) -> None:
    x0, y0, x1, y1 = np.rint([*start, *end]).astype(int)
    rows, columns, weight = line_aa(y0, x0, y1, x1)  # type: ignore[no-untyped-call]
    inside = (rows >= 0) & (rows < canvas.shape[0]) & (columns >= 0) & (columns < canvas.shape[1])
    rows, columns, weight = rows[inside], columns[inside], weight[inside, np.newaxis].astype(np.float32)
    canvas[rows, columns] = canvas[rows, columns] * (1 - weight) + np.array(COLOR, np.float32) * weight
