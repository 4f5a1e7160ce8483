"""A brick wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nrbench.errors import require

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, box, boxes, coverage, nearness, rim, split_period

_CLAY = (0.55, 0.38, 0.32)
_MORTAR = (0.75, 0.72, 0.67)
_SHIFTS = {"running": 0.5, "stack": 0.0, "english": 0.0, "flemish": 0.75}
"""Number of widths by which each course is shifted against the one above it."""


@dataclass(frozen=True)
class Brick(Model):
    """A brick wall. Element: brick.

    Parameters
    ----------
    width, height
        Distance from brick to brick along a course, and from course to course, in px.
    joint
        Width of the mortar joints in px, at least 1.
    bond
        ``"running"``: each course shifted by half a brick; ``"stack"``: all joints in line; ``"english"``: courses of
        bricks and of half bricks alternate; ``"flemish"``: bricks and half bricks alternate along every course.
    small_every
        Every n-th course has half bricks, with n at least 2; 0: none (English bond has such courses anyway).
    """

    width: float = 27.3
    height: float = 12.2
    joint: float = 2.2
    bond: Literal["running", "stack", "english", "flemish"] = "running"
    small_every: int = 0

    breadth = ("height", 1)

    ranges = {"joint": 1, "width": lambda own: (own.joint + 2) * (1 + own._halves), "height": lambda own: own.joint + 2}

    def _check_parameters(self) -> None:
        super()._check_parameters()
        every = self.small_every
        known = every in (0, *range(2, 101))
        require(known, f"small_every is {every}; give a number of courses from 2 to 100, or 0")
        require(not (every and self.bond == "english"), "small_every is for bonds other than English; leave it at 0")

    @property
    def _halves(self) -> bool:
        return self.bond in ("english", "flemish") or self.small_every > 0

    @property
    def _courses(self) -> int:
        """Number of courses after which the wall repeats."""
        return 2 if self.bond == "english" else max(1, self.small_every)

    @property
    def vectors(self) -> Vectors:
        """The vectors along a course, and to the next equal course."""
        along = self.width * (1.5 if self.bond == "flemish" else 1.0)
        return (along, 0.0), (self._courses * _SHIFTS[self.bond] * self.width % along, self._courses * self.height)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return bricks on mortar; the origin is the middle of a brick."""
        j, across = split_period(y, self.height)
        x = x - j * (_SHIFTS[self.bond] * self.width)
        widths = (self.width, self.width / 2) if self.bond == "flemish" else (self.width,)
        i, along, width = boxes(x, widths)
        if self._courses > 1:
            halves = boxes(x, (self.width / 2,))
            i, along, width = (
                np.where(j % self._courses == 0, *pair) for pair in zip(halves, (i, along, width), strict=True)
            )
        distance = box(along, across, width - self.joint, self.height - self.joint, radius=1.0)
        return Pattern(
            _MORTAR, (Layer("brick", (i, j), coverage(distance), _CLAY, rim(distance, 0.15, 1.5), nearness(distance)),)
        )
