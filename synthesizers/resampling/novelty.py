"""How new a picture is beside a sample: the distances of its windows to what the sample shows at equal places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray
from skimage.color import rgb2lab

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Shape

from .element_map import ElementMap, Numbers
from .element_threads import ElementThread

_MOST_CELLS = 48
"""Largest number of cells that are compared."""
_PLACES = 8
"""Places along s at which windows are compared."""
_MOST_PLACES = 64
"""Largest number of places of a cell."""
_WIDTHS = (0.0, 1 / 6)
"""Standard deviations of windows, in s: of single colors, and of forms."""
_BORDER = 1.5
"""Distance, in px along both axes, from the border of an element at which nothing is compared: there, neighbors mix."""
_BLUR = 0.7
"""Standard deviation in px of the least blur before windows are read."""
_MOVES = tuple((x, y) for y in (-0.5, 0.0, 0.5) for x in (-0.5, 0.0, 0.5))
"""Distances (x, y) in px by which windows of the sample are moved; the middle one is none."""
_QUANTILE = 0.9
"""Quantile of the distances of windows to the nearest ones."""
_MOST_NEW = 1.3
"""Largest novelty of a draw, in that of the sample's own cells."""
_UNSEEN = 3.0
"""CIELAB units that are added to the latter: less is hardly seen."""


