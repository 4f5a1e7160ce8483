"""Does a picture repeat? What lies across its opposite edges, compared with what lies across the lines inside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage, stats

from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import find_vertex
from nrbench.imaging.mean_tile import Values, fold, tile_grid
from nrbench.lattice.geometry import Lattice, Points

SHORTEST: Final = 16
"""px; a shorter side does not show how the lines inside a picture differ."""
FLOORS: Final[Mapping[str, float]] = {
    "lattice": 0.4, "step": 0.1, "place": 0.2, "color": 0.004, "sharpness": 0.1, "detail": 0.1,
}  # fmt: skip
"""Departures that nobody sees: px for ``lattice``, values in [0, 1] for ``color``, else natural logarithms."""
_MARGIN = 1.5
"""Margin over the largest departure of a line inside, which is one of a few dozen that are independent."""
_REACH, _NEAR = 16, 2
"""px; half widths of the bands in which detail is compared."""
_GAP = 24
"""px; largest distance from a line of the bands whose displacements are compared: a seam may be faded."""
_UNSEEN = (0.5 / 255) ** 2
_POWER = 4


@dataclass(frozen=True, eq=False)
class WrappedEdge:
    """How two opposite edges of a picture meet when it is repeated.

    Parameters
    ----------
    ratios
        How far the line between the edges departs from the lines inside, over what these and :data:`FLOORS` allow.
        ``lattice``: displacement of the lattice between both sides. ``step``: root mean square difference of the pixels
        across the line; ``place``: the same where it is largest. ``color``: their mean difference. ``sharpness`` and
        ``detail``: amplitude of the detail within 2 and 16 px. Empty if the side is shorter than :data:`SHORTEST`.
    profile
        ``(n,)``: squared step at each pixel along the edge, over the largest that occurs inside.
    """

    ratios: Mapping[str, float]
    profile: NDArray[np.float32]

    @property
    def ratio(self) -> float:
        """The largest ratio; up to 1 the picture repeats."""
        return max(self.ratios.values(), default=np.nan)

    @property
    def score(self) -> float:
        """Score in [0, 1]: 1 for no departure, 0.5 at the limit, falling on with the ratio."""
        return float(1 / (1 + self.ratio**_POWER))


def measure_edges(image: Image, lattice: Lattice | None) -> tuple[WrappedEdge, WrappedEdge]:
    """Compare the right edge of a picture with the left one, and the lower one with the upper one.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        Its lattice; None: colors and detail are compared, and the lines inside all count alike.
    """
    turned = lattice and Lattice(lattice.t1[::-1], lattice.t2[::-1], lattice.origin[::-1])
    return _measure_edge(image, lattice), _measure_edge(image.transpose(1, 0, 2), turned)


def _measure_edge(image: Image, lattice: Lattice | None) -> WrappedEdge:
    """Compare the right edge with the left one.

    The lines inside to which the edge is compared are the quarter at which the mean cell has the most similar steps:
    joints are compared with joints.
    """
    height, width = image.shape[:2]
    if width < SHORTEST:
        return WrappedEdge({}, np.zeros(height, np.float32))
    reach = min(_REACH, width // 6)
    inside = np.arange(reach, width - reach + 1)
    steps = image - np.roll(image, 1, 1)
    squares = (steps**2).mean(2)
    local = ndimage.uniform_filter1d(squares, max(3, min(height, width) // 16), axis=0, mode="wrap")
    along = ((image - np.roll(image, 1, 0)) ** 2).mean((0, 2))
    energies = {"step": squares.mean(0), "place": local.max(0)}
    energies |= {
        name: ndimage.uniform_filter1d(along, 2 * near, mode="wrap")
        for name, near in (("sharpness", _NEAR), ("detail", reach))
    }
    found = {name: np.log(energy + _UNSEEN)[:, np.newaxis] / 2 for name, energy in energies.items()}
    found["color"] = stats.trim_mean(steps, 0.25, axis=0)
    alike, ratios = inside, {}
    if lattice is not None:
        ideal = np.diff(fold(image, lattice).unfold((height, width + 1)), axis=1)
        shown = np.column_stack([ideal.mean(0), np.sqrt((ideal**2).mean((0, 2)))])
        order = np.abs(shown[inside - 1] - shown[-1]).sum(1).argsort(kind="stable")
        alike = inside[order[: max(len(inside) // 4, SHORTEST)]]
        jumps = _measure_jumps(image, lattice)
        if len(jumps):
            ratios["lattice"] = float(jumps[0] / max(FLOORS["lattice"], _MARGIN * jumps[1:].max()))
    for name, values in found.items():
        away = np.linalg.norm(values - np.median(values[alike], 0), axis=1)
        ratios[name] = float(away[0] / max(FLOORS[name], _MARGIN * away[alike].max()))
    return WrappedEdge(ratios, local[:, 0] / (local[:, inside].max() + np.float32(_UNSEEN)))


def _measure_jumps(image: Image, lattice: Lattice) -> NDArray[np.float64]:
    """Return by how many px the lattice moves between the bands on both sides of the edge, then of lines inside.

    The mean cells of bands, as high as the picture, are displaced to fit the mean cell of the picture. Places that vary
    from cell to cell count little. Empty if the picture shows too few cells.
    """
    width, basis = image.shape[1], lattice.reduced()
    gap, band = min(_GAP, width // 8), max(int(np.ceil(np.abs(basis.matrix[:, 0]).max())), _REACH)
    reach = gap + band
    if width < 2 * reach + band:
        return np.zeros(0)
    lines = np.unique(np.linspace(reach, width - reach, max(4 * (width - 2 * reach) // band, 6)).astype(int))
    starts = [(width - reach, width), (gap, 0), *((line + k, 0) for line in lines for k in (-reach, gap))]
    grid = tile_grid(basis)
    tiles = [fold(image[:, at : at + band], basis.shifted((turn - at, 0)), grid=grid).values for at, turn in starts]
    mean = fold(image, basis, grid=grid).values
    variance = (fold(image**2, basis, grid=grid).values - mean**2).mean(2, keepdims=True)
    weights = 1 / (variance * np.float32(basis.area / (image.shape[0] * band)) + np.float32((2 / 255) ** 2))
    moved = register_cells(np.stack(tiles), mean, weights)
    return np.asarray(np.linalg.norm(basis.wrap((moved[1::2] - moved[::2]) @ basis.matrix), axis=1))


def register_cells(cells: Values, mean: Values, weights: Values) -> Points:
    """Return the displacements (u, v) in cell coordinates, ``(n, 2)``, at which cells fit a mean cell best.

    Parameters
    ----------
    cells
        ``(n, V, U, C)``.
    mean, weights
        ``(V, U, C)`` and ``(V, U, 1)``: the mean cell, and how much its squared differences count.
    """
    sides = mean.shape[:2]
    squares, products = (
        np.conj(scipy.fft.rfft2(a, axes=(0, 1))) for a in (weights * np.ones_like(mean), weights * mean)
    )
    spectra = (scipy.fft.rfft2(a, axes=(1, 2)) for a in (cells**2, cells))
    total = sum(s * f for s, f in zip(spectra, (squares, -2 * products), strict=True)).sum(-1)
    costs = scipy.fft.irfft2(total, s=sides, axes=(1, 2))
    number = np.arange(len(costs))
    least = np.stack(np.unravel_index(costs.reshape(len(costs), -1).argmin(1), sides), -1)
    place = least.astype(np.float64)
    for axis, step in enumerate(np.eye(2, dtype=np.intp)):
        before, here, after = (-costs[number, *((least + k * step) % sides).T] for k in (-1, 0, 1))
        place[:, axis] += find_vertex(before, here, after)
    place /= sides
    return np.asarray((place - np.rint(place))[:, ::-1])
