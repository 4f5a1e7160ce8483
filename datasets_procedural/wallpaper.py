"""Printed wallpaper of any plane group.

Operations and settings of the 17 groups: International Tables for Crystallography, volume A, part 6 (plane groups). The
two centered groups (cm, cmm) are given in their primitive, rhombic cell, so that the lattice is always the smallest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.lattice.geometry import Lattice

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, hats, mix
from .modelling.random_fields import role_seed, uniform, unit

_PAPER = (0.62, 0.60, 0.54)
_INKS = ((0.36, 0.46, 0.42), (0.58, 0.36, 0.33), (0.57, 0.49, 0.30))

Group = Literal[
    "p1", "p2", "pm", "pg", "cm", "pmm", "pmg", "pgg", "cmm", "p4", "p4m", "p4g", "p3", "p3m1", "p31m", "p6", "p6m"
]
GROUPS: tuple[Group, ...] = get_args(Group)
HEXAGONAL = ("p3", "p3m1", "p31m", "p6", "p6m")
Operation = tuple[int, int, int, int, float, float]
"""(a, b, c, d, e, f): the cell coordinates (u, v) go to (a u + b v + e, c u + d v + f)."""

_TWO: Operation = (-1, 0, 0, -1, 0, 0)
_THREE: Operation = (0, -1, 1, -1, 0, 0)
_FOUR: Operation = (0, -1, 1, 0, 0, 0)
_SIX: Operation = (1, -1, 1, 0, 0, 0)
_MIRROR: Operation = (-1, 0, 0, 1, 0, 0)
_SWAP: Operation = (0, 1, 1, 0, 0, 0)
_GENERATORS: dict[Group, tuple[Operation, ...]] = {
    "p1": (),
    "p2": (_TWO,),
    "pm": (_MIRROR,),
    "pg": ((-1, 0, 0, 1, 0, 0.5),),
    "cm": (_SWAP,),
    "pmm": (_TWO, _MIRROR),
    "pmg": (_TWO, (-1, 0, 0, 1, 0.5, 0)),
    "pgg": (_TWO, (-1, 0, 0, 1, 0.5, 0.5)),
    "cmm": (_TWO, _SWAP),
    "p4": (_FOUR,),
    "p4m": (_FOUR, _MIRROR),
    "p4g": (_FOUR, (-1, 0, 0, 1, 0.5, 0.5)),
    "p3": (_THREE,),
    "p3m1": (_THREE, (0, -1, -1, 0, 0, 0)),
    "p31m": (_THREE, _SWAP),
    "p6": (_SIX,),
    "p6m": (_SIX, _SWAP),
}


@dataclass(frozen=True)
class Wallpaper(Model):
    """Wallpaper: a random smooth motif with the symmetry of a plane group, in three inks. Element: print of a cell.

    The prints fade into each other. The motif depends on ``group`` and ``motif`` only, and is the same in every draw.

    Parameters
    ----------
    width, height
        Sides of the cell in px. Square and hexagonal groups ignore the height; in the two centered groups the sides
        are the diagonals of a rhombic cell.
    group
        One of the 17, from ``"p1"`` to ``"p6m"``.
    slant
        Degrees from the y axis to the second side, from -45 to 45; for groups p1 and p2 only.
    motif
        Number of the motif.
    """

    width: float = 41.3
    height: float = 36.7
    group: Group = "pmg"
    slant: float = 0.0
    motif: int = 0

    ranges = {"width": 8, "height": 8, "slant": (-45, 45)}

    def _check_parameters(self) -> None:
        super()._check_parameters()
        slanted = self.slant and self.group not in ("p1", "p2")
        require(not slanted, f"slant is for groups p1 and p2, not {self.group}; give 0")

    @property
    def vectors(self) -> Vectors:
        """The sides of the cell."""
        width, height = self.width, self.height
        if self.group in HEXAGONAL:
            return (width, 0.0), (-width / 2, width * math.sqrt(3) / 2)
        if self.group in ("cm", "cmm"):
            return (width / 2, height / 2), (width / 2, -height / 2)
        if self.group.startswith("p4"):
            return (width, 0.0), (0.0, width)
        return (width, 0.0), (height * math.tan(math.radians(self.slant)), height)

    @cached_property
    def _motif(self) -> Motif:
        return random_motif(role_seed(self.motif, "motif"), self.group, len(_INKS))

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return the prints of four cells around each point."""
        uv = Lattice(*self.vectors).to_cell(np.stack(np.broadcast_arrays(x, y), -1))
        color = np.asarray(_PAPER)
        for wave, ink in zip(self._motif(uv[..., 0], uv[..., 1]), _INKS, strict=True):
            color = mix(1 / (1 + np.exp(-8 * (wave - 0.7))), color, ink)
        prints = (Layer("print", index, weight, color) for index, weight in hats(uv[..., 0], uv[..., 1]))
        return Pattern(_PAPER, tuple(prints))


