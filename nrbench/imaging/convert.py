"""The door: what users hold becomes the one image form that everything inside works on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput

Image = NDArray[np.float32]
"""``float32 (H, W, C)`` in [0, 1], C is 1 or 3, sRGB values as stored."""

MIN_SIDE = 8
_INTEGER_PEAK = {np.dtype(np.uint8): 255, np.dtype(np.uint16): 65535}


def as_image(array: Any, where: str = "image", smallest: int = MIN_SIDE) -> Image:
    """Convert what scikit-image users hold to an :data:`Image`.

    Parameters
    ----------
    array
        uint8, uint16 or float in [0, 1]; ``(H, W)``, ``(H, W, 1)`` or ``(H, W, 3)``.
    where
        How an error names the input.
    smallest
        Least number of px a side.

    Returns
    -------
    Image
        A fresh float32 array of shape ``(H, W, C)``.

    Raises
    ------
    BadInput
        For any other dtype or shape, alpha, NaN or infinity, values outside [0, 1], or too small a side.
    """
    pixels = np.asarray(array)
    pixels = pixels[..., np.newaxis] if pixels.ndim == 2 else pixels
    _check_shape(pixels, where, smallest)
    return _to_unit(pixels, where)


def _check_shape(pixels: NDArray[Any], where: str, smallest: int) -> None:
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 2, 3, 4):
        raise BadInput(f"{where}: shape {pixels.shape} is no image; pass (H, W), (H, W, 1) or (H, W, 3)")
    if pixels.shape[2] in (2, 4):
        raise BadInput(f"{where}: has an alpha channel; flatten it onto a background first, e.g. image[..., :3]")
    if min(pixels.shape[:2]) < smallest:
        raise BadInput(f"{where}: {pixels.shape[1]}x{pixels.shape[0]} px; at least {smallest} px a side are needed")


def _to_unit(pixels: NDArray[Any], where: str) -> Image:
    peak = _INTEGER_PEAK.get(pixels.dtype)
    if peak is not None:
        return np.asarray(pixels / np.float32(peak), np.float32)
    if not np.issubdtype(pixels.dtype, np.floating):
        raise BadInput(f"{where}: dtype {pixels.dtype}; convert it to uint8, uint16 or float in [0, 1]")
    if not np.isfinite(pixels).all():
        raise BadInput(f"{where}: has NaN or infinite pixels; replace them first, e.g. with numpy.nan_to_num")
    low, high = float(pixels.min()), float(pixels.max())
    if low < 0 or high > 1:
        raise BadInput(f"{where}: values from {low:g} to {high:g}; scale floats to [0, 1] first")
    return np.array(pixels, np.float32)


def to_bytes(image: Image) -> NDArray[np.uint8]:
    """Return the pixels as a PNG holds them: uint8, rounded, clipped to [0, 1] first."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def quantize(image: Image) -> Image:
    """Round to 8 bits: the float32 image that the PNG of ``image`` reads back as (any size)."""
    return np.asarray(to_bytes(image) / np.float32(255), np.float32)


def like_input(image: Image, array: Any) -> NDArray[np.float32]:
    """Give ``image`` the channel layout of what the user passed: ``(H, W)`` in, ``(H, W)`` out."""
    return image[..., 0] if np.ndim(array) == 2 else image


def gray(image: Image) -> NDArray[np.float32]:
    """Return the luma (ITU-R BT.601 weights) as float32 ``(H, W)``."""
    if image.shape[2] == 1:
        return image[..., 0]
    return np.asarray(image @ np.array([0.299, 0.587, 0.114], np.float32), np.float32)


def like_sample(image: Image, sample: Image) -> Image:
    """Return one channel where a program wrote a gray picture in color though the sample is gray."""
    same = sample.shape[2] == 1 and np.array_equal(image, np.broadcast_to(image[..., :1], image.shape))
    return image[..., :1] if same else image
