"""Convert images of users to float32 ``(H, W, C)``, round them to 8 or 16 bits, and crop them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput, require

Image = NDArray[np.float32]
"""``float32 (H, W, C)`` in [0, 1], C is 1 or 3, sRGB values as stored."""

MIN_SIDE = 8
"""px; the smallest side of an input."""
OPAQUE = 0.98
"""Least alpha, or brightness in a mask, of a pixel that counts. Soft edges do not: they show what lies below them."""
_INTEGER_PEAK = {np.dtype(np.bool_): 1, np.dtype(np.uint8): 255, np.dtype(np.uint16): 65535}


def as_image(array: Any, where: str = "image", smallest: int = MIN_SIDE) -> Image:
    """Convert an image as scikit-image holds it to an :data:`Image`.

    Parameters
    ----------
    array
        bool, uint8, uint16 or float in [0, 1]; ``(H, W)``, ``(H, W, 1)`` or ``(H, W, 3)``, or with an alpha channel,
        ``(H, W, 2)`` or ``(H, W, 4)``, that is opaque everywhere (:data:`OPAQUE`). Such a channel is left out.
    where
        The name of the input in error messages.
    smallest
        Least number of px a side.

    Returns
    -------
    Image
        A fresh float32 array of shape ``(H, W, C)``.

    Raises
    ------
    BadInput
        For any other dtype or shape, transparent pixels, NaN or infinity, values outside [0, 1], or too small a side.

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench.imaging.convert import as_image
    >>> as_image(np.full((16, 24), 255, np.uint8)).shape
    (16, 24, 1)
    """
    pixels = np.asarray(array)
    pixels = pixels.astype(pixels.dtype.newbyteorder("="), copy=False)
    pixels = pixels[..., np.newaxis] if pixels.ndim == 2 else pixels
    _check_shape(pixels, where, smallest)
    if pixels.shape[2] in (2, 4):
        _check_opaque(pixels[..., -1], where)
        pixels = pixels[..., :-1]
    return _scale_to_unit(pixels, where)


def as_layers(array: Any, where: str = "image", smallest: int = MIN_SIDE) -> NDArray[np.float32]:
    """Convert an image with an alpha channel as :func:`as_image` does, with alpha as the last of 2 or 4 channels."""
    pixels = np.asarray(array)
    if pixels.ndim != 3 or pixels.shape[2] not in (2, 4):
        raise BadInput(f"{where}: has no alpha channel to keep; leave out --keep-alpha")
    _check_shape(pixels, where, smallest)
    return _scale_to_unit(pixels, where)


def _check_shape(pixels: NDArray[Any], where: str, smallest: int) -> None:
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 2, 3, 4):
        raise BadInput(f"{where}: shape {pixels.shape} is no image; pass (H, W), (H, W, 1) or (H, W, 3)")
    if min(pixels.shape[:2]) < smallest:
        raise BadInput(f"{where}: {pixels.shape[1]}x{pixels.shape[0]} px; at least {smallest} px a side are needed")


def is_opaque(alpha: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where an alpha channel is at least :data:`OPAQUE`."""
    return np.asarray(alpha >= OPAQUE * _INTEGER_PEAK.get(alpha.dtype, 1))


def _check_opaque(alpha: NDArray[Any], where: str) -> None:
    """Raise BadInput if an alpha channel ``(H, W)`` is not opaque at every pixel."""
    transparent = ~is_opaque(alpha)
    if transparent.any():
        y, x = np.argwhere(transparent)[0]
        raise BadInput(
            f"{where}: has {np.count_nonzero(transparent)} transparent pixels, the first at ({x}, {y}); "
            "flatten it onto a background first"
        )


def _scale_to_unit(pixels: NDArray[Any], where: str) -> Image:
    peak = _INTEGER_PEAK.get(pixels.dtype)
    if peak is not None:
        return np.asarray(pixels / np.float32(peak), np.float32)
    if not np.issubdtype(pixels.dtype, np.floating):
        raise BadInput(f"{where}: dtype {pixels.dtype}; convert it to uint8, uint16 or float in [0, 1]")
    if not np.isfinite(pixels).all():
        raise BadInput(f"{where}: has NaN or infinite pixels; replace them first, e.g. with numpy.nan_to_num")
    low, high = float(pixels.min()), float(pixels.max())
    require(low >= 0 and high <= 1, f"{where}: values from {low:g} to {high:g}; scale floats to [0, 1] first")
    return np.array(pixels, np.float32)


def to_bytes(image: Image) -> NDArray[np.uint8]:
    """Clip an image to [0, 1] and round it to uint8, as a PNG file stores it."""
    pixels: NDArray[np.uint8] = to_integers(image)
    return pixels


def to_integers(image: Image, bits: int = 8) -> NDArray[Any]:
    """Clip an image to [0, 1] and round it to uint8, or to uint16 for 16 bits, as a file stores it."""
    pixels = np.clip(image, 0, 1)
    pixels *= 2**bits - 1  # in place: a large image leaves no room for a copy at each step
    return np.rint(pixels, out=pixels).astype(np.uint8 if bits == 8 else np.uint16)


def quantize(image: Image, bits: int = 8) -> Image:
    """Round an image of any size to 8 or 16 bits: return the float32 image that its file holds."""
    return np.asarray(to_integers(image, bits) / np.float32(2**bits - 1), np.float32)


