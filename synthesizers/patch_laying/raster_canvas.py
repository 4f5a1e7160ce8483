"""An output that is covered line by line with square patches which overlap their left and upper neighbors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.imaging.convert import Image, to_bytes
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task

from ..gap_filling.block_canvas import Box
from ..sampling.patches import Source
from ..sampling.torus import Torus
from ..seams.seam_kernels import cheapest_path, cut_corner, cut_overlap, link_costs, squared_differences

Place = tuple[int, int]
"""(x, y) of a patch's first pixel in the sample."""
Weights = NDArray[np.int64]
"""``int64 (h, w)``: weights in units of 1 / (zone + 1), from 1 to zone + 1. They are integers, so that blends are
rounded alike on every machine."""
SHARE = 0.5
"""Side of an automatic patch as a share of the sample's shorter side.

Mean quality on the suite core with other seeds: quilting 0.43 with a half, 0.35 with three eighths, less with a third
and a quarter; patch-based 0.41 with a half, 0.34 with three eighths.
"""
LEAST = 3
"""px: least side of an automatic patch."""
LARGEST_SHARE = 1e6
"""The largest relative error that a method accepts as a parameter. Its square times an error is finite."""


class Spot(NamedTuple):
    """The place of a patch in the output.

    Parameters
    ----------
    y, x
        Row and column of its first pixel.
    left, top, right, bottom
        Whether it overlaps earlier patches on these sides; on the last two only where the output wraps.
    """

    y: int
    x: int
    left: bool
    top: bool
    right: bool = False
    bottom: bool = False


