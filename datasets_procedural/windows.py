"""Windows in the front of a house."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.errors import require_ranges

from .modelling.model import LARGEST_SIZE, RectangularModel
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage, split_period

_WALL = (0.60, 0.54, 0.46)
_FRAME = (0.62, 0.62, 0.60)
_SILL = (0.39, 0.37, 0.34)
_GLASS = (0.31, 0.37, 0.44)


@dataclass(frozen=True)
class Windows(RectangularModel):
    """Windows in the front of a house, with sills. Elements: frame (with its sill), pane.

    Parameters
    ----------
    width, height
        Distance from window to window along and across a floor in px.
    columns, lines
        Numbers of panes of a window along and across, from 1 to 4.
    wall
        Share of ``width`` and of ``height`` that the wall takes, from 0.05 to 0.7.
    """

    width: float = 27.1
    height: float = 36.3
    columns: int = 2
    lines: int = 3
    wall: float = 0.35

    def _check_parameters(self) -> None:
        require_ranges(self, wall=(0.05, 0.7), columns=(1, 4), lines=(1, 4))
        least = 5 / (1 - self.wall)
        require_ranges(self, width=(least * self.columns, LARGEST_SIZE), height=(least * self.lines, LARGEST_SIZE))

    @property
    def element_size(self) -> float:
        """The breadth of a pane."""
        return (1 - self.wall) * self.width / self.columns

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return windows in a wall; the origin is the middle of a window."""
        (i, j), (right, down) = cells(x, y, self.width, self.height)
        width, height = (1 - self.wall) * self.width, (1 - self.wall) * self.height
        column, aside = split_period(right - width / self.columns * (self.columns - 1) / 2, width / self.columns)
        line, below = split_period(down - height / self.lines * (self.lines - 1) / 2, height / self.lines)
        window = coverage(box(right, down, width, height))
        pane = window * coverage(box(aside, below, width / self.columns - 2, height / self.lines - 2))
        sill = coverage(box(right, down - height / 2 - 1.2, 1.15 * width, 2.4)) * (1 - window)
        gleam = 1 + 0.25 * np.clip((right - 1.5 * down) / self.height, -1, 1)
        glass = Layer("pane", (self.columns * i + column, self.lines * j + line), pane, _GLASS, gleam)
        frame = Layer("frame", (i, j), window - pane, _FRAME)
        return Pattern(_WALL, (glass, frame, Layer("sill", (i, j), sill, _SILL)))
