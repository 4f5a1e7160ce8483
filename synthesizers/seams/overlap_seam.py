"""Cuts of a square patch into what it overlaps at its left, at its top, or at both (Efros and Freeman 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .seam_kernels import cheapest_path, cut_corner, squared_differences

Mask = NDArray[np.bool_]


def cut_sides(old: NDArray[np.uint8], new: NDArray[np.uint8], overlap: int, left: bool, top: bool) -> Mask:
    """Compute where a patch is shown if it is cut along the paths of least squared difference.

    Parameters
    ----------
    old, new
        ``(h, w, C)``: the picture and the patch.
    overlap
        Width of the overlap, px, from 1 to the lengths of the patch's sides.
    left, top
        Whether the patch overlaps the picture on these sides. With one overlap the cut is a path along it, from end to
        end. With both it is L-shaped, see :func:`l_shaped_seam`.

    Returns
    -------
    Mask
        ``bool (h, w)``: True where the patch is shown, which includes the pixels of the path.
    """
    height, width = new.shape[:2]
    mask = np.ones((height, width), np.bool_)
    if left and top:
        return l_shaped_seam(squared_differences(np.ascontiguousarray(old), np.ascontiguousarray(new)), overlap)[0]
    if left:
        mask[:, :overlap] = np.arange(overlap) >= cheapest_path(_strip_error(old, new, overlap))[:, np.newaxis]
    if top:
        error = _strip_error(old.swapaxes(0, 1), new.swapaxes(0, 1), overlap)
        mask[:overlap] = np.arange(overlap)[:, np.newaxis] >= cheapest_path(error)
    return mask


def _strip_error(old: NDArray[np.uint8], new: NDArray[np.uint8], overlap: int) -> NDArray[np.float64]:
    """Return the squared differences in the first ``overlap`` columns."""
    return squared_differences(np.ascontiguousarray(old[:, :overlap]), np.ascontiguousarray(new[:, :overlap]))


def l_shaped_seam(error: NDArray[np.float64], overlap: int) -> tuple[Mask, float]:
    """Compute the L-shaped cut of least error between a patch and what it overlaps at its left and at its top.

    "When there is both a vertical and a horizontal overlap, the minimal paths meet in the middle and the overall
    minimum is chosen for the end point(s)" (section 2.1). One path comes up from the lowest row in the left overlap,
    the other one comes from the last column in the upper overlap. They end at the same pixel of the corner, which is
    chosen so that the sum of errors over both paths is least.

    Parameters
    ----------
    error
        ``(h, w)``, not negative: the error of each pixel. Only the overlap counts.
    overlap
        Width of both overlaps, px, from 1 to the lengths of the sides.

    Returns
    -------
    mask
        ``bool (h, w)``: True to the right of the first path and below the second one, which includes their pixels.
    cost
        Sum of the errors of both paths. The pixel at which they meet counts once.

    Examples
    --------
    >>> error = np.array([[9, 9, 9, 9], [9, 0, 1, 0], [9, 2, 9, 9], [1, 9, 9, 9.0]])
    >>> mask, cost = l_shaped_seam(error, 2)
    >>> mask.astype(int).tolist(), cost
    ([[0, 0, 0, 0], [0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]], 4.0)
    """
    mask, cost = cut_corner(np.ascontiguousarray(error, np.float64), overlap)
    return mask.view(np.bool_), float(cost)
