"""What an eye sees of a picture, and of a cell of its texture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import skimage.color
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, gray
from nrbench.plugins.forms import Shape

from . import limits
from .blur_kernels import blur_plane

Lab = NDArray[np.float32]
"""``(H, W, 4)``: L*, a* and b* as they are seen, and L* before its blur."""


_DIM = 0.5
_BAND = 1 << 19


def perceive(image: Image) -> Lab:
    """Return what is seen of an image: CIELAB, in which chroma is blurred more than luminance.

    This is S-CIELAB (Zhang and Wandell, "A spatial extension of CIELAB", 1997) with one Gaussian for each channel, for
    a screen of 96 dpi seen from 57 cm: 1 px is 1.6 arc minutes. The fourth plane is L* without blur. Only changes of
    the finest grain are measured on it.

    Parameters
    ----------
    image
        ``(H, W, C)`` in [0, 1], with 1 or 3 channels.
    """
    lab = skimage.color.rgb2lab(np.broadcast_to(image, (*image.shape[:2], 3))).astype(np.float32)
    sigmas = (limits.BLUR, limits.CHROMA_BLUR, limits.CHROMA_BLUR)
    seen = [smooth_plane(lab[..., k], sigma, mirrored=False) for k, sigma in enumerate(sigmas)]
    return np.stack([*seen, lab[..., 0]], -1)


@dataclass(frozen=True, eq=False)
class SeenSample:
    """What is seen of a sample. Equal samples give one object, so that what is learned from it can be cached."""

    lab: Lab
    known: NDArray[np.bool_] | None = None
    """The pixels that count; None: all."""

    @property
    def shape(self) -> Shape:
        """Shape of the sample."""
        return self.lab.shape[0], self.lab.shape[1]


def perceive_sample(sample: Image, known: NDArray[np.bool_] | None = None) -> SeenSample:
    """Return what is seen of a sample; cached, because many outputs have one sample."""
    mask = b"" if known is None else known.tobytes()
    return _perceive_pixels(np.ascontiguousarray(sample, np.float32).tobytes(), sample.shape, mask)


@lru_cache(maxsize=4)
def _perceive_pixels(pixels: bytes, shape: tuple[int, ...], mask: bytes) -> SeenSample:
    known = np.frombuffer(mask, np.bool_).reshape(shape[:2]) if mask else None
    return SeenSample(perceive(np.frombuffer(pixels, np.float32).reshape(shape)), known)


def draw_in_bands(output: Image, draw: Callable[[Image, int], Image]) -> Image:
    """Return what a function draws on bands of an image, of about half a million pixels, from their first rows on."""
    step, drawn = max(_BAND // output.shape[1], 1), np.empty((*output.shape[:2], 3), np.float32)
    for top in range(0, output.shape[0], step):
        drawn[top : top + step] = draw(output[top : top + step], top)
    return drawn


def tint_places(image: Image, marked: NDArray[np.bool_], tint: NDArray[Any]) -> Image:
    """Return an image in faint gray, with n marked places, ``(H, W)``, in a color, (3,), or in colors, ``(n, 3)``."""
    faint = np.repeat((1 - _DIM + _DIM * gray(image))[..., np.newaxis], 3, 2)
    faint[marked] = (1 - _DIM) * faint[marked] + _DIM * tint
    return np.asarray(np.clip(faint, 0, 1), np.float32)


def smooth_plane(plane: NDArray[np.float32], sigma: float, mirrored: bool = True) -> NDArray[np.float32]:
    """Return a plane blurred by a Gaussian of three standard deviations ``sigma`` px; it is mirrored at the border.

    If not ``mirrored``, it has the values of the nearest pixel there.
    """
    return blur_plane(np.ascontiguousarray(plane, np.float32), _find_weights(sigma), mirrored)


@lru_cache(maxsize=16)
def _find_weights(sigma: float) -> NDArray[np.float64]:
    """Return the weights of a Gaussian cut at three standard deviations, from the middle one to the last."""
    weights = np.exp(-0.5 / sigma**2 * np.arange(int(3 * sigma + 0.5) + 1) ** 2)
    return np.asarray(weights / (2 * weights.sum() - 1))


def _level(energy: NDArray[Any], unseen: float = limits.BAND_OFFSET) -> NDArray[Any]:
    """Return 20 ln of the amplitude of an energy, plus the amplitude that is not seen."""
    # Into a plane of its own: in a strided view numpy takes thirty times as long.
    level: NDArray[Any] = energy + np.float32(unseen**2)
    np.log(level, out=level)
    level *= 10
    return level


def _halve(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the means of 2 x 2 pixels."""
    a = plane[: plane.shape[0] // 2 * 2, : plane.shape[1] // 2 * 2]
    return np.asarray(((a[::2, ::2] + a[::2, 1::2]) + (a[1::2, ::2] + a[1::2, 1::2])) * np.float32(0.25))


def measure_looks(lab: Lab) -> NDArray[np.float32]:
    """Return the local features of appearance at each pixel, ``(H, W, 9)``.

    They are the mean L*, a* and b*; the level of the finest grain (the second differences along both axes); the levels
    of three octaves of L*; and the levels of a* and b* below 6 px. A level is 20 ln of the local amplitude plus the
    amplitude that is not seen. Its mean over a window weighs dark joints and flat elements alike, so that strong edges
    do not hide a change of the grain between them.
    """
    raw, before, looks = lab[..., 3], lab[..., 0], np.empty((*lab.shape[:2], 9), np.float32)
    looks[..., :3] = lab[..., :3]
    grain = np.zeros_like(raw)
    grain[1:-1, 1:-1] = np.diff(np.diff(raw, 2, 0), 2, 1) / 6
    looks[..., 3] = _level(smooth_plane(grain * grain, 1.5), limits.GRAIN_OFFSET)
    del grain  # large, as are the planes that follow
    for k, (sigma, reach) in enumerate(((1.2, 2), (2.4, 2), (5.0, 3)), 4):
        octave = smooth_plane(raw, sigma)
        before = before - octave
        before *= before
        looks[..., k] = _level(smooth_plane(before, reach))
        before = octave
    for k in (1, 2):
        tint = lab[..., k] - smooth_plane(lab[..., k], 6)
        tint *= tint
        looks[..., 6 + k] = _level(smooth_plane(tint, 4), limits.JND)
    return looks


def measure_detail(lab: Lab) -> NDArray[np.float32]:
    """Return local features of the kind of detail, of every second pixel, ``(H // 2, W // 2, 8)``.

    For each of two octaves p of L*, with levels 20 ln as in :func:`measure_looks`: the level of its slope along x over
    that along y, and the same for the diagonals, which show streaks and relief under a light; the level of its
    amplitude within 3 px over that at a place, which shows speckles and other detail that comes in clusters; and the
    level of what is brighter than its surroundings over that of what is darker. None of them changes with the contrast.
    The second octave has every second pixel; both the even and the odd ones are measured, since elements of whole
    pixels lie on either.
    """

    def measure(octave: NDArray[np.float32], low: NDArray[np.float32]) -> Iterator[NDArray[Any]]:
        down, right = (np.asarray(slope, np.float32) for slope in np.gradient(octave))
        yield _level(right**2) - _level(down**2)
        yield _level((right + down) ** 2 / 2) - _level((right - down) ** 2 / 2)
        del down, right  # large
        band = octave - low
        near = smooth_plane(band * band, 1)
        yield _level(smooth_plane(near, 3)) - _level(near)
        bright = smooth_plane(np.maximum(band, 0) ** 2, 2)
        yield _level(bright) - _level(np.maximum(smooth_plane(band * band, 2) - bright, 0))

    height, width = lab.shape[0] // 2, lab.shape[1] // 2
    low = smooth_plane(lab[..., 0], 1.2)
    fine = [_halve(plane) for plane in measure(lab[..., 0], low)]
    halves = ((half, smooth_plane(half, 1.2)) for half in (low[::2, ::2], low[1::2, 1::2]))
    even, odd = (measure(*each) for each in halves)
    coarse = [(a[:height, :width] + b[:height, :width]) / 2 for a, b in zip(even, odd, strict=True)]
    return np.stack([*fine, *coarse], -1)


def measure_levels(lab: Lab) -> NDArray[np.float32]:
    """Return the levels of oriented detail, of every second pixel, ``(H // 2, W // 2, 12)``.

    They are those of the slopes along x, along y and along both diagonals of three octaves of L*, smoothed over about
    1.2 px of the octave. A level is 20 ln of the amplitude plus what is not seen, as in :func:`measure_looks`.
    """
    height, width = lab.shape[0] // 2, lab.shape[1] // 2
    octave, planes = lab[..., 3], []
    for number in range(3):
        low = smooth_plane(octave, 1.2)
        down, right = (np.asarray(slope, np.float32) for slope in np.gradient(octave - low))
        for slope in (right, down, (right + down) * np.float32(0.5**0.5), (right - down) * np.float32(0.5**0.5)):
            energy = smooth_plane(slope * slope, 1.2)
            level = _level(_halve(energy) if number == 0 else energy)
            planes.append(level.repeat(2, 0).repeat(2, 1)[:height, :width] if number == 2 else level[:height, :width])
        octave = low[::2, ::2]
    return np.asarray(np.stack(planes, -1), np.float32)


def measure_plateaus(lab: Lab) -> NDArray[np.float32]:
    """Return whether a pixel has the L* of the next one, within a quarter of a JND, ``(H, W, 1)``: 0, 1/2 or 1.

    The mean of the next one along x and of that along y; pictures of few tones have plateaus even where there is grain.
    """
    raw = lab[..., 3]
    alike = [np.abs(np.diff(raw, axis=axis, append=np.take(raw, [-2], axis))) < limits.JND / 4 for axis in (0, 1)]
    return np.asarray((alike[0] * np.float32(0.5) + alike[1] * np.float32(0.5))[..., np.newaxis])
