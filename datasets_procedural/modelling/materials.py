"""Materials: what a surface shows beside its tints, as random fields of mean 0 that are stationary over draws.

The ideal image is that of the plain model. A material adds to each pixel a sum of fields, each of variance 1 times a
color, and multiplies everything by an uneven light of mean 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Shape

from .pattern import Field, Pattern
from .random_fields import grain, role_seed, uniform, waves
from .recomposition import Draw

Color = tuple[float, float, float]
"""Standard deviation that a field has in each channel, with a sign: channels of equal sign vary together."""
_NOTHING: Color = (0.0, 0.0, 0.0)
_RARE = 1.7
"""Number of standard deviations above which a smooth field shows a speckle: on about 4.5 % of the plane."""
_COMMON = 1.0
"""The same for a chip in an edge: on about 16 %."""


@dataclass(frozen=True)
class Material:
    """The color, as :data:`Color`, of each part of a material.

    Parameters
    ----------
    grain, soft
        Grain about one px wide, and about 2.5 px wide, each of its own color.
    streaks
        Streaks along the model's x axis, stronger or weaker from element to element, dark here and bright there.
    speckles
        Rare spots 2 to 3 px wide.
    relief
        A rough surface under a light from the upper left.
    worn
        Chips along the edges of bricks, tiles and threads; models of other elements have none.
    stains
        Blots that pass over elements, about 2.5 s long.
    light
        Standard deviation of the uneven light, in waves about 10 s long.
    """

    grain: Color = _NOTHING
    soft: Color = _NOTHING
    streaks: Color = _NOTHING
    speckles: Color = _NOTHING
    relief: Color = _NOTHING
    worn: Color = _NOTHING
    stains: Color = _NOTHING
    light: float = 0.0

    def add(self, image: Image, pattern: Pattern, seed: int, numbers: Draw, s: float, rotation: float) -> None:
        """Add the material to ``image``.

        Stains and light belong to no element: they are those of the draw ``seed``. All else is that of ``numbers``.
        """
        read, shape = numbers.reader(pattern), (image.shape[0], image.shape[1])

        def paint(part: str, draw: Callable[[int, Shape], Field], factor: Callable[[], Field] | None = None) -> None:
            if any(color := getattr(self, part)):
                field = read(lambda size: draw(role_seed(numbers.seed, f"material.{part}"), size))
                _add_field(image, field if factor is None else field * factor(), color)

        paint("grain", partial(_smooth, width=0.4))
        paint("soft", partial(_smooth, width=1.4))
        paint("streaks", partial(_streaks, rotation=rotation), partial(_element_signs, pattern, numbers))
        paint("speckles", partial(_spots, level=_RARE))
        paint("relief", _relief)
        paint("worn", partial(_spots, level=_COMMON), partial(_edges, pattern))
        if any(self.stains):
            _add_field(image, waves(role_seed(seed, "material.stains"), shape, 2.5 * s), self.stains)
        if self.light:
            image *= (1 + self.light * waves(role_seed(seed, "material.light"), shape, 10 * s))[..., np.newaxis]

    def variance(self, mean: Field, variance: Field, pattern: Pattern) -> Field:
        """Return the variance at each point, ``(H, W, 3)``, of a texture of this mean and variance, before clipping."""
        parts = (self.grain, self.soft, self.speckles, self.relief, self.stains)
        added = np.sum(np.square(parts), axis=0)
        covered = np.sum([layer.coverage**2 for layer in pattern.layers], axis=0)
        along = covered[..., np.newaxis] * np.square(self.streaks)
        worn = _edges(pattern)[..., np.newaxis] ** 2 * np.square(self.worn)
        total = variance + added + along + worn
        return np.asarray(total + self.light**2 * (mean**2 + total))


MATERIALS: Mapping[str, Material] = {
    "clay": Material(
        grain=(0.025, 0.015, 0.005),
        soft=(0.035, 0.02, 0.0),
        speckles=(-0.05, -0.045, -0.04),
        relief=(0.025, 0.025, 0.025),
        worn=(0.07, 0.07, 0.065),
    ),
    "stone": Material(
        soft=(0.02, 0.025, 0.035),
        relief=(0.05, 0.05, 0.05),
        worn=(0.1, 0.095, 0.085),
        stains=(0.035, 0.025, 0.0),
        light=0.08,
    ),
    "wood": Material(
        grain=(0.015, 0.012, 0.01),
        streaks=(0.07, 0.055, 0.035),
        worn=(-0.06, -0.05, -0.04),
        stains=(0.02, 0.015, 0.01),
    ),
    "cloth": Material(
        grain=(0.03, 0.02, 0.02),
        streaks=(0.055, 0.055, 0.065),
        speckles=(0.035, 0.035, 0.025),
        worn=(-0.05, -0.05, -0.05),
        light=0.06,
    ),
}
"""The named materials; ``"plain"`` has none of these parts."""


def _add_field(image: Image, field: Field, color: Color) -> None:
    for plane, strength in zip(np.moveaxis(image, -1, 0), color, strict=True):
        plane += (strength * field).astype(np.float32)


def _smooth(seed: int, shape: Shape, width: float) -> Field:
    """Return grain of variance 1, smoothed by a Gaussian of ``width`` px more; windows of one seed agree."""
    reach = math.ceil(4 * width)
    large = shape[0] + 2 * reach, shape[1] + 2 * reach
    field = scipy.ndimage.gaussian_filter(grain(seed, large).astype(np.float64), width)
    # Gaussians of variances a and b, one after the other, smooth as one of variance a + b does.
    kept = math.sqrt(0.49 / (0.49 + width**2))
    return np.asarray(field[reach : reach + shape[0], reach : reach + shape[1]] / kept)


def _streaks(seed: int, shape: Shape, rotation: float) -> Field:
    """Return streaks along ``rotation`` degrees, about 2 px broad and 20 px long, of mean 0 and variance 1."""
    total, count = np.zeros(shape), 24
    y, x = np.arange(shape[0])[:, np.newaxis], np.arange(shape[1])
    angle = math.radians(rotation)
    along, across = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    slow, fast, phase = uniform(seed, np.arange(3)[:, np.newaxis], np.arange(count)) / math.sqrt(3)
    for a, b, c in zip(0.15 * slow, 0.7 + 0.6 * fast, math.pi * phase, strict=True):
        total += np.cos(a * along + b * 1.6 * across + c)
    return np.asarray(total * math.sqrt(2 / count))


def _spots(seed: int, shape: Shape, level: float) -> Field:
    """Return spots on an even ground, where smooth grain exceeds ``level``: of mean 0 and variance 1."""
    share = 0.5 * math.erfc(level / math.sqrt(2))
    return np.asarray(((_smooth(seed, shape, 0.9) > level) - share) / math.sqrt(share * (1 - share)))


def _edges(pattern: Pattern) -> Field:
    """Return how near each pixel is to the outline of the element that it shows."""
    return np.asarray(np.sum([layer.coverage * layer.edge for layer in pattern.layers], axis=0))


def _relief(seed: int, shape: Shape) -> Field:
    """Return the slope, towards the upper left, of a rough surface: mean 0, variance 1."""
    height = _smooth(seed, (shape[0] + 1, shape[1] + 1), 1.0)
    # Points sqrt(2) px apart on a field smoothed by a Gaussian of variance v are correlated by exp(-2 / (4 v)).
    correlation = math.exp(-0.5 / 1.49)
    return np.asarray((height[1:, 1:] - height[:-1, :-1]) / math.sqrt(2 * (1 - correlation)))


def _element_signs(pattern: Pattern, numbers: Draw) -> Field:
    """Return a number of mean 0 and variance 1 for each element, times its coverage, at each pixel."""
    total = np.zeros(pattern.layers[0].coverage.shape)
    for number, layer in enumerate(pattern.layers):
        census = layer.census()
        source = numbers.elements(number, census.index)
        table = uniform(role_seed(numbers.seed, f"{layer.name}.material"), *source.T)
        total += layer.coverage * table.take(census.row)
    return total
