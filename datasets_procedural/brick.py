"""Running bond."""

from __future__ import annotations

from dataclasses import dataclass

from nrbench.lattice.geometry import Vector

from .coordinates import Field, rows
from .model import Model, check
from .pattern import Layer, Pattern
from .shapes import box, coverage, rim

_CLAY = (0.55, 0.38, 0.32)
_MORTAR = (0.75, 0.72, 0.67)


@dataclass(frozen=True)
class Brick(Model):
    """A brick wall in running bond: each row moved by half a brick. Element: brick.

    Parameters
    ----------
    width, height
        From brick to brick along a row, and from row to row, in px: the lattice is (width, 0), (width / 2, height).
    joint
        Width of the mortar joints in px, at least 1.
    """

    width: float = 27.3
    height: float = 12.2
    joint: float = 2.2

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.joint >= 1, f"joint is {self.joint} px; give at least 1")
        for name in ("width", "height"):
            size = getattr(self, name)
            check(self.joint + 2 <= size < 1e4, f"{name} is {size} px; give at least joint + 2 = {self.joint + 2:g}")

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """Along a row, and to the next row."""
        return (self.width, 0.0), (self.width / 2, self.height)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return bricks on mortar; the origin is the middle of a brick."""
        index, (along, across) = rows(x, y, self.width, self.height, 0.5)
        distance = box(along, across, self.width - self.joint, self.height - self.joint, radius=1.0)
        return Pattern(_MORTAR, (Layer("brick", index, coverage(distance), _CLAY, rim(distance, 0.15, 1.5)),))
