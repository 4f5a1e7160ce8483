"""Printed wallpaper of any plane group."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nrbench.lattice.geometry import Lattice, Vector

from .modelling.checks import check, check_choice, check_sizes
from .modelling.coordinates import Field, hats
from .modelling.fields import role_seed
from .modelling.model import Model
from .modelling.pattern import Layer, Pattern
from .modelling.shades import mix
from .modelling.symmetry import GROUPS, HEXAGONAL, Group, Motif, random_motif

_PAPER = (0.62, 0.60, 0.54)
_INKS = ((0.36, 0.46, 0.42), (0.58, 0.36, 0.33), (0.57, 0.49, 0.30))


@dataclass(frozen=True)
class Wallpaper(Model):
    """Wallpaper: a random smooth motif with the symmetry of a plane group, in three inks. Element: print of a cell.

    The prints fade into each other. The motif is drawn from ``motif`` alone, and is the same in every texture.

    Parameters
    ----------
    width, height
        Sides of the cell in px. Square and hexagonal groups have no height of their own; in the two centred groups
        they are the diagonals of a rhombic cell.
    group
        One of the 17, from ``"p1"`` to ``"p6m"``.
    slant
        Degrees by which the second side leans over, from -45 to 45; only p1 and p2 can.
    motif
        Which motif.
    """

    width: float = 41.3
    height: float = 36.7
    group: Group = "pmg"
    slant: float = 0.0
    motif: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice(self, "group", GROUPS)
        check_sizes(self, width=8, height=8)
        check(abs(self.slant) <= 45, f"slant is {self.slant}; give degrees from -45 to 45")
        check(not self.slant or self.group in ("p1", "p2"), f"slant is for groups p1 and p2, not {self.group}; give 0")

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """The sides of the cell."""
        width, height = self.width, self.height
        if self.group in HEXAGONAL:
            return (width, 0.0), (-width / 2, width * math.sqrt(3) / 2)
        if self.group in ("cm", "cmm"):
            return (width / 2, height / 2), (width / 2, -height / 2)
        if self.group.startswith("p4"):
            return (width, 0.0), (0.0, width)
        return (width, 0.0), (height * math.tan(math.radians(self.slant)), height)

    @cached_property
    def _motif(self) -> Motif:
        return random_motif(role_seed(self.motif, "motif"), self.group, len(_INKS))

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return the prints of four cells around each point."""
        uv = Lattice(*self.vectors).to_cell(np.stack(np.broadcast_arrays(x, y), -1))
        color = np.asarray(_PAPER)
        for wave, ink in zip(self._motif(uv[..., 0], uv[..., 1]), _INKS, strict=True):
            color = mix(1 / (1 + np.exp(-8 * (wave - 0.7))), color, ink)
        prints = (Layer("print", index, weight, color) for index, weight in hats(uv[..., 0], uv[..., 1]))
        return Pattern(_PAPER, tuple(prints))
