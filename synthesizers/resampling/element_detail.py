"""The detail of elements: what is left of a sample without its mean tile and the colors of its elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.plugins.forms import Shape

from ..lattice_places.equal_places import CellTorus
from .element_map import WHOLE, ElementMap, ElementShares, Lag, Numbers

Colors = tuple[NDArray[np.float64], NDArray[np.float64]]

_SOFTNESS = 1.0
"""px, standard deviation of the Gaussian that softens the borders between the details of elements."""
_SHARPNESS = 0.4
"""The same where elements are whole instances, which may touch without a joint."""
_AROUND: tuple[Lag, ...] = ((1, 0), (0, 1), (1, 1), (1, -1))
_ALIKE = 0.8
"""How far, in standard deviations, the color of a new element differs from that of the one whose detail it copies."""
_EXACT = 0.02
"""The same for the crossings of a thread, which have one color."""
_REDRAWS = 20
"""Times that copies beside an equal one are drawn again."""


@dataclass(frozen=True)
class ElementDetail:
    """The detail of a sample, from which elements are copied whole.

    Parameters
    ----------
    elements
        The elements.
    rest
        ``(H, W, C)``: the sample without its mean tile and the colors of its elements.
    varies
        Whether the variance stays where elements meet, or the values.
    """

    elements: ElementMap
    rest: NDArray[np.float64]
    varies: bool = True

    @cached_property
    def whole(self) -> list[Numbers]:
        """The cells in which the sample shows each element whole, ``(n, 2)`` each."""
        corner = self.elements.cells(self.rest.shape[:2])[0, 0]
        return [np.argwhere(c.shown >= WHOLE) + corner for c in self.elements.mean_colors(self.rest)]

    @cached_property
    def _shares(self) -> ElementShares:
        return ElementShares.of(self.elements, _SOFTNESS if self.varies else _SHARPNESS)

    @cached_property
    def _splines(self) -> list[NDArray[np.float64]]:
        return [scipy.ndimage.spline_filter(plane, 5, mode="mirror") for plane in np.moveaxis(self.rest, -1, 0)]

    def draw(
        self,
        shape: Shape,
        rng: np.random.Generator,
        colors: Colors | None = None,
        torus: CellTorus | None = None,
        exact: Sequence[bool] = (),
    ) -> Numbers:
        """Return the cell of the sample from which each element of a picture is copied, ``(E, I, J, 2)``.

        The box of cells is that of :meth:`ElementMap.cells`. Neighbors are copied from different cells if there are
        enough. With ``colors``, elements of similar colors are more likely: their detail goes with their color, and
        edges that lie elsewhere than in the mean tile are recolored less.

        Parameters
        ----------
        shape
            Of the picture.
        rng
            Draws the cells.
        colors
            The colors ``(E, I, J, C)`` of the sample's elements, and those of the picture's.
        torus
            The cells of a picture that repeats.
        exact
            For each element whether the nearest color is taken.
        """
        places = self.elements.cells(shape)
        box, equal = places.shape[:2], ... if torus is None else torus.find_equal(places)
        corner = self.elements.cells(self.rest.shape[:2])[0, 0]
        drawn = []
        for k, cells in enumerate(self.whole):
            likelihood = np.zeros((*box, len(cells)))
            if colors is not None:
                own, new = colors[0][k][tuple((cells - corner).T)], colors[1][k]
                apart = np.square(new[:, :, np.newaxis] - own).sum(-1)
                alike = _EXACT if exact and exact[k] else _ALIKE
                likelihood -= apart / (2 * alike**2 * max(float(own.var(0).sum()), 1e-12))
            drawn.append(cells[_draw_apart(likelihood, rng, equal)])
        return np.stack(drawn)

    def render(self, drawn: Numbers, shape: Shape, rows: slice = slice(None)) -> NDArray[np.float64]:
        """Return the copied detail at some rows of a picture.

        Where elements meet, details a and b with the shares u and v give (u a + v b) / sqrt(u^2 + v^2), whose variance
        is that of the details, or u a + v b.
        """
        top, bottom, _ = rows.indices(shape[0])
        corner = self.elements.cells(shape)[0, 0]
        detail = np.zeros((bottom - top, shape[1], self.rest.shape[2]))
        power = np.zeros(detail.shape[:2])
        for at, share, label, cell in self._shares.within(detail.shape[:2], top):
            i, j = (cell - corner).T
            x, y = ((drawn[label, i, j] - cell) @ self.elements.lattice.matrix + np.argwhere(at)[:, ::-1] + (0, top)).T
            for channel, plane in enumerate(self._splines):
                read = scipy.ndimage.map_coordinates(plane, [y, x], order=5, mode="mirror", prefilter=False)
                detail[at, channel] += share * read
            power[at] += share**2
        return np.asarray(detail / np.sqrt(power)[..., np.newaxis] if self.varies else detail)


def _draw_apart(likelihood: NDArray[np.float64], rng: np.random.Generator, shown: Any) -> Numbers:
    """Return random numbers of log-likelihood ``(I, J, n)``, redrawn a few times where they equal a neighbor's.

    ``shown`` is the index of the place whose number each place shows.
    """
    drawn = (likelihood + rng.gumbel(size=likelihood.shape)).argmax(-1)[shown]
    for _ in range(_REDRAWS):
        equal = np.any([drawn == np.roll(drawn, lag, (0, 1)) for lag in _AROUND], 0)
        drawn[equal] = (likelihood[equal] + rng.gumbel(size=likelihood[equal].shape)).argmax(-1)
        drawn = drawn[shown]
    return np.asarray(drawn)
