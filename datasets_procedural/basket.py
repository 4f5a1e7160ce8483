"""Basketwork."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Pattern, interlace

_STAKE = (0.42, 0.32, 0.24)
_STRAND = (0.62, 0.51, 0.34)
_INSIDE = (0.24, 0.20, 0.18)
_SQUARE = np.indices((4, 4))
_DRAFTS = {
    "single": (_SQUARE.sum(0) % 2 == 0, ((1, 1), (1, -1))),
    "double": ((_SQUARE[1] + _SQUARE[0] // 2) % 2 == 0, ((1, 2), (1, -2))),
}
"""Whether the stake lies above at each crossing, and the generating vectors in stakes and strands."""


@dataclass(frozen=True)
class Basket(Model):
    """The side of a basket: thin strands woven around broad upright stakes. Elements: stake, strand.

    Parameters
    ----------
    stake, strand
        Distance from stake to stake along x, and from strand to strand along y, in px.
    gap
        Width of the dark gap between them in px, at least 1.
    draft
        ``"single"``: strands pass before and behind the stakes one by one in turn, so that the lattice is
        (stake, strand), (stake, -strand); ``"double"``: strands do so in pairs.
    """

    stake: float = 19.3
    strand: float = 8.7
    gap: float = 1.6
    draft: Literal["single", "double"] = "single"

    breadth = ("strand", 1)
    ranges = {"gap": 1, "stake": lambda own: own.gap + 2, "strand": lambda own: own.gap + 2}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next equal crossings."""
        (a, b), (c, d) = _DRAFTS[self.draft][1]
        return (a * self.stake, b * self.strand), (c * self.stake, d * self.strand)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return strands and stakes on the dark inside; the origin is a crossing where the stake lies above."""
        stake, strand = interlace(x, y, (self.stake, self.strand), self.gap, _DRAFTS[self.draft][0], depth=0.35)
        return Pattern(_INSIDE, (stake.layer("stake", _STAKE), strand.layer("strand", _STRAND)))
