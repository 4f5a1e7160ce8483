"""Discriminate composite tiles, joined of parts that do not belong together, from whole tiles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from nrbench.imaging.mean_tile import Values
from nrbench.lattice.geometry import Points

from .elements import Box, Cutter

Rows = NDArray[np.float64]
"""``(n, p)``: each row holds the departures of one tile from the mean tile."""
Levels = NDArray[np.float64]
_LEAST_RATIO = 2.0
_MOST_DIRECTIONS = 24
_CUTS, _ASIDE = 16, (-0.2, 0.0, 0.2, 0.0)
"""Number of directions of the cuts through a tile, and the distances of successive cuts from its middle, in sides."""
_PARTNERS = (3, 7, 11, 17)
"""Each tile is joined to the tiles this many rows before it."""
_MARGIN = 3
"""Number of samples by which the windows that are blurred are larger on every side."""
_MOST_ALTERED = 48
"""Largest number of windows of an image that are altered to estimate second moments."""
_BLURS = (1.5, 3.0, 6.0)
"""Standard deviations of the blurs, px."""
_BENDS, _BEND, _SHIFT = 64, 0.05, 0.05
"""Number of bends; standard deviations of the entries of their matrix, and of their shift in units of s."""
_LIGHTS, _LIGHT_DISTANCES = 16, (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
"""Directions of uneven light, and the distances of its edge from the middle, over the length of the window in
this direction."""
_LIGHT_REACH, _LIGHT_STEP = 16.0, 0.3
"""Distance from its edge at which the light has faded, px, and its step at the edge, in values."""


@dataclass(frozen=True)
class WholeTiles:
    """Whole tiles.

    Parameters
    ----------
    rows
        ``(n, p)``: their departures from their mean.
    altered
        ``(p, p)``: second moments of the changes by alterations, from :func:`alteration_moments`.
    """

    rows: Rows
    altered: Rows


@dataclass(frozen=True)
class Discriminant:
    """Directions in the space of departures along which composite tiles vary and whole tiles do not.

    The colors of the elements in a tile span a subspace. All tiles of the texture lie in it, up to their noise, but
    composite tiles do not. Tiles that are blurred, unevenly lit or bent may leave it too. Other metrics measure these
    defects, so they count here as variation of whole tiles. The directions are generalized eigenvectors of the
    covariance of composite tiles against that of whole tiles (the discriminants of two Gaussians that differ in
    covariance: Fukunaga and Koontz, IEEE Transactions on Computers C-19, 1970). At most 24 are kept, along which
    composite tiles have more than twice the variance of whole ones.

    Parameters
    ----------
    directions
        ``(p, k)``.
    whole, composite
        ``(k,)``: variance of whole (and altered) tiles and of composite tiles along the directions, measured on other
        tiles than those that the directions were fitted to.
    """

    directions: Rows
    whole: Levels
    composite: Levels

    @classmethod
    def fit(cls, tiles: WholeTiles, others: WholeTiles, floor: Levels, samples: tuple[int, int]) -> Discriminant:
        """Fit the directions to whole tiles, and measure variances along them on others.

        Parameters
        ----------
        tiles, others
            At least two whole tiles each, ``p = samples channels``.
        floor
            ``(p,)``: least variance of each value, e.g. because tiles are cut a fraction of a pixel off.
        samples
            Number of samples along each side of a window.
        """
        inner = shrunk_covariance(tiles.rows) + tiles.altered + np.diag(floor)
        joins = compose_tiles(tiles.rows, samples)
        first = max(len(floor) - _MOST_DIRECTIONS, 0)
        _, directions = eigh(joins.T @ joins / len(joins), inner, subset_by_index=(first, len(floor) - 1))
        spared = floor @ directions**2 + np.einsum("pk,pk->k", directions, others.altered @ directions)
        whole = ((others.rows @ directions) ** 2).mean(0) + spared
        composite = ((compose_tiles(others.rows, samples) @ directions) ** 2).mean(0) + spared
        keep = composite > _LEAST_RATIO * whole
        return cls(directions[:, keep], whole[keep], composite[keep])

    def evidence(self, tiles: Rows) -> Levels:
        """Return twice the log-likelihood ratio of composite to whole for each tile, up to a constant, ``(n,)``."""
        return np.asarray((tiles @ self.directions) ** 2 @ (1 / self.whole - 1 / self.composite))


def shrunk_covariance(rows: Rows) -> Rows:
    """Return the covariance of rows with mean 0, shrunk toward its diagonal, ``(p, p)``.

    The weight of the diagonal is the expected squared error of the covariances over their sum of squares, so that it
    goes to 0 as the number of rows grows (Schaefer and Strimmer, Statistical Applications in Genetics and Molecular
    Biology 4, 2005).
    """
    n = len(rows)
    covariance = rows.T @ rows / max(n - 1, 1)
    squared = covariance**2
    error = ((rows**2).T @ rows**2 / n - squared) / n
    np.fill_diagonal(error, 0)
    np.fill_diagonal(squared, 0)
    weight = float(np.clip(error.sum() / max(float(squared.sum()), 1e-30), 0, 1))
    return np.asarray((1 - weight) * covariance + weight * np.diag(np.diag(covariance)))


def compose_tiles(tiles: Rows, samples: tuple[int, int]) -> Rows:
    """Return each tile joined to four others along cuts of 16 directions, through its middle or 0.2 sides beside it.

    Parameters
    ----------
    tiles
        ``(n, p)``, where p is the number of samples of a window, times 3 in a color image.
    samples
        Number of samples along each side of a window.
    """
    cut = np.resize(_cut_masks(samples, tiles.shape[1]), tiles.shape)
    return np.concatenate([np.where(cut, np.roll(tiles, partner, 0), tiles) for partner in _PARTNERS])


@lru_cache(maxsize=16)
def _cut_masks(samples: tuple[int, int], values: int) -> NDArray[np.bool_]:
    """Return for each cut which values come from the second tile, ``(16, values)``."""
    u, v = np.meshgrid(*((np.arange(n) + 0.5) / n - 0.5 for n in samples))
    angles = 2 * np.pi * np.arange(_CUTS)[:, np.newaxis, np.newaxis] / _CUTS
    aside = np.resize(_ASIDE, _CUTS)[:, np.newaxis, np.newaxis]
    beyond = np.cos(angles) * u + np.sin(angles) * v > aside
    return np.repeat(beyond.reshape(_CUTS, -1), values // (samples[0] * samples[1]), 1)


def alteration_moments(cutter: Cutter, middles: Points, box: Box) -> Rows:
    """Return the second moments of the changes that blur and bending make to whole windows, ``(p, p)``.

    Each window is blurred by three Gaussians, completely and on one side of a cut (the border of a blurred region runs
    through tiles). It is bent by a random affine map, about as strong as a displacement of 0.15 s that is smooth over
    2 s. Directions along which these changes vary are no evidence of composite tiles. Otherwise a blurred band or a
    warp would count as broken tiles.

    Parameters
    ----------
    cutter
        Cutter of an image with whole tiles.
    middles
        ``(n, 2)``: middles of at least one window inside the image.
    box
        The shape of the windows.
    """
    middles = middles[:: -(-len(middles) // _MOST_ALTERED)]
    wide = cutter.cut_around(middles, box, _MARGIN)
    own, channels = _rows(wide[:, _MARGIN:-_MARGIN, _MARGIN:-_MARGIN]), wide.shape[-1]
    flat = wide.reshape(len(wide), -1, channels)
    total = _moments(_rows(cutter.cut_around(middles, box, bends=_bends(cutter.lattice.s))) - own)
    cut = np.resize(_cut_masks(box.samples, own.shape[1]), own.shape)
    for deviation in _BLURS:
        change = _rows(np.einsum("qp,npc->nqc", _blur(box, deviation), flat, optimize=True)) - own
        total += _moments(change) + _moments(np.where(cut, change, 0))
    return total


def light_moments(box: Box, gray: Levels) -> Rows:
    """Return the second moments of the changes that uneven light makes to windows, ``(p, p)``.

    A window is lit from one side of a line, in all channels of the image alike, in many directions and at many
    distances.

    Parameters
    ----------
    box
        The shape of the windows.
    gray
        ``(k,)``: a step of one gray level along each axis of color of the windows.
    """
    lights = _lights(box)
    return _moments((lights[..., np.newaxis] * gray).reshape(len(lights), -1))


def _rows(values: Values) -> Rows:
    return values.reshape(len(values), -1).astype(np.float64)


def _moments(rows: Rows) -> Rows:
    return np.asarray(rows.T @ rows / len(rows))


def _blur(box: Box, deviation: float) -> NDArray[np.float32]:
    """Return the Gaussian weights that compute each sample of a window from those of a wide one, ``(n, wide_n)``."""
    away = box.offsets().reshape(-1, 1, 2) - box.offsets(_MARGIN).reshape(-1, 2)
    weights = np.exp(-(away**2).sum(-1) / (2 * deviation**2))
    return np.asarray(weights / weights.sum(1, keepdims=True), np.float32)


@lru_cache(maxsize=4)
def _bends(s: float) -> tuple[NDArray[np.float64], Points]:
    """Return random matrices ``(64, 2, 2)`` and shifts ``(64, 2)`` px, the same in every call."""
    normal = np.random.default_rng(0).standard_normal((_BENDS, 3, 2))
    return np.eye(2) + _BEND * normal[:, :2], _SHIFT * s * normal[:, 2]


def _lights(box: Box) -> Rows:
    """Return patterns that are bright on one side of a line and dark on the other, ``(112, n)``."""
    angles = 2 * np.pi * np.arange(_LIGHTS) / _LIGHTS
    normals = np.stack([np.cos(angles), np.sin(angles)])
    across, reach = box.offsets().reshape(-1, 2) @ normals, np.abs(box.sides @ normals).sum(0)
    beyond = across.T[:, np.newaxis] - np.array(_LIGHT_DISTANCES)[:, np.newaxis] * reach[:, np.newaxis, np.newaxis]
    weight = np.maximum(1 - np.abs(beyond) / _LIGHT_REACH, 0)
    return np.asarray((_LIGHT_STEP / 2 * np.where(beyond >= 0, weight, -weight)).reshape(-1, across.shape[0]))
