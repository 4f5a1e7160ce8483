"""Plain weave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.lattice.geometry import Vector

from .coordinates import Field, nearest
from .model import Model, check
from .pattern import Layer, Pattern
from .shapes import coverage, round_profile, stripe

_WARP = (0.34, 0.37, 0.45)
_WEFT = (0.65, 0.61, 0.53)
_GAP = (0.20, 0.19, 0.18)


@dataclass(frozen=True)
class Weave(Model):
    """A plain weave: warp and weft threads pass over and under each other in turn. Elements: warp, weft thread.

    A thread keeps its color along its length.

    Parameters
    ----------
    warp, weft
        From a warp thread to the next along x, and from a weft thread to the next along y, in px. Over and under
        alternate like a chess-board, so the smallest lattice is (warp, weft), (warp, -weft).
    gap
        Width of the dark gap between threads in px, at least 1.
    """

    warp: float = 12.3
    weft: float = 13.9
    gap: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.gap >= 1, f"gap is {self.gap} px; give at least 1")
        for name in ("warp", "weft"):
            size = getattr(self, name)
            check(self.gap + 2 <= size < 1e4, f"{name} is {size} px; give at least gap + 2 = {self.gap + 2:g}")

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """To the next crossing below on the right, and above on the right."""
        return (self.warp, self.weft), (self.warp, -self.weft)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return threads on a dark gap; the origin is a crossing where the warp lies above."""
        (i, right), (j, down) = nearest(x, self.warp), nearest(y, self.weft)
        above = (i + j) % 2 == 0
        warp = coverage(stripe(right, self.warp - self.gap))
        weft = coverage(stripe(down, self.weft - self.gap))
        lift = np.where(above, 1.0, -1.0)
        warp_shade = round_profile(right, self.warp - self.gap, 0.45) * _height(lift, down / self.weft)
        weft_shade = round_profile(down, self.weft - self.gap, 0.45) * _height(-lift, right / self.warp)
        warp_seen = np.where(above, warp, warp * (1 - weft))
        weft_seen = np.where(above, weft * (1 - warp), weft)
        threads = (
            Layer("warp", (i,), warp_seen, _WARP, warp_shade),
            Layer("weft", (j,), weft_seen, _WEFT, weft_shade),
        )
        return Pattern(_GAP, threads)


def _height(lift: Field, along: Field) -> Field:
    """Return the shade of a thread that rises over one crossing (lift 1) and dives under the next (lift -1)."""
    return np.asarray(0.78 + 0.22 * lift * np.cos(np.pi * along))
