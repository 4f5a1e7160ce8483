"""Divide an output into square blocks like a chess-board, and join the patches of the blocks.

Every other block is *placed* first; the others are *gaps*. The patch of a placed block reaches beyond its square and
shows a border in the gaps beside it. Where two borders meet in a corner of a gap, the diagonal divides them, so that
each has the shape of a wedge. The patch of a gap is joined to the borders by blending or along seams, and may be
deformed to meet them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Refused

from ..canvas.canvas import (
    FURTHER,
    Box,
    Canvas,
    Further,
    Mask,
    Patch,
    Sides,
    Source,
    Window,
    cut_closed_seam,
    edge_mask,
    find_paths,
)
from ..canvas.seam_kernels import link_costs
from ..lattice_places.equal_places import SearchShape, pixel_grid, search_shape
from ..matching.frame_matching import fit_deformation
from ..sample_reading.patches import Patches

_STEPS: Final = ((-1, 0), (0, -1), (1, 0), (0, 1))
"""(x, y) from a block to each neighbor, in blocks."""
OWN: Final = 4
"""The layer of a gap's own patch; 0 to 3 are the neighbors'."""
SeamMethod = Literal["blend", "graphcut", "quilting"]
Places = NDArray[np.float64]
"""``float64 (rows, columns, 2)``: the real-valued (x, y) in the sample of every block's first pixel."""
Layers = tuple[Image, Source]
"""``(5, block, block, C)`` and ``(5, block, block, 3)``: what the patch of each neighbor shows in a gap, 0 where it
does not reach. The last layer is the gap's own patch."""


