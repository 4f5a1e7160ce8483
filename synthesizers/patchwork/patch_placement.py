"""Where patches go: which window of an output is covered next, and by which part of the sample.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .patchwork import Patchwork, Window
from .seam_heat import SeamHeat
from .translations import Features, Layer, Translations, drawn


@dataclass(frozen=True, eq=False)
class Placement:
    """Covers windows of an output by patches that match what they show (sub-patch matching).

    Parameters
    ----------
    work
        The output.
    colors
        ``int32 (H, W, C)``: what the sample's pixels are matched by.
    randomness
        The paper's k: places are drawn with a probability proportional to exp(-cost / (k sigma^2)), the cost being the
        mean squared difference of the window's pixels, sigma the standard deviation of the sample's colors, channels
        summed in both. 0: one of the best.
    rng
        Where places are drawn from.
    guide
        What every pixel of the output should be like, synthesized or not, beside the same of the sample's pixels: two
        ``int32 (H, W, M)``, of the output and of the sample; None: nothing.
    reach
        How far, px, beyond a window its patch may give pixels as well: see :meth:`Patchwork.lay`.
    """

    work: Patchwork
    colors: Features
    randomness: float
    rng: np.random.Generator
    guide: tuple[Features, Features] | None = None
    reach: int = 0

    def cover(self, window: Window) -> int:
        """Lay a patch into a window, and return how many pixels it gives; 0 where nothing would be better."""
        costs = self._translations.rate(self._layers(window))
        count = (window[1] - window[0]) * (window[3] - window[2])
        scale = self.randomness * self._variance * count
        return self.work.lay(window, drawn(costs, scale, self.rng), self.reach)

    def improve(self, heat: SeamHeat) -> int:
        """Cover, anew, the window whose seams are worst, and return how many pixels are new."""
        window = heat.worst()
        new = self.cover(window)
        heat.tried(window, self.reach)
        return new

    def _layers(self, window: Window) -> list[Layer]:
        pixels = self.work.pixels(window)
        known = self.work.known[pixels]
        layers = [Layer(self.work.shown(self.colors, window), None if known.all() else known)]
        if self.guide is not None:
            layers.append(Layer(self.guide[0][pixels]))
        return layers

    @cached_property
    def _translations(self) -> Translations:
        return Translations((self.colors,) if self.guide is None else (self.colors, self.guide[1]))

    @cached_property
    def _variance(self) -> float:
        """Return the sample's variance, channels summed; in whole numbers, so that it is the same everywhere."""
        values = self.colors.reshape(-1, self.colors.shape[2]).astype(np.int64)
        count, squares = len(values), int((values**2).sum())
        return (count * squares - sum(int(total) ** 2 for total in values.sum(0))) / count**2


def scan_lines(shape: tuple[int, int], size: tuple[int, int], step: tuple[int, int], wrap: bool) -> Iterator[Window]:
    """Yield windows of a size that cover an output, line by line, each ``step`` (rows, columns) after the last.

    The last of a line, and the last line, are cut off at the output's edge; where it wraps, they go beyond.
    """
    for top in range(0, shape[0] if wrap else max(shape[0] - size[0] + step[0], 1), step[0]):
        for left in range(0, shape[1] if wrap else max(shape[1] - size[1] + step[1], 1), step[1]):
            bottom, right = top + size[0], left + size[1]
            yield top, bottom if wrap else min(bottom, shape[0]), left, right if wrap else min(right, shape[1])
