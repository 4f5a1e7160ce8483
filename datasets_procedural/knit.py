"""Knitted cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import RectangularModel
from .modelling.pattern import Field, Layer, Pattern, capsule, coverage, round_profile, split_period

_WOOL = (0.55, 0.31, 0.33)
_SHADOW = (0.25, 0.18, 0.18)


@dataclass(frozen=True)
class Knit(RectangularModel):
    """Knitted cloth in stocking stitch: columns of stitches like a V. Element: stitch.

    Parameters
    ----------
    width, height
        Distance from stitch to stitch along and across a row in px.
    """

    width: float = 17.3
    height: float = 13.1

    ranges = {"width": 6, "height": 5}

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return stitches on a shadow; the origin is the tip of a V."""
        i, right = split_period(x, self.width)
        aside = np.abs(right) - self.width / 4
        j, down = split_period(y + 1.1 * self.height / self.width * 2 * aside, self.height)
        distance = capsule(aside, down * 0.9, 0.52 * self.width, 0.84 * self.height * 0.9)
        strand = 0.88 + 0.12 * np.cos(2 * np.pi * (aside / self.width * 4 + down / self.height))
        shade = strand * round_profile(down, self.height, 0.4)
        return Pattern(_SHADOW, (Layer("stitch", (i, j), coverage(distance), _WOOL, shade),))
