"""Exact minimum cuts of pixel grids, and the least visible seam between two pictures.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 3.

The solver is our own because PyMaxflow and igraph are under the GPL, and ``scipy.sparse.csgraph.maximum_flow`` takes
9 (48 x 48 pixels) to 19 times (80 x 80) as long and accepts only whole-number capacities.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .seam_kernels import SOURCE, grow_trees

Mask = NDArray[np.bool_]
Weights = NDArray[np.float64]


class Links(NamedTuple):
    """Costs of cutting between adjacent pixels: ``across`` is ``(H, W - 1)``, ``down`` is ``(H - 1, W)``."""

    across: Weights
    down: Weights


def minimum_cut(links: Links, source: Weights, sink: Weights) -> Mask:
    """Compute the labeling of a pixel grid with the least cost, exactly.

    The cost is the sum of the links between pixels of different labels, of ``source`` over all pixels labeled False,
    and of ``sink`` over all pixels labeled True.

    Parameters
    ----------
    links
        Not negative, finite.
    source, sink
        ``(H, W)``, not negative. An infinite source makes a pixel True, an infinite sink makes it False.

    Returns
    -------
    Mask
        ``bool (H, W)``. If several labelings have the least cost, the one with the fewest True pixels.

    Examples
    --------
    Cut a row of three pixels at its cheaper link:

    >>> links = Links(np.array([[5.0, 1.0]]), np.zeros((0, 3)))
    >>> minimum_cut(links, np.array([[np.inf, 0, 0]]), np.array([[0, 0, np.inf]]))
    array([[ True,  True, False]])
    """
    height, width = source.shape
    residual = np.zeros((4, height + 2, width + 2))
    residual[0, 1:-1, 1:-2] = residual[1, 1:-1, 2:-1] = links.across
    residual[2, 1:-2, 1:-1] = residual[3, 2:-1, 1:-1] = links.down
    terminal = np.pad(source - sink, 1)
    tree = grow_trees(residual.reshape(4, -1), terminal.ravel(), width + 2)
    return np.asarray(tree.reshape(terminal.shape)[1:-1, 1:-1] == SOURCE)


def cut_overlap(links: Links, fixed_old: Mask, fixed_new: Mask, old_seams: Links) -> Mask:
    """Compute where to show the new picture, so that the seam between old and new is the least visible.

    Parameters
    ----------
    links
        Costs of a seam between old and new, see :func:`~.seam_kernels.link_costs`.
    fixed_old, fixed_new
        ``bool (H, W)``: pixels that must stay old, and pixels that must be new. The others are the overlap.
    old_seams
        Costs of the seams that the old picture already has, 0 elsewhere, in the same unit. A seam counts if both its
        pixels stay old, so that it pays to cover it (section 3.1, "accounting for old seams").

    Returns
    -------
    Mask
        ``bool (H, W)``: True where the new picture is shown. Where both pictures agree the old one stays.

    Notes
    -----
    Let a link cost m and carry an old seam of cost c. It costs c if both pixels stay, m if one does, 0 if none does. A
    grid with links m - c / 2, and c / 2 for each pixel that stays, has these costs for every c up to 2 m. A larger c
    counts as 2 m. The paper's seam node gives the same costs, except that it compares the new picture with what the
    covered patches would show beyond the seam; here it is compared with the old picture as it is.
    """
    source, sink = np.where(fixed_new, np.inf, 0.0), np.where(fixed_old, np.inf, 0.0)
    across, down = (np.minimum(seam / 2, link) for seam, link in zip(old_seams, links, strict=True))
    source[:, 1:] += across
    source[:, :-1] += across
    source[1:] += down
    source[:-1] += down
    return minimum_cut(Links(links.across - across, links.down - down), source, sink)
