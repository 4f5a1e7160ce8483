"""A jigsaw puzzle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, coverage, disc, rim, split_period

_CARD = (0.52, 0.50, 0.39)
_TABLE = (0.24, 0.22, 0.20)


@dataclass(frozen=True)
class Jigsaw(Model):
    """A jigsaw puzzle: pieces that hold each other by round tabs. Element: piece.

    Parameters
    ----------
    width, height
        Distance from piece to piece in px.
    gap
        Width of the seams in px, at least 1.
    tabs
        ``"alternate"``: a piece has two opposite tabs, and its neighbors have the other two, so that the lattice
        is (width, height), (width, -height); ``"same"``: all pieces are alike.
    """

    width: float = 31.3
    height: float = 28.9
    gap: float = 1.6
    tabs: Literal["alternate", "same"] = "alternate"

    ranges = {"gap": 1, "width": lambda own: 8 * own.gap, "height": lambda own: 8 * own.gap}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next equal pieces."""
        if self.tabs == "same":
            return (self.width, 0.0), (0.0, self.height)
        return (self.width, self.height), (self.width, -self.height)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return pieces on a dark table; the origin is the middle of a piece with tabs on its left and right."""
        (i, right), (j, down) = split_period(x, self.width), split_period(y, self.height)
        after_i, aside = split_period(x - self.width / 2, self.width)
        after_j, below = split_period(y - self.height / 2, self.height)
        turn = 1 if self.tabs == "same" else -1
        tab = 0.27 * min(self.width, self.height)
        across = _seam(aside, down, turn ** ((after_i + j) % 2), tab)
        along = _seam(below, right, turn * turn ** ((i + after_j) % 2), tab)
        index = after_i + (across > 0), after_j + (along > 0)
        distance = self.gap / 2 - np.minimum(np.abs(across), np.abs(along))
        return Pattern(_TABLE, (Layer("piece", index, coverage(distance), _CARD, rim(distance, 0.25, 1.5)),))


def _seam(across: Field, along: Field, side: NDArray[np.int64], tab: float) -> Field:
    """Return the signed distance from a straight seam with a round tab of ``tab`` px that bulges to ``side``."""
    return np.asarray(side * np.minimum(side * across, disc(side * across - 0.4 * tab, along, tab)))
