"""What is measured of an image: its windows, its tiles and its courses against the periodic image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values

from ..ncc.periodic import Periodic
from .courses import Strips, strips
from .tiles import Tiles, inspect
from .windows import RegisteredWindows, register_windows


@dataclass(frozen=True)
class Measurements:
    """The windows, the tiles and the courses of an image, compared with the periodic image.

    Parameters
    ----------
    image
        The image.
    seen
        What is compared with the periodic image: the image, or its detail.
    periodic
        What it should follow.
    windows
        Its windows, two tiles wide.
    tiles
        Its tiles, at the phase that most windows share.
    """

    image: Image
    seen: Values
    periodic: Periodic
    windows: RegisteredWindows
    tiles: Tiles

    @classmethod
    def at(cls, image: Image, periodic: Periodic, seen: Values | None = None) -> Measurements:
        """Register the windows of ``seen`` (None: of the image), then inspect its tiles at their phase."""
        seen = image if seen is None else seen
        windows = register_windows(seen, periodic)
        return cls(image, seen, periodic, windows, inspect(seen, periodic, windows.phase))

    @cached_property
    def strips(self) -> Strips:
        """Its courses, each slid along the periodic image as a whole."""
        return strips(self.seen, self.tiles.lattice, self.periodic)
