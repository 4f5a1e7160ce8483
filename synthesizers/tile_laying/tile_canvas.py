"""The output that tiles are laid on, one over another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from ..seams.minimum_cut import ENDS, Links, cut_overlap, record_seams
from ..seams.seam_kernels import cheapest_path, link_costs
from .tile_stock import CoveredPixels, TilePlaces, TileStock

FEATHER = 3.0
"""px; width of the ramp where the two seams of dynamic programming conflict (the paper gives no width)."""


class TileCanvas:
    """An output with a margin around it, wide enough for every tile that touches the output.

    Parameters
    ----------
    shape
        Height and width of the output.
    stock
        The tiles.

    Attributes
    ----------
    values, filled, origins
        ``uint8 (H, W, C)``, the canvas with its margin; ``bool (H, W)``, where it is filled; and its source map.
    seams
        ``(H, W, 2)``: costs of the seams between each pixel and the next to its right, and below, for minimum cuts.
    weights
        ``(H, W)``: tiles are joined along exact minimum cuts of the overlap; how much a seam counts at each pixel.
        None: along two seams by dynamic programming, blended where they conflict.
    margin
        Width of the margin along x and y, px.
    """

    def __init__(self, shape: tuple[int, int], stock: TileStock) -> None:
        tile, images = stock.tile, stock.images
        self.shape, self.tile, self.images = shape, tile, images
        self.weights: NDArray[np.float32] | None = None
        self.margin = np.ceil(3 * tile.reach).astype(int) + 2
        size = shape[0] + 2 * self.margin[1], shape[1] + 2 * self.margin[0]
        self.values = np.zeros((*size, images.shape[2]), np.uint8)
        self.filled = np.zeros(size, np.bool_)
        self.origins = np.zeros((*size, 3), np.float32)
        self.seams = np.zeros((*size, 2), np.float32)
        self._nearest = _nearest_pixels(images.parts)
        dx, dy, _, _, border = tile.pixels.T
        self._own, self._free = np.zeros((2, *(np.ptp(tile.box, axis=0) + 1)[::-1]), np.bool_)
        self._own[dy - tile.box[0, 1], dx - tile.box[0, 0]] = True
        self._free[dy - tile.box[0, 1], dx - tile.box[0, 0]] = border > 0

    def overlap(self, left: int, top: int) -> CoveredPixels:
        """Return what is filled under a tile around pixel (left, top) of the canvas."""
        x, y = self.tile.pixels[:, :2].T
        seen = self.filled[top + y, left + x]
        offsets = (y * self.images.shape[1] + x)[seen] * self.images.shape[2]
        return CoveredPixels.from_offsets(self.values[top + y, left + x][seen], offsets)

    def lay(self, left: int, top: int, drawn: TilePlaces) -> None:
        """Lay one tile around pixel (left, top) of the canvas, and stitch it to what is filled (steps 5 and 6)."""
        row, (x, y) = int(drawn.row[0]), drawn.pixel[0]
        source = self.images.values[row].reshape(self.images.shape)
        if self.weights is not None:
            weights = self._cut(left, top, source, x, y)
        else:
            weights = self._blend(left, top, source, x, y)
        shown = weights > 0
        dx, dy = self.tile.pixels[shown, :2].T
        at, share = (top + dy, left + dx), weights[shown]
        mixed = share[:, np.newaxis] * source[y + dy, x + dx] + (1 - share)[:, np.newaxis] * self.values[at]
        self.values[at] = (mixed + 0.5).astype(np.uint8)
        near_x, near_y, copied = self._nearest[row]
        new, old = share * copied, (1 - share) * self.origins[at][:, 2]
        larger = ~self.filled[at] | (new >= old)
        places = np.column_stack([x + near_x + dx, y + near_y + dy, new])
        kept = np.column_stack([self.origins[at][:, :2], old])
        self.origins[at] = np.where(larger[:, np.newaxis], places, kept)
        self.filled[at] = True

    def _cut(self, left: int, top: int, source: NDArray[np.uint8], x: int, y: int) -> NDArray[np.float64]:
        """Return the weight of each of a tile's pixels: 1 where nothing is filled and beyond the best seam, else 0.

        The tile's outermost pixels are not shown where the canvas is filled. A seam along the border of the filled
        region has nothing to be compared with. Its cost is the double of what the known side contributes, for this tile
        and for those that follow. If it were free, cuts would follow it straight through elements.
        """
        assert self.weights is not None
        (x0, y0), (x1, y1) = self.tile.box
        dx, dy = self.tile.pixels[:, :2].T
        window = np.s_[top + y0 : top + y1 + 1, left + x0 : left + x1 + 1]
        filled, weights, seams = self.filled[window], self.weights[window].astype(np.float64), self.seams[window]
        empty = self._own & ~filled
        canvas, tile = self.values[window], source[y + y0 : y + y1 + 1, x + x0 : x + x1 + 1]
        new = np.asarray(np.where(self._own[..., np.newaxis], tile, canvas) / np.float32(255), np.float32)
        old = np.where(empty[..., np.newaxis], new, np.asarray(canvas / np.float32(255), np.float32))
        if (old == new).all():
            return np.asarray(empty[dy - y0, dx - x0], np.float64)
        links = Links(*link_costs(old, new, False))
        for cost, (here, there) in zip(links, ENDS, strict=True):
            cost *= (weights[here] + weights[there]) / 2
            cost[empty[here] != empty[there]] *= 2
        old_seams = Links(seams[:, :-1, 0], seams[:-1, :, 1])
        shown = cut_overlap(links, ~(self._free | empty), empty, old_seams)
        record_seams(old_seams, links, shown, filled | shown)
        return np.asarray(shown[dy - y0, dx - x0], np.float64)

    def _blend(self, left: int, top: int, source: NDArray[np.uint8], x: int, y: int) -> NDArray[np.float64]:
        """Return the weight of each of a tile's pixels over what is filled, given its two seams.

        Where nothing is filled the weight is 1. Where only one seam applies, it cuts. Where both apply, the tile fades
        in with the depth beyond the nearer seam, from half of :data:`FEATHER` before it to half of it behind. Where the
        canvas is filled and no seam applies, the tile fades in from its border.
        """
        dx, dy = np.moveaxis(self.tile.cells, -1, 0)
        difference = self.values[top + dy, left + dx].astype(np.float64) - source[y + dy, x + dx]
        surface = np.where(self.filled[top + dy, left + dx], (difference**2).sum(-1), -1)
        (left_band, across), (top_band, down) = find_seam(surface), find_seam(surface.T)
        dx, dy, row, column, border = self.tile.pixels.T
        beside, above = column < left_band, row < top_band
        depth = np.minimum(
            np.where(beside, column - across[row] + 0.5, np.inf), np.where(above, row - down[column] + 0.5, np.inf)
        )
        depth = np.where(beside | above, depth, border + 0.5 - FEATHER / 2)
        weights = np.where(beside == above, np.clip(depth / FEATHER + 0.5, 0, 1), depth > 0)
        return np.where(self.filled[top + dy, left + dx], weights, 1.0)

    def output(self) -> tuple[Image, NDArray[np.float32]]:
        """Return the output and its source map."""
        (height, width), (x, y) = self.shape, self.margin
        window = np.s_[y : y + height, x : x + width]
        return np.asarray(self.values[window] / np.float32(255), np.float32), self.origins[window]


def _nearest_pixels(parts: int) -> NDArray[np.float64]:
    """Return the sample's pixel (x, y) nearest to pixel (0, 0) of each shifted image, and its weight."""
    fractions = np.array([(fx, fy) for fy, fx in np.ndindex(parts, parts)]) / parts
    return np.column_stack([np.floor(fractions + 0.5), np.maximum(fractions, 1 - fractions).prod(1)])


def find_seam(surface: NDArray[np.float64]) -> tuple[int, NDArray[np.int64]]:
    """Find the seam of a tile by dynamic programming, from top to bottom (step 5).

    Parameters
    ----------
    surface
        ``(rows, columns)``: squared differences, negative where nothing is filled.

    Returns
    -------
    band
        How far the filled region reaches from the left in rows that are not completely covered, 0 if there are none.
    seam
        ``(rows,)``: the first new column, in the band.
    """
    empty = surface < 0
    band = int(np.where(empty.any(1), empty.argmax(1), 0).max())
    if not band:
        return 0, np.zeros(len(surface), np.int64)
    return band, cheapest_path(np.maximum(surface[:, :band], 0, order="C"))
