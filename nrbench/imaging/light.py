"""The light on a near-regular texture: what varies slowly from cell to cell, as a shadow or a dark corner does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

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
    light = np.zeros((*shape, 1))
    for _ in range(_ROUNDS if edges else 1):
        rest = seen - fold(np.asarray(seen - light, np.float32), lattice, known).unfold(shape)
        rest = (rest if known is None else fill_unknown(rest, known))[..., 0]
        light = (_find_light(rest, grid) if edges else _fit_polynomial(rest))[..., np.newaxis]
    return np.asarray(light[..., 0] - np.median(light))


def _find_light(rest: NDArray[Any], grid: Sequence[int]) -> NDArray[np.float64]:
    """Return the light with its edges, found on a coarse grid."""
    from scipy import ndimage  # light that is only named has no edges

    def resize(values: NDArray[Any], shape: Sequence[int]) -> NDArray[np.float64]:
        factors = [new / old for new, old in zip(shape, values.shape, strict=True)]
        return np.asarray(ndimage.zoom(values.astype(np.float64), factors, order=1, mode="mirror", grid_mode=True))

    blur = [(side / points - 1) / 2 for side, points in zip(rest.shape, grid, strict=True)]
    small = resize(ndimage.gaussian_filter(rest, blur, mode="mirror"), grid)
    slow = _fit_polynomial(small)
    return resize(slow + _find_edges(small - slow), rest.shape)


def _fit_polynomial(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the polynomial of degree 2 that fits an array of two dimensions best.

    Its terms are products of powers of x and of y, so its sums over the array are products of sums along the axes.
    """
    y, x = (np.linspace(-1, 1, side)[:, np.newaxis] ** np.arange(3) for side in values.shape)
    used = np.add.outer(np.arange(3), np.arange(3)).ravel() < 3
    products = np.kron(y.T @ y, x.T @ x)[used][:, used]
    factors = np.zeros(9)
    factors[used] = np.linalg.lstsq(products, (y.T @ values @ x).ravel()[used], rcond=None)[0]
    return np.asarray(y @ factors.reshape(3, 3) @ x.T)


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
