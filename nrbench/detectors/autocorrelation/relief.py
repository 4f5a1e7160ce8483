"""Whether an autocorrelation has separate peaks on a lattice, or ridges: two dimensions, or one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.topography_kernels import highest_ridge
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import Correlation
from nrbench.imaging.fold import fold
from nrbench.lattice.geometry import Lattice, Vector

LINES = 4
"""Lines in a pixel when stripes are taken out: with fewer, their edges leave steps, which form a lattice."""
FURTHEST = 512
"""px; the folded autocorrelation needs no lag beyond it."""
PERIODS = 6
"""Nor beyond so many of the longer generating vector, where that is more."""


@dataclass(frozen=True)
class Ridge:
    """The ridge of an autocorrelation that joins the peaks of a lattice.

    Parameters
    ----------
    relief
        By which share of their height the peaks stand above it: near 0 for a grating, whose peaks are one ridge; about
        1 where nothing joins them; more where it runs through negative correlations.
    direction
        The lattice vector (x, y) px along which it runs.
    """

    relief: float
    direction: Vector


def find_ridge(gamma: Correlation, lattice: Lattice, reach: tuple[int, int]) -> Ridge:
    """Return the highest ridge of the autocorrelation folded by a lattice, the surroundings of lag 0 left out.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    lattice
        Its generating vectors; the origin does not matter.
    reach
        Largest lag along x and y, px, that is looked at; no more than :data:`FURTHEST` px or :data:`PERIODS` are.
    """
    longest = float(np.abs(lattice.reduced().matrix).max())
    x_end, y_end = (min(end, max(FURTHEST, round(PERIODS * longest))) for end in reach)
    middle = gamma.shape[0] // 2
    right = gamma[middle - y_end : middle + y_end + 1, : x_end + 1]
    around = np.concatenate([right[::-1, :0:-1], right], 1)
    centred = Lattice(lattice.t1, lattice.t2, (x_end, y_end)).reduced()
    y, x = np.indices(around.shape)
    lags = np.stack([x - x_end, y - y_end], -1).astype(np.float64)
    others = np.asarray((np.abs(centred.wrap(lags) - lags) >= 0.5).any(-1))
    tile = fold(around[..., np.newaxis], centred, others).values[..., 0]
    level, *steps = highest_ridge(tile, np.argsort(-tile.ravel(), kind="stable"))
    direction = steps @ centred.matrix
    top = float(tile[0, 0])
    return Ridge(1 - float(level) / top if top > 0 else 0.0, (float(direction[0]), float(direction[1])))


def without_stripes(image: Image, direction: Vector) -> NDArray[np.float32]:
    """Return the image less its mean along each line of a direction, ``(H, W, C)``, any range.

    Parameters
    ----------
    image
        :data:`~nrbench.imaging.convert.Image`.
    direction
        (x, y), any length above 0. Each pixel is shared between the two lines it lies between.
    """
    y, x = np.indices(image.shape[:2])
    across = (y * direction[0] - x * direction[1]).ravel() / np.hypot(*direction) * LINES
    across -= across.min()
    line, share = np.floor(across).astype(np.intp), across % 1.0
    lines, shares = np.concatenate([line, line + 1]), np.concatenate([1 - share, share])
    counts = np.maximum(np.bincount(lines, shares), 1e-9)
    pixels = image.reshape(-1, image.shape[2])
    means = np.stack([np.bincount(lines, shares * np.tile(channel, 2)) / counts for channel in pixels.T], -1)
    stripes = (1 - share[:, np.newaxis]) * means[line] + share[:, np.newaxis] * means[line + 1]
    return np.asarray(image - stripes.reshape(image.shape), np.float32)
