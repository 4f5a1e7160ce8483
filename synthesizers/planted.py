"""Planted defects: fresh draws with one known fault, on which scores are tested."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.door import Image
from nrbench.lattice.geometry import Lattice
from nrbench.synthesis import Again, Refused, Synthesis, Task
from nrbench.texture import Shape

Field = NDArray[np.intp]
"""``(H, W, 2)``: how far, (x, y) px, the content at each pixel has moved."""

_FIRST_DRAW = 1 << 20
_PATCH_TILES = 2.0


@dataclass(frozen=True)
class Plot:
    """Where a defect is planted.

    Parameters
    ----------
    shape
        Shape of the output.
    lattice
        The texture's, of any origin.
    size
        The defect's size, in [0, 1].
    rng
        Where and in which direction.
    again
        Fresh draws.
    """

    shape: Shape
    lattice: Lattice
    size: float
    rng: np.random.Generator
    again: Again

    def fresh(self, margin: int = 0) -> Image:
        """Return a fresh draw, ``margin`` px wider than the output on every side."""
        height, width = self.shape
        draw = self.again((height + 2 * margin, width + 2 * margin), _FIRST_DRAW + int(self.rng.integers(1, 1 << 30)))
        if draw is None:
            raise Refused("planted: this texture has no fresh draw of the output's size")
        return draw.image

    def still(self) -> Field:
        """Return a displacement field of zeros."""
        return np.zeros((*self.shape, 2), np.intp)

    def step(self) -> NDArray[np.intp]:
        """Return a vector of whole px in a random direction, its length as near to ``size`` times s as they allow."""
        angle = self.rng.uniform(0, 2 * math.pi)
        distance = self.size * self.lattice.s
        wanted = distance * np.array([math.cos(angle), math.sin(angle)])
        corners = np.floor(wanted).astype(np.intp) + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
        return np.asarray(corners[np.argmin(np.abs(np.hypot(*corners.T) - distance))])

    def cell(self) -> NDArray[np.bool_]:
        """Return where one whole cell lies: the pixels nearer to a random point than to any that is equal to it."""
        size = np.array(self.shape[::-1])
        reach = np.minimum(np.sqrt((self.lattice.reduced().matrix ** 2).sum(0)), size / 3)
        center = reach + self.rng.random(2) * (size - 1 - 2 * reach)
        y, x = np.indices(self.shape)
        away = np.stack([x, y], -1) - center
        return np.asarray(np.abs(self.lattice.wrap(away) - away).max(-1) < 1e-6)


@dataclass(frozen=True)
class Planting:
    """An image with its defect, and where and how large it is."""

    image: Image
    displacement: Field
    covered: NDArray[np.bool_] | None = None


Fault = Callable[[Plot], Planting]


@dataclass(frozen=True)
class Planted:
    """A fresh draw of the texture with a known defect.

    Content moves by whole pixels, so that nothing but its place tells it from the rest; the size that came about is in
    the note, the displacement field in ``extras["displacement"]``, and where a tile was covered, ``extras["covered"]``.

    Parameters
    ----------
    kind
        ``"none"``: a fresh draw as it is. ``"phase-step"``: everything beyond a line through the middle is moved.
        ``"displaced-tile"``: one cell is moved. ``"off-lattice"``: patches two tiles wide, each moved in a direction of
        its own. ``"missing-tile"``: one cell is covered by its mean color.
    size
        In [0, 1]: how far content moves, as a fraction of the shortest lattice vector; of a missing tile, how opaque
        its cover is.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    kind: str = "phase-step"
    size: float = 0.25

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise BadInput(f"planted: kind {self.kind!r} is unknown; choose one of {', '.join(FAULTS)}")
        if not 0 <= self.size <= 1:
            raise BadInput(f"planted: size {self.size} is outside [0, 1]; give a fraction of the shortest vector")

    def synthesize(self, task: Task) -> Synthesis:
        """Return a fresh draw with the defect in it.

        Raises
        ------
        Refused
            Where the texture has no further draws or no lattice.
        """
        plot = self._plot(task)
        planting = FAULTS[self.kind](plot)
        distance = float(np.sqrt((planting.displacement**2).sum(-1)).max())
        extras = {"displacement": planting.displacement.astype(np.float32)}
        note = f"planted {self.kind} of {distance / plot.lattice.s:.3f} s ({distance:.1f} px)"
        if planting.covered is not None:
            extras["covered"] = planting.covered.astype(np.float32)
            note = f"planted {self.kind} of opacity {self.size:g}"
        return Synthesis(planting.image, extras=extras, note=note)

    def _plot(self, task: Task) -> Plot:
        first = task.again(task.sample.shape[:2], _FIRST_DRAW) if task.again is not None else None
        if task.again is None or first is None:
            raise Refused("planted: this texture has no fresh draws")
        if first.lattice is None:
            raise Refused("planted: this texture has no lattice")
        return Plot(task.shape, first.lattice, self.size, task.rng, task.again)


def _moved(plot: Plot, field: Field) -> Planting:
    """Plant a displacement: draw wider by as much as content moves, then read each pixel from where it came."""
    margin = int(np.abs(field).max())
    y, x = np.indices(plot.shape) + margin
    return Planting(plot.fresh(margin)[y - field[..., 1], x - field[..., 0]], field)


def _none(plot: Plot) -> Planting:
    return _moved(plot, plot.still())


def _phase_step(plot: Plot) -> Planting:
    field = plot.still()
    half = np.s_[plot.shape[0] // 2 :] if plot.rng.integers(2) else np.s_[:, plot.shape[1] // 2 :]
    field[half] = plot.step()
    return _moved(plot, field)


def _displaced_tile(plot: Plot) -> Planting:
    field = plot.still()
    field[plot.cell()] = plot.step()
    return _moved(plot, field)


def _off_lattice(plot: Plot) -> Planting:
    field = plot.still()
    box = np.sqrt((plot.lattice.reduced().matrix ** 2).sum(0))
    width, height = np.maximum(np.rint(_PATCH_TILES * box), 1).astype(int)
    for top in range(0, plot.shape[0], height):
        for left in range(0, plot.shape[1], width):
            field[top : top + height, left : left + width] = plot.step()
    return _moved(plot, field)


def _missing_tile(plot: Plot) -> Planting:
    covered, image = plot.cell(), plot.fresh()
    image = np.array(image)
    image[covered] += np.float32(plot.size) * (image[covered].mean(0) - image[covered])
    return Planting(image, plot.still(), covered)


FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        "none": _none,
        "phase-step": _phase_step,
        "displaced-tile": _displaced_tile,
        "off-lattice": _off_lattice,
        "missing-tile": _missing_tile,
    }
)
"""The defects by name; a new one is one more entry."""
