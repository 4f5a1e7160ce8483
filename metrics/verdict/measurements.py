"""Measure the windows, the tiles and the courses of an image against the periodic image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Values

from ..ncc.periodic import Periodic
from .courses import Courses, measure_courses
from .tiles import Tiles, measure_tiles
from .windows import RegisteredWindows, register_windows


@dataclass(frozen=True)
class Measurements:
    """The windows, the tiles and the courses of an image, compared with the periodic image.

    Parameters
    ----------
    image
        The image.
    prepared
        The image that is compared with the periodic image: ``image``, or its detail.
    periodic
        The periodic image.
    windows
        The windows, two tiles wide.
    tiles
        The tiles, at the phase that most windows share.
    """

    image: Image
    prepared: Values
    periodic: Periodic
    windows: RegisteredWindows
    tiles: Tiles

    @classmethod
    def at(cls, image: Image, periodic: Periodic, prepared: Values | None = None) -> Measurements:
        """Register the windows of ``prepared`` (None: of the image), then measure its tiles at their phase."""
        prepared = image if prepared is None else prepared
        windows = register_windows(prepared, periodic)
        return cls(image, prepared, periodic, windows, measure_tiles(prepared, periodic, windows.phase))

    @cached_property
    def courses(self) -> Courses:
        """The courses, each compared as a whole with the periodic image slid along it."""
        return measure_courses(self.prepared, self.tiles.lattice, self.periodic)
