"""An image as the judge sees it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values

from ..ncc.periodic import Periodic
from .reference import Yardstick
from .strips import Strips, strips
from .tiles import Tiles, inspect
from .window_registration import Placement, place


@dataclass(frozen=True)
class Look:
    """An image's windows, its tiles and its courses.

    Parameters
    ----------
    image
        The image.
    seen
        What is compared with the periodic image: the image, or its detail.
    periodic
        What it should follow.
    placement
        Its windows.
    tiles
        Its tiles, at the phase that most windows share.
    """

    image: Image
    seen: Values
    periodic: Periodic
    placement: Placement
    tiles: Tiles

    @classmethod
    def at(cls, image: Image, periodic: Periodic, seen: Values | None = None) -> Look:
        """Register the windows of ``seen`` (None: of the image), then inspect its tiles at their phase."""
        seen = image if seen is None else seen
        placement = place(seen, periodic)
        return cls(image, seen, periodic, placement, inspect(seen, periodic, placement.phase))

    @cached_property
    def strips(self) -> Strips:
        """Its courses, each slid along the periodic image as a whole."""
        return strips(self.seen, self.tiles.lattice, self.periodic)


def look_at_references(measure: Yardstick) -> tuple[Look, ...]:
    """Return the yardstick's references as the judge sees them."""
    return tuple(Look.at(one.image, one.periodic, measure.view(one.image)) for one in measure.references)
