"""Edits of pictures that nobody sees, and edits that everybody sees."""

import io
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from scipy import ndimage

from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice

Edit = Callable[[Image, Lattice], NDArray[np.float32]]


def compress(image: Image, quality: int) -> Image:
    """Return an image after JPEG with chroma at half the resolution."""
    file = io.BytesIO()
    Pictures.fromarray(np.rint(image * 255).astype(np.uint8)).save(file, "JPEG", quality=quality, subsampling=2)
    return np.asarray(Pictures.open(file), np.float32) / 255


def blur(image: Image, sigma: float) -> Image:
    """Return a blurred image."""
    return np.asarray(ndimage.gaussian_filter(image, (sigma, sigma, 0), mode="nearest"))


def resample(image: Image, degrees: float = 0.0, scale: float = 1.0, shift: float = 0.0) -> Image:
    """Return an image turned and enlarged about its middle and moved, interpolated linearly."""
    cosine, sine = np.cos(np.radians(degrees)) / scale, np.sin(np.radians(degrees)) / scale
    matrix, middle = np.array([[cosine, -sine], [sine, cosine]]), (np.array(image.shape[:2]) - 1) / 2
    offset = middle - matrix @ middle + shift
    planes = [
        ndimage.affine_transform(plane, matrix, offset, order=1, mode="reflect") for plane in image.transpose(2, 0, 1)
    ]
    return np.stack(planes, -1)


def draw_noise(shape: tuple[int, ...], levels: float, smooth: float = 0.0) -> NDArray[np.float32]:
    """Return noise of a standard deviation given in levels of 255."""
    noise = np.random.default_rng(0).standard_normal(shape)
    noise = ndimage.gaussian_filter(noise, (smooth, smooth, 0)) if smooth else noise
    return np.asarray(noise / noise.std() * levels / 255, np.float32)


def add_chroma(image: Image) -> Image:
    """Return an image with smooth noise of colors, which leaves the sum of the channels."""
    noise = draw_noise(image.shape, 1, smooth=2)
    noise -= noise.mean(-1, keepdims=True)
    return image + noise / noise.std() * np.float32(2 / 255)


def cut_hole(image: Image, lattice: Lattice) -> Image:
    """Return an image with a gray box of two by two cells in its middle."""
    sides = 2 * np.abs(lattice.canonical().matrix).max(0)[::-1]
    low = ((np.array(image.shape[:2]) - sides) / 2).astype(int)
    high, holed = (low + sides).astype(int), np.array(image)
    holed[low[0] : high[0], low[1] : high[1]] = image.mean()
    return holed


def slip_half(image: Image, lattice: Lattice) -> Image:
    """Return an image whose lower half has slipped by 0.3 s along the first vector."""
    t1 = lattice.canonical().matrix[0]
    moved = 0.3 * lattice.s * t1 / np.hypot(*t1)
    slipped, half = np.array(image), image.shape[0] // 2
    slipped[half:] = ndimage.shift(image, (moved[1], moved[0], 0), order=1, mode="mirror")[half:]
    return slipped


def light_half(image: Image) -> Image:
    """Return an image whose right half is brighter by 0.16."""
    lit, half = np.array(image), image.shape[1] // 2
    lit[:, half:] += np.float32(0.16)
    return lit


UNSEEN: Mapping[str, Edit] = {
    "JPEG 85": lambda image, _: compress(image, 85),
    "half a pixel": lambda image, _: resample(image, shift=0.5),
    "blur of .6 px": lambda image, _: blur(image, 0.6),
    "turned by .5 degrees": lambda image, _: resample(image, degrees=0.5),
    "1 % larger": lambda image, _: resample(image, scale=1.01),
    "chroma noise": lambda image, _: add_chroma(image),
    "two levels brighter": lambda image, _: image + np.float32(2 / 255),
}
"""Edits that nobody sees."""
SEEN: Mapping[str, Edit] = {
    "red and blue swapped": lambda image, _: image[..., ::-1],
    "brighter by .12": lambda image, _: image + np.float32(0.12),
    "blur of 2 px": lambda image, _: blur(image, 2),
    "JPEG 6": lambda image, _: compress(image, 6),
    "noise of 25 levels": lambda image, _: image + draw_noise(image.shape, 25),
    "gray hole": cut_hole,
    "half slipped": slip_half,
    "step of light": lambda image, _: light_half(image),
}
"""Edits that everybody sees."""


def apply(edit: Edit, image: Image, lattice: Lattice) -> Image:
    """Return an edited image of 8 bits."""
    return quantize(np.clip(edit(image, lattice), 0, 1).astype(np.float32))
