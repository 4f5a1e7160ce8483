"""Images of which some pixels do not count: transparent ones, and those that a mask leaves out."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.imaging.convert import MIN_SIDE, OPAQUE, Image, as_image, is_opaque
from nrbench.imaging.source_maps import read_nearest
from nrbench.lattice.geometry import Lattice

Mask = NDArray[np.bool_]
"""``bool (H, W)``: True where a pixel of an image counts."""


class MaskedImage(NamedTuple):
    """An image, and which of its pixels count.

    Parameters
    ----------
    image
        The pixels. Those that do not count have the color of the nearest one that does.
    known
        A :data:`Mask`; None: all count.
    """

    image: Image
    known: Mask | None = None

    def without(self, left_out: Mask, where: str) -> MaskedImage:
        """Return the image without further pixels, which ``left_out`` has True; ``where`` names it in errors."""
        known = ~left_out if self.known is None else self.known & ~left_out
        count = int(known.sum())
        require(count > 0, f"{where}: leaves no pixel that counts; white counts, and black is left out")
        few = f"{where}: leaves {count} of {known.size} px, fewer than {MIN_SIDE}x{MIN_SIDE}"
        require(count >= min(MIN_SIDE**2, known.size), f"{few}; white counts, and black is left out")
        return self if known.all() else MaskedImage(fill_unknown(self.image, known), known)


def as_masked(array: Any, where: str = "image", smallest: int = MIN_SIDE) -> MaskedImage:
    """Convert an image as :func:`~nrbench.imaging.convert.as_image` does; transparent pixels do not count.

    Raises
    ------
    BadInput
        As there, or if no pixel is opaque.
    """
    pixels = np.asarray(array)
    if pixels.ndim != 3 or pixels.shape[2] not in (2, 4):
        return MaskedImage(as_image(pixels, where, smallest))
    image, clear = MaskedImage(as_image(pixels[..., :-1], where, smallest)), ~is_opaque(pixels[..., -1])
    require(not clear.all(), f"{where}: has no opaque pixel, so that none counts; remove its alpha channel")
    return image.without(clear, where)


def as_mask(array: Any, shape: tuple[int, int], where: str = "mask") -> Mask:
    """Return the pixels that a mask counts: those that are True, 1 or white.

    Parameters
    ----------
    array
        ``(H, W)`` of bool or of 0 and 1; an image of any kind, in which white counts and black is left out; or a
        :class:`MaskedImage`. Its transparent pixels are left out.
    shape
        Height and width that it must have.
    where
        The name of the mask in error messages.

    Raises
    ------
    BadInput
        If it is no image, or has another size.
    """
    if not isinstance(array, MaskedImage):
        values = np.asarray(array)
        whole = values.dtype.kind in "ui" and values.size > 0 and values.max() <= 1
        array = as_masked(values.astype(bool) if whole else values, where, smallest=1)
    height, width = array.image.shape[:2]
    size = f"{where}: is {width}x{height} px, the picture {shape[1]}x{shape[0]}; make a mask of the same size"
    require((height, width) == shape, size)
    bright = np.asarray(array.image.mean(-1) >= OPAQUE)
    return bright if array.known is None else bright & array.known


def known_at(known: Mask, points: NDArray[np.floating[Any]]) -> Mask:
    """Return which values that are interpolated at points (x, y) px, ``(..., 2)``, come from pixels that count."""
    import scipy.ndimage  # most commands need none of this

    sure = scipy.ndimage.binary_erosion(known, np.ones((5, 5), bool), border_value=1)
    return read_nearest(sure, points)


def fill_periodically(image: Image, known: Mask, lattice: Lattice) -> Image:
    """Return an image in which pixels that do not count show those that count a lattice vector away, the nearest first.

    Those for which there is none stay as they are.
    """
    image, found = image.copy(), known.copy()
    sides = np.array(known.shape[::-1])
    reach = np.ceil(np.abs(sides @ np.abs(np.linalg.inv(lattice.matrix)))).astype(int)
    numbers = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in reach)), -1).reshape(-1, 2)
    steps = np.rint(numbers @ lattice.matrix).astype(int)
    steps = steps[(np.abs(steps) < sides).all(-1) & steps.any(-1)]
    for x, y in steps[np.argsort(np.hypot(*steps.T), kind="stable")]:
        rows, columns = np.nonzero(~found)
        if not rows.size:
            break
        inside = (rows + y >= 0) & (rows + y < sides[1]) & (columns + x >= 0) & (columns + x < sides[0])
        rows, columns = rows[inside], columns[inside]
        there = known[rows + y, columns + x]
        rows, columns = rows[there], columns[there]
        image[rows, columns], found[rows, columns] = image[rows + y, columns + x], True
    return image


def fill_unknown(image: NDArray[Any], known: Mask) -> NDArray[Any]:
    """Return an image ``(H, W, C)`` in which each pixel that does not count has the color of the nearest one."""
    import scipy.ndimage

    rows, columns = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(image[rows, columns])
