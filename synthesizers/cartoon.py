"""A reference: a cartoon of the sample, which knows its mean tile and its tints, and copies no detail."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

_PLACES = 6
"""Number of places along each lattice vector at which the middle of a cell is tried."""
_WHOLE = 0.6
"""Least share of a cell that the sample shows, for its color to count."""

Residual = NDArray[np.float64]
"""Sample minus mean tile, ``(H, W, C)``."""


@dataclass(frozen=True)
class Cartoon:
    """A cartoon of the sample: its mean tile, one flat tint a cell, and gray noise. It copies no detail.

    It shows what it is worth to know only the tints: what scores no better than this row has told nothing of the
    texture but its period, its mean colors and the strength of its grain.

    The output is the mean tile, laid on the lattice. To each cell one color is added. It is Gaussian, independent from
    cell to cell, with the covariance of the mean colors of the sample's cells. A cell is the Voronoi cell of a lattice
    point, or a box in a row of boxes, as a brick is. The shape and the place of the cells are those at which their mean
    colors vary most. If a cell holds several elements, as a crossing of threads does, all get the same tint. The noise
    is Gaussian, alike in all channels. Its variance is that of the rest of the sample: what neither the mean tile nor
    the tints explain, in the mean of the channels.

    Parameters
    ----------
    grain
        ``"short"``: the noise is smoothed by a Gaussian, so that neighboring pixels are as correlated as those of the
        sample's rest; ``"white"``: its pixels are independent.
    """

    grain: Literal["short", "white"] = "short"

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    finder: ClassVar[str] = "gncc"
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the cartoon. Draws of the same sample differ in tints and noise alone.

        Raises
        ------
        Refused
            When no lattice is found, or the sample shows fewer than two cells.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no mean tile to lay")
        tile = fold(task.sample, lattice.reduced())
        residual = np.asarray(task.sample - tile.unfold(task.sample.shape[:2]), np.float64)

        def spread(cells: _Cells) -> float:
            label = cells.number(residual.shape[:2])
            return float(_tints(residual, label, lattice.area).var(0).sum())

        cells = max(_Cells.all(tile.lattice), key=spread)
        label, row = cells.number(residual.shape[:2]), cells.number(task.shape)
        covariance = np.atleast_2d(np.cov(_tints(residual, label, lattice.area).T))
        rest = residual - _means(residual, label)[label]
        drawn = task.rng.multivariate_normal(np.zeros(len(covariance)), covariance, int(row.max()) + 1, method="eigh")
        image = tile.unfold(task.shape) + drawn[row] + self._noise(rest.mean(-1), task)[..., np.newaxis]
        return Synthesis(np.clip(image, 0, 1).astype(np.float32), lattice, detection_seconds=seconds)

    def _noise(self, rest: NDArray[np.float64], task: Task) -> NDArray[np.float64]:
        """Return noise of the standard deviation of ``rest`` and, with short grain, its correlation at 1 px."""
        noise = task.rng.standard_normal(task.shape)
        pairs = np.mean([(rest[1:] * rest[:-1]).mean(), (rest[:, 1:] * rest[:, :-1]).mean()])
        correlation = float(pairs / max(rest.var(), 1e-12))
        if self.grain == "short" and correlation > 0.01:
            # Smoothing white noise by a Gaussian of s px gives the correlation exp(-1 / (4 s^2)) at 1 px.
            width = 0.5 / math.sqrt(-math.log(min(correlation, 0.9)))
            noise = scipy.ndimage.gaussian_filter(noise, width, mode="wrap")
            kernel = np.exp(-(np.arange(-math.ceil(4 * width), math.ceil(4 * width) + 1) ** 2) / (2 * width**2))
            noise *= kernel.sum() ** 2 / (kernel**2).sum()
        return np.asarray(noise * rest.std())


@dataclass(frozen=True)
class _Cells:
    """The cells of a lattice, one of them around ``middle``: Voronoi cells, or boxes in rows along a lattice vector.

    ``basis`` holds the vector along a row and one to the next row; None: Voronoi cells.
    """

    lattice: Lattice
    basis: Points | None
    middle: Points

    def number(self, shape: Shape) -> NDArray[np.intp]:
        """Return the number of the cell that each pixel of a picture lies in."""
        y, x = np.indices(shape[:2])
        away = np.stack([x, y], -1) - self.middle
        if self.basis is None:
            numbers = np.rint((away - self.lattice.wrap(away)) @ np.linalg.inv(self.lattice.matrix))
        else:
            along, other = self.basis
            length = np.hypot(*along)
            axes = np.stack([along, (-along[1], along[0])], -1) / length
            shift, height = other @ axes
            right, down = np.moveaxis(away @ axes, -1, 0)
            row = np.rint(down / height)
            numbers = np.stack([np.rint((right - row * shift) / length), row], -1)
        offsets = numbers.astype(np.int64) - numbers.min((0, 1)).astype(np.int64)
        return np.asarray(np.ravel_multi_index((offsets[..., 0], offsets[..., 1]), tuple(offsets.max((0, 1)) + 1)))

    @classmethod
    def all(cls, lattice: Lattice) -> Iterator[_Cells]:
        """Yield the cells of each shape, with their middles all over one cell: boxes lie along the short vectors."""
        a, b = lattice.matrix
        places = lattice.from_cell(np.indices((_PLACES, _PLACES)).reshape(2, -1).T / _PLACES)
        for basis in (None, (a, b), (b, a), (a + b, a), (a - b, a)):
            yield from (cls(lattice, None if basis is None else np.stack(basis), place) for place in places)


def _tints(residual: Residual, label: NDArray[np.intp], area: float) -> Points:
    """Return the mean residual of each cell of which the sample shows enough, ``(n, C)``; ``area`` is a cell's."""
    shown = np.bincount(label.ravel()) >= _WHOLE * area
    if shown.sum() < 2:
        raise Refused(f"the sample shows fewer than two cells of {area:.0f} px^2; their colors cannot vary")
    return np.asarray(_means(residual, label)[shown])


def _means(residual: Residual, label: NDArray[np.intp]) -> Points:
    """Return the mean of each cell, ``(n, C)``."""
    sums = [np.bincount(label.ravel(), plane.ravel()) for plane in np.moveaxis(residual, -1, 0)]
    return np.stack(sums, -1) / np.maximum(np.bincount(label.ravel()), 1)[:, np.newaxis]
