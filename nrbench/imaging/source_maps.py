"""Lay other maps of a sample out as an output: every pixel is read where the source map says."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.errors import BadInput

Floats = NDArray[np.float64]

ORDER: Final = 5
"""Order of the splines by which maps are read between pixels, as the methods read the sample."""
_UNIT = 0.05
"""Largest median difference from 1 of the lengths of the vectors of a normal map."""
_LEVEL = 0.1
"""Largest mean x and y of vectors in [0, 1] that mostly point up."""
_LABELS = 16
"""Most distinct values of a map of labels or of a mask, which are not blended."""
_OPPOSED = 0.5
"""A mean of unit vectors that is shorter says little: the vectors lie more than 120 degrees apart."""


def lay_out(values: Floats, source: NDArray[np.float32], blended: NDArray[np.float32] | None = None) -> Floats:
    """Return the weighted means ``(H, W, C)`` of the values of a map ``(h, w, C)`` at the sources of each pixel.

    Parameters
    ----------
    values
        The map.
    source, blended
        As in :class:`~nrbench.plugins.forms.Synthesis`. Places between pixels are interpolated, and
        stay in the range of the map.
    """
    layers = [source] if blended is None else [source, *np.moveaxis(blended, 2, 0)]
    total = sum(layer[..., 2:].astype(np.float64) for layer in layers)
    planes = [scipy.ndimage.spline_filter(plane, ORDER, mode="mirror") for plane in np.moveaxis(values, -1, 0)]
    laid = np.zeros((*source.shape[:2], values.shape[2]))
    for layer in layers:
        between = (layer[..., :2] != np.rint(layer[..., :2])).any(-1) & (layer[..., 2] > 0)
        shown, at = read_nearest(values, layer), layer[between][:, 1::-1].T
        for channel, plane in enumerate(planes if between.any() else ()):
            read = scipy.ndimage.map_coordinates(plane, at, order=ORDER, mode="mirror", prefilter=False)
            shown[between, channel] = np.clip(read, values[..., channel].min(), values[..., channel].max())
        laid += layer[..., 2:] / total * shown
    return laid


def read_nearest(values: NDArray[Any], places: NDArray[Any]) -> NDArray[Any]:
    """Return the values ``(H, W, C)`` of a map at the pixels nearest to places (x, y), ``(H, W, 2 or more)``."""
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
    own = read_nearest(values, tints).reshape(-1, values.shape[2])
    colors = tints[..., 2:].reshape(-1, change.shape[2]).astype(np.float64)
    power = colors.T @ colors
    doubt = 1e-6 * np.trace(power) * np.eye(len(power)) + 1e-12
    return np.asarray(change @ np.linalg.solve(power + doubt, colors.T @ (own - own.mean(0))))


def as_layers_of_map(other: NDArray[Any], shape: tuple[int, ...]) -> Floats:
    """Return the channels of a map ``(h, w, C)``, for a normal map also the lengths of its vectors, 1 is half a peak.

    Raises
    ------
    BadInput
        Unless the map is finite and has the height and width of ``shape``, those of its sample.
    """
    size = np.shape(other)[:2]
    if size != shape[:2]:
        own, found = ("x".join(map(str, each[::-1])) for each in (shape[:2], size))
        raise BadInput(f"map: is {found} px, the sample {own}; all maps of a material need one size")
    values = np.asarray(other, np.float64).reshape(*size, -1)
    if not np.isfinite(values).all():
        raise BadInput("map: has NaN or infinite values; replace them first")
    units = values / _peak(other)
    return np.dstack([values, _lengths(units) * _peak(other) / 2]) if are_normals(units) else values


def _peak(other: NDArray[Any]) -> float:
    return float(np.iinfo(other.dtype).max) if other.dtype.kind in "iu" else 1.0


def _lengths(units: Floats) -> Floats:
    return np.asarray(np.linalg.norm(2 * units[..., :3] - 1, axis=-1, keepdims=True))


def are_normals(units: Floats) -> bool:
    """Return whether a map of values in [0, 1] holds normals, 2 v - 1: unit vectors, or such as mostly point up."""
    if units.shape[2] not in (3, 4):
        return False
    mean, up = units.mean((0, 1)), np.quantile(units[..., 2], 0.02)
    return bool(np.median(np.abs(_lengths(units) - 1)) < _UNIT or (up > 0.5 and np.abs(mean[:2] - 0.5).max() < _LEVEL))


def like_map(laid: Floats, other: NDArray[Any], nearest: Floats) -> NDArray[Any]:
    """Return layers that were laid out as a map, in the range of the one that they come from, with its dtype and axes.

    Means of the vectors of a normal map get the mean of their lengths, which is 1 if theirs are. Where the vectors
    oppose each other, the nearest one is taken. Labels, of which there are few, are never blended.

    Parameters
    ----------
    laid, nearest
        Means of the layers of :func:`as_layers_of_map`, and the layers of the sources of the largest weights; one array
        for both if the layers were drawn and have no sources.
    other
        The map.
    """
    channels, values = other.shape[2] if other.ndim > 2 else 1, other.reshape(*other.shape[:2], -1)
    low, high, is_drawn = values.min((0, 1)), values.max((0, 1)), nearest is laid
    if laid.shape[2] > channels:
        half = _peak(other) / 2
        vectors, lengths = laid[..., :3] / half - 1, _lengths(laid / (2 * half))
        wanted = laid[..., -1:] / half
        short = lengths < _OPPOSED * wanted
        vectors = np.where(short, nearest[..., :3] / half - 1, vectors * wanted / np.maximum(lengths, 1e-9))
        laid[..., :3] = half * (vectors + 1)
        low, high = np.minimum(low, 0), np.maximum(high, 2 * half)
    laid = np.clip(laid[..., :channels], low, high)
    labels = np.unique(other[::3, ::3].reshape(-1, channels), axis=0)
    if len(labels) <= _LABELS:
        laid = labels[scipy.spatial.KDTree(labels).query(laid)[1]] if is_drawn else nearest[..., :channels]
    if other.dtype.kind in "biu":
        laid = np.rint(laid)
    return laid.astype(other.dtype).reshape(*laid.shape[:2], *other.shape[2:])
