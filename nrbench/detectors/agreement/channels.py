"""What of an image is compared when it is shifted: its colors, its slopes and its edges, slow lighting taken out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import Correlation, half_autocorrelation
from nrbench.imaging.fold import Values

LIGHTING = 3
"""Half waves across the image: cosines of up to so many are lighting, not texture."""
FINE = 0.7
"""Standard deviation, px, of the Gaussian under which slopes are taken."""
NEIGHBORHOOD = 1 / 6
"""Radius of the neighborhood, in shorter sides of the image, whose contrast counts as one."""


def without_lighting(values: Values) -> Values:
    """Return values ``(H, W, C)`` less their slowest cosines (:data:`LIGHTING`)."""
    waves = scipy.fft.dctn(values, axes=(0, 1), norm="ortho")
    rows, columns = np.ogrid[: LIGHTING + 1, : LIGHTING + 1]
    slow = waves[: LIGHTING + 1, : LIGHTING + 1]
    slow[(rows**2 + columns**2 <= LIGHTING**2)[: slow.shape[0], : slow.shape[1]]] = 0
    return np.asarray(scipy.fft.idctn(waves, axes=(0, 1), norm="ortho"), np.float32)


def slopes(image: Image) -> Values:
    """Return the luminance's slopes along x and y over their root mean square nearby, ``(H, W, 2)``.

    Contrast that fades across a picture counts alike everywhere; flat places stay flat.
    """
    smooth = ndimage.gaussian_filter(image.mean(2), FINE)
    pair = np.stack([ndimage.sobel(smooth, 1), ndimage.sobel(smooth, 0)], -1)
    power = (pair**2).sum(-1)
    nearby = ndimage.gaussian_filter(power, NEIGHBORHOOD * min(power.shape), truncate=2)
    return np.asarray(pair / np.sqrt(nearby + 1e-3 * power.mean() + 1e-12)[..., np.newaxis], np.float32)


def edges(pair: Values) -> Values:
    """Return how strong an edge each pixel of :func:`slopes` lies on, compressed by a square root, ``(H, W, 1)``."""
    return without_lighting(np.sqrt(np.hypot(pair[..., :1], pair[..., 1:])))


class Likeness(NamedTuple):
    """How like itself an image is at each lag: right halves of autocorrelations, ``(2H-1, W)`` each.

    Parameters
    ----------
    pooled
        The mean of those of colors, slopes and edges.
    colors
        That of the colors alone, the only linear one.
    """

    pooled: Correlation
    colors: Correlation


def likeness(image: Image) -> Likeness:
    """Return how like itself an image is at each lag.

    Each has what the others lack: colors tell tiles that only differ in hue, slopes keep the joints of a wall whose
    bricks all differ in color, edges keep joints of either sign.
    """
    pair = slopes(image)
    kinds = (without_lighting(image), pair, edges(pair))
    surfaces = [half_autocorrelation(kind) for kind in kinds]
    return Likeness(np.asarray(np.mean(surfaces, 0), np.float32), surfaces[0])
