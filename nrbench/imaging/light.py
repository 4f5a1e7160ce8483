"""The light on a near-regular texture: what varies slowly from cell to cell, as a shadow or a dark corner does."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import skimage.transform
from numpy.typing import NDArray
from skimage.restoration import denoise_tv_chambolle

from nrbench.imaging.convert import Image
from nrbench.imaging.masks import Mask, fill_unknown
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice

STRONG: Final = 2.2
"""Factor by which the light varies from which it is named. In even light it is at most 1.7 on brick, hexagon and weave
of color 0.5, intensity 0.3 and noise 0.1 (192 to 384 px, seeds 41 and 42), and at most 2.1 on bricks of color 1,
intensity 0.5 and noise 0.25 (256 and 384 px, seeds 41 to 46)."""
_PARTS = 3
"""Points of the grid of the light for each s."""
_WEIGHT = 3.0
"""Weight of the total variation, in standard deviations of what the mean tile does not explain on that grid."""
_BLACK = 0.01
"""Linear light that is added before the logarithm is taken, so that black has one."""
_GAMMA = 2.2
_ROUNDS = 3
"""How often the mean tile is taken from the picture in even light."""


def estimate_light(image: Image, lattice: Lattice, known: Mask | None = None) -> NDArray[np.float64]:
    """Return the logarithm of the light on a texture, ``(H, W)``; its median is 0.

    The logarithm of the linear luminance is compared with its mean tile. The rest is the light, and what tells elements
    from each other. Of this rest, the light is a polynomial of degree 2, and of what that leaves, the part of small
    total variation (Rudin, Osher and Fatemi 1992, Physica D 60): the tints of elements are averaged out, but the edge
    of a shadow stays.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        Its lattice.
    known
        The pixels that count; None: all.
    """
    shape = image.shape[0], image.shape[1]
    seen = np.log(np.mean(image.astype(np.float64) ** _GAMMA, -1, keepdims=True) + _BLACK)
    grid = [min(max(math.ceil(side * _PARTS / lattice.s), 2), side) for side in shape]
    y, x = np.mgrid[-1 : 1 : grid[0] * 1j, -1 : 1 : grid[1] * 1j]
    terms = np.stack([(x**i * y**j).ravel() for i in range(3) for j in range(3 - i)], -1)
    light = np.zeros((*shape, 1))
    for _ in range(_ROUNDS):
        rest = seen - fold(np.asarray(seen - light, np.float32), lattice, known).unfold(shape)
        rest = (rest if known is None else fill_unknown(rest, known))[..., 0]
        small = skimage.transform.resize(rest, grid, order=1, anti_aliasing=True)  # type: ignore[no-untyped-call]
        slow = (terms @ np.linalg.lstsq(terms, small.ravel(), rcond=None)[0]).reshape(small.shape)
        left = small - slow
        scatter = float(np.std(left - denoise_tv_chambolle(left, weight=1.0)))  # type: ignore[no-untyped-call]
        if scatter > 0:
            strength = {"weight": _WEIGHT * scatter, "eps": 1e-5, "max_num_iter": 400}
            slow += denoise_tv_chambolle(left, **strength)  # type: ignore[no-untyped-call]
        light = skimage.transform.resize(slow, shape, order=1)[..., np.newaxis]  # type: ignore[no-untyped-call]
    return np.asarray(light[..., 0] - np.median(light))


def divide_light(image: Image, light: NDArray[np.float64]) -> Image:
    """Return an image in even light: its linear values are divided by the light, all channels alike."""
    return np.asarray(np.clip(image * np.exp(-light / _GAMMA)[..., np.newaxis], 0, 1), np.float32)


def describe_light(light: NDArray[np.float64]) -> str:
    """Return by how much the light varies; empty if this is less than :data:`STRONG`."""
    factor = math.exp(np.ptp(np.quantile(light, (0.02, 0.98))))
    return f"the light on the sample varies by a factor of {factor:.1f}" if factor > STRONG else ""
