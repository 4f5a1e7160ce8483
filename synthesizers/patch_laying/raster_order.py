"""Cover an output line by line with square patches that overlap their left and upper neighbors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.imaging.convert import depth_of, to_bytes
from nrbench.plugins.forms import Refused, Shape, Synthesis, Task

from ..canvas.canvas import Box, Canvas, ExactPatch, Sides, Window, copy_patch

Place = tuple[int, int]
"""(x, y) of a patch's first pixel in the sample."""
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
    window
        The rows and columns.
    sides
        The sides on which it overlaps earlier patches; right and bottom only where the output wraps.
    hole
        The part of the patch that overlaps no earlier one.
    """

    window: Window
    sides: Sides
    hole: Box


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
        step = self.size - self.overlap
        tops, lefts = (
            [n * side // count if self.wrap else n * step for n in range(count)]
            for side, count in zip(self.shape, self.counts, strict=True)
        )
        for y in tops:
            for x in lefts:
                sides = x > 0, y > 0, self.wrap and x == lefts[-1], self.wrap and y == tops[-1]
                left, top, right, bottom = (self.overlap * there for there in sides)
                hole = top, self.size - bottom, left, self.size - right
                yield Spot((y, y + self.size, x, x + self.size), sides, hole)


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


def cover(
    task: Task,
    grid: RasterGrid,
    choose: Callable[[NDArray[np.float32], Box], Place],
    join: Callable[[Canvas, Spot, ExactPatch], None],
) -> Synthesis:
    """Cover all spots of a grid in their order, and return the synthesis.

    Parameters
    ----------
    task
        The sample, the source of random numbers, and where progress is reported.
    grid
        The spots.
    choose
        ``choose(old, hole)`` returns the place of a patch but the first, which is drawn from all places: ``old`` are
        the pixels of its spot, ``float32 (size, size, C)``, gray levels; ``hole`` is the part without pixels.
    join
        ``join(canvas, spot, patch)`` lays the patch into its spot. Pixels are gray levels, ``uint8``, so that
        comparisons are exact.
    """
    sample, size = to_bytes(task.sample), grid.size
    exact = task.sample if depth_of(task.sample) == 16 else None
    canvas = Canvas(grid.shape, sample.shape[2], np.uint8, (size, size), grid.wrap, exact=exact is not None)
    rows, columns = sample.shape[0] - size + 1, sample.shape[1] - size + 1
    for number, spot in enumerate(grid.spots()):
        if number == 0:
            y, x = divmod(int(task.rng.integers(rows * columns)), columns)
        else:
            x, y = choose(canvas.image[canvas.pixels(spot.window)].astype(np.float32), spot.hole)
        join(canvas, spot, copy_patch(sample, (x, y), (size, size), exact))
        if spot.window[2] == 0:
            task.progress(spot.window[0] / task.shape[0])
    task.progress(1.0)
    image, source = canvas.output()
    return Synthesis(image, source=source, blended=canvas.blended())