@dataclass(frozen=True)
class RasterGrid:
    """The spots of square patches that cover an output. The last ones may reach beyond it.

    Parameters
    ----------
    shape
        Height and width of the output, px.
    size
        Side of a patch, px.
    overlap
        Width of the overlap of adjacent patches, px; less than ``size``. Where the output wraps it may be wider.
    wrap
        Whether opposite edges of the output are adjacent. The spots are then evenly spread.
    """

    shape: Shape
    size: int
    overlap: int
    wrap: bool = False

    @classmethod
    def of(cls, task: Task, size: int, overlap: int) -> RasterGrid:
        """Return the grid of a task. Patches of a tileable output are smaller than the output by an overlap."""
        if not task.tileable:
            return cls(task.shape, size, overlap)
        size = min(size, min(task.shape) - overlap)
        if size < max(2 * overlap, LEAST):
            raise Refused(f"a tileable output needs {3 * overlap} px a side or more; choose a larger one")
        return cls(task.shape, size, overlap, True)

    @property
    def counts(self) -> tuple[int, int]:
        """Rows and columns of patches."""
        step = self.size - self.overlap
        covered = 0 if self.wrap else self.overlap
        height, width = (max(-(-(side - covered) // step), 1) for side in self.shape)
        return height, width

    def spots(self) -> Iterator[Spot]:
        """Yield the spots line by line."""
        rows, columns = self.counts
        step = self.size - self.overlap
        if self.wrap:
            tops = [i * self.shape[0] // rows for i in range(rows)]
            lefts = [j * self.shape[1] // columns for j in range(columns)]
            return (Spot(y, x, x > 0, y > 0, x == lefts[-1], y == tops[-1]) for y in tops for x in lefts)
        return (Spot(i * step, j * step, j > 0, i > 0) for i in range(rows) for j in range(columns))

    def hole(self, spot: Spot) -> Box:
        """Return the part of a patch that overlaps no earlier one, as (y0, y1, x0, x1) px from its first pixel."""
        left, top, right, bottom = (self.overlap * there for there in spot[2:])
        return top, self.size - bottom, left, self.size - right


def check_patch(what: str, size: int, margin: str, overlap: int) -> None:
    """Raise :class:`BadInput` unless a patch's side is 0 or at least 3 px, and its overlap 0 or at most half of it.

    Parameters
    ----------
    what, margin
        The names of the two parameters.
    size, overlap
        Their values, px. 0: automatic.
    """
    require(size == 0 or size >= 3, f"{what} {size}; choose 0 (automatic), or 3 px or more")
    fits = overlap >= 0 and not 0 < size // 2 < overlap
    require(fits, f"{margin} {overlap} with {what} {size}; choose a width from 1 px to half of the {what}")


def choose_size(what: str, size: int, margin: str, overlap: int, sample_shape: tuple[int, ...]) -> int:
    """Return the side of a patch, px. An automatic one is half the sample's shorter side, at least twice the overlap.

    Parameters
    ----------
    what, margin
        The names of the two parameters.
    size
        Side of the patch, px. 0: automatic.
    overlap
        Width of the overlap, px. 0: automatic.
    sample_shape
        Height and width of the sample, px.

    Raises
    ------
    Refused
        If the sample does not hold a patch; the message names parameters that would do.
    """
    height, width = sample_shape[:2]
    side = min(height, width)
    size = size or max(round(SHARE * side), LEAST, 2 * overlap)
    if size <= side:
        return size
    if 2 * overlap > side:
        raise Refused(
            f"the sample is {width}x{height} px, a {what} at least twice the {margin} of {overlap} px; "
            f"choose {margin} <= {side // 2}, and leave {what} out"
        )
    raise Refused(
        f"the sample is {width}x{height} px, a {what} {size}x{size} px; choose {what} <= {side}, or leave it out"
    )


def draw_within(errors: NDArray[Any], limit: float, rng: np.random.Generator) -> int:
    """Draw one of the entries that are at most ``limit``, all with the same probability.

    If there are none, one of the least entries is drawn, so that there is always a result.

    Parameters
    ----------
    errors
        At least one, of any shape.
    limit
        The largest accepted error, in the unit of ``errors``.
    rng
        The generator; at most one number is drawn from it.

    Returns
    -------
    int
        Flat index of the entry.
    """
    accepted = np.flatnonzero(errors <= max(limit, errors.min()))
    return int(accepted[rng.integers(len(accepted))])


class RasterCanvas:
    """An output under construction. Its pixels are 8-bit whole numbers, so that comparisons are exact.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    grid
        The spots of the patches, which are to be covered in their order.

    Attributes
    ----------
    sample
        ``uint8 (H, W, C)``.
    image
        ``uint8``: the output, in whole patches.
    source
        The source map of ``image``.
    """

    def __init__(self, sample: Image, grid: RasterGrid) -> None:
        self.sample, self.grid = to_bytes(sample), grid
        step = grid.size - grid.overlap
        rows, columns = (count * step + grid.overlap for count in grid.counts)
        self.torus = Torus(grid.shape, (grid.size, grid.size)) if grid.wrap else None
        if self.torus:
            rows, columns = self.torus.canvas
        self.image = np.zeros((rows, columns, sample.shape[2]), np.uint8)
        self.source: Source = np.ones((rows, columns, 3), np.float32)
        y, x = np.indices((grid.size, grid.size))
        self._steps = np.stack([x, y], -1).astype(np.float32)

    def window(self, spot: Spot) -> tuple[slice, slice]:
        """Return the rows and columns of a spot in :attr:`image`."""
        size = self.grid.size
        y, x = (spot.y + size, spot.x + size) if self.torus else spot[:2]
        return slice(y, y + size), slice(x, x + size)

    def cut_patch(self, place: Place) -> NDArray[np.uint8]:
        """Return the patch at a place (x, y) of the sample, ``(size, size, C)``."""
        x, y = place
        return self.sample[y : y + self.grid.size, x : x + self.grid.size]

    def join_along_seam(self, spot: Spot, place: Place) -> None:
        """Lay the patch at a place (x, y) of the sample into a spot, cut along the seams of least error."""
        window, patch = self.window(spot), self.cut_patch(place)
        if spot.right or spot.bottom:
            mask = cut_ring(self.image[window], patch, self.grid.hole(spot))[..., np.newaxis]
        else:
            mask = cut_sides(self.image[window], patch, self.grid.overlap, spot.left, spot.top)[..., np.newaxis]
        np.copyto(self.image[window], patch, where=mask)
        np.copyto(self.source[window][..., :2], self._steps + np.array(place, np.float32), where=mask)

    def join_by_feathering(self, spot: Spot, place: Place) -> None:
        """Lay the patch at a place (x, y) of the sample into a spot, and blend it with the patches it overlaps."""
        window, patch, zone = self.window(spot), self.cut_patch(place), self.grid.overlap
        weights = feather_weights(self.grid.size, zone, *spot[2:])
        self.image[window] = blend(self.image[window], patch, weights, zone)
        source, share = self.source[window], (weights / (zone + 1)).astype(np.float32)
        kept = source[..., 2] * (1 - share)
        larger = share >= kept
        np.copyto(source[..., :2], self._steps + np.array(place, np.float32), where=larger[..., np.newaxis])
        source[..., 2] = np.where(larger, share, kept)

    def cover(
        self,
        task: Task,
        places: Shape,
        choose: Callable[[NDArray[np.float32], Box], Place],
        join: Callable[[Spot, Place], None],
    ) -> Synthesis:
        """Cover all spots in their order, and return the synthesis.

        Parameters
        ----------
        task
            The source of random numbers, and where progress is reported.
        places
            Rows and columns of the places of a patch in the sample. The first patch is drawn from all of them.
        choose
            ``choose(old, hole)`` returns the place of a later patch: ``old`` are the pixels of its spot, ``float32
            (size, size, C)``, gray levels; ``hole`` is the part without pixels.
        join
            :meth:`join_along_seam` or :meth:`join_by_feathering`.
        """
        for number, spot in enumerate(self.grid.spots()):
            if number == 0:
                y, x = divmod(int(task.rng.integers(places[0] * places[1])), places[1])
            else:
                x, y = choose(self.image[self.window(spot)].astype(np.float32), self.grid.hole(spot))
            join(spot, (x, y))
            if self.torus:
                self.torus.repeat(self.window(spot), self.image, self.source)
            if spot.x == 0:
                task.progress(spot.y / task.shape[0])
        task.progress(1.0)
        image, source = self.result()
        return Synthesis(image, source=source)

    def result(self) -> tuple[Image, Source]:
        """Return the output and its source map."""
        height, width = self.grid.shape
        window = self.torus.output if self.torus else (slice(height), slice(width))
        image = self.image[window] / np.float32(255)
        return np.asarray(image, np.float32), np.ascontiguousarray(self.source[window])


@lru_cache(maxsize=64)
def feather_weights(size: int, zone: int, left: bool, top: bool, right: bool = False, bottom: bool = False) -> Weights:
    """Return the weights of a square patch that overlaps earlier patches on some of its sides.

    The weight of a pixel is its distance to the nearest overlapped side, and is largest from ``zone`` on (Szeliski and
    Shum 1997; Liang et al. 2001, step e). The rest of the weight goes to what lies under the patch.

    Parameters
    ----------
    size
        Side of the patch, px.
    zone
        Width of the overlap, px.
    left, top, right, bottom
        Whether the patch overlaps earlier patches on these sides.

    Examples
    --------
    >>> feather_weights(4, 2, left=True, top=False)[0].tolist()
    [1, 2, 3, 3]
    """
    ramp, full = np.minimum(np.arange(size) + 1, zone + 1), np.full(size, zone + 1)
    down, across = (
        np.minimum(ramp if first else full, ramp[::-1] if last else full)
        for first, last in ((top, bottom), (left, right))
    )
    weights = np.minimum(down[:, np.newaxis], across)
    weights.flags.writeable = False
    return weights


def blend(old: NDArray[np.uint8], new: NDArray[np.uint8], weights: Weights, zone: int) -> NDArray[np.uint8]:
    """Return the weighted means of two pictures, rounded to gray levels, halves up.

    Parameters
    ----------
    old, new
        ``(h, w, C)``.
    weights
        ``(h, w)``: the weights of ``new`` in units of 1 / (zone + 1).
    zone
        See :func:`feather_weights`.
    """
    part = weights[..., np.newaxis]
    total = part * new + (zone + 1 - part) * old
    return np.asarray((2 * total + zone + 1) // (2 * zone + 2), np.uint8)


Mask = NDArray[np.bool_]


def cut_sides(old: NDArray[np.uint8], new: NDArray[np.uint8], overlap: int, left: bool, top: bool) -> Mask:
    """Compute where a patch is shown if it is cut along the paths of least squared difference.

    Parameters
    ----------
    old, new
        ``(h, w, C)``: the picture and the patch.
    overlap
        Width of the overlap, px, from 1 to the lengths of the patch's sides.
    left, top
        Whether the patch overlaps the picture on these sides. With one overlap the cut is a path along it, from end to
        end. With both it is L-shaped, see :func:`l_shaped_seam`.

    Returns
    -------
    Mask
        ``bool (h, w)``: True where the patch is shown, which includes the pixels of the path.
    """
    height, width = new.shape[:2]
    mask = np.ones((height, width), np.bool_)
    if left and top:
        return l_shaped_seam(squared_differences(np.ascontiguousarray(old), np.ascontiguousarray(new)), overlap)[0]
    if left:
        mask[:, :overlap] = np.arange(overlap) >= cheapest_path(_strip_error(old, new, overlap))[:, np.newaxis]
    if top:
        error = _strip_error(old.swapaxes(0, 1), new.swapaxes(0, 1), overlap)
        mask[:overlap] = np.arange(overlap)[:, np.newaxis] >= cheapest_path(error)
    return mask


def cut_ring(old: NDArray[np.uint8], new: NDArray[np.uint8], hole: Box) -> Mask:
    """Compute where a patch is shown that overlaps the picture on three or four sides, by an exact minimum cut.

    Parameters
    ----------
    old, new
        ``(h, w, C)``: the picture and the patch.
    hole
        The part of the patch, as (y0, y1, x0, x1) px, around which the picture is known.

    Returns
    -------
    Mask
        ``bool (h, w)``: True where the patch is shown, which includes the hole.
    """
    size, (y0, y1, x0, x1) = new.shape[0], hole
    fixed_old, fixed_new = np.zeros((2, size, size), np.bool_)
    fixed_new[y0:y1, x0:x1] = True
    fixed_old[0], fixed_old[-1], fixed_old[:, 0] = y0 > 0, y1 < size, x0 > 0
    fixed_old[:, -1] |= x1 < size
    before, after = (np.asarray(part / np.float32(255), np.float32) for part in (old, new))
    costs = link_costs(before, after, True)
    return cut_overlap(costs, np.zeros((2, size, size), np.float32), fixed_old & ~fixed_new, fixed_new)


def _strip_error(old: NDArray[np.uint8], new: NDArray[np.uint8], overlap: int) -> NDArray[np.float64]:
    """Return the squared differences in the first ``overlap`` columns."""
    return squared_differences(np.ascontiguousarray(old[:, :overlap]), np.ascontiguousarray(new[:, :overlap]))


def l_shaped_seam(error: NDArray[np.float64], overlap: int) -> tuple[Mask, float]:
    """Compute the L-shaped cut of least error between a patch and what it overlaps at its left and at its top.

    "When there is both a vertical and a horizontal overlap, the minimal paths meet in the middle and the overall
    minimum is chosen for the end point(s)" (section 2.1). One path comes up from the lowest row in the left overlap,
    the other one comes from the last column in the upper overlap. They end at the same pixel of the corner, which is
    chosen so that the sum of errors over both paths is least.

    Parameters
    ----------
    error
        ``(h, w)``, not negative: the error of each pixel. Only the overlap counts.
    overlap
        Width of both overlaps, px, from 1 to the lengths of the sides.

    Returns
    -------
    mask
        ``bool (h, w)``: True to the right of the first path and below the second one, which includes their pixels.
    cost
        Sum of the errors of both paths. The pixel at which they meet counts once.

    Examples
    --------
    >>> error = np.array([[9, 9, 9, 9], [9, 0, 1, 0], [9, 2, 9, 9], [1, 9, 9, 9.0]])
    >>> mask, cost = l_shaped_seam(error, 2)
    >>> mask.astype(int).tolist(), cost
    ([[0, 0, 0, 0], [0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]], 4.0)
    """
    mask, cost = cut_corner(np.ascontiguousarray(error, np.float64), overlap)
    return mask.view(np.bool_), float(cost)
