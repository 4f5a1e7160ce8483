"""The base class of all texture models: from a pattern of elements to a texture with its truth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, ClassVar, Literal, get_args, get_origin, get_type_hints

import numpy as np

from nrbench.errors import BadInput, require, require_ranges
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.plugins.forms import Kind, Shape, Texture
from nrbench.plugins.parameters import SharedParameters

from .departures import Departures
from .materials import MATERIALS
from .pattern import Field, Frame, Pattern, hue_rotation
from .random_fields import role_seed
from .recomposition import Draw, Picture

Vectors = tuple[Vector, Vector]
"""Two generating vectors (x, y) in px."""
LARGEST_AREA = 1 << 26
"""Area in px^2 of the largest picture that a model draws: about 8000 x 8000, which takes a few GiB."""
_STRENGTHS = ("color", "intensity", "noise", "light", "damage", "missing", "jitter", "bend")
LARGEST_SIZE = 1e4
"""px: the greatest length that a parameter may have."""
_CELL_STEPS = 96
"""Samples along each side of a cell when its variance is integrated."""
_DRAWS = 32
"""Draws of the displacements, of fixed seeds, from which the regular share under jitter is measured."""


@dataclass(frozen=True, kw_only=True)
class Model(SharedParameters, ABC):
    """A texture model: a pattern on a lattice, with departures that act on the pattern's own elements.

    A subclass defines its vectors and its pattern; this class draws textures of them. All models have the parameters
    below. They follow a model's own parameters on its page. Except for damaged and missing elements, no departure
    changes the mean color of a point, before clipping. The ideal image has no damage and no displacement.

    ``Texture.elements`` holds, for each kind of element and the n of them in the picture, ``NAME.index`` ``(n, k)``,
    whole numbers, ``NAME.factor`` ``(n, 3)``, and where there are such departures ``NAME.ink`` ``(n,)``, the number of
    the ink from 0, ``NAME.damage`` ``(n,)``, the share lost (0, 0.5 or 1), and ``NAME.displacement`` ``(n, 2)`` px. The
    regular share is the variance of the mean over draws, damage and displacements included, over mean total variance;
    under jitter it is measured, to about 0.05, on draws of fixed seeds.

    Parameters
    ----------
    rotation
        Degrees by which the pattern is turned, from x towards y (clockwise on the screen).
    phase
        Fractions (u, v): the lattice's origin is at u t1 + v t2 from pixel (0, 0). None: drawn at random.
    hue
        Degrees by which all colors are turned around the gray axis.
    color
        Strength in [0, 1]: each element's channels are multiplied by independent uniform factors of mean 1 and
        standard deviation ``color / 2``.
    intensity
        Strength in [0, 1]: the same with one factor for all channels of an element.
    inks
        Number of colors that the elements of one kind have, from 2 to 6, as in prints; 0: colors are continuous. Each
        element, and each thread as a whole, takes one ink, independently. The shares of the inks are as k to k - 1 to
        ... to 1. All draws have the same inks. By their shares, they have the mean, and in each channel the variance,
        that ``color`` and ``intensity`` say.
    noise
        Strength in [0, 1]: standard deviation of the grain added to every pixel, all channels alike. Up to 0.05 it
        clips less than 0.1 % of the pixels; above, visibly more.
    light
        Strength in [0, 1] of a lighting gradient: everything is multiplied by a wave of random direction, about 16 s
        long (s: the shortest vector of any of its lattices), of mean 1 and standard deviation ``light / 4``.
    damage
        Probability that an element is worn: about half of it, in blots, shows the ground.
    missing
        Probability that an element is missing; only the others can be worn.
    jitter
        Strength in [0, 1]: each element is displaced as a whole, by numbers of mean 0 and standard deviation
        ``jitter * s / 4`` along x and y; what lies between two elements is stretched. Elements move independently, by
        uniform numbers, as far as their breadth allows. The rest of the displacement of small elements is shared with
        their neighbors, in waves (:mod:`~.departures`), so that up to 0.6 the picture folds over at no more than about
        3 % of the pixels.
    bend
        Strength in [0, 1] of a smooth warp: nearly normal displacements of standard deviation ``bend * s / 4`` along x
        and y, in waves about 5 s long.
    material
        What the surface shows beside the tints, of mean 0 (:mod:`~.materials`): ``"plain"``: nothing; ``"clay"``: warm
        grain, speckles, relief and chips; ``"stone"``: relief, chips, stains across elements and uneven light;
        ``"wood"``: streaks along elements, worn edges and stains; ``"cloth"``: colored grain, streaks, bright specks,
        frayed edges and uneven light.
    """

    rotation: float = 0.0
    phase: tuple[float, float] | None = None
    hue: float = 0.0
    color: float = 0.2
    intensity: float = 0.1
    inks: int = 0
    noise: float = 0.03
    light: float = 0.0
    damage: float = 0.0
    missing: float = 0.0
    jitter: float = 0.0
    bend: float = 0.0
    material: Literal["plain", "clay", "stone", "wood", "cloth"] = "plain"

    procedural: ClassVar[bool] = True
    version: ClassVar[str] = "1"
    ranges: ClassVar[Mapping[str, float | tuple[float, float] | Callable[[Any], float]]] = {}
    """The least and the greatest values of parameters; of lengths, px, the least one, or a function of the model."""
    breadth: ClassVar[tuple[str, float]] = ("s", 0.5)
    """Typical breadth of an element: the name of a length, and the breadth as its multiple."""

    def __post_init__(self) -> None:
        require_ranges(self, **dict.fromkeys(_STRENGTHS, (0, 1)))
        check_degrees(self, "rotation", "hue")
        require(self.inks in (0, *range(2, 7)), f"inks is {self.inks}; give a number of colors from 2 to 6, or 0")
        fixed = () if self.phase is None else self.phase
        require(bool(np.isfinite(fixed).all()), f"phase is {self.phase}; give two fractions of the generating vectors")
        check_choices(self)
        self._check_parameters()

    def _check_parameters(self) -> None:
        """Raise :class:`BadInput` if a model's own parameters are out of range."""
        given = {name: low(self) if callable(low) else low for name, low in self.ranges.items()}
        require_ranges(
            self, **{name: low if isinstance(low, tuple) else (low, LARGEST_SIZE) for name, low in given.items()}
        )

    @property
    @abstractmethod
    def vectors(self) -> Vectors:
        """Generating vectors of the smallest lattice in px, before rotation."""

    @abstractmethod
    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return the pattern at points (x, y) px in the model's own axes, a lattice point at (0, 0)."""

    @property
    def s(self) -> float:
        """Length in px of the shortest vector of any of its lattices: the unit of displacements."""
        return min(Lattice(*vectors).s for vectors in (self.vectors, *self.sublattices()))

    @property
    def element_size(self) -> float:
        """Typical breadth of an element in px."""
        name, share = self.breadth
        return share * float(getattr(self, name))

    def sublattices(self) -> tuple[Vectors, ...]:
        """Return the generating vectors, before rotation, of the parts of the pattern that have their own lattices."""
        return ()

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a texture of ``shape``. Its phase, and then its departures, are drawn from ``rng``."""
        fractions = rng.random(2)
        u, v = fractions if self.phase is None else self.phase
        origin = np.array([u, v]) @ self._lattice((0.0, 0.0)).matrix
        return self._draw(shape, (float(origin[0]), float(origin[1])), rng)

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return an independent draw on the lattice of ``texture``, origin included."""
        if texture.lattice is None:
            raise BadInput(f"texture {texture.name!r} has no lattice; pass one that this model rendered")
        return self._draw(shape, texture.lattice.origin, rng)

    def recompose(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture:
        """Return a draw on the lattice of ``texture`` in which each element copies an element of ``texture``.

        The copied element is drawn uniformly from those at equal places, which differ by a lattice vector. The copy has
        its color, losses, independent displacement and grain. Light, bend, and the displacement that neighbors share
        belong to no element and are drawn again. Details are in :mod:`~.recomposition`.
        """
        if texture.lattice is None or texture.draw_seed is None:
            raise BadInput(f"texture {texture.name!r} was not drawn by a model; pass one that this model rendered")
        return self._draw(shape, texture.lattice.origin, rng, texture)

    def kind_vectors(self, name: str) -> Vectors:
        """Return the generating vectors of the lattice of one kind of element, before rotation."""
        return self.vectors

    @cached_property
    def departures(self) -> Departures:
        """The strengths, with the lengths that they refer to."""
        strengths = {name: getattr(self, name) for name in _STRENGTHS}
        return Departures(
            **strengths,
            s=self.s,
            element_size=self.element_size,
            material=MATERIALS.get(self.material),
            rotation=self.rotation,
            inks=self.inks,
        )

    @cached_property
    def regular_share(self) -> float:
        """Variance of the mean over draws, over mean total variance: integrated over one cell, or measured (jitter)."""
        if self.jitter:
            return self.departures.measured_share(self._displaced_patterns())
        steps = (np.arange(_CELL_STEPS) + 0.5) / _CELL_STEPS
        u, v = np.meshgrid(steps, steps)
        (ax, ay), (bx, by) = self.vectors
        cell = self.colored_pattern(u * ax + v * bx, u * ay + v * by)
        return self.departures.regular_share(cell, Lattice(*self.vectors))

    def _displaced_patterns(self) -> Iterator[Pattern]:
        """Yield the pattern on about three periods, upright, under some draws of the displacements."""
        side = int(np.clip(3 * np.abs(self.vectors).max(), 96, 192))
        frame, shape = Frame(), (side, side)
        around = self.colored_pattern(*frame.grid(shape, self.departures.margin))
        for draw in range(_DRAWS):
            seed = role_seed(draw, "regular share")
            moved = self.departures.displacement(around, shape, seed, Draw(seed))
            yield self.colored_pattern(*frame.grid(shape, moved=moved))

    @property
    def kind(self) -> Kind:
        """The type of departures, see :class:`~nrbench.plugins.forms.Texture`."""
        return self.departures.kind

    def colored_pattern(self, x: Field, y: Field) -> Pattern:
        """Return the pattern at points (x, y) px in the model's own axes, its colors turned by ``hue``."""
        pattern = self.pattern(x, y)
        return pattern.recolor(hue_rotation(self.hue)) if self.hue else pattern

    def _lattice(self, origin: Vector, vectors: Vectors | None = None) -> Lattice:
        t1, t2 = vectors or self.vectors
        frame = Frame(rotation=self.rotation)
        return Lattice(frame.vector(t1), frame.vector(t2), origin)

    def _draw(self, shape: Shape, origin: Vector, rng: np.random.Generator, sample: Texture | None = None) -> Texture:
        """Return a draw on the lattice at ``origin``; with a sample, a draw of copies of the sample's elements.

        The only number that is drawn from ``rng`` is the seed of the draw.
        """
        check_shape(shape)
        seed = int(rng.integers(2**63))
        frame, departures = Frame(origin, self.rotation), self.departures
        numbers = Draw(seed) if sample is None else self._copied_draw(shape, frame, sample, seed)
        around = self.colored_pattern(*frame.grid(shape, departures.margin))
        pattern = around.crop(departures.margin)
        ideal, moved = pattern.ideal(), None
        if departures.spread:
            moved = departures.displacement(around, shape, seed, numbers)
            pattern = self.colored_pattern(*frame.grid(shape, moved=moved))
        image, elements = departures.paint(pattern, seed, numbers)
        name = type(self).__name__.lower()
        lattices = tuple(self._lattice(origin, vectors) for vectors in (self.vectors, *self.sublattices()))
        return Texture(
            np.clip(image, 0, 1),
            lattice=lattices[0],
            lattices=lattices,
            name=name,
            family=name,
            kind=departures.kind,
            ideal=ideal,
            displacement=None if moved is None else moved.astype(np.float32),
            elements=elements,
            regular_share=self.regular_share,
            draw_seed=seed,
        )

    def _copied_draw(self, shape: Shape, frame: Frame, sample: Texture, seed: int) -> Draw:
        """Return the element of the sample that each element of a picture copies."""
        margin = self.departures.margin + self.departures.reach
        picture = Picture(self.colored_pattern, *frame.grid(shape, margin), margin, sample, seed)

        def lattice_of(name: str) -> tuple[Vectors, Lattice]:
            vectors = self.kind_vectors(name)
            return vectors, self._lattice(frame.origin, vectors)

        return picture.copied_draw(lattice_of)


class RectangularModel(Model):
    """A model on an upright rectangular lattice."""

    sides: ClassVar[tuple[str, str]] = ("width", "height")
    """Names of the parameters that are the sides of a cell, px."""

    @property
    def vectors(self) -> Vectors:
        """The vectors along a row, and to the next one."""
        width, height = (getattr(self, side) for side in self.sides)
        return (width, 0.0), (0.0, height)


class SquareModel(RectangularModel):
    """A model on the upright square lattice of side ``period``."""

    period: float
    sides = ("period", "period")


def check_degrees(model: Any, *names: str) -> None:
    """Raise :class:`BadInput` if an angle of ``model`` is infinite or NaN."""
    for name in names:
        require(math.isfinite(getattr(model, name)), f"{name} is {getattr(model, name)}; give degrees")


def check_choices(model: Any) -> None:
    """Raise :class:`BadInput` unless each ``Literal`` field of ``model`` holds one of its words."""
    for name, words in _choices(type(model)).items():  # type: ignore[arg-type]
        word = getattr(model, name)
        require(word in words, f"{name} is {word!r}; give one of: {', '.join(words)}")


@cache
def _choices(model: type[Any]) -> dict[str, tuple[str, ...]]:
    """Return the words of each ``Literal`` field of a class. To read its annotations takes longer than many a cell."""
    return {name: get_args(hint) for name, hint in get_type_hints(model).items() if get_origin(hint) is Literal}


def check_shape(shape: Shape) -> None:
    """Raise :class:`BadInput` if a picture has no pixels, or more than :data:`LARGEST_AREA`."""
    height, width = shape
    size = f"shape {width}x{height} px"
    require(min(shape) >= 1, f"{size} has no pixels; give at least 1 a side")
    require(height * width <= LARGEST_AREA, f"{size} is too large to draw; give at most {LARGEST_AREA} px in all")
