"""Where a defect is planted, and what comes of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again, Refused, Shape

Field = NDArray[np.intp]
"""``(H, W, 2)``: how far, (x, y) whole px, the content at each pixel has moved."""
Mask = NDArray[np.bool_]
FIRST_DRAW = 1 << 20
"""Fresh draws from here on are those that defects are planted in."""


@dataclass(frozen=True)
class Plot:
    """Where a defect is planted.

    Parameters
    ----------
    shape
        Shape of the output.
    known
        The texture's lattice; None where it has none.
    size
        The defect's size, in [0, 1].
    rng
        Where and in which direction.
    again
        Fresh draws.
    """

    shape: Shape
    known: Lattice | None
    size: float
    rng: np.random.Generator
    again: Again

    @property
    def lattice(self) -> Lattice:
        """The texture's lattice, in the pixels of a draw without margin; :class:`Refused` where there is none."""
        if self.known is None:
            raise Refused("planted: this texture has no lattice")
        return self.known

    @property
    def room(self) -> Points:
        """Width and height of the output in px."""
        return np.array(self.shape[::-1], np.float64)

    @property
    def box(self) -> Points:
        """Width and height in px of what one tile of the reduced lattice takes."""
        return np.asarray(np.sqrt((self.lattice.reduced().matrix ** 2).sum(0)))

    @property
    def reach(self) -> Points:
        """How far, along x and y in px, a point inside lies from the border at least: a tile, where there is room."""
        return np.asarray(np.minimum(self.box, self.room / 3))

    def fresh(self, margin: int = 0) -> Image:
        """Return a fresh draw, ``margin`` px wider than the output on every side."""
        height, width = self.shape
        draw = self.again((height + 2 * margin, width + 2 * margin), FIRST_DRAW + int(self.rng.integers(1, 1 << 30)))
        if draw is None:
            raise Refused("planted: this texture has no fresh draw of the output's size")
        return draw.image

    def pixels(self) -> Points:
        """Return (x, y) of every pixel, ``(H, W, 2)``."""
        y, x = np.indices(self.shape)
        return np.stack([x, y], -1).astype(np.float64)

    def still(self) -> Field:
        """Return a displacement field of zeros."""
        return np.zeros((*self.shape, 2), np.intp)

    def step(self, most: float = 1.0) -> NDArray[np.intp]:
        """Return a vector of whole px in a random direction, its length as near to the distance as they allow.

        Parameters
        ----------
        most
            The distance is ``size`` times s, at most this times s.
        """
        angle = self.rng.uniform(0, 2 * math.pi)
        distance = min(self.size, most) * self.lattice.s
        wanted = distance * np.array([math.cos(angle), math.sin(angle)])
        corners = np.floor(wanted).astype(np.intp) + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
        return np.asarray(corners[np.argmin(np.abs(np.hypot(*corners.T) - distance))])

    def cell(self) -> Mask:
        """Return where one whole cell lies: the pixels nearer to a random point than to any that is equal to it."""
        away = self.pixels() - self.inside()
        return np.asarray(np.abs(self.lattice.wrap(away) - away).max(-1) < 1e-6)

    def inside(self) -> Points:
        """Return a random point (x, y) around which a whole cell fits, where one does."""
        return np.asarray(self.reach + self.rng.random(2) * (self.room - 1 - 2 * self.reach))

    def middling(self) -> Points:
        """Return a random point (x, y) of the middle half."""
        return np.asarray((self.room - 1) * (0.25 + self.rng.random(2) / 2))


@dataclass(frozen=True)
class Planting:
    """An image with its defect, and where and how large it is.

    Parameters
    ----------
    image
        The output.
    displacement
        ``(H, W, 2)``: how far, (x, y) px, the content at each pixel has moved from its place in the fresh draw.
    covered
        The pixels that the defect lies on; None: those whose content has moved.
    amount
        What came about, for the note; empty: the largest displacement.
    """

    image: Image
    displacement: Field | Points
    covered: Mask | None = None
    amount: str = ""

    @property
    def where(self) -> Mask:
        """The pixels that the defect lies on."""
        return np.asarray(self.displacement.any(-1)) if self.covered is None else self.covered


Fault = Callable[[Plot], Planting]


def read(draw: Image, margin: int, field: Field) -> Image:
    """Return ``draw``, which has a margin, with each pixel read from where its content came.

    Raises
    ------
    IndexError
        Where content came from beyond the draw, on any side: the margin is too small for the displacement.
    """
    rows, columns = np.indices(field.shape[:2])
    y, x = rows + margin - field[..., 1], columns + margin - field[..., 0]
    if min(y.min(), x.min()) < 0 or y.max() >= draw.shape[0] or x.max() >= draw.shape[1]:
        raise IndexError(f"a margin of {margin} px is too small for displacements of {np.abs(field).max()} px")
    return np.asarray(draw[y, x])
