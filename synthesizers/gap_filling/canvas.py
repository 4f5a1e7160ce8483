"""Compose an output of blocks: place patches side by side, and join gap patches by blending or along seams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

from ..sampling.patches import Patches, Source
from ..seams.seam_kernels import cut_overlap, link_costs, record_seams
from .blocks import OWN, Block, BlockGrid, Box, Sides, box_slices

Mask = NDArray[np.bool_]
SeamMethod = Literal["blend", "graphcut"]
Places = NDArray[np.float64]
"""``float64 (rows, columns, 2)``: the real-valued (x, y) in the sample of every block's first pixel."""
Layers = tuple[Image, Source]
"""``(5, block, block, C)`` and ``(5, block, block, 3)``: what the patch of each neighbor shows in a gap, 0 where it
does not reach. The last layer is the gap's own patch."""


class BlockCanvas:
    """An output under construction.

    First place every block that is not a gap with :meth:`place_block`, then show their borders in the gaps with
    :meth:`extend_placed`, then fill every gap with :meth:`fill_gap`. With ``"blend"`` the patch of a gap stays inside
    the gap and fades in linearly over the border. With seams the patch also covers half of each block around, as far as
    the sample shows it, so that a seam can run around elements there, and around the corners where placed blocks meet.

    Parameters
    ----------
    patches
        The patches of the sample.
    grid
        The blocks.
    seam
        ``"blend"``: linear blending. ``"graphcut"``: cut along the least visible closed seam, an exact minimum cut of
        the squared differences over the gradients.

    Attributes
    ----------
    places
        See :data:`Places`.
    image, source, known
        The output in whole blocks, ``(rows * block, columns * block, C)``, its source map, and where it is known.
    """

    def __init__(self, patches: Patches, grid: BlockGrid, seam: SeamMethod = "blend") -> None:
        rows, columns = grid.counts
        height, width = rows * grid.size, columns * grid.size
        self.patches, self.grid, self.seam = patches, grid, seam
        self.places: Places = np.zeros((rows, columns, 2))
        self.image: Image = np.zeros((height, width, patches.sample.shape[2]), np.float32)
        self.source: Source = np.ones((height, width, 3), np.float32)
        self.known: Mask = np.zeros((height, width), np.bool_)
        self._seams = np.zeros((2, height, width), np.float32)
        """Costs of the seams of the image to the right and downward, for graph cuts."""

    def output(self) -> tuple[Image, Source]:
        """Return the output and its source map: the (x, y) that has the largest weight, and that weight."""
        height, width = self.grid.shape
        return self.image[:height, :width], self.source[:height, :width]

    def place_block(self, block: Block, place: Points) -> None:
        """Place a block. Its borders must lie inside the sample, too."""
        self.places[block.row, block.column] = place
        window = block.window()
        self.image[window], self.source[window] = self.cut_patch(place, block.box)
        self.known[window] = True

    def extend_placed(self) -> None:
        """Show, in the border of every gap, the patches of the placed blocks around, each in its wedge."""
        for gap in self.grid.gaps():
            border, window = gap.border, gap.window()
            image, source = self._layers(gap)
            x, y = border.pixels.T
            self.image[window][y, x] = image[border.owner, y, x]
            self.source[window][y, x] = source[border.owner, y, x]
            self.known[window][y, x] = True
            if self.seam == "graphcut":
                self._record_corner_seams(gap, image)

    def fill_gap(self, gap: Block, place: Points) -> None:
        """Fill a gap with the patch whose first pixel lies at a place (x, y), and join it to what is known around."""
        self.places[gap.row, gap.column] = place
        box = self._patch_box(gap, place)
        patch = self.cut_patch(place, box)
        if self.seam == "blend":
            self._blend(gap, patch)
        else:
            self._cut(gap, box, patch)
        self.known[gap.window()] = True

    def _patch_box(self, gap: Block, place: Points) -> Box:
        """Return the largest box, px from the gap's first pixel, that a gap's patch may show and the sample holds."""
        size = self.grid.size
        reach = 0 if self.seam == "blend" else size // 2
        left, top, right, bottom = (reach if side else 0 for side in gap.sides)
        height, width = self.patches.sample.shape[:2]
        x, y = (float(value) for value in place)
        return (
            max(-top, math.ceil(-y - 0.5)),
            min(size + bottom, math.floor(height - 0.5 - y) + 1),
            max(-left, math.ceil(-x - 0.5)),
            min(size + right, math.floor(width - 0.5 - x) + 1),
        )

    def border_mask(self, gap: Block) -> Mask:
        """Return where something is known in a gap, outside the hole."""
        mask = self.known[gap.window()].copy()
        mask[box_slices(gap.border.hole)] = False
        return mask

    def cut_patch(self, place: Points, box: Box) -> tuple[Image, Source]:
        """Return what the patch at a place shows over a box, and its source map."""
        y0, y1, x0, x1 = box
        return self.patches.cut_patch(np.add(place, (x0, y0)), (y1 - y0, x1 - x0))

    def _layers(self, gap: Block) -> Layers:
        size = self.grid.size
        image = np.zeros((5, size, size, self.image.shape[2]), np.float32)
        source = np.ones((5, size, size, 3), np.float32)
        for side, neighbor, strip in gap.neighbors():
            origin = self.places[neighbor.row, neighbor.column] - (neighbor.corner - gap.corner)
            part = box_slices(strip)
            image[side][part], source[side][part] = self.cut_patch(origin, strip)
        return image, source

    def _blend(self, gap: Block, patch: tuple[Image, Source]) -> None:
        border, window = gap.border, gap.window()
        layers, sources = self._layers(gap)
        layers[OWN], sources[OWN] = patch
        x, y = border.pixels.T
        image, source = self.image[window], self.source[window]
        image[...], source[...] = patch
        image[y, x] = np.einsum("ln,lnc->nc", border.weights, layers[border.layers, y, x])
        main, every = border.weights.argmax(0), np.arange(len(x))
        source[y, x] = sources[border.layers[main, every], y, x]
        source[y, x, 2] *= border.weights[main, every]

    def _cut(self, gap: Block, box: Box, patch: tuple[Image, Source]) -> None:
        window = gap.window(box)
        overlap = PatchOverlap(self.image[window], patch[0], self.known[window], box, gap.border.hole, gap.sides)
        new = cut_graph(overlap, self._seams[:, *window])
        np.copyto(self.image[window], patch[0], where=new[..., np.newaxis])
        np.copyto(self.source[window], patch[1], where=new[..., np.newaxis])

    def _record_corner_seams(self, gap: Block, layers: Image) -> None:
        """Record the costs of the seams in a gap's corners, where the borders of two neighbors meet."""
        half = self.grid.size // 2
        beside = np.concatenate([layers[0][:, :half], layers[2][:, half:]], 1)
        above = np.concatenate([layers[1][:half], layers[3][half:]], 0)
        costs, owners, seams = link_costs(beside, above, True), gap.border.owners, self._seams[:, *gap.window()]
        seams[0, :, :-1] = _costs_between_neighbors(owners[:, 1:], owners[:, :-1], costs[0, :, :-1])
        seams[1, :-1] = _costs_between_neighbors(owners[1:], owners[:-1], costs[1, :-1])


