"""What the elements of a texture share: coarse residuals that run on across their borders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values
from nrbench.plugins.forms import Shape

from ..lattice_places.equal_places import CellTorus
from .element_map import ElementMap, Numbers

_COARSE = 1 / 14
"""Standard deviation, in s, of the Gaussian by which the coarse part of a residual is told from its detail."""
_APART = 1 / 8
"""Distance, in s, of two places on both sides of a border."""
_LEAST_SHOWN = 0.4
"""Least share of an element that the sample must show, for its residual to be moved."""


def smooth_coarsely(residual: NDArray[np.floating[Any]], elements: ElementMap) -> NDArray[np.float64]:
    """Return the coarse part of a residual."""
    width = _COARSE * elements.lattice.s
    return np.asarray(scipy.ndimage.gaussian_filter(residual.astype(np.float64), (width, width, 0), mode="mirror"))


def measure_steps(residual: NDArray[np.floating[Any]], elements: ElementMap) -> float:
    """Return how far the coarse residuals on both sides of the borders of elements differ.

    It is the sum of their squared differences over the sum of their squares: about 1 if they are independent, 0 if they
    are equal.
    """
    coarse = smooth_coarsely(residual, elements)
    label, cell = elements.instances(residual.shape[:2])
    instance = np.concatenate([label[..., np.newaxis], cell], -1)
    apart = max(2, round(_APART * elements.lattice.s))
    steps = power = 1e-12
    for axis in (0, 1):
        here, there = (np.moveaxis(a, axis, 0) for a in (coarse, instance))
        border = (there[:-apart] != there[apart:]).any(-1)
        a, b = here[:-apart][border], here[apart:][border]
        steps += float(np.square(a - b).sum())
        power += float(np.square(a).sum() + np.square(b).sum())
    return steps / power


@dataclass(frozen=True, eq=False)
class CellField:
    """A random field with the covariance of a sample's coarse residual, within elements, across them and over cells.

    It is the spot noise (van Wijk 1991) of a lattice: the sum of copies of the residual, each moved by a lattice vector
    and times a random number. Each instance counts as far as the sample shows it, and is extended beyond the border of
    the sample, so that no border shows.

    Parameters
    ----------
    elements
        The elements, on whose grid the field is drawn.
    cells
        ``(n, 2)``: the cells of which the sample shows some instance.
    values
        ``float32 (n, V, U, C)``: the residual of their instances, without its mean, times their weight.
    """

    elements: ElementMap
    cells: Numbers
    values: Values

    @classmethod
    def fit(cls, elements: ElementMap, residual: NDArray[np.floating[Any]]) -> CellField:
        """Return the field of the coarse part of a residual."""
        cells = elements.cells(residual.shape[:2])
        shown = np.minimum([color.shown for color in elements.mean_colors(residual)], 1)
        shown[shown < _LEAST_SHOWN] = 0
        some = shown.any(0)
        weight = shown[:, some].T[:, elements.label, np.newaxis]
        v, u = elements.label.shape
        place = np.stack(np.meshgrid((np.arange(u) + 0.5) / u, (np.arange(v) + 0.5) / v), -1) - elements.offset
        x, y = np.moveaxis(elements.lattice.from_cell(cells[some][:, np.newaxis, np.newaxis] + place), -1, 0)
        planes = np.moveaxis(smooth_coarsely(residual, elements), -1, 0)
        read = [scipy.ndimage.map_coordinates(plane, [y, x], order=1, mode="nearest") for plane in planes]
        values = np.stack(read, -1)
        values -= (values * weight).sum(0) / weight.sum(0)
        values *= weight / np.sqrt(np.maximum(np.square(weight).sum(0) - 1, 1))
        return cls(elements, cells[some], values.astype(np.float32))

    def draw(self, shape: Shape, rng: np.random.Generator, torus: CellTorus | None = None) -> Values:
        """Return a field for a picture, ``(I, J, V, U, C)``: the instances on the box of :meth:`ElementMap.cells`."""
        cells = self.elements.cells(shape)
        if torus is None:
            torus = CellTorus.of(np.diag(np.array(cells.shape[:2]) + np.ptp(self.cells, 0)))
        i, j = np.moveaxis(torus.wrap(cells[:, :, np.newaxis] - self.cells), -1, 0)
        white = rng.standard_normal((torus.columns, torus.rows)).astype(np.float32)
        return np.asarray(np.tensordot(white[i, j], self.values, 1), np.float32)

    def render(self, field: Values, shape: Shape, rows: slice) -> NDArray[np.float64]:
        """Return the field at some rows of a picture."""
        top, bottom, _ = rows.indices(shape[0])
        row, column, cell = self.elements.places((bottom - top, shape[1]), (0, top))
        instance = cell + self.elements.offset[row, column] - self.elements.cells(shape)[0, 0]
        return np.asarray(field[instance[..., 0], instance[..., 1], row, column], np.float64)
