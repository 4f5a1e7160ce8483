"""An output under construction, and the masks and weights by which patches are joined to it."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Shape

from .seam_kernels import blend_pixels, cheapest_path, corner_paths, cut_overlap, link_costs, record_seams

Window = tuple[int, int, int, int]
"""(y0, y1, x0, x1), half-open, px of the output. A window may reach beyond the edges of the output."""
Box = tuple[int, int, int, int]
"""(y0, y1, x0, x1), half-open, px from the first pixel of a patch."""
Sides = tuple[bool, bool, bool, bool]
"""Left, top, right, bottom: the sides on which a patch has neighbors."""
Mask = NDArray[np.bool_]
Pixels = NDArray[Any]
"""``(h, w, C)``: ``float32`` in [0, 1], or ``uint8``."""
Source = NDArray[np.float32]
"""``float32 (h, w, 3)``: the place (x, y) in the sample that a pixel shows, and its weight, 1 unless it is blended."""
FURTHER: Final = 3
"""Sources of a blended pixel that are kept beside the main one."""
Further = NDArray[np.float32]
"""``float32 (h, w, 3, 3)``: the further sources of blended pixels; 0 where there is none."""
Patch = tuple[Pixels, Source]
"""The pixels of a patch and its source map."""
ExactPatch = Patch | tuple[Pixels, Source, Image]
"""A patch, also with its exact pixels, for a canvas that has them."""


class Canvas:
    """An output under construction: its pixels, their sources, and the seams between patches.

    Parameters
    ----------
    shape
        Height and width of the output, px.
    channels
        Number of channels.
    dtype
        Type of the pixels: ``float32`` in [0, 1], or ``uint8``, with which comparisons are exact.
    margin
        Rows above and below the output, and columns at its sides, into which patches may reach. An output that wraps
        needs none.
    wrap
        Whether opposite edges of the output are adjacent. A window that crosses an edge goes on at the opposite one; it
        must not be larger than the output.
    seam_type
        Type of the costs of seams.
    exact
        Whether a canvas of ``uint8`` also has exact pixels, which are the output: for samples of 16 bits.

    Attributes
    ----------
    image
        ``(H, W, C)``: the pixels, with the margin.
    source
        ``float32 (H, W, 3)``: the source map.
    further
        The further sources, ``float32 (H, W, 3, 3)``; None until something is blended.
    exact
        ``float32 (H, W, C)``, or None: the exact pixels.
    known
        ``bool (H, W)``: where there are pixels.
    seams
        ``(2, H, W)``: the costs of the seams between each pixel and the next one to the right, and below. Methods that
        do not cut around old seams leave them 0.

    Examples
    --------
    >>> canvas = Canvas((2, 3), 1, wrap=True)
    >>> canvas.place((0, 2, 2, 4), (np.ones((2, 2, 1)), np.ones((2, 2, 3))))
    >>> canvas.known.astype(int).tolist()
    [[1, 0, 1], [1, 0, 1]]
    """

    def __init__(
        self,
        shape: Shape,
        channels: int,
        dtype: DTypeLike = np.float32,
        margin: Shape = (0, 0),
        wrap: bool = False,
        seam_type: DTypeLike = np.float32,
        exact: bool = False,
    ) -> None:
        self.shape, self.wrap, self.margin = shape, wrap, (0, 0) if wrap else margin
        size = shape[0] + 2 * self.margin[0], shape[1] + 2 * self.margin[1]
        self.image: Pixels = np.zeros((*size, channels), dtype)
        self.source: Source = np.zeros((*size, 3), np.float32)
        self.further: Further | None = None
        self.exact: Image | None = np.zeros((*size, channels), np.float32) if exact else None
        self.known: Mask = np.zeros(size, np.bool_)
        self.seams: NDArray[Any] = np.zeros((2, *size), seam_type)

    def pixels(self, window: Window) -> tuple[Any, Any]:
        """Return the indices of a window into the arrays of the canvas.

        Indexing gives a view, or a copy if the window crosses an edge of an output that wraps.
        """
        y0, y1, x0, x1 = window
        (height, width), (down, across) = self.shape, self.margin
        if self.wrap and (y0 < 0 or x0 < 0 or y1 > height or x1 > width):
            return (np.arange(y0, y1) % height)[:, np.newaxis], np.arange(x0, x1)[np.newaxis] % width
        return slice(y0 + down, y1 + down), slice(x0 + across, x1 + across)

    def place(
        self, window: Window, patch: ExactPatch, mask: Mask | None = None, further: Further | None = None
    ) -> None:
        """Show a patch in a window, where a mask ``bool (h, w)`` is True; everywhere if None, with further sources."""
        pixels = self.pixels(window)
        layers = [each for each in (self.image, self.source, self.exact) if each is not None]
        if further is not None:
            self._further()[pixels] = further
        elif self.further is not None:
            old = self.further[pixels]
            self.further[pixels] = 0 if mask is None else np.where(mask[..., np.newaxis, np.newaxis], 0, old)
        if mask is None:
            for canvas, new in zip(layers, patch, strict=True):
                canvas[pixels] = new
            self.known[pixels] = True
            return
        for canvas, new in zip(layers, patch, strict=True):
            old = canvas[pixels]
            np.copyto(_whole_pixels(old), _whole_pixels(new), where=mask)
            if old.base is not canvas:  # a copy across an edge
                canvas[pixels] = old
        self.known[pixels] |= mask

    def blend(self, window: Window, patch: ExactPatch, weights: NDArray[np.float64], full: float = 1.0) -> None:
        """Blend a patch into a window of a canvas of ``uint8``. Halves of a gray level are rounded up.

        Parameters
        ----------
        window, patch
            Where, and what.
        weights
            ``(h, w)``: the weights of the patch, in units of 1 / ``full``: 0, or ``full`` where nothing is known. The
            rest of the weight goes to what lies under the patch. Whole numbers give exact means.
        full
            The largest weight.

        Notes
        -----
        The source of a pixel is the one of the largest weight of all patches that were blended there. Three more are
        kept.
        """
        pixels = self.pixels(window)
        under = self.image[pixels], self.source[pixels], self._further()[pixels], self.known[pixels]
        blend_pixels(*under, *patch[:2], weights, full)
        if self.exact is not None:
            share = np.float32(1 / full) * weights[..., np.newaxis].astype(np.float32)
            self.exact[pixels] += share * (patch[2] - self.exact[pixels])  # type: ignore[misc]
        if under[0].base is not self.image:  # copies across an edge
            self.image[pixels], self.source[pixels], self._further()[pixels], self.known[pixels] = under

    def _further(self) -> Further:
        if self.further is None:
            self.further = np.zeros((*self.known.shape, FURTHER, 3), np.float32)
        return self.further

    def output(self) -> tuple[Image, Source]:
        """Return the output, ``float32`` in [0, 1], and its source map."""
        pixels = self.pixels((0, self.shape[0], 0, self.shape[1]))
        image = self.image[pixels] if self.exact is None else self.exact[pixels]
        if image.dtype == np.uint8:
            image = image / np.float32(255)
        return np.ascontiguousarray(image), np.ascontiguousarray(self.source[pixels])

    def blended(self) -> Further | None:
        """Return the further sources of the output's blended pixels; None if there are none."""
        pixels = self.pixels((0, self.shape[0], 0, self.shape[1]))
        return None if self.further is None else np.ascontiguousarray(self.further[pixels])


