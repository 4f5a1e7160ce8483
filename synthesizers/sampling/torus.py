"""A canvas whose opposite edges are adjacent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from nrbench.plugins.forms import Shape

Window = tuple[slice, slice]


@dataclass(frozen=True)
class Torus:
    """An output that repeats, inside a canvas that shows its repetitions on all sides.

    What is written into the canvas is copied to all places of the canvas that show the same pixel of the output. Code
    that reads and writes windows of the canvas therefore need not know that the output repeats.

    Parameters
    ----------
    shape
        Height and width of the output, px.
    margin
        Rows above and below the output, and columns at its sides, px.
    """

    shape: Shape
    margin: tuple[int, int]

    @property
    def canvas(self) -> Shape:
        """Height and width of the canvas, px."""
        return self.shape[0] + 2 * self.margin[0], self.shape[1] + 2 * self.margin[1]

    @property
    def output(self) -> Window:
        """The rows and columns of the output in the canvas."""
        rows, columns = (slice(first, first + side) for first, side in zip(self.margin, self.shape, strict=True))
        return rows, columns

    def repeat(self, window: Window, *arrays: NDArray[Any]) -> None:
        """Copy a window of the canvas, no larger than the output, to all other places that show the same pixels."""
        for top, rows in self._images(window[0], 0):
            for left, columns in self._images(window[1], 1):
                if top or left:
                    here = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
                    for array in arrays:
                        array[rows, columns] = array[here]

    def _images(self, span: slice, axis: int) -> list[tuple[int, slice]]:
        """Return the shifts by whole periods at which a span of pixels lies inside the canvas, at least partly."""
        period, end = self.shape[axis], self.canvas[axis]
        shifts = range(-(span.stop // period) * period, end - span.start + 1, period)
        images = [(shift, slice(max(span.start + shift, 0), min(span.stop + shift, end))) for shift in shifts]
        return [(shift, image) for shift, image in images if image.stop > image.start]