@cache
def operations(group: Group) -> tuple[Operation, ...]:
    """Return all operations of a group, except for translations by lattice vectors."""
    known: list[Operation] = [(1, 0, 0, 1, 0.0, 0.0)]
    for operation in known:
        known += [new for other in _GENERATORS[group] if (new := _product(other, operation)) not in known]
    return tuple(known)


def _product(left: Operation, right: Operation) -> Operation:
    """Return the operation that applies ``right`` first, then ``left``."""
    first, second = (np.array(operation[:4]).reshape(2, 2) for operation in (left, right))
    (a, b), (c, d) = (first @ second).tolist()
    e, f = ((first @ right[4:] + left[4:]) % 1.0).tolist()
    return a, b, c, d, e, f


@dataclass(frozen=True)
class Motif:
    """Some real functions of cell coordinates with period 1, as Fourier series of few terms.

    Parameters
    ----------
    orders
        int ``(n, 2)``: the waves (k, m), one of each pair (k, m), (-k, -m).
    terms
        complex ``(n, count)``: the Fourier coefficients of each function.
    """

    orders: NDArray[np.int64]
    terms: NDArray[np.complex128]

    def __call__(self, u: Field, v: Field) -> Field:
        """Return the functions' values, ``(count, ...)``."""
        along, across = (_powers(part, int(np.abs(self.orders).max())) for part in np.broadcast_arrays(u, v))
        total = np.zeros((self.terms.shape[1], *along[0].shape))
        for (k, m), terms in zip(self.orders, self.terms, strict=True):
            wave = along[k] * across[m]
            for sum_, term in zip(total, terms, strict=True):
                sum_ += term.real * wave.real - term.imag * wave.imag
        return total


def _powers(u: Field, most: int) -> dict[int, NDArray[np.complex128]]:
    """Return exp(2 pi i k u) by k, from -most to most."""
    powers = {0: np.ones(u.shape, np.complex128), 1: np.exp(2j * np.pi * u)}
    for k in range(2, most + 1):
        powers[k] = powers[k - 1] * powers[1]
    return powers | {-k: np.conj(power) for k, power in powers.items() if k}


def random_motif(seed: int, group: Group, count: int) -> Motif:
    """Return random smooth functions, each of mean 0 and variance 1, that have the symmetry of a group.

    They consist of waves no shorter than 0.37 of the cell's side, so that the motif is simple.
    """
    drawn: dict[tuple[int, int], NDArray[np.complex128]] = {}
    for k, m in _short_orders(group):
        size, turn = (draw(role_seed(seed, f"{draw.__name__} {k} {m}"), np.arange(count)) for draw in (uniform, unit))
        for a, b, c, d, e, f in operations(group):
            order, term = (a * k + c * m, b * k + d * m), size * np.exp(2j * np.pi * (turn + k * e + m * f))
            for sign, signed in ((1, term), (-1, np.conj(term))):
                key = (sign * order[0], sign * order[1])
                drawn[key] = drawn.get(key, 0) + signed
    kept = [key for key, term in drawn.items() if key > (0, 0) and np.abs(term).max() > 1e-9]
    terms = np.array([drawn[key] for key in kept])
    return Motif(np.array(kept), terms / np.sqrt((np.abs(terms) ** 2).sum(0) / 2))


def _short_orders(group: Group) -> list[tuple[int, int]]:
    """Return the waves (k, m) up to a length in the metric of the reciprocal cell, without (0, 0)."""
    hexagonal = group in HEXAGONAL
    steps = range(-3, 4)
    squares = {(k, m): k * k + m * m + k * m * hexagonal for k in steps for m in steps}
    return [order for order, square in squares.items() if 0 < square <= (7 if hexagonal else 5)]
