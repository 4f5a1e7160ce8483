"""A flat-woven rug."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, cells, coverage, round_profile, stripe

_COLORS = np.array([(0.57, 0.26, 0.22), (0.62, 0.54, 0.41), (0.23, 0.30, 0.39), (0.58, 0.42, 0.22)])
_STEPS = np.array([3, 1, 0, 0, 2, 2, 0])
"""Colors from the middle of a lozenge outwards."""
_JUTE = (0.41, 0.37, 0.31)


@dataclass(frozen=True)
class Rug(Model):
    """A flat-woven rug: stepped lozenges of ribbed yarn, between bands. Element: patch of two steps by four ribs.

    Parameters
    ----------
    yarn
        Distance from rib to rib in px.
    step
        Length of a step in px.
    steps
        Number of steps from lozenge to lozenge along the band, from 4 to 20. A band has twice as many ribs.
    """

    yarn: float = 3.1
    step: float = 5.3
    steps: int = 8

    breadth = ("step", 2)

    ranges = {"yarn": 2.5, "step": 3, "steps": (4, 20)}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next lozenge along the band, and in the next band."""
        return (self.steps * self.step, 0.0), (0.0, 2 * self.steps * self.yarn)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return yarn on jute; the origin is the middle of a lozenge."""
        (i, j), (right, down) = cells(x, y, self.step, self.yarn)
        n = self.steps
        across = np.abs(j - 2 * n * np.rint(j / (2 * n)).astype(np.int64))
        aside = np.abs(i - n * np.rint(i / n).astype(np.int64))
        lozenge = _STEPS[(aside + across // 2) % len(_STEPS)]
        color = np.where(across >= n - 2, 1 + 2 * ((across + aside) % 2), lozenge)
        rib = coverage(stripe(down, self.yarn - 0.5))
        shade = round_profile(down, self.yarn, 0.45) * (0.9 + 0.1 * np.cos(2 * np.pi * right / self.step))
        return Pattern(_JUTE, (Layer("patch", (i // 2, j // 4), rib, _COLORS[color], shade),))
