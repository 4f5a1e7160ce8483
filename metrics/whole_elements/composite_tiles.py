"""Tiles joined of parts that do not belong together: what they have that no tile of the texture has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

Rows = NDArray[np.float64]
"""``(n, p)``: one tile's departures from the mean tile a row."""
Levels = NDArray[np.float64]
_LEAST_RATIO = 2.0
_MOST_DIRECTIONS = 24
_CUTS, _ASIDE = 16, (-0.2, 0.0, 0.2, 0.0)
_PARTNERS = (3, 7, 11, 17)


@dataclass(frozen=True)
class Whole:
    """Tiles that are whole.

    Parameters
    ----------
    rows
        ``(n, p)``: their departures from their mean.
    altered
        ``(p, p)``: second moments of what altering them adds.
    """

    rows: Rows
    altered: Rows


@dataclass(frozen=True)
class Joint:
    """Directions in the space of departures along which joined tiles vary and whole tiles do not.

    The tones of the elements that a tile shows span a subspace, in which all tiles of the texture lie but for their
    noise. A tile that is joined of two parts leaves it. So may one that is blurred, lit or bent, which others judge
    (:func:`~nrbench.metrics.whole_elements.alterations.alterations`): what those show counts as if whole tiles varied so. Of the
    generalized eigenvectors of the covariance of joined tiles against that of whole ones (the discriminants of two
    Gaussians that differ in covariance: Fukunaga and Koontz, IEEE Transactions on Computers C-19, 1970) those are kept
    along which joined tiles have more than twice the variance of whole ones, at most 24.

    Parameters
    ----------
    directions
        ``(p, k)``.
    whole, joined
        ``(k,)``: variance of whole and of joined tiles along them, altered ones included, measured on tiles that they
        were not fitted to.
    """

    directions: Rows
    whole: Levels
    joined: Levels

    @classmethod
    def fit(cls, tiles: Whole, others: Whole, floor: Levels) -> Joint:
        """Fit the directions to whole tiles, and measure them on others.

        Parameters
        ----------
        tiles, others
            Whole tiles, ``p = samples^2 channels``, at least two.
        floor
            ``(p,)``: variance that each value has at least, e.g. because tiles are cut a fraction of a pixel off.
        """
        inner = tiles.rows.T @ tiles.rows / (len(tiles.rows) - 1) + tiles.altered + np.diag(floor)
        joins = joined(tiles.rows, len(floor))
        first = max(len(floor) - _MOST_DIRECTIONS, 0)
        _, directions = eigh(joins.T @ joins / len(joins), inner, subset_by_index=(first, len(floor) - 1))
        spared = floor @ directions**2 + np.einsum("pk,pk->k", directions, others.altered @ directions)
        whole = ((others.rows @ directions) ** 2).mean(0) + spared
        broken = ((joined(others.rows, len(floor)) @ directions) ** 2).mean(0) + spared
        keep = broken > _LEAST_RATIO * whole
        return cls(directions[:, keep], whole[keep], broken[keep])

    def evidence(self, tiles: Rows) -> Levels:
        """Return ``(n,)``: twice the log-likelihood ratio of joined to whole, but for its constant."""
        return np.asarray((tiles @ self.directions) ** 2 @ (1 / self.whole - 1 / self.joined))


def joined(tiles: Rows, values: int) -> Rows:
    """Return tiles each joined to four others, along cuts of 16 directions through the middle or a fifth beside it.

    Parameters
    ----------
    tiles
        ``(n, values)``.
    values
        Three times the number of samples of a square window, or once where the image is gray.
    """
    cut = np.resize(cuts(values), tiles.shape)
    return np.concatenate([np.where(cut, np.roll(tiles, partner, 0), tiles) for partner in _PARTNERS])


@lru_cache(maxsize=2)
def cuts(values: int) -> NDArray[np.bool_]:
    """Return which values each cut takes from the second tile, ``(16, values)``."""
    samples = math.isqrt(values)
    channels = 1 if samples**2 == values else 3
    samples = math.isqrt(values // channels)
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    v, u = np.meshgrid(steps, steps, indexing="ij")
    angles = 2 * np.pi * np.arange(_CUTS)[:, np.newaxis, np.newaxis] / _CUTS
    aside = np.resize(_ASIDE, _CUTS)[:, np.newaxis, np.newaxis]
    beyond = np.cos(angles) * u + np.sin(angles) * v > aside
    return np.repeat(beyond.reshape(_CUTS, -1), channels, 1)
