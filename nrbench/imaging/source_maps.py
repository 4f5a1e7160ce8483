"""Lay other maps of a sample out as an output: every pixel is read where the source map says."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ORDER: Final = 5
"""Order of the splines by which maps are read between pixels, as the methods read the sample."""
_UNIT = 0.05
"""Largest median difference from 1 of the lengths of the vectors of a normal map."""
_OPPOSED = 0.5
"""A mean of unit vectors that is shorter says little: the vectors lie more than 120 degrees apart."""


def lay_out(values: Floats, source: NDArray[np.float32], blended: NDArray[np.float32] | None = None) -> Floats:
    """Return the weighted means ``(H, W, C)`` of the values of a map ``(h, w, C)`` at the sources of each pixel.

    Parameters
    ----------
    values
        The map.
    source, blended
        As in :class:`~nrbench.plugins.forms.Synthesis`. Places between pixels are interpolated.
    """
    layers = [source] if blended is None else [source, *np.moveaxis(blended, 2, 0)]
    total = sum(layer[..., 2:].astype(np.float64) for layer in layers)
    planes = [scipy.ndimage.spline_filter(plane, ORDER, mode="mirror") for plane in np.moveaxis(values, -1, 0)]
    laid = np.zeros((*source.shape[:2], values.shape[2]))
    for layer in layers:
        between = (layer[..., :2] != np.rint(layer[..., :2])).any(-1) & (layer[..., 2] > 0)
        shown, at = _read_nearest(values, layer), layer[between][:, 1::-1].T
        for channel, plane in enumerate(planes if between.any() else ()):
            shown[between, channel] = scipy.ndimage.map_coordinates(plane, at, order=ORDER, mode="mirror", prefilter=False)
        laid += layer[..., 2:] / total * shown
    return np.clip(laid, values.min((0, 1)), values.max((0, 1)))


def _read_nearest(values: NDArray[Any], places: NDArray[Any]) -> NDArray[Any]:
    x, y = np.rint(places[..., :2]).astype(np.intp).clip(0, np.array(values.shape[1::-1]) - 1).T
    return np.asarray(values[y.T, x.T])


def follow_tints(values: Floats, tints: NDArray[np.float32], change: Floats) -> Floats:
    """Return by how much a map changes with the drawn colors of an output, ``(H, W, C)``: a linear regression.

    Parameters
    ----------
    values
        The map ``(h, w, C)``.
    tints
        As in :class:`~nrbench.plugins.forms.Synthesis`.
    change
        ``(H, W, c)``: the output, without what was copied from the sample.
    """
    own = _read_nearest(values, tints).reshape(-1, values.shape[2])
    colors = tints[..., 2:].reshape(-1, change.shape[2]).astype(np.float64)
    power = colors.T @ colors
    doubt = 1e-6 * np.trace(power) * np.eye(len(power)) + 1e-12
    return np.asarray(change @ np.linalg.solve(power + doubt, colors.T @ (own - own.mean(0))))


def are_normals(units: Floats) -> bool:
    """Return whether a map of values in [0, 1] holds unit vectors: 2 v - 1 has length 1 at most pixels."""
    if units.shape[2] != 3:
        return False
    return bool(np.median(np.abs(np.linalg.norm(2 * units - 1, axis=-1) - 1)) < _UNIT)


def normalize(units: Floats, nearest: Floats) -> Floats:
    """Return vectors of a normal map with length 1. Where the vectors that were blended oppose each other, the nearest.

    Parameters
    ----------
    units, nearest
        ``(H, W, 3)`` in [0, 1]: the means, and the values of the sources of the largest weights.
    """
    vectors = 2 * units - 1
    vectors = np.where(np.linalg.norm(vectors, axis=-1, keepdims=True) < _OPPOSED, 2 * nearest - 1, vectors)
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9) / 2 + 0.5)


def lay_out_map(
    values: Floats,
    peak: float,
    source: NDArray[np.float32],
    blended: NDArray[np.float32] | None,
    tints: tuple[NDArray[np.float32], Floats] | None,
) -> Floats:
    """Return a map as :func:`lay_out`, with the drawn colors, and with vectors of length 1 if it is a normal map.

    Parameters
    ----------
    values, source, blended
        As for :func:`lay_out`.
    peak
        The value that stands for 1.
    tints
        The arguments ``tints`` and ``change`` of :func:`follow_tints`; None if no colors were drawn.
    """
    laid = lay_out(values, source, blended)
    if tints is not None:
        laid = np.clip(laid + follow_tints(values, *tints), values.min((0, 1)), values.max((0, 1)))
    if not are_normals(values / peak):
        return laid
    copied = (source[..., :2] == np.rint(source[..., :2])).all(-1, keepdims=True)
    if blended is not None:
        copied &= blended[:, :, :1, 2] == 0
    nearest = _read_nearest(values, source)
    return np.where(copied, nearest, peak * normalize(laid / peak, nearest / peak))
