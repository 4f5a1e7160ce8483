"""Hexagonal tiles, and a hexagonal net."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import (
    Field,
    Index,
    Layer,
    Local,
    Pattern,
    coverage,
    hexagon,
    honeycomb,
    nearness,
    rim,
    round_profile,
)

_GLAZE = (0.32, 0.46, 0.52)
_GROUT = (0.78, 0.77, 0.73)
_WIRE = (0.60, 0.56, 0.44)
_SHADOW = (0.20, 0.23, 0.21)
_NEIGHBORS = np.array([(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)])
"""Steps (i, j) to the hexagons around one, in order of their angle."""


@dataclass(frozen=True)
class Hexagon(Model):
    """Regular hexagonal tiles with grout between them, or a net of wires. Element: tile, or wire.

    Parameters
    ----------
    period
        Distance from a tile's center to the next in px: the lattice is (period, 0), (period / 2, period sqrt(3) / 2).
    joint
        Width of the grout, or of the wires, in px, at least 1.
    style
        ``"tiles"`` or ``"net"``.
    """

    period: float = 26.2
    joint: float = 2.4
    style: Literal["tiles", "net"] = "tiles"

    ranges = {"joint": 1, "period": lambda own: own.joint + 2}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next tile on the right, and to the next one below it."""
        return (self.period, 0.0), (self.period / 2, self.period * math.sqrt(3) / 2)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return tiles on grout, or wires; the origin is the middle of a tile, or of a mesh."""
        index, (right, down) = honeycomb(x, y, self.period)
        if self.style == "net":
            return self._net(index, (right, down))
        distance = hexagon(right, down, self.period - self.joint, radius=0.5)
        tile = Layer("tile", index, coverage(distance), _GLAZE, rim(distance, 0.2, 1.5), nearness(distance))
        return Pattern(_GROUT, (tile,))

    def _net(self, mesh: tuple[Index, Index], local: Local) -> Pattern:
        """Return the wires. The index of a wire is the sum of the indices of the two meshes that it separates."""
        sector = np.rint(np.arctan2(local[1], local[0]) / (math.pi / 3)).astype(np.int64) % 6
        beyond = _NEIGHBORS[sector]
        index = 2 * mesh[0] + beyond[..., 0], 2 * mesh[1] + beyond[..., 1]
        aside = -hexagon(*local, self.period)
        shade = round_profile(aside, self.joint * 1.05, 0.5)
        return Pattern(_SHADOW, (Layer("wire", index, coverage(aside - self.joint / 2), _WIRE, shade),))
