"""The light on a near-regular texture: what varies slowly from cell to cell, as a shadow or a dark corner does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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


def estimate_light(
    image: Image, lattice: Lattice, known: Mask | None = None, edges: bool = True
) -> NDArray[np.float64]:
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
    edges
        Whether edges of shadows are found. Without, the light is the polynomial alone, in a fraction of the time.
    """
    shape = image.shape[0], image.shape[1]
    seen = np.log(np.mean(image.astype(np.float64) ** _GAMMA, -1, keepdims=True) + _BLACK)
    grid = [min(max(math.ceil(side * _PARTS / lattice.s), 2), side) for side in shape]
    y, x = np.mgrid[-1 : 1 : grid[0] * 1j, -1 : 1 : grid[1] * 1j]
    terms = np.stack([(x**i * y**j).ravel() for i in range(3) for j in range(3 - i)], -1)
    light = np.zeros((*shape, 1))
    for _ in range(_ROUNDS if edges else 1):
        rest = seen - fold(np.asarray(seen - light, np.float32), lattice, known).unfold(shape)
        rest = (rest if known is None else fill_unknown(rest, known))[..., 0]
        blur = [(side / points - 1) / 2 for side, points in zip(shape, grid, strict=True)]
        small = _resize(ndimage.gaussian_filter(rest, blur, mode="mirror"), grid)
        slow = (terms @ np.linalg.lstsq(terms, small.ravel(), rcond=None)[0]).reshape(small.shape)
        light = _resize(slow + _find_edges(small - slow) if edges else slow, shape)[..., np.newaxis]
    return np.asarray(light[..., 0] - np.median(light))


def _resize(values: NDArray[Any], shape: Sequence[int]) -> NDArray[np.float64]:
    factors = [new / old for new, old in zip(shape, values.shape, strict=True)]
    return np.asarray(ndimage.zoom(values.astype(np.float64), factors, order=1, mode="mirror", grid_mode=True))


def _find_edges(rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of small total variation."""
    from skimage.restoration import denoise_tv_chambolle  # few pictures need it, and it imports statistics

    scatter = float(np.std(rest - denoise_tv_chambolle(rest, weight=1.0)))  # type: ignore[no-untyped-call]
    if scatter == 0:
        return rest
    strength = {"weight": _WEIGHT * scatter, "eps": 1e-5, "max_num_iter": 400}
    return np.asarray(denoise_tv_chambolle(rest, **strength))  # type: ignore[no-untyped-call]


def divide_light(image: Image, light: NDArray[np.float64]) -> Image:
    """Return an image in even light: its linear values are divided by the light, all channels alike."""
    return np.asarray(np.clip(image * np.exp(-light / _GAMMA)[..., np.newaxis], 0, 1), np.float32)


def describe_light(light: NDArray[np.float64]) -> str:
    """Return by how much the light varies; empty if this is less than :data:`STRONG`."""
    factor = math.exp(np.ptp(np.quantile(light, (0.02, 0.98))))
    return f"the light on the sample varies by a factor of {factor:.1f}" if factor > STRONG else ""
