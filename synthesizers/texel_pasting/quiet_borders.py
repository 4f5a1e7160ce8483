"""Choose the shape and the place of texels so that the texels of a sample differ least along their borders."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Values, fold, sample_tile
from nrbench.lattice.geometry import Lattice, Points

TexelKind = Literal["quadrilateral", "hexagon"]
STEPS: Final = 16
"""Number of places of the cell, along each vector, at which a corner is tried."""
ALONG: Final = 12
"""Number of points along each side at which a border is rated."""
REFINEMENTS: Final = 3
"""How often the steps are halved around the best corner and link."""
LINKS: Final = 8
"""Number of steps along each side of the triangle in which the links between corners are tried."""
BLUR: Final = 1 / 12
"""Standard deviation, in s, of a blur of the departures from the mean tile. Where an outline is off by a fraction of a
pixel, departures of both signs lie side by side; they would make joints look like places where texels differ."""
Corners = tuple[Lattice, Points]
"""The lattice of the middles of texels, and the corners of a texel from its middle, in order, ``(2 k, 2)`` px."""


def quiet_texels(image: Image, lattice: Lattice, kind: TexelKind) -> Corners:
    """Return the texels of the least visible borders.

    In the report a user draws them. Two texels that are pasted side by side differ, at each point of their common
    border, by twice the variance over all texels there. The border with the least sum of variances is taken.

    Parameters
    ----------
    image
        ``(H, W, C)``, straight.
    lattice
        Its lattice.
    kind
        ``"quadrilateral"``: parallelograms whose sides are two of the two shortest vectors, their sum and their
        difference. ``"hexagon"``: hexagons with parallel sides, and parallelograms, which are hexagons two of whose
        sides have no length. A brick of a wall in running bond is such a hexagon too.
    """
    lattice = lattice.reduced()
    mean = fold(image, lattice)
    sigma = BLUR * lattice.s
    departures = scipy.ndimage.gaussian_filter(image - mean.unfold(image.shape[:2]), (sigma, sigma, 0))
    departures = (departures**2).sum(-1, keepdims=True)
    variance = fold(departures, lattice).values
    grid = np.arange(STEPS) / STEPS
    places = lattice.from_cell(np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2))
    best, least = (np.array(lattice.origin), np.zeros(2), *lattice.matrix), np.inf
    for first, second in (lattice.matrix, lattice.matrix * [(1.0,), (-1.0,)]):
        for link in _links(kind) @ np.stack([first, second]):
            costs = _costs(variance, lattice, places, link, first, second)
            if costs.min() < least * (1 - 1e-9):
                least = float(costs.min())
                best = places[costs.argmin()], link, first, second
    corner, link, first, second = best
    for halvings in range(1, REFINEMENTS + 1):
        step = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 0), (0, 1), (1, -1), (1, 0), (1, 1)]) / 2**halvings
        near = corner + step @ lattice.matrix / STEPS
        links = link + (step @ np.stack([first, second]) / LINKS if kind == "hexagon" else np.zeros((1, 2)))
        links = [each for each in links if _is_convex(each, first, second)]
        costs = np.stack([_costs(variance, lattice, near, each, first, second) for each in links])
        row, column = np.unravel_index(costs.argmin(), costs.shape)
        corner, link = near[column], links[row]
    return _texel(corner, link, first, second)


def parallelogram(lattice: Lattice) -> Corners:
    """Return the texels whose sides are the vectors of the lattice and whose middles are its points."""
    first, second = lattice.matrix
    return _texel(np.array(lattice.origin) - (first + second) / 2, np.zeros(2), first, second)


def _links(kind: TexelKind) -> NDArray[np.float64]:
    """Return the links from a corner to the next one that are tried, ``(n, 2)``, in steps along two vectors.

    The links to the three corners around a corner are d, d - u and d - v for two vectors u and v that span the lattice.
    The hexagon is convex if d lies in the triangle of 0, u and v; at a corner of the triangle it is a parallelogram.
    """
    if kind == "quadrilateral":
        return np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    grid = np.stack(np.meshgrid(np.arange(LINKS + 1), np.arange(LINKS + 1)), -1).reshape(-1, 2)
    return np.asarray(grid[grid.sum(1) <= LINKS] / LINKS)


def _is_convex(link: Points, first: Points, second: Points) -> bool:
    """Return whether a link lies in the triangle of 0 and two vectors, up to rounding."""
    along = link @ np.linalg.inv(np.stack([first, second]))
    return bool((along >= -1e-9).all() and along.sum() <= 1 + 1e-9)


def _costs(
    variance: Values, lattice: Lattice, places: Points, link: Points, first: Points, second: Points
) -> NDArray[np.float64]:
    """Return the sum of variances along the sides that start at a corner, for corners at ``(n, 2)`` px: ``(n,)``."""
    sides = np.stack([link, link - first, link - second])
    along = (np.arange(ALONG)[:, np.newaxis] + 0.5) / ALONG
    points = (sides[:, np.newaxis] * along).reshape(-1, 2)
    values = sample_tile(variance, lattice.to_cell(places)[:, np.newaxis] + points @ np.linalg.inv(lattice.matrix))
    lengths = np.repeat(np.hypot(*sides.T) / ALONG, ALONG)
    return np.asarray(values[..., 0] @ lengths)


def _texel(corner: Points, link: Points, first: Points, second: Points) -> Corners:
    """Return the texel with a corner, the link from it to the next one, and the vectors that span the lattice."""
    path = np.cumsum([link, first - link, link - second, -link, link - first], 0)
    corners = np.concatenate([np.zeros((1, 2)), path])
    middle = corners[3] / 2
    return Lattice.from_basis((first, second), corner + middle), corners - middle
