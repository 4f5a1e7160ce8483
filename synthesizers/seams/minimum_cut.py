"""The exact minimum cut of a pixel grid, and the seam between two pictures that it finds.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from .minimum_cut_kernels import SOURCE, grow_trees, link_costs

Mask = NDArray[np.bool_]
Weights = NDArray[np.float64]


class Links(NamedTuple):
    """What it costs to cut between neighbouring pixels: ``across`` is ``(H, W - 1)``, ``down`` ``(H - 1, W)``."""

    across: Weights
    down: Weights


def minimum_cut(links: Links, source: Weights, sink: Weights) -> Mask:
    """Return the labelling of a pixel grid that costs least, exactly.

    Its cost is the sum of the links between pixels of different labels, of the ``source`` of all pixels labelled False
    and of the ``sink`` of all labelled True.

    Parameters
    ----------
    links
        Not negative, finite.
    source, sink
        ``(H, W)``, not negative; infinite where a pixel must be True (source) or False (sink), not both.

    Returns
    -------
    Mask
        ``bool (H, W)``. Of several labellings that cost least, the one with the fewest pixels True.

    Raises
    ------
    ValueError
        For weights that are negative, not a number, or infinite where that means nothing.
    """
    height, width = source.shape
    _check(links, source, sink)
    residual = np.zeros((4, height + 2, width + 2))
    residual[0, 1:-1, 1:-2] = residual[1, 1:-1, 2:-1] = links.across
    residual[2, 1:-2, 1:-1] = residual[3, 2:-1, 1:-1] = links.down
    terminal = np.pad(source - sink, 1)
    tree = grow_trees(residual.reshape(4, -1), terminal.ravel(), width + 2)
    return np.asarray(tree.reshape(terminal.shape)[1:-1, 1:-1] == SOURCE)


def _check(links: Links, source: Weights, sink: Weights) -> None:
    height, width = source.shape
    shapes = links.across.shape, links.down.shape, sink.shape
    if shapes != ((height, width - 1), (height - 1, width), (height, width)):
        raise ValueError(f"links and sink of shapes {shapes} do not fit a grid of {height} x {width} pixels")
    if not all((weights >= 0).all() for weights in (*links, source, sink)):
        raise ValueError("weights of a cut are at least 0")
    if not all(np.isfinite(weights).all() for weights in links):
        raise ValueError("links are finite; make a terminal infinite to keep pixels together")
    if (np.isinf(source) & np.isinf(sink)).any():
        raise ValueError("a pixel's source and sink are both infinite: it cannot be True and False")


def cut_value(mask: Mask, links: Links, source: Weights, sink: Weights) -> float:
    """Return what a labelling costs."""
    across, down = mask[:, 1:] != mask[:, :-1], mask[1:] != mask[:-1]
    terminals = float(source[~mask].sum() + sink[mask].sum())
    return terminals + float(links.across[across].sum() + links.down[down].sum())


def seam_links(old: Image, new: Image, normalized: bool = False, power: float = 1.0) -> Links:
    """Return what it costs to change from one picture to the other between neighbouring pixels s and t.

    ``|old(s) - new(s)| + |old(t) - new(t)|``, Euclidean over the channels (equation 1); normalized, that over the sum
    of the gradients of both pictures at s and t along the link (section 5, the adapted cost), so that seams run where
    both are busy: along the outlines of what the texture is made of, not through it.

    Parameters
    ----------
    old, new
        ``(H, W, C)``.
    normalized
        By gradients, to which a gray level is added, so that flat places have a cost.
    power
        To which the differences are raised (the paper: 1); with 2 one strong step costs more than many weak ones.
    """
    first, second = (np.ascontiguousarray(picture, np.float32) for picture in (old, new))
    return Links(*link_costs(first, second, normalized, power))


def graphcut_seam(old: Image, new: Image, fixed_old: Mask, fixed_new: Mask, *, normalized: bool = False) -> Mask:
    """Return where to show the new picture, such that the seam between old and new is the least visible.

    Parameters
    ----------
    old, new
        ``(H, W, C)``; both known wherever the choice is free.
    fixed_old, fixed_new
        ``bool (H, W)``: pixels that must stay old, or be new. What lies between is the overlap.
    normalized
        See :func:`seam_links`.

    Returns
    -------
    Mask
        ``bool (H, W)``: True where new. Where both pictures agree the old one stays.

    Raises
    ------
    ValueError
        When a pixel is to be both, or shapes differ.
    """
    return cut_overlap(seam_links(old, new, normalized), fixed_old, fixed_new)


def cut_overlap(links: Links, fixed_old: Mask, fixed_new: Mask, seams: Links | None = None) -> Mask:
    """Return where to show the new picture when the links' costs are known.

    Parameters
    ----------
    links
        Costs of a seam between old and new, see :func:`seam_links`.
    fixed_old, fixed_new
        As in :func:`graphcut_seam`.
    seams
        What seams cost that the old picture has already, 0 where there is none; in the same unit. They count as long as
        both their pixels stay old: covering them is worth something (section 3.1, "accounting for old seams").

    Notes
    -----
    A link with an old seam costs c where both pixels stay, m where one does, 0 where none: a grid with links m - c / 2,
    and c / 2 for each of both pixels that stays, whatever c up to 2 m. A seam that costs more counts as 2 m. The
    paper's seam node is the same, but for what the covered patches would show on the seam's other side: here the
    picture as it is stands for it.
    """
    source, sink = np.where(fixed_new, np.inf, 0.0), np.where(fixed_old, np.inf, 0.0)
    if seams is None:
        return minimum_cut(links, source, sink)
    across, down = (np.minimum(kept / 2, link) for kept, link in zip(seams, links, strict=True))
    source[:, 1:] += across
    source[:, :-1] += across
    source[1:] += down
    source[:-1] += down
    return minimum_cut(Links(links.across - across, links.down - down), source, sink)
