"""The output that blocks make: patches laid side by side, and gap patches joined to them by blending or along seams."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

from ..sampling.equal_places import pixel_grid
from ..sampling.patches import Patches, Source
from ..seams.minimum_cut import Links, Mask
from .blocks import OWN, STEPS, BlockGrid, wedges
from .seam_cut import Box, Joint, box_slices, dynamic_joint, graphcut_joint, visible_links

Seam = Literal["blend", "dynamic", "graphcut"]
Places = NDArray[np.float64]
"""``float64 (rows, columns, 2)``: the real-valued (x, y) in the sample of every block's first pixel."""
Map = NDArray[np.float64]
Layers = tuple[Image, Source]
"""``(5, block, block, C)`` and ``(5, block, block, 3)``: what each neighbour's patch, continued, shows in a gap, 0
where it does not reach; the last is the gap's own."""


@dataclass(frozen=True, eq=False)
class Canvas:
    """An output in the making.

    First every placed block is laid, then :meth:`continue_placed` shows their borders in the gaps, then every gap is
    filled. With ``"blend"`` a gap's patch stays inside the gap and fades in linearly over the border. With seams it is
    laid over half of each block around, too, as far as the sample shows it, so that a seam has room to run around what
    lies there, and over the corners, where placed blocks meet.

    Parameters
    ----------
    patches
        Of the sample.
    grid
        The blocks.
    seam
        ``"blend"``: linear blending; ``"dynamic"``: cut along the four minimum-error seams that dynamic programming
        finds; ``"graphcut"``: along the least visible seam of all, an exact minimum cut of the squared differences over
        the gradients.
    """

    patches: Patches
    grid: BlockGrid
    seam: Seam = "blend"
    places: Places = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "places", np.zeros((*self.grid.counts, 2)))

    @cached_property
    def image(self) -> Image:
        """``(rows * block, columns * block, C)``."""
        return np.zeros((*self._shape, self.patches.sample.shape[2]), np.float32)

    @cached_property
    def source(self) -> Source:
        """The source map, as large as the image."""
        return np.ones((*self._shape, 3), np.float32)

    @cached_property
    def known(self) -> Mask:
        """Where the image shows something already."""
        return np.zeros(self._shape, np.bool_)

    @cached_property
    def _seams(self) -> Links:
        """What the seams cost that the image has: kept for graph cuts."""
        height, width = self._shape
        return Links(np.zeros((height, width - 1), np.float32), np.zeros((height - 1, width), np.float32))

    @property
    def _shape(self) -> tuple[int, int]:
        rows, columns = self.grid.counts
        return rows * self.grid.block, columns * self.grid.block

    def finished(self) -> tuple[Image, Source]:
        """Return the output and its source map: (x, y) of the largest weight and that weight."""
        height, width = self.grid.shape
        return self.image[:height, :width], self.source[:height, :width]

    def lay(self, row: int, column: int, place: Points) -> None:
        """Lay a placed block's square; its border must lie in the sample, too."""
        self.places[row, column] = place
        window, block = self.window(row, column), self.grid.block
        self.image[window], self.source[window] = self.patches.cut(place, (block, block))
        self.known[window] = True

    def continue_placed(self) -> None:
        """Show, in the border of every gap, the patches of the placed blocks around, each in its wedge."""
        for row, column in self.grid.gaps():
            border = wedges(self.grid.block, self.grid.border, self.grid.sides(row, column))
            image, source = self._layers(row, column)
            x, y = border.pixels.T
            window = self.window(row, column)
            self.image[window][y, x] = image[border.owner, y, x]
            self.source[window][y, x] = source[border.owner, y, x]
            self.known[window][y, x] = True
            if self.seam == "graphcut":
                self._remember_corners(row, column, image)

    def fill(self, row: int, column: int, place: Points, field: Map | None = None) -> None:
        """Fill a gap with a patch, joined to what is there.

        Parameters
        ----------
        row, column
            The gap.
        place
            (x, y) in the sample of the gap's first pixel.
        field
            How far each pixel of the patch is displaced, ``(h, w, 2)`` over :meth:`extent`; None: not at all.
        """
        self.places[row, column] = place
        box = self.extent(row, column, place)
        patch = self.patch(place, box, field)
        if self.seam == "blend":
            self._blend(row, column, patch)
        else:
            self._join(row, column, box, patch)
        self.known[self.window(row, column)] = True

    def extent(self, row: int, column: int, place: Points) -> Box:
        """Return what a gap's patch may show, px from its first pixel: as much as the sample holds of it."""
        block = self.grid.block
        reach = 0 if self.seam == "blend" else block // 2
        left, top, right, bottom = (reach if there else 0 for there in self.grid.sides(row, column))
        height, width = self.patches.sample.shape[:2]
        x, y = (float(value) for value in place)
        return (
            max(-top, math.ceil(-y - 0.5)),
            min(block + bottom, math.floor(height - 0.5 - y) + 1),
            max(-left, math.ceil(-x - 0.5)),
            min(block + right, math.floor(width - 0.5 - x) + 1),
        )

    def window(self, row: int, column: int, box: Box | None = None) -> tuple[slice, slice]:
        """Return the rows and columns of a block, or of a box around it."""
        block = self.grid.block
        return box_slices(box or (0, block, 0, block), row * block, column * block)

    def overlap(self, row: int, column: int, box: Box) -> Mask:
        """Return where a gap's patch over ``box`` meets what is known: in its border and beyond."""
        inside = self.known[self.window(row, column, box)].copy()
        hole = wedges(self.grid.block, self.grid.border, self.grid.sides(row, column)).hole
        inside[box_slices(hole, -box[0], -box[2])] = False
        return inside

    def patch(self, place: Points, box: Box, field: Map | None = None) -> tuple[Image, Source]:
        """Return what a patch shows over a box, and its source map."""
        y0, y1, x0, x1 = box
        first = np.add(place, (x0, y0))
        if field is None:
            return self.patches.cut(first, (y1 - y0, x1 - x0))
        points = first + pixel_grid(x1 - x0, y1 - y0) + field
        return self.patches.at(np.clip(points, -0.5, np.array(self.patches.sample.shape[1::-1]) - 0.5))

    def _strips(self, row: int, column: int) -> Iterator[tuple[int, Box]]:
        """Yield each side that has a neighbour, and the part of the gap that its patch, continued, shows."""
        block, border = self.grid.block, self.grid.border
        far = block - border
        strips = ((0, block, 0, border), (0, border, 0, block), (0, block, far, block), (far, block, 0, block))
        return ((side, strips[side]) for side, there in enumerate(self.grid.sides(row, column)) if there)

    def _layers(self, row: int, column: int) -> Layers:
        block = self.grid.block
        image = np.zeros((5, block, block, self.image.shape[2]), np.float32)
        source = np.ones((5, block, block, 3), np.float32)
        for side, box in self._strips(row, column):
            dx, dy = STEPS[side]
            origin = self.places[row + dy, column + dx] - (block * dx, block * dy)
            part = box_slices(box)
            image[side][part], source[side][part] = self.patch(origin, box)
        return image, source

    def _blend(self, row: int, column: int, patch: tuple[Image, Source]) -> None:
        border = wedges(self.grid.block, self.grid.border, self.grid.sides(row, column))
        layers, sources = self._layers(row, column)
        layers[OWN], sources[OWN] = patch
        x, y = border.pixels.T
        window = self.window(row, column)
        image, source = self.image[window], self.source[window]
        image[...], source[...] = patch
        image[y, x] = np.einsum("ln,lnc->nc", border.weights, layers[border.layers, y, x])
        main, every = border.weights.argmax(0), np.arange(len(x))
        source[y, x] = sources[border.layers[main, every], y, x]
        source[y, x, 2] *= border.weights[main, every]

    def _join(self, row: int, column: int, box: Box, patch: tuple[Image, Source]) -> None:
        grid, window = self.grid, self.window(row, column, box)
        sides = grid.sides(row, column)
        hole = wedges(grid.block, grid.border, sides).hole
        joint = Joint(self.image[window], patch[0], self.known[window], box, hole, sides)
        new = dynamic_joint(joint) if self.seam == "dynamic" else graphcut_joint(joint, _inside(self._seams, window))
        np.copyto(self.image[window], patch[0], where=new[..., np.newaxis])
        np.copyto(self.source[window], patch[1], where=new[..., np.newaxis])

    def _remember_corners(self, row: int, column: int, layers: Image) -> None:
        """Note what it costs that in a gap's corners the borders of two neighbours meet."""
        half = self.grid.block // 2
        beside = np.concatenate([layers[0][:, :half], layers[2][:, half:]], 1)
        above = np.concatenate([layers[1][:half], layers[3][half:]], 0)
        costs = visible_links(beside, above)
        owners = wedges(self.grid.block, self.grid.border, self.grid.sides(row, column)).owners
        kept = _inside(self._seams, self.window(row, column))
        kept.across[...] = _between_layers(owners[:, 1:], owners[:, :-1], costs.across)
        kept.down[...] = _between_layers(owners[1:], owners[:-1], costs.down)


def _between_layers(one: NDArray[np.int64], other: NDArray[np.int64], cost: Map) -> Map:
    """Return the cost where the one pixel is of a neighbour beside and the other of one above or below, else 0."""
    return np.where((one != other) & (one % 2 != other % 2) & (one != OWN) & (other != OWN), cost, 0.0)


def _inside(links: Links, window: tuple[slice, slice]) -> Links:
    """Return the links inside a window of pixels, a view."""
    rows, columns = window
    across = links.across[rows, columns.start : columns.stop - 1]
    return Links(across, links.down[rows.start : rows.stop - 1, columns])


def compose(patches: Patches, grid: BlockGrid, places: Places) -> tuple[Image, Source]:
    """Return the output that patches at given places make when they are blended, and its source map.

    Parameters
    ----------
    patches
        Of the sample.
    grid
        The blocks.
    places
        ``(rows, columns, 2)``: see :data:`Places`; placed blocks have their borders inside the sample, too.
    """
    canvas = Canvas(patches, grid)
    for row, column in grid.placed():
        canvas.lay(row, column, places[row, column])
    for row, column in grid.gaps():
        canvas.fill(row, column, places[row, column])
    return canvas.finished()
