"""A reference: a cartoon of the sample, which knows its mean tile, its tints and its grain, and copies no detail."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

_PLACES = 6
"""Number of places along each lattice vector at which the middle of a cell is tried."""
_WHOLE = 0.6
"""Least share of a cell that the sample shows, for its color to count."""
_REACH = 4.0
"""Standard deviation in px of the Gaussian by which the covariance of the grain is tapered."""

Residual = NDArray[np.float64]
"""Sample minus mean tile, ``(H, W, C)``."""


@dataclass(frozen=True)
class Cartoon:
    """A cartoon of the sample: its mean tile, one flat tint an element, and Gaussian grain. It copies no detail.

    It shows what it is worth to know only means and covariances: what scores no better than this row has told nothing
    of the texture but its period, its colors and the strength of its grain.

    The output is the mean tile, laid on the lattice. To each element one color is added. It is Gaussian, independent
    from element to element, with the covariance of the colors of the sample's elements. An element is the Voronoi cell
    of a lattice point; a box in a row of boxes, as a brick is; or a thread of a plain weave, which has one tint along
    its length. The shape and the place of the elements are those at which their mean colors vary most. Each place of
    the cell takes its own share of the tint, by least squares: a joint has none. The grain is Gaussian noise with the
    covariances, between channels and between pixels up to a few px apart, of what mean tile and tints leave.

    Parameters
    ----------
    grain
        ``"short"``: the grain has the covariances of the sample's rest, tapered by a Gaussian of 4 px; ``"white"``:
        its pixels are independent.
    """

    grain: Literal["short", "white"] = "short"

    reference: ClassVar[bool] = True
    finder: ClassVar[str] = "gncc"
    version: ClassVar[str] = "2"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the cartoon. Draws of the same sample differ in tints and grain alone.

        Raises
        ------
        Refused
            When no lattice is found, or the sample shows fewer than two cells.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no mean tile to lay")
        tile = fold(task.sample, lattice.reduced())
        shape = task.sample.shape[:2]
        residual = np.asarray(task.sample - tile.unfold(shape), np.float64)

        planes = np.moveaxis(residual, -1, 0).copy()

        def spread(cells: _Cells) -> float:
            label = cells.number(shape)
            return float(_means(planes, label)[_shown(label, lattice.area)].var(0).sum())

        cells = max(_Cells.all(tile.lattice), key=spread)
        label, row = cells.number(shape), cells.number(task.shape)
        share, tints = np.ones((*shape, 1)), _means(planes, label)
        for _ in range(2):
            tint = tints[label]
            moments = np.stack([(residual * tint).sum(-1), (tint**2).sum(-1)], -1).astype(np.float32)
            folded = fold(moments, tile.lattice)
            folded.values[..., 0] /= np.maximum(folded.values[..., 1], 1e-9)
            share = np.clip(folded.unfold(shape)[..., :1], 0, 2)
            tints = _means(planes * share[..., 0], label) / np.maximum(
                _means(share[np.newaxis, ..., 0] ** 2, label), 1e-3
            )
        seen = tints[_shown(label, lattice.area)]
        drawn = task.rng.multivariate_normal(
            np.zeros(seen.shape[1]), np.atleast_2d(np.cov(seen.T)), int(row.max()) + 1, method="eigh"
        )
        image = tile.unfold(task.shape) + np.clip(folded.unfold(task.shape)[..., :1], 0, 2) * drawn[row]
        rest = residual - share * tints[label]
        level = fold((rest**2).mean(-1, dtype=np.float32)[..., np.newaxis], tile.lattice)
        strength, laid = (np.sqrt(level.unfold(size) + 1e-9) for size in (shape, task.shape))
        image += laid * self._draw_grain(rest / strength, task)
        return Synthesis(np.clip(image, 0, 1).astype(np.float32), lattice, detection_seconds=seconds)

    def _draw_grain(self, rest: Residual, task: Task) -> Residual:
        """Return Gaussian noise of the covariances of ``rest``, ``(H, W, C)``; with white grain those at 0 px only."""
        (height, width), room = task.shape, (2 * rest.shape[0], 2 * rest.shape[1])
        spectrum = np.fft.rfft2(rest, room, axes=(0, 1))
        lagged = np.fft.irfft2(spectrum[..., np.newaxis] * spectrum.conj()[..., np.newaxis, :], room, axes=(0, 1))
        y, x = (np.rint(np.fft.fftfreq(n, 1 / n)).astype(int) for n in (height, width))
        squared = (y**2)[:, np.newaxis] + x**2
        taper = np.exp(-squared / (2 * _REACH**2)) if self.grain == "short" else 1.0 * (squared == 0)
        taper[(np.abs(y) >= rest.shape[0])[:, np.newaxis] | (np.abs(x) >= rest.shape[1])] = 0
        covariance = lagged[y[:, np.newaxis] % room[0], x % room[1]] / (rest.shape[0] * rest.shape[1])
        values, axes = np.linalg.eigh(np.fft.rfft2(covariance * taper[..., np.newaxis, np.newaxis], axes=(0, 1)))
        white = np.fft.rfft2(task.rng.standard_normal((height, width, rest.shape[2])), axes=(0, 1))
        colored = np.sqrt(np.maximum(values, 0))[..., np.newaxis] * (axes.conj().swapaxes(-1, -2) @ white[..., None])
        return np.asarray(np.fft.irfft2((axes @ colored)[..., 0], task.shape, axes=(0, 1)))


@dataclass(frozen=True)
class _Cells:
    """The elements of a lattice, one of them around ``middle``: Voronoi cells, boxes in rows, or threads.

    ``basis`` holds the vector along a row and one to the next row; None: Voronoi cells. If ``woven``, it holds the
    vectors from a crossing to the next, above and below alternating, and all crossings of one thread have its number.
    """

    lattice: Lattice
    basis: Points | None
    middle: Points
    woven: bool = False

    def number(self, shape: Shape) -> NDArray[np.intp]:
        """Return the number of the element that each pixel of a picture lies in."""
        y, x = np.indices(shape[:2])
        away = np.stack([x, y], -1) - self.middle
        if self.basis is None:
            column, row = np.moveaxis(
                np.rint((away - self.lattice.wrap(away)) @ np.linalg.inv(self.lattice.matrix)), -1, 0
            )
        elif self.woven:
            first, second = np.moveaxis(np.rint(away @ np.linalg.inv(self.basis)), -1, 0)
            row = (first + second) % 2
            column = np.where(row == 0, first, second)
        else:
            along, other = self.basis
            length = np.hypot(*along)
            axes = np.stack([along, (-along[1], along[0])], -1) / length
            shift, height = other @ axes
            right, down = np.moveaxis(away @ axes, -1, 0)
            row = np.rint(down / height)
            column = np.rint((right - row * shift) / length)
        column, row = (number.astype(np.intp) - int(number.min()) for number in (column, row))
        return np.asarray(column * (row.max() + 1) + row)

    @classmethod
    def all(cls, lattice: Lattice) -> Iterator[_Cells]:
        """Yield the elements of each shape, with their middles all over one cell: boxes lie along the short vectors."""
        a, b = lattice.matrix
        places = lattice.from_cell(np.indices((_PLACES, _PLACES)).reshape(2, -1).T / _PLACES)
        for basis in (None, (a, b), (b, a), (a + b, a), (a - b, a)):
            yield from (cls(lattice, None if basis is None else np.stack(basis), place) for place in places)
        yield from (cls(lattice, np.stack([a + b, a - b]) / 2, place, woven=True) for place in places)


def _shown(label: NDArray[np.intp], area: float) -> NDArray[np.bool_]:
    """Return the elements of which the sample shows enough, ``(n,)``; ``area`` is that of a cell, px^2."""
    shown = np.bincount(label.ravel()) >= _WHOLE * area
    if shown.sum() < 2:
        raise Refused(f"the sample shows fewer than two cells of {area:.0f} px^2; their colors cannot vary")
    return np.asarray(shown)


def _means(planes: Residual, label: NDArray[np.intp]) -> Points:
    """Return the mean of planes ``(C, H, W)`` over each element, ``(n, C)``."""
    sums = [np.bincount(label.ravel(), plane.ravel()) for plane in planes]
    return np.stack(sums, -1) / np.maximum(np.bincount(label.ravel()), 1)[:, np.newaxis]
