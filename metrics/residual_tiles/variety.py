"""What randomness compares: the tiles of the output beside those of fresh draws as large, and those of the sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.fold import Values, cut_tiles
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Observation, Shape

from ..verdict.measurements import Look
from ..verdict.reference import FIRST_DRAW
from ..verdict.verdict import Judgement
from .tile_alignment import aligned_middles, interior_weights
from .tileset import QUARTERS, Grid, TileSet, even_grid

_DRAWS, _MOST_DRAWS = 4, 12
"""Fresh draws: as many as outputs of 256 x 256 px need, of smaller ones more, so that the tiles are about as many."""
_FIRST = FIRST_DRAW + 1000
"""Fresh draws from here on are those of the output's size; those below are the regularity's."""


@dataclass(frozen=True)
class Variety:
    """The tiles of an output and of what it is compared with.

    Parameters
    ----------
    output
        Cut where they were found.
    sample
        All of the sample's whole tiles.
    fresh
        Those of fresh draws of the output's size; where there are none (photographs) of two halves of the sample.
    windows
        The sample's windows of half a tile around the four quarters' middles, ``(m, V / 2, U / 2, C)`` each: also
        those whose tile is not whole.
    extent, shapes
        Height and width px over which energies are compared, and those of output and reference.
    model
        Whether the model's fresh draws are at hand.
    """

    output: TileSet
    sample: TileSet
    fresh: tuple[TileSet, ...]
    windows: tuple[Values, ...]
    extent: Shape
    shapes: tuple[Shape, Shape]
    model: bool

    @classmethod
    def of(cls, observation: Observation, judgement: Judgement) -> Variety:
        """Cut all tiles on one grid."""
        lattice, sample, output = judgement.yardstick.lattice, observation.sample, observation.output
        grid, looks = even_grid(lattice), judgement.references
        model = judgement.yardstick.source == "model"
        tiles = TileSet.on(sample, lattice, grid)
        cut = _found(judgement.output, looks, grid)
        fresh = _fresh(observation, judgement, grid) if model else _halves(sample, tiles)
        own = output.shape[:2] if model else sample.shape[:2]
        extent = min(output.shape[0], own[0]), min(output.shape[1], own[1])
        windows = tuple(_half_windows(sample, lattice, quarter, grid) for quarter in QUARTERS)
        return cls(cut, tiles, fresh, windows, extent, (output.shape[:2], own), model)

    @property
    def reference(self) -> tuple[TileSet, ...]:
        """The images that the output is compared with: fresh draws, or the sample as a whole."""
        return self.fresh if self.model else (self.sample,)

    @cached_property
    def weights(self) -> NDArray[np.float32]:
        """``(V, U)``: what each sample of a tile counts for; edges less, see :func:`~.residual.interior_weights`."""
        energy = sum(float((tiles.departures**2).mean()) for tiles in self.reference) / len(self.reference)
        return interior_weights(self.mean, energy, self.sample.lattice)

    @cached_property
    def mean(self) -> Values:
        """The mean tile of all fresh draws (of the sample)."""
        return np.asarray(np.concatenate([tiles.tiles for tiles in self.reference]).mean(0))

    @property
    def least(self) -> int:
        """The fewest tiles in any image, or block of one, that is compared."""
        blocks = [*self.output.blocks(self.shapes[0], self.extent)]
        blocks += [block for tiles in self.reference for block in tiles.blocks(self.shapes[1], self.extent)]
        return min(map(len, (*blocks, *self.fresh)), default=0)


def _found(look: Look, references: tuple[Look, ...], grid: Grid) -> TileSet:
    """Cut an image's whole tiles where they were found, as far as the references do not explain their offsets."""
    tiles = look.tiles
    numbers = tiles.lattice.to_cell(tiles.centers[tiles.whole])
    return TileSet.cut(look.image, tiles.lattice, numbers, aligned_middles(look, references), grid)


def _fresh(observation: Observation, judgement: Judgement, grid: Grid) -> tuple[TileSet, ...]:
    """Cut fresh draws of the output's size: on the lattice, or where found if the model displaces its content."""
    again, shape = observation.again, observation.output.shape[:2]
    count = int(np.clip(_DRAWS * 256**2 / (shape[0] * shape[1]), _DRAWS, _MOST_DRAWS))
    draws = [again(shape, _FIRST + k) for k in range(count)] if again else []
    sets = []
    for draw in draws:
        if draw is None:
            raise ValueError(f"the texture's model gave no fresh draw of {shape[1]}x{shape[0]} px")
        image = quantize(draw.image)
        if draw.displacement is None:
            sets.append(TileSet.on(image, judgement.yardstick.lattice, grid))
        else:
            sets.append(_found(Look.at(image, judgement.yardstick.periodic), judgement.references, grid))
    return tuple(sets)


def _halves(sample: Image, tiles: TileSet) -> tuple[TileSet, TileSet]:
    """Return the tiles of two halves of the sample, cut across its longer side."""
    height, width = sample.shape[:2]
    along = tiles.centers[:, int(height > width)]
    low = along < np.median(along) if len(along) else np.zeros(0, np.bool_)
    first, second = (tiles.some(np.flatnonzero(part)) for part in (low, ~low))
    return first, second


def _half_windows(sample: Image, lattice: Lattice, quarter: tuple[float, float], grid: Grid) -> Values:
    """Cut all windows of half a tile of the sample whose middle the lattice calls equal to a quarter's."""
    (ax, ay), (bx, by) = lattice.matrix / 2
    half = Lattice((float(ax), float(ay)), (float(bx), float(by)))
    move = quarter @ lattice.matrix
    places = lattice.shifted((float(move[0]), float(move[1]))).points(sample.shape[:2])
    return cut_tiles(sample, half, places, (grid[0] // 2, grid[1] // 2))[0]
