"""Survival of rare elements: whether what is damaged or odd in the texture is as frequent in the output."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.fold import Values

from .tileset import quarters
from .variety import Variety

_OUTLYING = 4.5
"""A window is odd when the logarithm of its worst spot exceeds the median by this many median absolute deviations."""
_SPOTS = 3
"""A window of half a tile is searched in this many spots along each side: damage comes in blots."""


def survival(
    variety: Variety, elements: Mapping[str, NDArray[np.float64]]
) -> tuple[float | None, str, dict[str, float]]:
    """Return the share of odd windows in the output over what is expected, or why there is none; and both shares.

    A window of half a tile is odd when the largest mean squared departure in any of 3 x 3 spots of it, relative to the
    texture's mean tile, is an outlier among the windows of sample and fresh draws: median plus 4.5 median absolute
    deviations, in logarithms. Expected is the share among those; where there are no fresh draws, in the sample alone,
    which scatters much where few are odd. Where the model tells its elements and none in the sample is damaged, nothing
    is rare: no method could know of it.

    Parameters
    ----------
    variety
        What is compared.
    elements
        Of the sample, see :class:`~nrbench.plugins.forms.Texture`; empty where they are not known.
    """
    damage = [rows for name, rows in elements.items() if name.endswith(".damage")]
    if elements and not any((rows > 0).any() for rows in damage):
        return None, "not applicable: no element of the sample is damaged or missing", {}
    own, right = _worst(quarters(variety.output.tiles), variety), [_worst(variety.windows, variety)]
    if variety.model:
        right += [_worst(quarters(tiles.tiles), variety) for tiles in variety.fresh]
    limit = _limit(np.concatenate(right))
    shares = {"odd_windows": float((own > limit).mean()), "odd_expected": float((np.concatenate(right) > limit).mean())}
    if not shares["odd_expected"]:
        return None, "not applicable: no window of the texture stands out from the rest", shares
    return shares["odd_windows"] / shares["odd_expected"], "", shares


def _worst(windows: Iterable[Values], variety: Variety) -> NDArray[np.float64]:
    """Return the logarithm of the worst spot of each window, given by quarters of the cell."""
    means, weights = quarters(variety.mean[np.newaxis])[:, 0], quarters(variety.weights[np.newaxis, ..., np.newaxis])
    found = [
        _spots(((part - mean) ** 2).mean(-1) * weight[0, ..., 0]).max((1, 2))
        for part, mean, weight in zip(windows, means, weights, strict=True)
    ]
    return np.asarray(np.log(np.concatenate(found).astype(np.float64) + 1e-8))


def _spots(squares: Values) -> Values:
    """Return the mean over each of 3 x 3 parts of windows ``(n, V, U)``."""
    rows, columns = (np.unique(np.linspace(0, side, _SPOTS + 1).astype(int)[:-1]) for side in squares.shape[1:])
    summed = np.add.reduceat(np.add.reduceat(squares, rows, 1), columns, 2)
    heights, widths = np.diff([*rows, squares.shape[1]]), np.diff([*columns, squares.shape[2]])
    return np.asarray(summed / (heights[:, np.newaxis] * widths), np.float32)


def _limit(values: NDArray[np.float64]) -> float:
    middle = float(np.median(values))
    return middle + _OUTLYING * float(np.median(np.abs(values - middle)))