def _whole_pixels(array: NDArray[Any]) -> NDArray[Any]:
    """View all channels of a pixel as one item, ``(h, w)``: masked copies then take a fifth of the time."""
    return array.view(np.dtype((np.void, array.itemsize * array.shape[-1])))[..., 0]


def copy_patch(values: Pixels, place: tuple[int, int], shape: Shape, exact: Image | None = None) -> ExactPatch:
    """Return a view of the patch at a place (x, y) of a sample ``(H, W, C)``, its source map, and its exact pixels."""
    (x, y), (height, width) = place, shape
    source = np.ones((height, width, 3), np.float32)
    source[..., 0], source[..., 1] = x + np.arange(width), y + np.arange(height)[:, np.newaxis]
    patch = values[y : y + height, x : x + width], source
    return patch if exact is None else (*patch, exact[y : y + height, x : x + width])


def feather_weights(size: int, zone: int, sides: Sides) -> NDArray[np.float64]:
    """Return the weights of a square patch that overlaps earlier patches on some of its sides.

    The weight of a pixel is its distance to the nearest overlapped side, and is largest from ``zone`` on (Szeliski and
    Shum 1997; Liang et al. 2001, step e). The rest of the weight goes to what lies under the patch.

    Parameters
    ----------
    size
        Side of the patch, px.
    zone
        Width of the overlap, px.
    sides
        The sides on which the patch overlaps earlier patches.

    Returns
    -------
    NDArray
        ``(size, size)``: whole numbers from 1 to ``zone + 1``.

    Examples
    --------
    >>> feather_weights(4, 2, (True, False, False, False))[0].tolist()
    [1.0, 2.0, 3.0, 3.0]
    """
    left, top, right, bottom = sides
    ramp, full = np.minimum(np.arange(size) + 1, zone + 1), np.full(size, zone + 1)
    down, across = (
        np.minimum(ramp if first else full, ramp[::-1] if last else full)
        for first, last in ((top, bottom), (left, right))
    )
    return np.minimum(down[:, np.newaxis], across).astype(np.float64)


