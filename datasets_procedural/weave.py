"""Woven cloth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Pattern, interlace

_WARP = (0.34, 0.37, 0.45)
_WEFT = (0.65, 0.61, 0.53)
_GAP = (0.20, 0.19, 0.18)
_WEFTS, _WARPS = np.indices((8, 8))
_DRAFTS = {
    "plain": ((_WARPS + _WEFTS) % 2 == 0, ((1, 1), (1, -1))),
    "twill": ((_WARPS + _WEFTS) % 4 < 2, ((1, -1), (2, 2))),
    "basket": ((_WARPS // 2 + _WEFTS // 2) % 2 == 0, ((2, 2), (2, -2))),
    "herringbone": ((np.minimum(_WARPS, 8 - _WARPS) + _WEFTS) % 4 < 2, ((8, 0), (0, 4))),
}
"""Whether the warp lies above at each crossing, and the generating vectors in threads."""


@dataclass(frozen=True)
class Weave(Model):
    """Woven cloth: warp and weft threads pass over and under each other. Elements: warp, weft thread.

    A thread keeps its color along its length.

    Parameters
    ----------
    warp, weft
        Distance from a warp thread to the next along x, and from a weft thread to the next along y, in px.
    gap
        Width of the dark gap between threads in px, at least 1.
    draft
        ``"plain"``: over one and under one, like a chessboard, so that the smallest lattice is (warp, weft),
        (warp, -weft); ``"twill"``: over two and under two, shifted by one for each thread; ``"basket"``: a plain weave
        of double threads; ``"herringbone"``: a twill that changes its direction every four warp threads.
    """

    warp: float = 12.3
    weft: float = 13.9
    gap: float = 1.5
    draft: Literal["plain", "twill", "basket", "herringbone"] = "plain"

    ranges = {"gap": 1, "warp": lambda own: own.gap + 2, "weft": lambda own: own.gap + 2}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next equal crossings."""
        (a, b), (c, d) = _DRAFTS[self.draft][1]
        return (a * self.warp, b * self.weft), (c * self.warp, d * self.weft)

    @property
    def element_size(self) -> float:
        """The breadth of the thinner threads."""
        return min(self.warp, self.weft)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return threads on a dark gap; the origin is a crossing where the warp lies above."""
        warp, weft = interlace(x, y, (self.warp, self.weft), self.gap, _DRAFTS[self.draft][0])
        return Pattern(_GAP, (warp.layer("warp", _WARP), weft.layer("weft", _WEFT)))