def depth_of(image: Image, others: int = 8) -> int:
    """Return the bits a channel of the file that holds exactly these values: 8, or 16; ``others`` if there is none.

    Images carry no depth. Their values tell it: those of a file are whole numbers over 255, or over 65535.

    Examples
    --------
    >>> import numpy as np
    >>> heights = np.linspace(0, 1, 10000, dtype=np.float32).reshape(100, 100, 1)
    >>> depth_of(quantize(heights, 16)), depth_of(quantize(heights)), depth_of(heights)
    (16, 8, 8)
    """
    part = image[:: max(1, len(image) // 16)]  # most images show it in a few rows
    for bits in (8, 16):
        if all(np.array_equal(quantize(rows, bits), np.asarray(rows, np.float32)) for rows in (part, image)):
            return bits
    return others


def match_ndim(image: Image, array: Any) -> NDArray[np.float32]:
    """Return ``image`` as ``(H, W)`` if ``array``, the image that the user passed, is ``(H, W)``."""
    return image[..., 0] if np.ndim(array) == 2 else image


def match_channels(image: Image, sample: Image) -> Image:
    """Return ``image`` with one channel if ``sample`` has one and the channels of ``image`` are equal.

    Many programs write a gray picture in color.
    """
    same = sample.shape[2] == 1 and np.array_equal(image, np.broadcast_to(image[..., :1], image.shape))
    return image[..., :1] if same else image


def gray(image: Image) -> NDArray[np.float32]:
    """Return the luma (ITU-R BT.601 weights) as float32 ``(H, W)``.

    Parameters
    ----------
    image
        Float32 ``(H, W, C)`` in [0, 1]; C is 1 or 3.

    Returns
    -------
    NDArray
        Float32 ``(H, W)`` in [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> from nrbench import gray
    >>> gray(np.ones((8, 8, 3), np.float32)).shape
    (8, 8)
    """
    if image.shape[2] == 1:
        return image[..., 0]
    return np.asarray(image @ np.array([0.299, 0.587, 0.114], np.float32), np.float32)


def smooth_inside(field: NDArray[Any], kernel: NDArray[np.float64]) -> NDArray[Any]:
    """Return a field smoothed along its first axis by a symmetric kernel, without the rows that the kernel overhangs.

    The sums are those of :func:`scipy.ndimage.correlate1d`, to the bit. To import that module takes longer than to draw
    a sample.
    """
    reach = kernel.size // 2
    rows = len(field) - 2 * reach
    total = field[reach : reach + rows] * kernel[reach]
    for far in range(reach, 0, -1):
        pair = field[reach - far : reach - far + rows].astype(np.float64) + field[reach + far : reach + far + rows]
        total += pair * kernel[reach - far]
    return np.asarray(total.astype(field.dtype))


def shrink(image: Image, factor: int) -> Image:
    """Return the means of blocks of ``factor`` x ``factor`` px; incomplete blocks at the borders are dropped."""
    if factor == 1:
        return image
    height, width = (n // factor for n in image.shape[:2])
    whole = image[: height * factor, : width * factor]
    # Whole rows are added first: a sum over both axes takes ten times as long.
    columns = whole.reshape(height, factor, width * factor, -1).sum(1)
    return np.asarray(columns.reshape(height, width, factor, -1).sum(2) / np.float32(factor**2))


def crop_middle(image: Image, side: int) -> Image:
    """Return the middle of an image, at most ``side`` px a side."""
    top, left = (max(n - side, 0) // 2 for n in image.shape[:2])
    return image[top : top + side, left : left + side]


Table = NDArray[np.float64]
"""``float64 (H + 1, W + 1, ...)``: the sums over all pixels above and to the left."""


def integral_image(values: NDArray[Any]) -> Table:
    """Return the integral image of ``(H, W)``, or of each channel of ``(H, W, C)``; exact for whole numbers.

    :func:`skimage.transform.integral_image` also sums over channels and has no border of zeros. Applied to each channel
    and padded, it returns the same bits in 1.1 to 1.5 times the time.
    """
    table = np.zeros((values.shape[0] + 1, values.shape[1] + 1, *values.shape[2:]))
    np.cumsum(np.cumsum(values, 0, dtype=np.float64), 1, out=table[1:, 1:])
    return table


def box_sums_from(table: Table, size: tuple[int, int]) -> Table:
    """Return the sums over all boxes of ``size`` (rows, columns) from an integral image.

    ``(H - rows + 1, W - columns + 1, ...)`` for an image ``(H, W, ...)``, at the position of the first pixel of each
    box. The time is O(H W) for any size.
    """
    rows, columns = size
    bands = table[rows:] - table[: len(table) - rows]
    return np.asarray(bands[:, columns:] - bands[:, : bands.shape[1] - columns])


def box_sums(values: NDArray[Any], size: tuple[int, int]) -> Table:
    """Return the sums over all boxes of ``size`` (rows, columns) of an image; see :func:`box_sums_from`."""
    return box_sums_from(integral_image(values), size)


def largest_box(inside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return first and last row and column, half-open, of a box whose borders hold True values alone.

    The worst border of the mask is removed until none holds a False value. Where False values lie along the borders of
    the mask, the box is close to the largest one without any. Holes in the middle are not seen.
    """
    y0, y1, x0, x1 = 0, inside.shape[0], 0, inside.shape[1]
    while y1 - y0 > 1 and x1 - x0 > 1:
        box = inside[y0:y1, x0:x1]
        worst = [float((~border).mean()) for border in (box[0], box[-1], box[:, 0], box[:, -1])]
        side = int(np.argmax(worst))
        if worst[side] == 0:
            break
        y0, y1, x0, x1 = y0 + (side == 0), y1 - (side == 1), x0 + (side == 2), x1 - (side == 3)
    return y0, y1, x0, x1
