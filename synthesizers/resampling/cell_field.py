"""What the elements of a texture share: coarse residuals that run on across their borders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values, cell_coordinates
from nrbench.plugins.forms import Shape

from ..lattice_places.equal_places import CellTorus
from .element_map import ElementMap, Numbers

_PLACES = 20
"""Places of the field along s."""
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
    instance = np.ravel_multi_index(
        (label, *np.moveaxis(cell - cell.min((0, 1)), -1, 0)), (elements.count, *np.ptp(cell, (0, 1)) + 1)
    )
    apart = max(2, round(_APART * elements.lattice.s))
    steps = power = 1e-12
    for axis in (0, 1):
        here, there = (np.moveaxis(a, axis, 0) for a in (coarse, instance))
        border = there[:-apart] != there[apart:]
        a, b = here[:-apart][border], here[apart:][border]
        steps += float(np.square(a - b).sum())
        power += float(np.square(a).sum() + np.square(b).sum())
    return steps / power


@dataclass(frozen=True, eq=False)
class CellField:
    """A random field with the covariance of a sample's coarse residual, within elements, across them and over cells.

    It is the spot noise (van Wijk 1991) of a lattice: the sum of copies of the residual, each moved by a lattice vector
    and times a random number. Only instances that the sample shows whole are summed, and each element by its own
    number of them, so that no border of the sample shows.

    Parameters
    ----------
    elements
        The elements, on the grid of the field.
    cells
        ``(n, 2)``: the cells in which the sample shows an element whole.
    values
        ``float32 (n, V, U, C)``: the residual there, without its mean and over the root of the number of instances; 0
        where the element is not whole.
    """

    elements: ElementMap
    cells: Numbers
    values: Values

    @classmethod
    def fit(cls, elements: ElementMap, residual: NDArray[np.floating[Any]]) -> CellField:
        """Return the field of the coarse part of a residual."""
        height, width, channels = residual.shape
        lattice = elements.lattice
        grid = [max(6, round(_PLACES * float(np.hypot(*t)) / lattice.s)) for t in (lattice.t2, lattice.t1)]
        rows, columns = ((np.arange(n) + 0.5) / n for n in grid)
        at = np.ix_(*((a * n).astype(int) for a, n in zip((rows, columns), elements.label.shape, strict=True)))
        coarse = ElementMap(lattice, elements.label[at], elements.offset[at])
        box = coarse.cells((height, width))
        place = box[:, :, np.newaxis, np.newaxis] + np.stack(np.meshgrid(columns, rows), -1) - coarse.offset
        x, y = np.moveaxis(lattice.from_cell(place.reshape(-1, 2)), -1, 0)
        inside = ((x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)).reshape(place.shape[:-1])
        planes = np.moveaxis(smooth_coarsely(residual, elements), -1, 0)
        read = [scipy.ndimage.map_coordinates(plane, [y, x], order=1, mode="nearest") for plane in planes]
        values = np.stack(read, -1).reshape(*place.shape[:-1], channels)
        weight = np.zeros(inside.shape)
        for k in range(coarse.count):
            own = coarse.label == k
            shown = inside[..., own].mean(-1)
            shown = np.where(shown < _LEAST_SHOWN, 0, shown)[..., np.newaxis]
            mean = (values[..., own, :] * shown[..., np.newaxis]).sum((0, 1)) / shown.sum()
            values[..., own, :] -= mean
            weight[..., own] = shown / np.sqrt(max(np.square(shown).sum() - 1, 1))
        some = weight.any((2, 3))
        return cls(coarse, box[some], (values * weight[..., np.newaxis])[some].astype(np.float32))

    def draw(self, shape: Shape, rng: np.random.Generator, torus: CellTorus | None = None) -> Values:
        """Return a field for a picture, ``(J V, I U, C)``, on the box of :meth:`ElementMap.cells`."""
        box = self.elements.cells(shape).shape[:2]
        low = self.cells.min(0)
        span = self.cells.max(0) - low
        if torus is None:
            white = rng.standard_normal(box + span).astype(np.float32)
        else:
            i, j = np.moveaxis(torus.wrap(np.moveaxis(np.indices(box + span), 0, -1)), -1, 0)
            white = rng.standard_normal((torus.columns, torus.rows))[i, j].astype(np.float32)
        numbers = np.indices(box).reshape(2, -1, 1) + (span - self.cells + low).T[:, np.newaxis]
        moved = white[numbers[0], numbers[1]] @ self.values.reshape(len(self.values), -1)
        instances = moved.reshape(*box, *self.values.shape[1:])
        v, u = self.elements.label.shape
        row, column = np.indices((v, u))
        i, j = (
            np.clip(np.arange(n)[:, np.newaxis, np.newaxis] + self.elements.offset[..., k], 0, n - 1)
            for k, n in enumerate(box)
        )
        field = instances[i[:, np.newaxis], j[np.newaxis], row, column].transpose(1, 2, 0, 3, 4)
        return np.asarray(field.reshape(box[1] * v, box[0] * u, -1), np.float32)

    def render(self, field: Values, shape: Shape, rows: slice) -> NDArray[np.float64]:
        """Return the field at some rows of a picture."""
        top, bottom, _ = rows.indices(shape[0])
        corner = self.elements.cells(shape)[0, 0]
        cell = cell_coordinates(self.elements.lattice.shifted((0.0, -top)), (bottom - top, shape[1])) - corner
        v, u = self.elements.label.shape
        at = [cell[..., 1] * v - 0.5, cell[..., 0] * u - 0.5]
        planes = np.moveaxis(field, -1, 0)
        read = [scipy.ndimage.map_coordinates(plane, at, order=1, mode="nearest") for plane in planes]
        return np.stack(read, -1).astype(np.float64)
