"""What each tile of an image is worth: how well the image is retold by repeating it, how smoothly it meets itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.box_sums import box_sums

Values = NDArray[np.float32]
"""``float32 (H, W, C)``, any range."""
Costs = NDArray[np.float64]
"""``float64 (H - h + 1, W - w + 1)``: one for each place (row, column) of a tile's first pixel."""
Mask = NDArray[np.bool_]
"""``bool (H, W)``."""
Size = tuple[int, int]
"""(h, w): rows and columns of a tile."""


def resemblance(image: Values, size: Size, known: Mask | None = None) -> Costs:
    """Return the mean squared difference between the image and each of its tiles repeated over it.

    Every tile stays where it lies, so that pixel q is compared with the tile's pixel of its residue class, modulo the
    tile's sides. A tile holds one pixel p of each class r, which alone brings D(p) = sum over the class of (I - I(p))^2
    = Q_r - 2 I(p) S_r + n_r I(p)^2 with the class' sum of squares Q_r, sum S_r and number n_r. What a tile costs is the
    sum of D over its box: one integral image serves all tiles.

    Parameters
    ----------
    image
        Channels' squares are summed.
    size
        Of the tile, at most the image's.
    known
        The pixels that count; None: all. Tiles that hold others cost infinity.

    Returns
    -------
    Costs
        SSDN(I, I_T) of representative tile, section 4.2. O(H W C), whatever the number of tiles; trying each of n tiles
        is O(n H W C).
    """
    shape, mask = image.shape[:2], np.ones(image.shape[:2], np.bool_) if known is None else known
    weight = mask.astype(np.float64)
    number, cost = _spread(_classes(weight, size), shape), np.zeros(shape)
    for channel in np.moveaxis(image, -1, 0):
        plane = (channel - channel[mask].mean(dtype=np.float64)) * weight
        cost += _spread(_classes(plane**2, size), shape)
        cost += plane * (number * plane - 2 * _spread(_classes(plane, size), shape))
    total = np.maximum(box_sums(cost, size), 0) / max(weight.sum(), 1)
    if known is not None:
        total[box_sums(weight, size) < size[0] * size[1] - 0.5] = np.inf
    return np.asarray(total)


def continuity(image: Values, size: Size) -> Costs:
    """Return how much each tile's first row and column differ from its last: where it meets itself when repeated.

    The squared differences, summed over channels and over the h + w pairs of pixels, over 2 (w + h - 1).

    Notes
    -----
    Representative tile, section 4.1, equation 5: h(T). The sums along each border come from cumulative sums, O(H W C).
    The paper calls h a mean, but divides by about twice the number of pairs: kept, as it is what its alpha weighs.
    """
    rows, columns = size
    height, width = image.shape[:2]
    across = _squares(image[:, columns - 1 :], image[:, : width - columns + 1])
    down = _squares(image[rows - 1 :], image[: height - rows + 1])
    total = box_sums(across, (rows, 1)) + box_sums(down, (1, columns))
    return np.asarray(np.maximum(total, 0) / (2 * (columns + rows - 1)))


def _squares(one: Values, other: Values) -> NDArray[np.float64]:
    difference = np.subtract(one, other, dtype=np.float64)
    return np.asarray(np.einsum("ijk,ijk->ij", difference, difference))


def _classes(plane: NDArray[np.float64], size: Size) -> NDArray[np.float64]:
    """Return the sum over each residue class, ``(h, w)``."""
    (height, width), (rows, columns) = plane.shape, size
    padded = np.pad(plane, ((0, -height % rows), (0, -width % columns)))
    return np.asarray(padded.reshape(-1, rows, padded.shape[1]).sum(0).reshape(rows, -1, columns).sum(1))


def _spread(classes: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return each pixel's class' value."""
    wide = classes[:, np.arange(shape[1]) % classes.shape[1]]
    return np.asarray(wide[np.arange(shape[0]) % classes.shape[0]])
