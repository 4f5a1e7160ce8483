"""How new a picture is beside a sample: the distances of its colors to those of the sample at equal places."""

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
from nrbench.imaging.mean_tile import Values, interpolate
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Shape

from .element_map import ElementMap, ElementShares, Numbers
from .element_threads import ElementThread

_MOST_CELLS = 48
"""Largest number of cells that are compared."""
_MOST_PLACES = 64
"""Largest number of places of a cell."""
_BORDER = (0.75, 0.97)
"""Places are compared whose element has this share after a Gaussian of so many px: at its border, neighbors mix."""
_BLUR = 0.7
"""Standard deviation in px of the blur before colors are read."""
_MOVES = np.stack(np.meshgrid((-0.5, 0, 0.5), (-0.5, 0, 0.5)), -1).reshape(-1, 2)
"""Distances (x, y) in px by which places of the sample are moved."""
_QUANTILE = 0.9
"""Quantile of the distances of colors to the nearest ones."""
_MOST_NEW = 1.3
"""Largest novelty of a draw, in that of the sample's own cells."""
_UNSEEN = 3.0
"""CIELAB units that are added to the latter: less is hardly seen."""


@dataclass(frozen=True)
class NoveltyTest:
    """Compares pictures with a sample at the equal places of its cells.

    A color is as new as it is far from the nearest one of the sample at the same place of a cell, moved by up to half a
    pixel. Places on the borders of elements are left out: what two neighbors are need not have been seen side by side.
    The colors of the sample itself are compared with those of other cells, and of other threads.

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

    @cached_property
    def _places(self) -> Numbers:
        """Rows and columns of the element map that are compared, ``(P, 2)``."""
        width, core = _BORDER
        inner = ElementShares.of(self.elements, width).share[0] > core
        return np.random.default_rng(0).permutation(np.argwhere(inner | ~inner.any()))[:_MOST_PLACES]

    def _locate(self, shape: Shape) -> tuple[Numbers, Points]:
        """Return the cells of a picture that are compared, ``(n, 2)``, and their places in px, ``(P, n, 2)``."""
        cells = self.elements.cells(shape).reshape(-1, 2)
        place = (self._places[:, np.newaxis, ::-1] + 0.5) / self.elements.label.shape[::-1]
        at = self.elements.lattice.from_cell(cells + place)
        shown = ((at >= -0.5) & (at < np.array(shape[::-1]) - 0.5)).all(-1).mean(0)
        most = np.flatnonzero(shown >= min(0.95, shown.max()))
        most = most[:: -(-len(most) // _MOST_CELLS)]
        return cells[most], at[:, most]

    def _read(self, picture: Image, moves: Points) -> Values:
        """Return the colors at the places of all cells, each moved, ``(P, n, moves, C)``."""
        lab = rgb2lab(picture) if picture.shape[-1] == 3 else 100 * picture
        _, at = self._locate(picture.shape[:2])
        return interpolate(scipy.ndimage.gaussian_filter(lab, (_BLUR, _BLUR, 0)), at[:, :, np.newaxis] + moves)

    @cached_property
    def _known(self) -> Values:
        return self._read(self.sample, _MOVES)

    @cached_property
    def own(self) -> float:
        """The novelty of the cells of the sample, in CIELAB units."""
        cells, _ = self._locate(self.sample.shape[:2])
        label, offset = (part[tuple(self._places.T)] for part in (self.elements.label, self.elements.offset))
        number = np.stack([self.threads[k].number(cells + step) for k, step in zip(label, offset, strict=True)])
        return self.measure(self.sample, (number[:, :, np.newaxis] == number[:, np.newaxis]).all(-1))

    def measure(self, picture: Image, same: NDArray[np.bool_] | None = None) -> float:
        """Return the novelty of a picture, in CIELAB units.

        Parameters
        ----------
        picture
            The picture.
        same
            ``(P, n, m)``: whether a place of a cell of the picture is not compared with that of one of the sample.
        """
        new = self._read(picture, np.zeros((1, 2)))[:, :, 0]
        known = self._known.reshape(len(new), -1, new.shape[-1])
        away = np.stack([scipy.spatial.distance.cdist(*pair) for pair in zip(new, known, strict=True)])
        away = away.reshape(*new.shape[:2], -1, len(_MOVES)).min(-1)
        nearest = np.where(False if same is None else same, np.inf, away).min(-1)
        seen = nearest[np.isfinite(nearest)]
        return float(np.quantile(seen, _QUANTILE)) if seen.size else math.inf

    def compare(self, picture: Image) -> float:
        """Return the novelty of a picture over that of the sample's own cells."""
        return self.measure(picture) / (self.own + _UNSEEN)

    def passes(self, picture: Image) -> bool:
        """Return whether a picture is about as near to the sample as the sample's cells are to each other."""
        return bool(np.isfinite(picture).all()) and self.compare(picture) <= _MOST_NEW
