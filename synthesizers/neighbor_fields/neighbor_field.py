"""Nearest patches of a sample for the patches of an output, and the mean of the patches found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Shape

from .neighbor_field_kernels import FieldArrays, add_votes, improve_matches

DRAWS: Final = 1 << 16
"""Number of random numbers that one search uses again and again."""
Grid = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows and columns of the first pixels of patches, ascending."""


def make_grid(shape: Shape, size: int, spacing: int = 1, wrap: bool = False) -> Grid:
    """Return the grid of patches of ``size`` px that cover an image, at most ``spacing`` px apart.

    With ``wrap`` they may cross its lower and its right edge.
    """
    if wrap:
        return np.arange(0, shape[0], spacing), np.arange(0, shape[1], spacing)
    rows, columns = (np.unique(np.append(np.arange(0, side - size, spacing), side - size)) for side in shape)
    return rows, columns


def wrap_around(image: Image, size: int) -> Image:
    """Return an image with its first rows and columns repeated at its end, for patches that cross its edges."""
    return np.pad(image, ((0, size - 1), (0, size - 1), (0, 0)), "wrap")


@dataclass(frozen=True, eq=False)
class NeighborField:
    """For each patch of an image on a grid, the most similar patch of another image that was found so far.

    The search is PatchMatch (Barnes and others 2009), on the pixels themselves: a match is tried at the neighbors, and
    at random places around itself. The search is approximate, needs no memory beyond the matches, and never exchanges a
    match for a worse one. Exact search among all patches would take a hundred times as long.

    Parameters
    ----------
    grid
        The patches that search.
    size
        Side of a patch in px.
    places
        Number of rows and columns of places at which a patch can be found.
    matches
        ``int32 (rows, columns, 2)``: row and column of each match. :meth:`search` overwrites it.
    costs
        ``(rows, columns)``: the cost of each match. :meth:`search` overwrites it.
    wrap
        Whether opposite edges of the image whose patches search are adjacent.

    References
    ----------
    .. [1] Connelly Barnes, Eli Shechtman, Adam Finkelstein, Dan B Goldman. "PatchMatch: A Randomized Correspondence
           Algorithm for Structural Image Editing." ACM Transactions on Graphics 28(3), 2009.
    """

    grid: Grid
    size: int
    places: Shape
    matches: NDArray[np.int32]
    costs: NDArray[np.float32]
    wrap: bool = False

    @classmethod
    def draw(cls, grid: Grid, size: int, shape: Shape, rng: np.random.Generator, wrap: bool = False) -> NeighborField:
        """Return a field of random matches in an image of ``shape``."""
        rows, columns = places = shape[0] - size + 1, shape[1] - size + 1
        extent = len(grid[0]), len(grid[1])
        matches = np.stack([rng.integers(rows, size=extent), rng.integers(columns, size=extent)], -1)
        return cls(grid, size, places, matches.astype(np.int32), np.zeros(extent, np.float32), wrap)

    def move(self, grid: Grid, size: int, shape: Shape, factor: float = 1.0) -> NeighborField:
        """Return a field of other patches, each with the match of the nearest old patch, shifted as the patch is.

        Parameters
        ----------
        grid, size, shape
            The new patches, their side, and the height and width of the image in which they are found.
        factor
            The new resolution over the old one.
        """
        places = shape[0] - size + 1, shape[1] - size + 1
        nearest = [
            np.abs((new[:, np.newaxis] + size / 2) / factor - (old + self.size / 2)).argmin(1)
            for old, new in zip(self.grid, grid, strict=True)
        ]
        old = np.stack(np.meshgrid(self.grid[0][nearest[0]], self.grid[1][nearest[1]], indexing="ij"), -1)
        shifts = factor * (self.matches[np.ix_(*nearest)] - old)
        moved = np.stack(np.meshgrid(*grid, indexing="ij"), -1) + np.rint(shifts)
        matches = np.clip(moved, 0, np.array(places) - 1).astype(np.int32)
        return NeighborField(grid, size, places, matches, np.zeros(matches.shape[:2], np.float32), self.wrap)

    def search(
        self,
        image: Image,
        other: Image,
        rng: np.random.Generator,
        sweeps: int,
        factors: NDArray[np.float32] | None = None,
    ) -> None:
        """Improve the matches of the patches of an image in another one, and compute their costs.

        Parameters
        ----------
        image, other
            ``(H, W, C)``: the images in which patches search and are found.
        rng
            The source of random numbers.
        sweeps
            Number of passes over all patches.
        factors
            For each of :attr:`places`: the cost is this multiple of the sum of squared differences. None: 1.
        """
        factors = np.ones(self.places, np.float32) if factors is None else factors
        draws, channels = rng.random(DRAWS, np.float32), image.shape[2]
        queries, keys = _flatten(wrap_around(image, self.size) if self.wrap else image), _flatten(other)
        field = FieldArrays(queries, keys, *self.grid, channels, self.size, factors, self.matches, self.costs)
        improve_matches(field, draws, sweeps)

    def average(self, other: Image, shape: Shape, weights: NDArray[np.float32], falloff: NDArray[np.float32]) -> Image:
        """Return the image whose pixels are the weighted means of the matches that cover them.

        Parameters
        ----------
        other
            The image from which the matches are copied.
        shape
            Height and width of the result.
        weights
            ``(rows, columns)``: the weight of each match.
        falloff
            ``(size, size)``: the weight of each pixel of a match.
        """
        channels, beyond = other.shape[2], self.size - 1 if self.wrap else 0
        rows, columns = shape[0] + beyond, shape[1] + beyond
        sums, totals = np.zeros((rows, columns * channels), np.float32), np.zeros((rows, columns), np.float32)
        add_votes(_flatten(other), self.grid, channels, self.matches, weights, falloff, sums, totals)
        image, weight = sums.reshape(rows, columns, channels), totals[..., np.newaxis]
        for votes in (image, weight) if beyond else ():
            for axis, side in enumerate(shape):
                lines = votes.swapaxes(0, axis)
                for start in range(side, len(lines), side):
                    part = lines[start : start + side]
                    lines[: len(part)] += part
        return np.asarray(image[: shape[0], : shape[1]] / weight[: shape[0], : shape[1]])


def _flatten(image: Image) -> NDArray[np.float32]:
    """Return an image as rows of values, ``(H, W C)``."""
    return np.ascontiguousarray(image).reshape(len(image), -1)
