"""Mosaic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.lattice.geometry import Vector

from .checks import check, check_sizes
from .coordinates import Field, Index
from .fields import role_seed, uniform
from .model import Model
from .pattern import Layer, Pattern
from .shades import rim
from .shapes import coverage

_COLORS = np.array([(0.58, 0.34, 0.16), (0.60, 0.55, 0.44), (0.18, 0.34, 0.44), (0.50, 0.16, 0.14)])
_GROUT = (0.24, 0.23, 0.22)


@dataclass(frozen=True)
class Mosaic(Model):
    """A mosaic: rings of small stones, the same uneven ones in every cell. Element: stone.

    Parameters
    ----------
    period
        From rosette to rosette in px.
    stones
        Along a side of the cell, from 3 to 12.
    joint
        Width of the grout in px, at least 1.
    """

    period: float = 47.3
    stones: int = 6
    joint: float = 1.4

    def __post_init__(self) -> None:
        super().__post_init__()
        check(3 <= self.stones <= 12, f"stones is {self.stones}; give a number from 3 to 12")
        check_sizes(self, joint=1, period=3 * self.joint * self.stones)

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """Along a row, and to the next one."""
        return (self.period, 0.0), (0.0, self.period)

    @property
    def element_size(self) -> float:
        """The breadth of a stone."""
        return self.period / self.stones

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return stones on grout: each point belongs to the nearest stone's middle; the origin is a rosette's."""
        u, v = x / self.element_size, y / self.element_size
        i, j = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
        near = [(i + a, j + b) for b in (-1, 0, 1) for a in (-1, 0, 1)]
        offsets = np.stack([np.stack(self._middle(*stone)) - (u, v) for stone in near])
        squares = (offsets**2).sum(1)
        order = np.argsort(squares, 0, kind="stable")[:1]
        first = np.take_along_axis(offsets, order[:, np.newaxis], 0)
        gap = np.maximum(np.sqrt(((offsets - first) ** 2).sum(1)), 1e-9)
        bisector = (squares - np.take_along_axis(squares, order, 0)) / (2 * gap)
        bisector[gap < 1e-6] = np.inf
        distance = self.joint / 2 - bisector.min(0) * self.element_size
        index = tuple(np.take_along_axis(np.stack(part), order, 0)[0] for part in zip(*near, strict=True))
        color = _COLORS[self._ring(*index)]
        return Pattern(_GROUT, (Layer("stone", index, coverage(distance), color, rim(distance, 0.15, 1.0)),))

    def _middle(self, i: Index, j: Index) -> tuple[Field, Field]:
        """Return the middle of a stone, in stones."""
        n = self.stones
        jitter = (0.16 * uniform(role_seed(n, name), i % n, j % n) for name in "xy")
        dx, dy = jitter
        return i + dx, j + dy

    def _ring(self, i: Index, j: Index) -> Index:
        n = self.stones
        du, dv = (part - n * np.rint(part / n) for part in (i, j))
        return np.rint(np.hypot(du, dv)).astype(np.int64) % len(_COLORS)
