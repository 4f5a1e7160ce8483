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

from .element_map import ElementMap, Numbers
from .element_threads import ElementThread

_MOST_CELLS = 48
"""Largest number of cells that are compared."""
_PLACES = 8
"""Places along s at which windows are compared."""
_MOST_PLACES = 100
"""Largest number of places of a cell."""
_WIDTHS = (0.0, 1 / 6)
"""Standard deviations of windows, in s: of single colors, and of forms."""
_BLUR = 0.7
"""Standard deviation in px of the least blur before windows are read."""
_MOVES = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Distances (x, y) in px by which windows of the sample are moved."""
_QUANTILES = (0.75, 0.9)
"""Quantiles, for the two widths, of the distances of windows to the nearest ones. A thread may have a color alone."""
_MOST_NEW = (1.5, 1.05)
"""Largest novelty of colors and of forms, in that of the sample's own cells."""
_UNSEEN = 0.5
"""CIELAB units of novelty that are not seen."""


@dataclass(frozen=True)
class NoveltyTest:
    """Compares pictures with a sample, window by window, at the equal places of its cells.

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

    @cached_property
    def _cells(self) -> Numbers:
        """The cells that lie inside the sample, at most 48, ``(n, 2)``."""
        box = self.elements.cells(self.sample.shape[:2]).reshape(-1, 2)
        lattice = self.elements.lattice
        corners = lattice.from_cell(box[:, np.newaxis] + np.array([(0, 0), (1, 0), (0, 1), (1, 1)], float))
        slack, last = 0.1 * lattice.s, np.array(self.sample.shape[1::-1]) - 1
        cells = box[((corners >= -slack) & (corners <= last + slack)).all((1, 2))]
        return np.asarray(cells[:: -(-len(cells) // _MOST_CELLS) or 1])

    @cached_property
    def _places(self) -> Points:
        """The places (u, v) of a cell that are compared, at most 100."""
        lattice = self.elements.lattice
        u, v = (max(3, round(_PLACES * math.hypot(*t) / lattice.s)) for t in (lattice.t1, lattice.t2))
        grid = np.stack(np.meshgrid((np.arange(u) + 0.5) / u, (np.arange(v) + 0.5) / v), -1).reshape(-1, 2)
        return np.asarray(grid[:: -(-len(grid) // _MOST_PLACES)])

    @cached_property
    def _apart(self) -> NDArray[np.bool_]:
        """Whether the element at a place lies in different threads in two cells, ``(P, n, n)``."""
        v, u = self.elements.label.shape
        at = (self._places[:, 1] * v).astype(int), (self._places[:, 0] * u).astype(int)
        label, offset = self.elements.label[at], self.elements.offset[at]
        numbers = [self.threads[k].number(self._cells + step) for k, step in zip(label.tolist(), offset, strict=True)]
        number = np.stack(numbers)
        return np.asarray((number[:, :, np.newaxis] != number[:, np.newaxis]).any(-1))

    def _read(self, picture: Image, width: float, moved: tuple[int, int] = (0, 0)) -> NDArray[np.float64]:
        """Return the windows around the places of all cells, ``(P, n, F)``."""
        lattice = self.elements.lattice
        spread = width * lattice.s
        step = np.linspace(-2, 2, 5) * spread if width else np.zeros(1)
        window = np.stack(np.meshgrid(step, step), -1).reshape(-1, 2)
        weight = np.exp(-(window**2).sum(-1) / (2 * spread**2)) if width else np.ones(1)
        at = lattice.from_cell(self._cells + self._places[:, np.newaxis])[:, :, np.newaxis] + window + np.array(moved)
        blur = max(_BLUR, 0.4 * spread)
        lab = scipy.ndimage.gaussian_filter(
            rgb2lab(picture) if picture.shape[-1] == 3 else 100 * picture, (blur, blur, 0)
        )
        planes = np.moveaxis(lab, -1, 0)
        read = [scipy.ndimage.map_coordinates(p, [at[..., 1], at[..., 0]], order=1, mode="nearest") for p in planes]
        windows = np.stack(read, -1) * np.sqrt(weight / weight.sum())[:, np.newaxis]
        return np.asarray(windows.reshape(*windows.shape[:2], -1))

    @cached_property
    def _known(self) -> list[NDArray[np.float64]]:
        """The windows of the sample of each width, and those moved by a pixel, ``(P, n, moves, F)``."""
        return [np.stack([self._read(self.sample, width, move) for move in _MOVES], 2) for width in _WIDTHS]

    @cached_property
    def own(self) -> NDArray[np.float64]:
        """The novelty of the cells of the sample, each beside those that share no thread with it."""
        return np.array(
            [_measure(known[:, :, 0], known, q, self._apart) for known, q in zip(self._known, _QUANTILES, strict=True)]
        )

    def measure(self, picture: Image) -> NDArray[np.float64]:
        """Return the novelty of a picture of the sample's shape, of its colors and of its forms, in CIELAB units."""
        parts = zip(_WIDTHS, self._known, _QUANTILES, strict=True)
        return np.array([_measure(self._read(picture, width), known, q) for width, known, q in parts])

    def passes(self, picture: Image) -> bool:
        """Return whether a picture is as near to the sample as the sample's cells are to each other."""
        return bool((self.measure(picture) <= np.array(_MOST_NEW) * (self.own + _UNSEEN)).all())


def _measure(
    windows: NDArray[np.float64], known: NDArray[np.float64], quantile: float, among: NDArray[np.bool_] | None = None
) -> float:
    """Return a quantile of the distances of windows to the nearest known ones at equal places."""
    places, count, moves, size = known.shape
    known = known.reshape(places, count * moves, size)
    square = (windows**2).sum(-1)[..., np.newaxis] + (known**2).sum(-1)[:, np.newaxis]
    square -= 2 * windows @ known.swapaxes(1, 2)
    if among is not None:
        square = np.where(np.repeat(among, moves, -1), square, np.inf)
    return float(np.sqrt(max(np.quantile(square.min(-1), quantile), 0)))
