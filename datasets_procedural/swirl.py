"""Swirls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, coverage, disc, mix, rows

_LIGHT = (0.60, 0.55, 0.46)
_DARK = (0.44, 0.25, 0.31)
_GROUND = (0.33, 0.39, 0.41)


@dataclass(frozen=True)
class Swirl(Model):
    """Spirals of two colors in discs, each row shifted by half a disc. Element: swirl.

    Parameters
    ----------
    period
        Distance from swirl to swirl in px.
    arms
        Number of arms of each spiral, from 1 to 6.
    """

    period: float = 30.7
    arms: int = 3

    ranges = {"period": 12, "arms": (1, 6)}

    @property
    def vectors(self) -> Vectors:
        """The vectors along a row, and to the next one."""
        return (self.period, 0.0), (self.period / 2, self.period)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return swirls on a ground; the origin is the middle of one."""
        index, (right, down) = rows(x, y, self.period, self.period, 0.5)
        radius, angle = np.hypot(right, down), np.arctan2(down, right)
        wave = np.cos(self.arms * angle - 13 * np.sqrt(radius / self.period + 0.01))
        slope = np.hypot(self.arms / np.maximum(radius, 1), 6.5 / np.sqrt(self.period * (radius + 1)))
        color = mix(np.clip(0.5 + wave / slope, 0, 1), _DARK, _LIGHT)
        outline = coverage(disc(right, down, 0.95 * self.period))
        return Pattern(_GROUND, (Layer("swirl", index, outline, color),))
