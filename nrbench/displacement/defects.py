"""Where a picture leaves its own lattice and its own look: cells, and rows of cells, that stand out from the others."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

import numpy as np
import scipy.spatial
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Values, interpolate
from nrbench.imaging.wrapped_edges import register_cells
from nrbench.lattice.geometry import Lattice, Points, Vector
from nrbench.plugins.forms import NoLatticeFound

Mask = NDArray[np.bool_]
ERROR: Final = 0.05
"""Share of clean pictures in which anything may stand out by chance."""
FEWEST: Final = 12
"""Fewer whole cells do not show how cells vary."""
_SAMPLES = (8, 24)
"""Least and largest number of samples of a cell along a vector."""
_MIDDLE, _HIGH, _MARGIN = 0.7, 0.9, 2.0
"""Quantiles from which the tail of departures is extrapolated, and the margin over it."""
_LEAST_AWAY = 0.15
"""s; a smaller displacement is not called out of place: photographed walls wander by 0.1 s."""
_EXPLAINED = 0.5
"""Share of its squared departures that is left of a window which is displaced, where it belongs."""
_SEEN = 0.01
"""Departure in [0, 1] that nobody sees."""
_LOOKS: Final = {"light": 0.006, "color": 0.006, "misfit": 0.1, "spot": 0.1, "detail": 0.1}
"""What is compared, and the least standard deviation of each: values in [0, 1], and natural logarithms."""
_LEAST_LINE, _NEAR_LINES = 8, 13
"""Least number of windows of a line of cells, and number of lines to whose median it is compared."""


@dataclass(frozen=True)
class PictureDefect:
    """A part of a picture that stands out.

    Parameters
    ----------
    x, y
        Middle of the windows that stand out, px of the picture.
    kind
        ``"out of place"``: the cell, or its whole row, is displaced. ``"other look"``: it shows something else.
    size
        Displacement in s, or departure in standard deviations from cell to cell.
    outline
        Corners (x, y) px of the convex outline of the windows that stand out.

    Examples
    --------
    >>> from nrbench import PictureDefect
    >>> print(PictureDefect(31.0, 40.0, "out of place", 0.31, ()))
    out of place by 0.31 s at x = 31, y = 40
    """

    x: float
    y: float
    kind: Literal["out of place", "other look"]
    size: float
    outline: tuple[Vector, ...]

    def __str__(self) -> str:
        """Return the defect in one line."""
        size = f"{self.size:.2f} s" if self.kind == "out of place" else f"{self.size:.1f} standard deviations"
        return f"{self.kind} by {size} at x = {self.x:.0f}, y = {self.y:.0f}"

    def as_dict(self) -> dict[str, Any]:
        """Return a mapping that can be written as JSON.

        Returns
        -------
        dict
            The values by the names of the parameters.
        """
        return asdict(self)


@dataclass(frozen=True, eq=False)
class CellWindows:
    """All windows of one cell at every half cell of a straight picture, less the mean cell.

    Parameters
    ----------
    lattice
        The lattice, reduced.
    first
        ``(R, C, 2)``: cell coordinates of the first corners.
    valid
        ``(R, C)``: the windows that lie inside the picture.
    values
        ``(n, V, U, C)``: the valid windows at their places: drifts of the lattice are followed.
    steep
        ``(n,)``: mean squared gradient of each.
    """

    lattice: Lattice
    first: Points
    valid: Mask
    values: Values
    steep: Values

    @classmethod
    def of(cls, image: Image, lattice: Lattice) -> CellWindows:
        """Read the windows of a picture; raises :class:`NoLatticeFound` if they are too few."""
        basis, (height, width) = lattice.reduced(), image.shape[:2]
        seen = ndimage.gaussian_filter(image, (0.6, 0.6, 0))
        slopes = np.sum([ndimage.sobel(seen, axis) ** 2 for axis in (0, 1)], 0)
        planes = np.concatenate([seen, slopes.mean(2, keepdims=True)], 2)
        ends = basis.to_cell([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)])
        ranges = (np.arange(math.floor(a), math.ceil(b), 0.5) for a, b in zip(ends.min(0), ends.max(0), strict=True))
        first = np.stack(np.meshgrid(*ranges), -1)
        corners = basis.from_cell(first[..., np.newaxis, :] + _CORNERS)
        valid = np.asarray(((corners >= -0.5) & (corners <= (width - 0.5, height - 0.5))).all((-1, -2)))
        if valid.sum() < 4 * FEWEST:
            raise NoLatticeFound(f"the picture shows fewer than {FEWEST} whole cells")
        sides = (int(np.clip(math.ceil(math.hypot(*vector)), *_SAMPLES)) for vector in basis.matrix)
        grid = np.stack(np.meshgrid(*((np.arange(side) + 0.5) / side for side in sides)), -1)
        starts = first[valid][:, np.newaxis, np.newaxis]
        places = np.floor(starts) + grid + (grid < starts % 1)  # samples keep their places in the cell
        values = interpolate(planes, basis.from_cell(places))
        field = np.full((*valid.shape, 2), np.nan)
        field[valid] = register_cells(values[..., :-1], *_fold(values[..., :-1]))
        padded = np.pad(field, ((3, 3), (3, 3), (0, 0)), constant_values=np.nan)
        near = np.lib.stride_tricks.sliding_window_view(padded, (7, 7), (0, 1))[valid]
        moved = np.nanmedian(near, (-1, -2))[:, np.newaxis, np.newaxis]
        values = interpolate(planes, basis.from_cell(places + moved))
        return cls(basis, first, valid, values[..., :-1], values[..., -1].mean((1, 2)))

    def find_strange(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the squared departure of the look of each window over what chance explains, and in deviations."""
        mean, weights = _fold(self.values)
        rest = self.values - mean
        color = rest.mean((1, 2))
        light = color.mean(1, keepdims=True)
        squares = (weights * (rest - color[:, np.newaxis, np.newaxis]) ** 2).mean(-1)
        looks = {
            "light": light,
            "color": (color - light)[:, :2],
            "misfit": np.log(squares.mean((1, 2)) + 0.3)[:, np.newaxis],
            "spot": np.log(ndimage.uniform_filter(squares, (0, 3, 3), mode="wrap").max((1, 2)) + 1)[:, np.newaxis],
            "detail": np.log(self.steep + _SEEN**2)[:, np.newaxis],
        }
        rated = [_rate(values, _LOOKS[name]) for name, values in looks.items()]
        ratios, sizes = np.array([ratio for ratio, _ in rated]), np.array([size for _, size in rated])
        worst = ratios.argmax(0), np.arange(len(rest))
        return ratios[worst], sizes[worst]

    def find_displaced(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far each window, and the line of cells through it that is displaced farthest, lie away, in s.

        Lines along both vectors and both diagonals count, where they hold enough windows. The mean of a line shows its
        displacement surely. One window is displaced only if that explains half of its squared departures.
        """
        mean, weights = _fold(self.values)
        number = np.rint(2 * self.first[self.valid]).astype(int)
        lines = np.zeros(len(self.values))
        for step in ((1, 0), (0, 1), (1, 1), (1, -1)):
            _, line, count = np.unique(number @ step, return_inverse=True, return_counts=True)
            means = [self.values[line == k].mean(0) for k in range(len(count))]
            moved = register_cells(np.stack(means), mean, weights)
            away = self._measure(moved - ndimage.median_filter(moved, (_NEAR_LINES, 1), mode="nearest"))
            usual = max(_LEAST_AWAY, 5 * float(np.median(away)))
            away = np.where((count >= _LEAST_LINE) & (away > usual), away, 0)
            lines = np.maximum(lines, away[line])
        moved = register_cells(self.values, mean, weights)
        single = self._measure(moved)
        for k in np.flatnonzero(single > _LEAST_AWAY):
            turn = np.rint(-moved[k, ::-1] * mean.shape[:2]).astype(int)
            costs = [
                (weights * (own - mean) ** 2).mean() for own in (self.values[k], np.roll(self.values[k], turn, (0, 1)))
            ]
            single[k] *= costs[1] < _EXPLAINED * costs[0]
        return single, lines

    def _measure(self, moved: Points) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm((moved - np.rint(moved)) @ self.lattice.matrix, axis=1) / self.lattice.s)


_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float64)


def _fold(values: Values) -> tuple[Values, Values]:
    """Return the median cell of windows, and the weights of its places: those that vary count little."""
    mean = np.median(values, 0)
    variance = (1.4826 * np.median(np.abs(values - mean), 0)) ** 2
    return mean, 1 / (variance.mean(-1, keepdims=True) + np.float32(_SEEN**2))


def _rate(values: NDArray[Any], least: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return squared departures from the median over what chance explains, and departures in standard deviations.

    The tail of the squared departures is taken for an exponential one through two quantiles, as that of normal values
    nearly is. The limit is passed by chance in at most :data:`ERROR` of pictures, by any window and any look.
    """
    rest = np.abs(values - np.median(values, 0))
    size = np.linalg.norm(rest / np.maximum(1.4826 * np.median(rest, 0), least), axis=1)
    middle, high = np.quantile(size**2, (_MIDDLE, _HIGH))
    slope = max((high - middle) / math.log((1 - _MIDDLE) / (1 - _HIGH)), 1.0)
    limit = high + _MARGIN * slope * math.log((1 - _HIGH) * len(size) * len(_LOOKS) / ERROR)
    return size**2 / limit, size


def find_straight_defects(
    image: Image, lattice: Lattice, locate: Callable[[Points], Points] = np.asarray
) -> tuple[PictureDefect, ...]:
    """Return the defects of a straight picture, the worst one first.

    Parameters
    ----------
    image, lattice
        ``(H, W, C)``, and its lattice.
    locate
        From points (x, y) px of the image, ``(..., 2)``, to those of the picture as it was before it was straightened.

    Raises
    ------
    NoLatticeFound
        If the picture shows too few cells.
    """
    windows = CellWindows.of(image, lattice)
    (strange, sizes), (away, lines) = windows.find_strange(), windows.find_displaced()
    worth = np.maximum(strange, lines / _LEAST_AWAY)
    rating = np.zeros(windows.valid.shape)
    rating[windows.valid] = worth
    label, _ = ndimage.label(rating > 1, np.ones((3, 3)))
    own, found = label[windows.valid], []
    for number in sorted(set(own) - {0}, key=lambda k: -worth[own == k].max()):
        part = np.flatnonzero(own == number)
        worst = part[worth[part].argmax()]
        moved = lines[worst] or (away[worst] if away[worst] > _LEAST_AWAY else 0.0)
        first, weights = windows.first[windows.valid][part], worth[part] - 1
        corners = (first[:, np.newaxis] + _CORNERS).reshape(-1, 2)
        hull = corners[scipy.spatial.ConvexHull(corners).vertices]
        cells = np.vstack([weights @ first / weights.sum() + 0.5, hull])
        middle, *outline = ((float(x), float(y)) for x, y in locate(windows.lattice.from_cell(cells)))
        kind: Literal["out of place", "other look"] = "out of place" if moved else "other look"
        found.append(PictureDefect(*middle, kind, float(moved or sizes[worst]), tuple(outline)))
    return tuple(found)
