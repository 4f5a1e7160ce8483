"""Baseline: random patches without a lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nrbench.plugins.forms import Kind, Synthesis, Task

from .gap_filling.blocks import BlockGrid, BlockPlacer, check_border
from .sample_reading.patches import Patches


@dataclass(frozen=True)
class Scatter:
    """Random patches of the sample side by side, blended at their borders: keeps randomness, loses the lattice.

    This baseline is a valid method for textures without a lattice.

    Parameters
    ----------
    block
        Side of a block in px.
    border
        Width in px of the border over which neighbors are blended, at most half a block.
    """

    block: int = 32
    border: int = 4

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    wraps: ClassVar[bool] = True
    right_on: ClassVar[frozenset[Kind]] = frozenset({"stochastic"})
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        check_border(self.block, self.border)

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            If the sample does not hold a block with its borders.
        """
        grid = BlockGrid(task.shape, self.block, self.border)
        if task.tileable:
            grid = BlockGrid.closing(task.shape, self.block, self.border, task.sample.shape)
        rows, columns = grid.search_shape(task.sample.shape)
        places = task.rng.integers((columns, rows), size=(*grid.counts, 2)) + float(self.border)
        placer = BlockPlacer(Patches(task.sample), grid)
        for block in grid.placed():
            placer.place_block(block, places[block.row, block.column])
        for gap in grid.gaps():
            placer.fill_gap(gap, places[gap.row, gap.column])
        image, source = placer.canvas.output()
        task.progress(1.0)
        return Synthesis(image, source=source, blended=placer.canvas.blended())