@dataclass(frozen=True)
class NoveltyTest:
    """Compares pictures with a sample, window by window, at the equal places of its cells.

    A window holds the colors around a place, within the element that the place is in: what two neighbors are need not
    have been seen side by side. Two sizes are compared, single colors and forms. A window is as new as it is far from
    the nearest one of the sample at the same place of a cell, moved by up to half a pixel. The windows of the sample
    itself are compared with those of other cells, and of other threads.

    Parameters
    ----------
    sample
        The sample.
    elements
        Its elements.
    threads
        The thread of each element.
    """

    sample: Image
    elements: ElementMap
    threads: Sequence[ElementThread]

    @property
    def shape(self) -> Shape:
        """Shape of the pictures that are compared: the sample's, or less if it shows more cells than are compared."""
        height, width = self.sample.shape[:2]
        lattice = self.elements.lattice
        side = round(math.sqrt(_MOST_CELLS) * max(math.hypot(*lattice.t1), math.hypot(*lattice.t2)) + 2 * lattice.s)
        return min(height, side), min(width, side)

    def _inner_cells(self, shape: Shape) -> Numbers:
        """Return the cells that lie inside a picture, at most 48, ``(n, 2)``."""
        box = self.elements.cells(shape).reshape(-1, 2)
        lattice = self.elements.lattice
        corners = lattice.from_cell(box[:, np.newaxis] + np.array([(0, 0), (1, 0), (0, 1), (1, 1)], float))
        slack, last = 0.1 * lattice.s, np.array(shape[::-1]) - 1
        cells = box[((corners >= -slack) & (corners <= last + slack)).all((1, 2))]
        if not len(cells):  # those of a skewed lattice reach far
            middle = corners.mean(1)
            cells = box[((middle >= 0) & (middle <= last)).all(-1)]
        return np.asarray(cells[:: -(-len(cells) // _MOST_CELLS) or 1])

    @cached_property
    def _places(self) -> Points:
        """The places (u, v) of a cell that are compared, at most 64."""
        lattice = self.elements.lattice
        u, v = (max(3, round(_PLACES * math.hypot(*t) / lattice.s)) for t in (lattice.t1, lattice.t2))
        grid = np.stack(np.meshgrid((np.arange(u) + 0.5) / u, (np.arange(v) + 0.5) / v), -1).reshape(-1, 2)
        inner = self._are_inside(grid[:, np.newaxis], grid)[:, 0]
        grid = grid[inner] if inner.any() else grid
        return np.asarray(grid[:: -(-len(grid) // _MOST_PLACES)])

    def _are_inside(self, places: Points, own: Points) -> NDArray[np.bool_]:
        """Return whether places ``(P, F, 2)`` lie inside the instances of others ``(P, 2)``, off their borders."""
        label, cell = self._instances(own[:, np.newaxis, np.newaxis])
        side = _BORDER * np.array([(0, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)])
        there = self._instances(places[:, :, np.newaxis] + side @ np.linalg.inv(self.elements.lattice.matrix))
        return np.asarray(((there[0] == label) & (there[1] == cell).all(-1)).all(-1))

    def _instances(self, places: Points) -> tuple[Numbers, Numbers]:
        """Return the element at places (u, v), and the cell of its instance."""
        cell = np.floor(places).astype(int)
        grid = np.array(self.elements.label.shape[::-1])
        u, v = np.moveaxis(np.minimum(((places - cell) * grid).astype(int), grid - 1), -1, 0)
        return self.elements.label[v, u], cell + self.elements.offset[v, u]

    def _are_apart(self, cells: Numbers) -> NDArray[np.bool_]:
        """Return whether the element at a place lies in different threads in two cells, ``(P, n, n)``."""
        label, offset = self._instances(self._places)
        numbers = [self.threads[k].number(cells + step) for k, step in zip(label.tolist(), offset, strict=True)]
        number = np.stack(numbers)
        return np.asarray((number[:, :, np.newaxis] != number[:, np.newaxis]).any(-1))

    def _read(self, picture: Image, width: float, moves: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
        """Return the windows around the places of all cells, each moved, ``(P, n, moves, F)``."""
        lattice, cells = self.elements.lattice, self._inner_cells(picture.shape[:2])
        spread = width * lattice.s
        step = np.linspace(-2, 2, 5) * spread if width else np.zeros(1)
        window = np.stack(np.meshgrid(step, step), -1).reshape(-1, 2)
        around = self._places[:, np.newaxis] + lattice.to_cell(window + lattice.origin)
        weight = self._are_inside(around, self._places).astype(float)
        weight[~weight.any(-1)] = 1
        if width:
            weight *= np.exp(-(window**2).sum(-1) / (2 * spread**2))
        weight = np.sqrt(weight / weight.sum(-1, keepdims=True))
        at = lattice.from_cell(cells + self._places[:, np.newaxis])[:, :, np.newaxis, np.newaxis] + window
        y, x = np.moveaxis(at + np.array(moves, float)[:, np.newaxis], -1, 0)[::-1]
        blur = max(_BLUR, 0.4 * spread)
        lab = rgb2lab(picture) if picture.shape[-1] == 3 else 100 * picture
        planes = np.moveaxis(scipy.ndimage.gaussian_filter(lab, (blur, blur, 0)), -1, 0)
        read = [scipy.ndimage.map_coordinates(plane, [y, x], order=1, mode="nearest") for plane in planes]
        windows = np.stack(read, -1) * weight[:, np.newaxis, np.newaxis, :, np.newaxis]
        return np.asarray(windows.reshape(*windows.shape[:3], -1))

    @cached_property
    def _known(self) -> list[NDArray[np.float64]]:
        return [self._read(self.sample, width, _MOVES) for width in _WIDTHS]

    @cached_property
    def own(self) -> NDArray[np.float64]:
        """The novelty of the cells of the sample, of their colors and forms, in CIELAB units."""
        apart = self._are_apart(self._inner_cells(self.sample.shape[:2]))
        return np.array([_measure(known[:, :, 4], known, apart) for known in self._known])

    def measure(self, picture: Image) -> NDArray[np.float64]:
        """Return the novelty of a picture, of its colors and of its forms, in CIELAB units."""
        windows = [self._read(picture, width, ((0.0, 0.0),))[:, :, 0] for width in _WIDTHS]
        return np.array([_measure(new, known) for new, known in zip(windows, self._known, strict=True)])

    def compare(self, picture: Image) -> float:
        """Return the novelty of a picture over that of the sample's own cells: of colors or forms, the larger."""
        return float((self.measure(picture) / (self.own + _UNSEEN)).max())

    def passes(self, picture: Image) -> bool:
        """Return whether a picture is about as near to the sample as the sample's cells are to each other."""
        return self.compare(picture) <= _MOST_NEW


def _measure(windows: NDArray[np.float64], known: NDArray[np.float64], among: NDArray[np.bool_] | None = None) -> float:
    """Return a quantile of the distances of windows to the nearest known ones at equal places."""
    places, count, moves, size = known.shape
    known = known.reshape(places, count * moves, size)
    square = (windows**2).sum(-1)[..., np.newaxis] + (known**2).sum(-1)[:, np.newaxis]
    square -= 2 * windows @ known.swapaxes(1, 2)
    if among is not None:
        square = np.where(np.repeat(among, moves, -1), square, np.inf)
    nearest = square.min(-1)
    seen = nearest[np.isfinite(nearest)]
    return float(np.sqrt(max(np.quantile(seen, _QUANTILE), 0))) if seen.size else math.inf