def _costs_between_neighbors(
    owner: NDArray[np.int64], other: NDArray[np.int64], cost: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the cost where one owner is to the left or right and the other one above or below, else 0."""
    return np.where((owner % 2 != other % 2) & (owner != OWN) & (other != OWN), cost, 0.0)


def compose(patches: Patches, grid: BlockGrid, places: Places) -> tuple[Image, Source]:
    """Compose an output of patches at given places, blended at their borders.

    Parameters
    ----------
    patches
        The patches of the sample.
    grid
        The blocks.
    places
        See :data:`Places`. The borders of placed blocks must lie inside the sample, too.

    Returns
    -------
    image, source
        The output and its source map.
    """
    canvas = BlockCanvas(patches, grid)
    for block in grid.placed():
        canvas.place_block(block, places[block.row, block.column])
    for gap in grid.gaps():
        canvas.fill_gap(gap, places[gap.row, gap.column])
    return canvas.output()


@dataclass(frozen=True, eq=False)
class PatchOverlap:
    """A gap's patch over the picture that it is joined to.

    Parameters
    ----------
    old, new
        ``(h, w, C)``: the picture and the patch, over ``box``.
    known
        ``bool (h, w)``: where the old picture is known. It is unknown in the hole, and in gaps that are still empty. A
        seam there cannot be judged and counts as the most visible one.
    box
        What both show, px from the gap's first pixel.
    hole
        The part of the gap where nothing old is known.
    sides
        Where the gap has neighbors. The other sides are edges of the output.
    """

    old: Image
    new: Image
    known: Mask
    box: Box
    hole: Box
    sides: Sides

    @property
    def inner(self) -> Box:
        """The pixels that must be new: the hole, px from the box's first pixel, and at least 2 px wide if possible.

        A small block at the sample's edge has a hole of less than 2 px. The box's edge beside a neighbor stays old.
        """
        y0, y1, x0, x1 = self.hole
        left, top, right, bottom = self.sides
        return (
            *_widen(y0 - self.box[0], y1 - self.box[0], int(top), self.old.shape[0] - bottom),
            *_widen(x0 - self.box[2], x1 - self.box[2], int(left), self.old.shape[1] - right),
        )

    def fixed_new(self) -> Mask:
        """Return the pixels that must be new."""
        mask = np.zeros(self.old.shape[:2], np.bool_)
        mask[box_slices(self.inner)] = True
        return mask

    def fixed_old(self) -> Mask:
        """Return the pixels that must stay old: those at the box's edge, on the sides that have neighbors."""
        mask = np.zeros(self.old.shape[:2], np.bool_)
        for edge, there in zip((mask[:, 0], mask[0], mask[:, -1], mask[-1]), self.sides, strict=True):
            edge |= there
        return mask


def _widen(start: int, stop: int, first: int, last: int) -> tuple[int, int]:
    """Return a range of less than 2 px lengthened by one at both ends, but not beyond ``first`` and ``last``."""
    return (start, stop) if stop - start >= 2 else (max(start - 1, first), min(stop + 1, last))


def cut_graph(overlap: PatchOverlap, seams: NDArray[np.float32]) -> Mask:
    """Return where the new picture is shown if the seam is the least visible closed one around the hole.

    With plain differences (Kwatra et al. 2003, equation 1) the shortest seam often crosses bricks of nearly one color
    and leaves them two-toned. Divided by gradients, it follows their outlines; squared, it avoids large differences.

    Parameters
    ----------
    overlap
        The patch and the picture.
    seams
        ``(2, h, w)``: the costs of the old picture's seams over the box, to the right and downward. They are changed in
        place to those of the joined picture.
    """
    known = overlap.known
    old = np.where(known[..., np.newaxis], overlap.old, overlap.new)
    costs = link_costs(old, np.ascontiguousarray(overlap.new), True)
    highest = costs.max(initial=0)
    np.copyto(costs[0, :, :-1], highest, where=~(known[:, 1:] & known[:, :-1]))
    np.copyto(costs[1, :-1], highest, where=~(known[1:] & known[:-1]))
    new = cut_overlap(costs, seams, overlap.fixed_old(), overlap.fixed_new())
    record_seams(seams, np.ones(new.shape, np.uint8), new, costs)
    return new
