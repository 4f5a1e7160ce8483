"""Image quilting: square blocks, joined along minimum error boundary cuts (method ``quilting``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.plugins.forms import Synthesis, Task

from .canvas.canvas import Box, Canvas, ExactPatch, cut_closed_seam, edge_mask, find_paths
from .gap_filling.holes import leaves_out
from .matching.frame_matching import FrameMatcher
from .patch_laying.raster_order import (
    LARGEST_SHARE,
    Place,
    RasterGrid,
    Spot,
    check_patch,
    choose_size,
    cover,
    draw_within,
)

PARTS = 6
"""An automatic overlap is this part of the block: a sixth (section 2.2)."""


@leaves_out
@dataclass(frozen=True)
class Quilting:
    """Image quilting (Efros and Freeman 2001).

    Square blocks of the sample are laid line by line, each in steps of a block less the overlap. The error of a block
    is the L2 norm of the differences of pixel values over its overlap with earlier blocks: at its left, at its top, or
    both in the shape of an L. For each spot the method computes the error of every block of the sample, and draws one
    of those within the tolerance of the least error, all with the same probability. Then it cuts the block along the
    path of least squared difference through the overlap (the minimum error boundary cut, section 2.1). In an L-shaped
    overlap, the two paths end at the same pixel, which is chosen so that their sum is least.

    The first block is drawn from all blocks of the sample. The paper leaves the size of the block to the user: it must
    be large enough to capture the structures of the texture. An automatic block is half the sample's shorter side,
    the best of the quarter, the third, three eighths and the half on texture models with periods of a tenth to a
    quarter of the sample. Errors are norms, as printed, not sums of squares: with these, the same tolerance would
    accept fewer blocks.

    Parameters
    ----------
    block
        Side of a block in px. 0: automatic, half the sample's shorter side.
    overlap
        Width of the overlap in px, from 1 to half a block. 0: a sixth of the block, rounded (the paper).
    tolerance
        A block is accepted if its error is at most (1 + tolerance) times the least error; 0 to 1e6. (The paper: 0.1.)

    References
    ----------
    .. [1] Alexei A. Efros, William T. Freeman. "Image Quilting for Texture Synthesis and Transfer." Proceedings of
           SIGGRAPH 2001, 341-346. :DOI:`10.1145/383259.383296`
    """

    block: int = 0
    overlap: int = 0
    tolerance: float = 0.1

    wraps: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "patches without a lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "1"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {"overlap": 0, "tolerance": 0.1}}
    patch_shape: ClassVar[str] = "user defined, square block"
    patch_placement: ClassVar[str] = "patch grids"
    patch_stitching: ClassVar[str] = "dynamic programming"
    paper: ClassVar[str] = """@inproceedings{efros2001image,
  author = {Alexei A. Efros and William T. Freeman},
  title = {Image Quilting for Texture Synthesis and Transfer},
  booktitle = {Proceedings of SIGGRAPH 2001},
  pages = {341--346},
  year = {2001}
}"""

    def __post_init__(self) -> None:
        check_patch("block", self.block, "overlap", self.overlap)
        require_ranges(self, tolerance=(0, LARGEST_SHARE))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            If the sample does not hold a block.
        """
        block = choose_size("block", self.block, "overlap", self.overlap, task.sample.shape)
        grid = RasterGrid.of(task, block, self.overlap or max(round(block / PARTS), 1))
        matcher = FrameMatcher(task.sample, grid.size)

        def choose(old: NDArray[np.float32], hole: Box) -> Place:
            errors = -matcher.rate_everywhere(old, hole)
            # Errors are squares of the paper's norm.
            index = draw_within(errors, (1 + self.tolerance) ** 2 * float(errors.min()), task.rng)
            y, x = divmod(index, matcher.search_shape[1])
            return x, y

        return cover(task, grid, choose, cut_in)


def cut_in(canvas: Canvas, spot: Spot, patch: ExactPatch) -> None:
    """Lay a patch into a spot, cut along the paths of least squared difference, or along a closed seam of least cost.

    A closed seam, an exact minimum cut, is needed where the patch overlaps others on three or four sides.
    """
    old, new = canvas.image[canvas.pixels(spot.window)], patch[0]
    if spot.sides[2] or spot.sides[3]:
        known = np.ones(old.shape[:2], np.bool_)
        before, after = (np.asarray(part / np.float32(255), np.float32) for part in (old, new))
        fixed_old, fixed_new = edge_mask(known.shape, spot.sides), np.zeros_like(known)
        fixed_old[:, 0] &= spot.sides[0]
        y0, y1, x0, x1 = spot.hole
        fixed_new[y0:y1, x0:x1] = True
        mask = cut_closed_seam(before, after, known, (fixed_old & ~fixed_new, fixed_new))
    else:
        apart = old.astype(np.int32) - new
        error = np.einsum("hwc,hwc->hw", apart, apart).astype(np.float64)
        mask = find_paths(error, spot.hole[2], spot.hole[0]).mask()
    canvas.place(spot.window, patch, mask)