def check_border(block: int, border: int) -> None:
    """Raise :class:`BadInput` unless ``border`` is from 1 px to half a block."""
    require(1 <= border <= block // 2, f"border {border} with block {block}; choose a border from 1 to half a block")


def box_slices(box: Box) -> tuple[slice, slice]:
    """Return the rows and columns of a box."""
    y0, y1, x0, x1 = box
    return slice(y0, y1), slice(x0, x1)


@dataclass(frozen=True)
class BlockGrid:
    """The blocks of an output. Those at the right and at the bottom may reach beyond it.

    Parameters
    ----------
    shape
        Height and width of the output in px.
    size
        Side of a block in px.
    border
        Width in px of what the patch of a placed block shows beyond its square, at most half a block.
    wrap
        (rows, columns) of blocks, even numbers, if opposite edges of the output are adjacent; blocks that are larger
        than their share of a side then overlap their neighbors by the rest. None: nothing wraps.
    """

    shape: tuple[int, int]
    size: int
    border: int
    wrap: tuple[int, int] | None = None

    @classmethod
    def closing(cls, shape: tuple[int, int], size: int, border: int, sample: tuple[int, ...]) -> BlockGrid:
        """Return a grid that wraps. Its blocks are about as large as ``size``, fit the sample, and overlap least.

        Raises
        ------
        Refused
            If there is none.
        """
        evens = [range(2, 2 * math.ceil(side / size) + 3, 2) for side in shape]
        grids = []
        for counts in itertools.product(evens[0], evens[1]):
            shares = [side / count for side, count in zip(shape, counts, strict=True)]
            side = math.ceil(max(shares))
            if 2 * border <= side <= min(sample[:2]) - 2 * border:
                grids.append((side - min(shares) + abs(side - size) / 4, cls(shape, side, border, counts)))
        if not grids:
            raise Refused(
                f"no even number of blocks from {2 * border} px to {min(sample[:2]) - 2 * border} px a side, which the "
                f"sample holds with their borders, covers {shape[1]}x{shape[0]} px; choose a smaller border"
            )
        return min(grids, key=lambda rated: rated[0])[1]

    @property
    def counts(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        if self.wrap:
            return self.wrap
        height, width = self.shape
        return -(-height // self.size), -(-width // self.size)

    def placed(self) -> Iterator[Block]:
        """Yield the placed blocks, row by row."""
        return self._alternate(0)

    def gaps(self) -> Iterator[Block]:
        """Yield the gaps, row by row."""
        return self._alternate(1)

    def _alternate(self, parity: int) -> Iterator[Block]:
        rows, columns = self.counts
        return (Block(self, i, j) for i in range(rows) for j in range(columns) if (i + j) % 2 == parity)

    def search_shape(self, sample_shape: tuple[int, ...]) -> SearchShape:
        """Return the rows and columns of places at which a block and its borders lie inside a sample.

        Raises
        ------
        Refused
            If there are none.
        """
        height, width = sample_shape[:2]
        side = self.size + 2 * self.border
        if side > min(height, width):
            raise Refused(
                f"the sample is {width}x{height} px, a block with its borders {side}x{side} px; "
                f"choose block + 2 border <= {min(height, width)}"
            )
        return search_shape(side, (height, width))


@dataclass(frozen=True)
class Block:
    """A block of a grid: where it lies in the output, and what surrounds it.

    Parameters
    ----------
    grid
        The grid.
    row, column
        The place of the block in the grid.
    """

    grid: BlockGrid
    row: int
    column: int

    @property
    def corner(self) -> Points:
        """(x, y) px of the first pixel."""
        if self.grid.wrap:
            (height, width), (rows, columns) = self.grid.shape, self.grid.wrap
            return np.rint([self.column * width / columns, self.row * height / rows])
        return np.array([self.column, self.row], np.float64) * self.grid.size

    @property
    def box(self) -> Box:
        """The block itself, px from its first pixel."""
        return 0, self.grid.size, 0, self.grid.size

    def window(self, box: Box | None = None) -> Window:
        """Return the window of the output under the block, or under a box, px from its first pixel."""
        (left, top), (y0, y1, x0, x1) = self.corner.astype(int).tolist(), box or self.box
        return top + y0, top + y1, left + x0, left + x1

    @property
    def sides(self) -> Sides:
        """Which neighbors the block has."""
        if self.grid.wrap:
            return True, True, True, True
        rows, columns = self.grid.counts
        return self.column > 0, self.row > 0, self.column < columns - 1, self.row < rows - 1

    def neighbors(self) -> Iterator[tuple[int, Block, Box]]:
        """Yield each side that has a neighbor, the neighbor, and the strip of this gap that its patch shows."""
        size, border = self.grid.size, self.grid.border
        far = size - border
        strips = ((0, size, 0, border), (0, border, 0, size), (0, size, far, size), (far, size, 0, size))
        for side, (there, (dx, dy), strip) in enumerate(zip(self.sides, _STEPS, strips, strict=True)):
            if there:
                yield side, Block(self.grid, self.row + dy, self.column + dx), strip

    @property
    def border(self) -> GapBorder:
        """The border inside the block, which is a gap."""
        return gap_border(self.grid.size, self.grid.border, self.sides)


@dataclass(frozen=True, eq=False)
class GapBorder:
    """The border inside a gap: its n pixels are less than ``border`` px from a neighbor.

    Parameters
    ----------
    pixels
        ``(n, 2)``: (x, y) in the gap.
    layers
        ``(3, n)``: the layers blended at the pixel: the gap's own patch, the neighbor to the left or right, and the one
        above or below.
    weights
        ``float32 (3, n)``: weights of these layers; they sum to 1.
    hole
        The rest of the gap.
    owners
        ``(block, block)``: the side in whose wedge each pixel lies, which is the nearest one; :data:`OWN` in the hole.
    """

    pixels: NDArray[np.int64]
    layers: NDArray[np.int64]
    weights: NDArray[np.float32]
    hole: Box
    owners: NDArray[np.int64]


@lru_cache(maxsize=256)
def gap_border(block: int, border: int, sides: Sides) -> GapBorder:
    """Return the border of a gap that has neighbors at ``sides``.

    The gap's own patch fades in linearly from the gap's edge to the border's inner edge. The rest of the weight goes to
    the neighbor in whose wedge the pixel lies, with a smooth passage across the diagonal between two wedges. At the
    gap's edge the neighbor has all the weight, so that the squares of placed blocks stay as they are.
    """
    depths = _depths(block, border, sides)
    rows, columns = np.nonzero(depths.min(0) < 1)
    depth = depths[:, rows, columns]
    beside, above = np.where(depth[0] < depth[2], 0, 2), np.where(depth[1] < depth[3], 1, 3)
    p, q = depth[[0, 2]].min(0), depth[[1, 3]].min(0)
    layers, weights = np.stack([np.full_like(beside, OWN), beside, above]), _weights(p, q)
    owners = np.full((block, block), OWN)
    owners[rows, columns] = np.where(p <= q, beside, above)
    left, top, right, bottom = (border if side else 0 for side in sides)
    return GapBorder(
        pixels=np.stack([columns, rows], -1),
        layers=np.where(weights > 0, layers, OWN),
        weights=weights,
        hole=(top, block - bottom, left, block - right),
        owners=owners,
    )


def _depths(block: int, border: int, sides: Sides) -> NDArray[np.float64]:
    """Return the distance of each pixel from each side over the border's width, at most 1: ``(4, block, block)``."""
    depth = np.minimum((np.arange(block) + 0.5) / border, 1)
    across, down = np.broadcast_to(depth, (block, block)), np.broadcast_to(depth[:, np.newaxis], (block, block))
    depths = np.stack([across, down, across[:, ::-1], down[::-1]])
    return np.where(np.array(sides)[:, np.newaxis, np.newaxis], depths, 1)


def _weights(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float32]:
    own = np.minimum(p, q)
    beside, above = 1 / p - 1, 1 / q - 1
    share = beside / (beside + above)
    return np.stack([own, (1 - own) * share, (1 - own) * (1 - share)]).astype(np.float32)


class BlockPlacer:
    """Places the patches of blocks on a canvas.

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
        ``"blend"``: linear blending. ``"graphcut"``: cut along the least visible closed seam
        (:func:`~nrbench.synthesizers.canvas.canvas.cut_closed_seam`). ``"quilting"``: cut along the path of least
        squared difference of each side (:func:`~nrbench.synthesizers.canvas.canvas.find_paths`).
    deform
        Largest displacement of a pixel of a gap's patch, px. 0: patches are not deformed.

    Attributes
    ----------
    places
        See :data:`Places`.
    canvas
        The output.
    """

    def __init__(self, patches: Patches, grid: BlockGrid, seam: SeamMethod = "blend", deform: float = 0.0) -> None:
        self.patches, self.grid, self.seam, self.deform = patches, grid, seam, deform
        self.places: Places = np.zeros((*grid.counts, 2))
        channels, beyond = patches.sample.shape[2], (grid.size, grid.size)
        self.canvas = Canvas(grid.shape, channels, margin=beyond, wrap=grid.wrap is not None)

    def place_block(self, block: Block, place: Points) -> None:
        """Place a block. Its borders must lie inside the sample, too."""
        self.places[block.row, block.column] = place
        self.canvas.place(block.window(), self.cut_patch(place, block.box))

    def extend_placed(self) -> None:
        """Show, in the border of every gap, the patches of the placed blocks around, each in its wedge."""
        rows, columns = np.indices((self.grid.size, self.grid.size))
        for gap in self.grid.gaps():
            owners, (image, source) = gap.border.owners, self._layers(gap)
            self.canvas.place(gap.window(), (image[owners, rows, columns], source[owners, rows, columns]), owners < OWN)
            if self.seam == "graphcut":
                self._record_corner_seams(gap, image)

    def fill_gap(self, gap: Block, place: Points) -> None:
        """Fill a gap with the patch whose first pixel lies at a place (x, y), and join it to what is known around."""
        self.places[gap.row, gap.column] = place
        box = self._patch_box(gap, place)
        patch = self._deformed(gap, place, box) if self.deform else self.cut_patch(place, box)
        if self.seam == "blend":
            blended, further = self._blended(gap, patch)
            self.canvas.place(gap.window(), blended, further=further)
        else:
            self._cut_in(gap, box, patch)

    def _patch_box(self, gap: Block, place: Points) -> Box:
        """Return the largest box, px from the gap's first pixel, that a gap's patch may show and the sample holds."""
        size = self.grid.size
        reach = 0 if self.seam == "blend" else size // 2
        if self.grid.wrap:
            reach = min(reach, (min(self.grid.shape) - size) // 2)
        left, top, right, bottom = (reach if side else 0 for side in gap.sides)
        height, width = self.patches.sample.shape[:2]
        x, y = (float(value) for value in place)
        return (
            max(-top, math.ceil(-y - 0.5)),
            min(size + bottom, math.floor(height - 0.5 - y) + 1),
            max(-left, math.ceil(-x - 0.5)),
            min(size + right, math.floor(width - 0.5 - x) + 1),
        )

    def border_mask(self, gap: Block, box: Box) -> Mask:
        """Return where something is known in a box, px from a gap's first pixel, outside the hole."""
        mask: Mask = self.canvas.known[self.canvas.pixels(gap.window(box))].copy()
        mask[box_slices(_hole_in(gap, box))] = False
        return mask

    def cut_patch(self, place: Points, box: Box) -> Patch:
        """Return what the patch at a place shows over a box, and its source map."""
        y0, y1, x0, x1 = box
        return self.patches.cut_patch(np.add(place, (x0, y0)), (y1 - y0, x1 - x0))

    def _deformed(self, gap: Block, place: Points, box: Box) -> Patch:
        """Return a gap's patch over a box, deformed so that it agrees best with what the output shows around the hole.

        A pixel that the displacement moves out of the sample shows the sample's edge.
        """
        y0, y1, x0, x1 = box
        points = np.add(place, (x0, y0)) + pixel_grid(x1 - x0, y1 - y0)
        last = np.array(self.patches.sample.shape[1::-1]) - 0.5
        field = fit_deformation(
            lambda moves: self.patches.read_points(np.clip(points + moves, -0.5, last)),
            self.canvas.image[self.canvas.pixels(gap.window(box))],
            self.border_mask(gap, box).astype(np.float64),
            self.deform,
        )
        return self.patches.read_with_source(np.clip(points + field, -0.5, last))

    def _layers(self, gap: Block) -> Layers:
        size = self.grid.size
        image = np.zeros((5, size, size, self.patches.sample.shape[2]), np.float32)
        source = np.ones((5, size, size, 3), np.float32)
        for side, neighbor, strip in gap.neighbors():
            rows, columns = self.grid.counts
            origin = self.places[neighbor.row % rows, neighbor.column % columns] - (neighbor.corner - gap.corner)
            part = box_slices(strip)
            image[side][part], source[side][part] = self.cut_patch(origin, strip)
        return image, source

    def _blended(self, gap: Block, patch: Patch) -> tuple[Patch, Further]:
        """Return the patch of a gap, blended with those of its neighbors over its border, and its further sources."""
        border, (layers, sources) = gap.border, self._layers(gap)
        layers[OWN], sources[OWN] = patch
        image, source = patch[0].copy(), patch[1]
        x, y = border.pixels.T
        image[y, x] = np.einsum("ln,lnc->nc", border.weights, layers[border.layers, y, x])
        shown = sources[border.layers, y, x]
        shown[..., 2] *= border.weights
        shown = np.take_along_axis(shown, (-border.weights).argsort(0, "stable")[..., np.newaxis], 0)
        source[y, x], further = shown[0], np.zeros((*source.shape[:2], FURTHER, 3), np.float32)
        further[y, x, :2] = shown[1:].swapaxes(0, 1)
        return (image, source), further

    def _cut_in(self, gap: Block, box: Box, patch: Patch) -> None:
        """Cut a patch into the canvas along a closed seam, or a path at each side, around the hole of a gap.

        The outermost pixels of the box beside a neighbor stay old. The hole must be new, at least 2 px of it if
        possible: a small block at the sample's edge has a narrower one.
        """
        canvas, window = self.canvas, gap.window(box)
        pixels = canvas.pixels(window)
        if self.seam == "quilting":
            old, known = canvas.image[pixels], canvas.known[pixels]
            canvas.place(window, patch, cut_paths(old, patch[0], known, _hole_in(gap, box)))
            return
        known, seams, ends = canvas.known[pixels], canvas.seams[:, *pixels], []
        for axis in (0, 1):
            start, stop = _hole_in(gap, box)[2 * axis : 2 * axis + 2]
            if stop - start < 2:
                first, last = int(gap.sides[1 - axis]), known.shape[axis] - int(gap.sides[3 - axis])
                start, stop = max(start - 1, first), min(stop + 1, last)
            ends.append(slice(start, stop))
        fixed_new = np.zeros_like(known)
        fixed_new[*ends] = True
        fixed = edge_mask(fixed_new.shape, gap.sides), fixed_new
        canvas.place(window, patch, cut_closed_seam(canvas.image[pixels], patch[0], known, fixed, seams))
        canvas.seams[:, *pixels] = seams

    def _record_corner_seams(self, gap: Block, layers: Image) -> None:
        """Record the costs of the seams in a gap's corners, where the borders of two neighbors meet."""
        half, pixels = self.grid.size // 2, self.canvas.pixels(gap.window())
        beside = np.concatenate([layers[0][:, :half], layers[2][:, half:]], 1)
        above = np.concatenate([layers[1][:half], layers[3][half:]], 0)
        costs, owners, seams = link_costs(beside, above, True), gap.border.owners, self.canvas.seams[:, *pixels]
        seams[0, :, :-1] = _costs_between_neighbors(owners[:, 1:], owners[:, :-1], costs[0, :, :-1])
        seams[1, :-1] = _costs_between_neighbors(owners[1:], owners[:-1], costs[1, :-1])
        self.canvas.seams[:, *pixels] = seams


def _hole_in(gap: Block, box: Box) -> Box:
    """Return the hole of a gap, px from the first pixel of a box."""
    y0, y1, x0, x1 = gap.border.hole
    return y0 - box[0], y1 - box[0], x0 - box[2], x1 - box[2]


def cut_paths(old: Image, new: Image, known: Mask, hole: Box) -> Mask:
    """Return where a patch is shown if it is cut along a path of least squared difference at each side of a hole.

    The paths of the left and of the top meet, and those of the right and of the bottom (Efros and Freeman 2001, section
    2.1). At the other two corners the patch is shown where it lies inside both paths. A pixel that is not known counts
    as the largest difference.
    """
    error = np.einsum("hwc,hwc->hw", old - new, old - new).astype(np.float64)
    error[~known] = error[known].max(initial=0)
    (y0, y1, x0, x1), (height, width) = hole, error.shape
    before, after = find_paths(error, x0, y0), find_paths(error[::-1, ::-1].copy(), width - x1, height - y1)
    return before.mask() & after.mask()[::-1, ::-1]


def _costs_between_neighbors(
    owner: NDArray[np.int64], other: NDArray[np.int64], cost: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the cost where one owner is to the left or right and the other one above or below, else 0."""
    return np.where((owner % 2 != other % 2) & (owner != OWN) & (other != OWN), cost, 0.0)
