"""Energy of the tiles' departures, about the mean tile of each image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .tileset import TileSet
from .variety import Variety

_LEAST_COLOR = (1 / 255) ** 2
"""Mean colors that vary by less than a gray level (of 8 bits) are not compared."""


@dataclass(frozen=True)
class Energies:
    """Mean squared departures of tiles, and of their mean colors.

    Parameters
    ----------
    output, reference, sample
        Of all pixels.
    color, reference_color
        Of the tiles' mean colors.
    """

    output: float
    reference: float
    sample: float
    color: float
    reference_color: float

    @property
    def ratio(self) -> float:
        """The output's over the reference's."""
        return self.output / max(self.reference, 1e-12)

    @property
    def color_ratio(self) -> float | None:
        """That of mean colors; None where these hardly vary."""
        return None if self.reference_color < _LEAST_COLOR else self.color / self.reference_color

    @property
    def all(self) -> dict[str, float]:
        """Those of all pixels, by name."""
        return {"output": self.output, "reference": self.reference, "sample": self.sample}


def energies(variety: Variety) -> Energies:
    """Return the energies, each over boxes of the extent that output and reference share.

    Over a box the mean tile of what lies in it is taken out: n tiles leave n - 1 degrees of freedom. Where elements
    are longer than a tile more is lost than that, and the more the smaller the box, which is why extents are equal.
    """
    weights, (own, other) = variety.weights, variety.shapes
    output = list(variety.output.blocks(own, variety.extent))
    reference = [block for tiles in variety.reference for block in tiles.blocks(other, variety.extent)]
    full, color = _pooled(output, weights)
    right, right_color = _pooled(reference, weights)
    return Energies(full, right, _pooled([variety.sample], weights)[0], color, right_color)


def _pooled(sets: Iterable[TileSet], weights: NDArray[np.float32]) -> tuple[float, float]:
    """Return the weighted mean squared departure of pixels, and that of the tiles' mean colors."""
    shares, total, color, freedom = weights / weights.sum(), 0.0, 0.0, 0
    for tiles in sets:
        if len(tiles) > 1:
            left = tiles.departures
            means = np.tensordot(left, shares, ([1, 2], [0, 1]))
            total += (len(tiles) - 1) * float(np.tensordot((left**2).mean(-1), shares, 2).mean(dtype=np.float64))
            color += (len(tiles) - 1) * float((means**2).mean(dtype=np.float64))
            freedom += len(tiles) - 1
    return total / max(freedom, 1), color / max(freedom, 1)
