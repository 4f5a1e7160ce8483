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
from nrbench.synthesis import Refused, Synthesis, Task
from nrbench.texture import Shape

Field = NDArray[np.intp]
"""``(H, W, 2)``: how far, (x, y) px, the content at each pixel has moved."""
Fault = Callable[[Shape, Lattice, float, np.random.Generator], Field]
"""From the output's shape, the lattice, the wanted distance in px and a generator to a displacement field."""

_FIRST_DRAW = 1 << 20
_PATCH_TILES = 2.0


@dataclass(frozen=True)
class Planted:
    """A fresh draw of the texture with a known defect.

    Content moves by whole pixels, so that nothing but its place tells it from the rest; the size that came about is in
    the note, and the displacement field in ``extras["displacement"]``.

    Parameters
    ----------
    kind
        ``"none"``: a fresh draw as it is. ``"phase-step"``: everything beyond a line through the middle is moved.
        ``"displaced-tile"``: one cell is moved. ``"off-lattice"``: patches two tiles wide, each moved in a direction of
        its own.
    size
        How far content moves, as a fraction of the shortest lattice vector, in [0, 1].
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
        lattice = self._lattice(task)
        field = FAULTS[self.kind](task.shape, lattice, self.size * lattice.s, task.rng)
        image = _moved(task, field)
        distance = float(np.sqrt((field**2).sum(-1)).max())
        note = f"planted {self.kind} of {distance / lattice.s:.3f} s ({distance:.1f} px)"
        return Synthesis(image, extras={"displacement": field.astype(np.float32)}, note=note)

    def _lattice(self, task: Task) -> Lattice:
        first = task.again(task.sample.shape[:2], _FIRST_DRAW) if task.again is not None else None
        if first is None:
            raise Refused("planted: this texture has no fresh draws")
        if first.lattice is None:
            raise Refused("planted: this texture has no lattice")
        return first.lattice


def _moved(task: Task, field: Field) -> Image:
    """Return a fresh draw whose content has moved by ``field``."""
    assert task.again is not None
    margin = int(np.abs(field).max())
    height, width = task.shape
    draw = task.again((height + 2 * margin, width + 2 * margin), _FIRST_DRAW + int(task.rng.integers(1, 1 << 30)))
    if draw is None:
        raise Refused("planted: this texture has no fresh draw of the output's size")
    y, x = np.indices(task.shape) + margin
    return draw.image[y - field[..., 1], x - field[..., 0]]


def _still(shape: Shape, lattice: Lattice, distance: float, rng: np.random.Generator) -> Field:
    return np.zeros((*shape, 2), np.intp)


def _phase_step(shape: Shape, lattice: Lattice, distance: float, rng: np.random.Generator) -> Field:
    field = _still(shape, lattice, distance, rng)
    half = np.s_[shape[0] // 2 :] if rng.integers(2) else np.s_[:, shape[1] // 2 :]
    field[half] = _step(distance, rng)
    return field


def _displaced_tile(shape: Shape, lattice: Lattice, distance: float, rng: np.random.Generator) -> Field:
    """Move one cell: the pixels nearer to a point well inside than to that point plus any lattice vector."""
    field = _still(shape, lattice, distance, rng)
    reach = np.minimum(np.sqrt((lattice.reduced().matrix ** 2).sum(0)), np.array(shape[::-1]) / 3)
    center = reach + rng.random(2) * (np.array(shape[::-1]) - 1 - 2 * reach)
    y, x = np.indices(shape)
    away = np.stack([x, y], -1) - center
    field[np.abs(lattice.wrap(away) - away).max(-1) < 1e-6] = _step(distance, rng)
    return field


def _off_lattice(shape: Shape, lattice: Lattice, distance: float, rng: np.random.Generator) -> Field:
    field = _still(shape, lattice, distance, rng)
    width, height = np.maximum(np.rint(_PATCH_TILES * np.sqrt((lattice.reduced().matrix ** 2).sum(0))), 1).astype(int)
    for top in range(0, shape[0], height):
        for left in range(0, shape[1], width):
            field[top : top + height, left : left + width] = _step(distance, rng)
    return field


def _step(distance: float, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return a whole-pixel vector in a random direction whose length is nearest to ``distance`` among its neighbors."""
    angle = rng.uniform(0, 2 * math.pi)
    wanted = distance * np.array([math.cos(angle), math.sin(angle)])
    corners = np.floor(wanted).astype(np.intp) + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
    return np.asarray(corners[np.argmin(np.abs(np.hypot(*corners.T) - distance))])


FAULTS: Mapping[str, Fault] = MappingProxyType(
    {"none": _still, "phase-step": _phase_step, "displaced-tile": _displaced_tile, "off-lattice": _off_lattice}
)
"""The defects by name; a new one is one more entry."""
