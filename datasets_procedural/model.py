"""The machinery that all texture models share: from a pattern of elements to a texture with its truth."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.door import Image
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.texture import Kind, Shape, Texture

from .coordinates import Field, Frame
from .fields import factor_variance, factors, grain, role_seed
from .pattern import Layer, Pattern

Elements = dict[str, NDArray[np.float64]]
_CELL_STEPS = 96
"""Samples along each side of a cell when its variance is integrated."""


@dataclass(frozen=True, kw_only=True)
class Model(ABC):
    """A texture model: a pattern on a lattice, with departures that act on the pattern's own elements.

    A model gives its vectors and its pattern; what is here makes textures of them. The parameters below are every
    model's, and stand at the end of its page. ``Texture.elements`` holds ``NAME.index`` ``(n, k)``, whole numbers, and
    ``NAME.factor`` ``(n, 3)`` of the n elements in the picture, for each kind of element.

    Parameters
    ----------
    rotation
        Degrees by which the pattern is turned, from x towards y (clockwise on the screen).
    phase
        Where the lattice starts: fractions (u, v), the origin is u t1 + v t2 from pixel (0, 0); None: drawn at random.
    color
        Strength in [0, 1]: each element's channels are multiplied by independent uniform factors of mean 1 and
        standard deviation ``color / 2``.
    intensity
        The same by one factor common to the channels.
    noise
        Strength in [0, 1]: standard deviation of the grain added to every pixel, all channels alike.
    """

    rotation: float = 0.0
    phase: tuple[float, float] | None = None
    color: float = 0.2
    intensity: float = 0.1
    noise: float = 0.03

    procedural: ClassVar[bool] = True
    version: ClassVar[str] = "1"

    def __init_subclass__(cls) -> None:
        """Complete a model's page: its own parameters, then those of all models."""
        super().__init_subclass__()
        if cls.__doc__ and Model.__doc__:
            shared = inspect.cleandoc(Model.__doc__).partition("Parameters\n----------\n")[2]
            cls.__doc__ = f"{inspect.cleandoc(cls.__doc__)}\n{shared}\n"

    def __post_init__(self) -> None:
        for name in ("color", "intensity", "noise"):
            check(0 <= getattr(self, name) <= 1, f"{name} is {getattr(self, name)}; give a strength from 0 to 1")
        check(bool(np.isfinite(self.rotation)), f"rotation is {self.rotation}; give degrees")
        fixed = () if self.phase is None else self.phase
        check(bool(np.isfinite(fixed).all()), f"phase is {self.phase}; give two fractions of the generating vectors")

    @property
    @abstractmethod
    def vectors(self) -> tuple[Vector, Vector]:
        """Generating vectors of the smallest lattice in px, before rotation."""

    @abstractmethod
    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return the pattern at points (x, y) px in the model's own axes, a lattice point at (0, 0)."""

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a texture of ``shape``: its phase, then its departures, drawn from ``rng``."""
        drawn = rng.random(2)
        u, v = drawn if self.phase is None else self.phase
        origin = np.array([u, v]) @ self._lattice((0.0, 0.0)).matrix
        return self._drawn(shape, (float(origin[0]), float(origin[1])), rng)

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return an independent draw on the lattice of ``texture``, origin included."""
        if texture.lattice is None:
            raise BadInput(f"texture {texture.name!r} has no lattice; pass one that this model rendered")
        return self._drawn(shape, texture.lattice.origin, rng)

    @cached_property
    def regular_share(self) -> float:
        """Variance of the ideal image over mean total variance, integrated over one cell."""
        steps = (np.arange(_CELL_STEPS) + 0.5) / _CELL_STEPS
        u, v = np.meshgrid(steps, steps)
        (ax, ay), (bx, by) = self.vectors
        pattern = self.pattern(u * ax + v * bx, u * ay + v * by)
        paints = [layer.paint() for layer in pattern.layers]
        regular = (pattern.bare() + sum(paints)).var((0, 1), dtype=np.float64).mean()
        elements = sum(float((paint.astype(np.float64) ** 2).mean()) for paint in paints)
        return float(regular / (regular + elements * factor_variance(self.color, self.intensity) + self.noise**2))

    @property
    def kind(self) -> Kind:
        """``"0"`` without departures, else ``"I"``."""
        return "I" if self.color or self.intensity or self.noise else "0"

    def _lattice(self, origin: Vector) -> Lattice:
        t1, t2 = self.vectors
        frame = Frame(rotation=self.rotation)
        return Lattice(frame.vector(t1), frame.vector(t2), origin)

    def _drawn(self, shape: Shape, origin: Vector, rng: np.random.Generator) -> Texture:
        """Return a draw on the lattice of that origin: all of it is a function of one number from ``rng``."""
        seed = int(rng.integers(2**63))
        image, ideal, elements = self._painted(self.pattern(*Frame(origin, self.rotation).grid(shape)), seed)
        image += np.float32(self.noise) * grain(role_seed(seed, "noise"), shape)[..., np.newaxis]
        lattice, name = self._lattice(origin), type(self).__name__.lower()
        return Texture(
            image=np.clip(image, 0, 1),
            lattice=lattice,
            lattices=(lattice,),
            name=name,
            family=name,
            kind=self.kind,
            ideal=ideal,
            elements=elements,
            regular_share=self.regular_share,
        )

    def _painted(self, pattern: Pattern, seed: int) -> tuple[Image, Image, Elements]:
        """Return the image with its elements' factors, the ideal image without, and the elements."""
        ideal = pattern.bare()
        image = ideal.copy()
        elements: Elements = {}
        for layer in pattern.layers:
            factor, seen = self._factors(layer, seed)
            paint = layer.paint()
            ideal += paint
            image += paint * factor
            elements |= seen
        return image, ideal, elements

    def _factors(self, layer: Layer, seed: int) -> tuple[Image, Elements]:
        """Return the factor at each pixel, ``(H, W, 3)``, and index and factors of the elements that are seen."""
        low = [int(part.min()) for part in layer.index]
        sizes = [int(part.max()) - first + 1 for part, first in zip(layer.index, low, strict=True)]
        place = np.ravel_multi_index([part - first for part, first in zip(layer.index, low, strict=True)], sizes)
        index = np.indices(sizes).reshape(len(sizes), -1).T + low
        table = factors(seed, layer.name, index, self.color, self.intensity)
        seen = np.bincount(place[layer.coverage > 0], minlength=len(index)) > 0
        truth = {f"{layer.name}.index": index[seen].astype(np.float64), f"{layer.name}.factor": table[seen]}
        return table.astype(np.float32)[place], truth


def check(holds: bool, message: str) -> None:
    """Raise :class:`BadInput` with ``message`` unless ``holds``."""
    if not holds:
        raise BadInput(message)
