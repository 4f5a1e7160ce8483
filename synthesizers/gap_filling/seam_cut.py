"""How a gap's patch is joined to what is around it: where the new pixels are shown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from ..seams.dynamic_seam import dynamic_seam, seam_mask
from ..seams.minimum_cut import Links, Mask, cut_overlap, seam_links
from .blocks import Sides
from .matching import Hole

Box = tuple[int, int, int, int]
"""(y0, y1, x0, x1), half-open, px from a gap's first pixel."""


def box_slices(box: Box, top: int = 0, left: int = 0) -> tuple[slice, slice]:
    """Return the rows and columns of a box whose gap has its first pixel at (``top``, ``left``)."""
    y0, y1, x0, x1 = box
    return slice(top + y0, top + y1), slice(left + x0, left + x1)


@dataclass(frozen=True, eq=False)
class Joint:
    """A patch over what it is joined to.

    Parameters
    ----------
    old, new
        ``(h, w, C)``: both pictures, over ``box``.
    known
        ``bool (h, w)``: where the old picture shows something. Elsewhere is the hole, or another's that is not yet
        filled: what a seam there would look like is not known, and it is taken to be the worst.
    box
        What they show.
    hole
        Where nothing old is known.
    sides
        Where the gap has neighbours; elsewhere is the output's edge, and there is nothing to be joined.
    """

    old: Image
    new: Image
    known: Mask
    box: Box
    hole: Hole
    sides: Sides

    @property
    def inner(self) -> Box:
        """The hole in the box's own coordinates, widened to 2 px where there is room: what must be new.

        The box's edge beside a neighbour stays old: a small block at the sample's edge has a hole of less than 2 px.
        """
        y0, y1, x0, x1 = self.hole
        left, top, right, bottom = self.sides
        return (
            *_widened(y0 - self.box[0], y1 - self.box[0], int(top), self.old.shape[0] - bottom),
            *_widened(x0 - self.box[2], x1 - self.box[2], int(left), self.old.shape[1] - right),
        )

    def depth(self, side: int) -> int:
        """Return how far it is from the box's edge to the hole, px."""
        y0, y1, x0, x1 = self.inner
        height, width = self.old.shape[:2]
        return (x0, y0, width - x1, height - y1)[side]

    def fixed_new(self) -> Mask:
        """Return the pixels that must be new."""
        mask = np.zeros(self.old.shape[:2], np.bool_)
        mask[box_slices(self.inner)] = True
        return mask

    def fixed_old(self) -> Mask:
        """Return the pixels that must stay: those at the box's edge, on the sides that have neighbours."""
        mask = np.zeros(self.old.shape[:2], np.bool_)
        for edge, there in zip((mask[:, 0], mask[0], mask[:, -1], mask[-1]), self.sides, strict=True):
            edge |= there
        return mask


def _widened(start: int, stop: int, first: int, last: int) -> tuple[int, int]:
    """Return a range of less than 2 px made longer by one at both ends, from ``first`` to ``last`` at most."""
    return (start, stop) if stop - start >= 2 else (max(start - 1, first), min(stop + 1, last))


def dynamic_joint(joint: Joint) -> Mask:
    """Return where the new picture is shown when every side is cut by itself.

    Along each side that has a neighbour the seam of least squared difference between the box's edge and the hole (Efros
    and Freeman 2001, section 2.1); what lies beyond all of them is new.
    """
    error = ((joint.old - joint.new).astype(np.float64) ** 2).sum(-1)
    error[~joint.known] = error.max()
    mask = np.ones(error.shape, np.bool_)
    for side, there in enumerate(joint.sides):
        if there:
            surface, shown = _seen_from(error, side), _seen_from(mask, side)
            width = joint.depth(side)
            shown[:, :width] &= seam_mask(dynamic_seam(surface[:, :width]), width) > 0
    return mask


def _seen_from(plane: NDArray[Any], side: int) -> NDArray[Any]:
    """Return a view in which a side is on the left."""
    plane = plane if side % 2 == 0 else plane.T
    return plane if side < 2 else plane[:, ::-1]


def graphcut_joint(joint: Joint, seams: Links) -> Mask:
    """Return where the new picture is shown when the seam is the least visible of all closed ones around the hole.

    Parameters
    ----------
    joint
        What is joined.
    seams
        What the seams of the old picture cost, over the box; in place they become those of the joined picture.
    """
    links = visible_links(np.where(joint.known[..., np.newaxis], joint.old, joint.new), joint.new)
    dearest = max(float(cost.max(initial=0)) for cost in links)
    np.copyto(links.across, dearest, where=~(joint.known[:, 1:] & joint.known[:, :-1]))
    np.copyto(links.down, dearest, where=~(joint.known[1:] & joint.known[:-1]))
    new = cut_overlap(links, joint.fixed_old(), joint.fixed_new(), seams)
    ends = ((new[:, 1:], new[:, :-1]), (new[1:], new[:-1]))
    for kept, cost, (one, other) in zip(seams, links, ends, strict=True):
        np.copyto(kept, np.where(one != other, cost, 0), where=one | other)
    return new


def visible_links(old: Image, new: Image) -> Links:
    """Return how visible a seam is between neighbouring pixels: squared differences over gradients.

    By differences alone (equation 1) the shortest way often leads through bricks of nearly one color, and leaves them
    two-toned. Over gradients it leads along their outlines; squared, it shuns what differs much.
    """
    return seam_links(old, new, normalized=True, power=2.0)