class SeamPaths(NamedTuple):
    """The paths along which a patch is cut at its left and at its top.

    Parameters
    ----------
    across
        ``(h,)``: the first column of each row that shows the patch.
    down
        ``(w,)``: the first row of each column that shows the patch.
    row, column
        The pixel at which the paths meet; what lies before it in both directions does not show the patch. (0, 0) if
        there is only one path.
    """

    across: NDArray[np.int64]
    down: NDArray[np.int64]
    row: int = 0
    column: int = 0

    def mask(self) -> Mask:
        """Return where the patch is shown, ``bool (h, w)``, which includes the pixels of the paths."""
        rows, columns = np.arange(len(self.across))[:, np.newaxis], np.arange(len(self.down))
        before = (rows < self.row) & (columns < self.column)
        return np.asarray((columns >= self.across[:, np.newaxis]) & (rows >= self.down) & ~before)


def find_paths(error: NDArray[np.float64], beside: int, above: int) -> SeamPaths:
    """Find the paths of least error between a patch and what it overlaps at its left and at its top.

    "When there is both a vertical and a horizontal overlap, the minimal paths meet in the middle and the overall
    minimum is chosen for the end point(s)" (Efros and Freeman 2001, section 2.1). One path comes up from the lowest row
    in the left overlap, the other one comes from the last column in the upper overlap. They end at the same pixel of
    the corner, which is chosen so that the sum of errors over both paths is least.

    Parameters
    ----------
    error
        ``(h, w)``, not negative: the error of each pixel. Only the overlap counts.
    beside, above
        Width of the overlap at the left and at the top, px, at most the lengths of the sides; 0 if there is none.

    Examples
    --------
    >>> error = np.array([[9, 9, 9, 9], [9, 0, 1, 0], [9, 2, 9, 9], [1, 9, 9, 9.0]])
    >>> find_paths(error, 2, 2).mask().astype(int).tolist()
    [[0, 0, 0, 0], [0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]]
    """
    across, down = np.zeros(error.shape[0], np.int64), np.zeros(error.shape[1], np.int64)
    row = column = 0
    if beside and above:
        row, column, across[row:], down[column:], _ = corner_paths(error, beside, above)
    elif beside:
        across = cheapest_path(np.ascontiguousarray(error[:, :beside]))
    elif above:
        down = cheapest_path(np.ascontiguousarray(error[:above].T))
    return SeamPaths(across, down, row, column)


def edge_mask(shape: Shape, sides: Sides) -> Mask:
    """Return the outermost pixels of a patch of a shape (height, width) on some sides."""
    mask = np.zeros(shape, np.bool_)
    for edge, there in zip((mask[:, 0], mask[0], mask[:, -1], mask[-1]), sides, strict=True):
        edge |= there
    return mask


def cut_closed_seam(
    old: Image,
    new: Image,
    known: Mask,
    fixed: tuple[Mask, Mask],
    seams: NDArray[np.float32] | None = None,
) -> Mask:
    """Return where a patch is shown if its seam is the least visible closed one around a part, an exact minimum cut.

    With plain differences (Kwatra et al. 2003, equation 1) the shortest seam often crosses bricks of nearly one color
    and leaves them two-toned. Divided by gradients, it follows their outlines; squared, it avoids large differences.

    Parameters
    ----------
    old, new
        ``(h, w, C)``: the picture and the patch.
    known
        ``bool (h, w)``: where the picture is known. A seam elsewhere cannot be judged and counts as the most visible
        one.
    fixed
        ``bool (h, w)`` each: where the picture must stay, and where the patch must be shown; no pixel is in both.
    seams
        ``(2, h, w)``: the costs of the picture's seams, changed to those with the patch. None: old seams do not count.

    Returns
    -------
    Mask
        ``bool (h, w)``.
    """
    costs = link_costs(np.where(known[..., np.newaxis], old, new), np.ascontiguousarray(new), True)
    highest = costs.max(initial=0)
    np.copyto(costs[0, :, :-1], highest, where=~(known[:, 1:] & known[:, :-1]))
    np.copyto(costs[1, :-1], highest, where=~(known[1:] & known[:-1]))
    before = np.zeros_like(costs, np.float32) if seams is None else seams
    mask = cut_overlap(costs, before, *fixed)
    record_seams(before, np.ones_like(mask), mask, costs)
    return mask
