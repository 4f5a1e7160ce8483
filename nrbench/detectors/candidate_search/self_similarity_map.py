"""The self-similarity map of an image: the autocorrelation of its colors, slopes and edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, crop_middle, shrink
from nrbench.imaging.correlation import Correlation, half_autocorrelation
from nrbench.imaging.masks import Mask
from nrbench.imaging.mean_tile import Values

LIGHTING = 3
"""Cosines of up to this number of half waves across the image are lighting, not texture."""
FINE = 0.7
"""Standard deviation, px, of the Gaussian that smooths the image before its slopes are computed."""
NEIGHBORHOOD = 1 / 6
"""Standard deviation, in shorter sides of the image, of the Gaussian window over which contrast is normalized."""
SIDE = 640
"""px; an image up to this side is analyzed in one view."""
MIN_SIDE = 24
"""px; no view is shrunk below this side."""


MARGIN = 3
"""px around pixels that do not count: there, slopes of the smoothed image show them."""


class SimilarityMap(NamedTuple):
    """Right halves of autocorrelations, ``(2H-1, W)`` each.

    Parameters
    ----------
    pooled
        The mean of the autocorrelations of colors, slopes and edges.
    colors
        The autocorrelation of the colors alone. Only the colors are linear in the pixels.
    """

    pooled: Correlation
    colors: Correlation


def compute_self_similarity(image: Image, known: Mask | None = None) -> SimilarityMap:
    """Compute the similarity of an image to its shifted self at each lag.

    Colors distinguish tiles that differ in hue only. Slopes show the joints of a wall whose bricks all differ in color.
    Edges show joints that are brighter as well as joints that are darker than their surroundings.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    known
        The pixels that count; None: all. Slopes within :data:`MARGIN` of others do not count; if they are most slopes,
        the colors alone are compared.
    """
    inner = known
    if known is not None:
        inner = scipy.ndimage.binary_erosion(known, iterations=MARGIN, border_value=1)
        if 2 * inner.sum() < known.sum():
            colors = half_autocorrelation(_without_lighting(image), known)
            return SimilarityMap(colors, colors)
    slopes = _slopes(image)
    edges = _without_lighting(np.sqrt(np.hypot(slopes[..., :1], slopes[..., 1:])))
    parts = (_without_lighting(image), known), (slopes, inner), (edges, inner)
    surfaces = [half_autocorrelation(values, count) for values, count in parts]
    return SimilarityMap(np.asarray(np.mean(surfaces, 0), np.float32), surfaces[0])


def _without_lighting(values: Values) -> Values:
    """Return values ``(H, W, C)`` without their slowest cosines (:data:`LIGHTING`)."""
    waves = scipy.fft.dctn(values, axes=(0, 1), norm="ortho")
    rows, columns = np.ogrid[: LIGHTING + 1, : LIGHTING + 1]
    slow = waves[: LIGHTING + 1, : LIGHTING + 1]
    slow[(rows**2 + columns**2 <= LIGHTING**2)[: slow.shape[0], : slow.shape[1]]] = 0
    return np.asarray(scipy.fft.idctn(waves, axes=(0, 1), norm="ortho"), np.float32)


def _slopes(image: Image) -> Values:
    """Return the slopes of the luminance along x and y over their local root mean square, ``(H, W, 2)``.

    So contrast that fades across the image has the same weight everywhere. Flat regions stay flat.
    """
    smooth = scipy.ndimage.gaussian_filter(image.mean(2), FINE)
    pair = np.stack([scipy.ndimage.sobel(smooth, 1), scipy.ndimage.sobel(smooth, 0)], -1)
    power = (pair**2).sum(-1)
    nearby = _blur(power, NEIGHBORHOOD * min(power.shape))
    return np.asarray(pair / np.sqrt(nearby + 1e-3 * power.mean() + 1e-12)[..., np.newaxis], np.float32)


def _blur(values: NDArray[np.float32], deviation: float) -> NDArray[np.float32]:
    """Return ``scipy.ndimage.gaussian_filter(values, deviation, truncate=2)``, ``(H, W)``.

    A symmetric filter on a mirrored image is a product of cosine transforms, which is much faster for a wide filter.
    """
    radius = int(2 * deviation + 0.5)
    taps = np.arange(-radius, radius + 1)
    window = np.exp(-0.5 * (taps / deviation) ** 2)
    waves = scipy.fft.dctn(values)
    for axis, length in enumerate(values.shape):
        response = np.cos(np.pi / length * np.outer(np.arange(length), taps)) @ (window / window.sum())
        waves *= np.expand_dims(response.astype(np.float32), 1 - axis)
    return np.asarray(scipy.fft.idctn(waves), np.float32)


def view_factors(shape: tuple[int, int]) -> list[int]:
    """Return the factors by which the views of an image of ``shape`` (height, width) are shrunk.

    The views show the image from the middle at full detail to the whole. Each covers twice the side of the one before
    at half its detail. Whatever the period, one of them shows many periods and resolves them well.
    """
    factors = [1]
    while max(shape) > factors[-1] * SIDE and min(shape) >= 2 * factors[-1] * MIN_SIDE:
        factors.append(2 * factors[-1])
    return factors


def view_mask(known: Mask | None, factor: int, side: int) -> Mask | None:
    """Return which pixels of the view that :func:`make_view` returns count: those of which all pixels do."""
    if known is None:
        return None
    return np.asarray(make_view(known[..., np.newaxis].astype(np.float32), factor, side)[..., 0] > 1 - 1e-3)


def make_view(image: Image, factor: int, side: int) -> Image:
    """Return the middle of an image, shrunk by a factor to at most ``side`` px a side."""
    return shrink(crop_middle(image, factor * side), factor)
