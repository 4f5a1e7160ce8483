"""Recognize the wallpaper group of a picture whose lattice is known.

The cells of the picture are compared with one another, and with one another moved by each isometry that maps the
lattice to itself. A symmetry of the texture leaves the agreement of two cells as it is, however much noise they have.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import interpolate
from nrbench.lattice.geometry import Integers, Lattice, Points, Vector

Kind = Literal["rotation", "mirror", "glide"]
SLACK: Final = 0.05
"""Largest relative stretch of the picture by an isometry of its lattice."""
LEAST_AGREEMENT: Final = 0.9
"""Least agreement of the texture with its moved copy if the isometry is a symmetry."""
SURE: Final = 2.0
"""Number of standard errors between the agreement and :data:`LEAST_AGREEMENT` below which nothing is decided."""
LEAST_CONTRAST: Final = 0.5 / 255
"""Least standard deviation of what the cells have in common: half a gray level. What is fainter may be rounding."""
MOST_CELLS: Final = 256
"""Most cells that are compared: those nearest to the middle of the picture."""
MOST_WAVES: Final = 8
"""Most periods of a compared wave in a cell, along each vector."""
_SAMPLES: Final = 32
"""Most samples of a cell along each vector."""
_SHORTER: Final = ((1 / 2, 0), (0, 1 / 2), (1 / 2, 1 / 2), (1 / 3, 0), (0, 1 / 3), (1 / 3, 1 / 3), (1 / 3, 2 / 3))
"""Periods (u, v) of the cells that are 2 or 3 times too large."""

_Turn = tuple[int, int, int, int]
"""(a, b, c, d): cell coordinates (u, v) go to (u a + v c, u b + v d)."""
_IDENTITY: Final[_Turn] = (1, 0, 0, 1)


@dataclass(frozen=True)
class Symmetry:
    """An isometry that maps the lattice to itself, and whether it is a symmetry of the texture.

    Parameters
    ----------
    kind
        ``"rotation"``, ``"mirror"``, or ``"glide"``: a reflection and a translation by half of ``axis``.
    order
        Number of times after which a rotation is a whole turn: 2, 3, 4 or 6; 2 for reflections.
    center
        (x, y) px: a center of the rotation, or a point on an axis of the reflection.
    axis
        (x, y) px: the shortest lattice vector along the axis; (0, 0) for rotations.
    spacing
        (x, y) px: the axis repeats after each multiple of this; (0, 0) for rotations.
    centered
        Whether there are glides half-way between these mirrors, because a lattice vector leads from one to the next.
    agreement
        Agreement of the cells with the moved cells over their agreement with one another. It is 1 for a symmetry, up to
        the error.
    error
        Standard error of the agreement.
    matrix, offset
        The isometry: points (x, y) px go to ``(x, y) @ matrix + offset``.
    implied
        Whether it is a symmetry because others are, although its own agreement leaves that open.

    Examples
    --------
    >>> from nrbench import detect_symmetry, texture
    >>> weave = texture("weave", shape=(160, 160), seed=1)
    >>> sorted(each.kind for each in detect_symmetry(weave, weave.lattice).symmetries)
    ['mirror', 'mirror', 'rotation']
    """

    kind: Kind
    order: int
    center: Vector
    axis: Vector
    spacing: Vector
    centered: bool
    agreement: float
    error: float
    matrix: Points
    offset: Points
    implied: bool = False

    @property
    def holds(self) -> bool | None:
        """Whether it is a symmetry of the texture; None if that cannot be told."""
        return True if self.implied else self.margin > 0 if abs(self.margin) > SURE else None

    @property
    def margin(self) -> float:
        """Number of standard errors by which the agreement exceeds :data:`LEAST_AGREEMENT`."""
        return (self.agreement - LEAST_AGREEMENT) / max(self.error, 1e-9)

    @property
    def name(self) -> str:
        """Kind, order or direction, and place, as text."""
        x, y = (round(part, 2) + 0.0 for part in self.center)
        if self.kind == "rotation":
            return f"rotation of order {self.order} about ({x:.2f}, {y:.2f})"
        degrees = round(math.degrees(math.atan2(self.axis[1], self.axis[0])), 1) % 180
        return f"{self.kind} along {degrees:.1f} degrees through ({x:.2f}, {y:.2f})"

    def as_dict(self) -> dict[str, Any]:
        """Return what is known, ready for JSON.

        Returns
        -------
        dict
            Lists, numbers and texts by name.
        """
        names = ("kind", "order", "center", "axis", "spacing", "agreement", "error", "holds", "implied")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class FoundGroup:
    """The wallpaper group of a picture, and the evidence.

    Parameters
    ----------
    group
        Short name of one of the 17 groups, from ``"p1"`` to ``"p6m"``; None if it cannot be told.
    reason
        Why it cannot be told.
    lattice
        The lattice, in a reduced basis.
    candidates
        The isometries that were tested: rotations by their orders, then mirrors and glides.
    cells
        Number of cells that were compared.

    Examples
    --------
    >>> from nrbench import detect_symmetry, texture
    >>> honeycomb = texture("hexagon", shape=(160, 160), seed=1, color=0.1)
    >>> detect_symmetry(honeycomb, honeycomb.lattice).group
    'p6m'
    """

    group: str | None
    reason: str
    lattice: Lattice
    candidates: tuple[Symmetry, ...]
    cells: int

    @property
    def symmetries(self) -> tuple[Symmetry, ...]:
        """The isometries that are symmetries of the texture."""
        return tuple(each for each in self.candidates if each.holds)

    @property
    def confidence(self) -> float:
        """Probability, for normal errors, that the least certain decision is right; 0 without a group.

        Candidates about which nothing was decided do not count: what holds without them implies whether they hold.
        """
        margins = (abs(each.margin) for each in self.candidates if abs(each.margin) > SURE)
        return float(scipy.special.ndtr(min(margins, default=np.inf))) if self.group else 0.0

    def __str__(self) -> str:
        told = f"cannot tell the wallpaper group: {self.reason}"
        if self.group is not None:
            told = f"wallpaper group {self.group}, confidence {self.confidence:.3f}, from {self.cells} cells"
        shown = (f"{each.name}, agreement {each.agreement:.2f} +- {each.error:.2f}" for each in self.symmetries)
        notes = (", implied" * each.implied for each in self.symmetries)
        return "\n".join([told, *map("".join, zip(shown, notes, strict=True))])

    def as_dict(self) -> dict[str, Any]:
        """Return what is known, ready for JSON.

        Returns
        -------
        dict
            Lists, numbers and texts by name.
        """
        known = {"group": self.group, "reason": self.reason, "confidence": self.confidence, "cells": self.cells}
        return {**known, "candidates": [each.as_dict() for each in self.candidates]}


def find_wallpaper_group(image: Image, lattice: Lattice) -> FoundGroup:
    """Return the wallpaper group of a picture with a lattice.

    Each isometry that maps the lattice to itself, within :data:`SLACK`, is tested at the center or axis where the mean
    cell agrees best with its moved copy. The mean product of a cell and another, moved cell is divided by that of two
    cells as they are: noise, which differs from cell to cell, changes neither. Only cells that share no row of cells,
    in four directions, are multiplied, because the cells of a row may share a thread. The standard error is that of the
    jackknife over rows, the largest of the four directions. An isometry holds if its agreement is at least
    :data:`LEAST_AGREEMENT`; nothing is decided within :data:`SURE` errors of that. The isometries that hold decide the
    group [1]_, and those that they imply hold, too. There is no group if the decision about another one is open.

    Parameters
    ----------
    image
        All channels count. A linear trend of the light does not.
    lattice
        The smallest lattice of the picture. Its origin does not matter.

    References
    ----------
    .. [1] Doris Schattschneider. "The Plane Symmetry Groups: Their Recognition and Notation." American Mathematical
           Monthly 85(6):439-450, 1978.
    """
    lattice = lattice.reduced()
    cells = _CellSpectra(image, lattice)
    count = len(cells.spectra)
    if not cells.pairs.any():
        return FoundGroup(None, f"{count} complete cells are too few to compare", lattice, (), count)
    if cells.contrast < LEAST_CONTRAST:
        return FoundGroup(None, "the cells have no texture in common", lattice, (), count)
    found = {turn: tuple(cells.test(turn)) for turn in _list_turns(lattice)}
    held = _generate(turn for turn, tested in found.items() if any(each.holds for each in tested))
    group, reason = _name_group(found, held)
    tested = (cells.agreement(np.eye(2), np.array(period)) for period in _SHORTER)
    shorter = [agreement - SURE * error for agreement, error in tested]
    if max(shorter) > LEAST_AGREEMENT:
        x, y = np.array(_SHORTER[int(np.argmax(shorter))]) @ lattice.matrix
        group, reason = None, f"the picture also repeats by ({x:.2f}, {y:.2f}) px; give its smallest lattice"
    implied = {id(_best(tested)) for turn, tested in found.items() if group and turn in held}
    candidates = sorted(itertools.chain(*found.values()), key=lambda each: (-len(each.kind), each.kind, -each.order))
    marked = (replace(each, implied=id(each) in implied and not each.holds) for each in candidates)
    return FoundGroup(group, reason, lattice, tuple(marked), count)


def _best(tested: tuple[Symmetry, ...]) -> Symmetry:
    """Return the candidate of a turn that is a symmetry if one is: of a mirror and a glide at most one is."""
    return max(tested, key=lambda each: (each.holds is True, each.holds is None, each.agreement))


def _name_group(found: dict[_Turn, tuple[Symmetry, ...]], held: set[_Turn]) -> tuple[str | None, str]:
    """Return the group of the turns that hold; or None, and why it cannot be told."""
    refuted = {turn for turn, tested in found.items() if all(each.holds is False for each in tested)}
    if held & refuted:
        return None, "some isometries hold, and one that they imply does not"
    if undecided := found.keys() - held - refuted:
        near = max((each for turn in undecided for each in found[turn]), key=lambda each: each.agreement)
        return None, f"the agreement by a {near.name} is {near.agreement:.2f} +- {near.error:.2f}"
    order = max(len(_generate([turn])) for turn in held if _determinant(turn) > 0)
    axes = [_best(found[turn]) for turn in held if _determinant(turn) < 0]
    if not axes:
        return f"p{order}", ""
    if order == 3:
        shortest = min(math.hypot(*each.axis) for tested in found.values() for each in tested if each.kind == "mirror")
        return ("p31m" if math.hypot(*axes[0].axis) < 1.3 * shortest else "p3m1"), ""
    if order < 3 and any(each.centered for each in axes):
        return ("cm", "cmm")[order - 1], ""
    return _REFLECTIONS[order][sum(each.kind == "glide" for each in axes)], ""


_REFLECTIONS: Final = {1: ("pm", "pg"), 2: ("pmm", "pmg", "pgg"), 4: ("p4m", "p4g", "p4g"), 6: ("p6m",)}
"""Groups with reflections by the order of their rotations and the number of directions of glides without mirrors."""


class _CellSpectra:
    """The complete cells of a picture, by the Fourier coefficients of their waves.

    Attributes
    ----------
    waves
        ``(K, 2)``: periods of each wave along u and v, one wave of each pair of opposite ones.
    spectra
        ``(n, K, C)``: coefficients of each cell, in the coordinates of the lattice.
    lines
        ``(5, n)``: the number of each cell's row in four directions, and its own.
    pairs
        ``(n, n)``: whether two cells share no row.
    """

    def __init__(self, image: Image, lattice: Lattice) -> None:
        self.lattice = lattice
        first, values = _cut_cells(image, lattice)
        self._spectra = scipy.fft.fft2(values, axes=(1, 2))
        self._phase = first[0] % 1 if len(first) else np.zeros(2)
        most = np.minimum((np.array(values.shape[2:0:-1]) - 1) // 2, MOST_WAVES)
        waves = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in most)), -1).reshape(-1, 2)
        moved = np.stack([waves @ _matrix(turn).T for turn in _list_turns(lattice)])
        half = (waves[:, 1] > 0) | ((waves[:, 1] == 0) & (waves[:, 0] > 0))
        self.waves = waves[half & (np.abs(moved) <= most).all((0, 2))]
        self.spectra = self._read(self.waves)
        i, j = np.floor(first).astype(np.int64).T
        self.lines = np.array([i, j, i + j, i - j, np.arange(len(i))])
        self.pairs = (self.lines[:4, :, np.newaxis] != self.lines[:4, np.newaxis]).all(0)

    def _read(self, waves: Integers) -> NDArray[np.complex128]:
        """Return the coefficients of some waves ``(n, K, C)``."""
        phases = np.exp(-2j * np.pi * (waves @ self._phase))
        return np.asarray(self._spectra[:, waves[:, 1], waves[:, 0]] * phases[:, np.newaxis])

    def _multiply(self, matrix: Points, offset: Points) -> NDArray[np.float64]:
        """Return the products of each two cells of a pair, one of them moved from uv to ``uv @ matrix + offset``."""
        phases = np.exp(2j * np.pi * (self.waves @ offset))[:, np.newaxis]
        there, here = self._read(self.waves @ matrix.T.astype(np.int64)), self.spectra * phases
        products = (np.conj(there.reshape(len(there), -1)) @ here.reshape(len(here), -1).T).real
        return np.where(self.pairs, (products + products.T) / 2, 0.0)

    @cached_property
    def _same(self) -> NDArray[np.float64]:
        return self._multiply(np.eye(2), np.zeros(2))

    @property
    def contrast(self) -> float:
        """Standard deviation of what the cells have in common."""
        power = 2 * self._same.sum() / (self.pairs.sum() * self._spectra[0].size * self._spectra[0, ..., 0].size)
        return math.sqrt(max(float(power), 0.0))

    def agreement(self, matrix: Points, offset: Points) -> tuple[float, float]:
        """Return the agreement of the cells with moved cells, and its standard error."""
        same, moved = self._same, self._multiply(matrix, offset)
        total = same.sum()
        value, errors = float(moved.sum() / total), []
        change, rest = 2 * (moved - value * same).sum(1), 2 * same.sum(1)
        for line in self.lines:
            number = np.unique(line, return_inverse=True)[1]
            left = total - np.bincount(number, rest)
            without = np.bincount(number, change) / np.where(left > 0, left, 1e-12)
            errors.append(math.sqrt((len(left) - 1) * float(np.var(without))))
        return value, max(errors)

    def test(self, turn: _Turn) -> Iterator[Symmetry]:
        """Yield the rotation by a turn about its best center, or the mirror and the glide along their best axes."""
        matrix, basis, origin = _matrix(turn), self.lattice.matrix, np.array(self.lattice.origin)
        order, centered = len(_generate([turn])), False
        isometry = np.linalg.inv(basis) @ matrix @ basis
        along = across = np.zeros(2)
        kinds: list[tuple[Kind, Points]] = [("rotation", along)]
        if _determinant(turn) < 0:
            sums = (max(np.eye(2) + sign * matrix, key=np.any) for sign in (1, -1))
            along, across = (row / math.gcd(*row.astype(int).tolist()) for row in sums)
            centered = abs(along[0] * across[1] - along[1] * across[0]) > 1
            kinds = [("mirror", 0 * along)] if centered else [("mirror", 0 * along), ("glide", along / 2)]
        for kind, glide in kinds:
            shift = self._find_offset(matrix, glide, np.eye(2) if kind == "rotation" else across[np.newaxis])
            center = shift @ np.linalg.inv(np.eye(2) - matrix) if kind == "rotation" else (shift - glide) / 2
            places = self.lattice.from_cell(center), along @ basis, across @ basis / 2
            at, axis, spacing = ((float(x), float(y)) for x, y in places)
            offset = shift @ basis + origin - origin @ isometry
            yield Symmetry(kind, order, at, axis, spacing, centered, *self.agreement(matrix, shift), isometry, offset)

    def _find_offset(self, matrix: Points, start: Points, directions: Points) -> Points:
        """Return the offset, start plus a sum of shares of the directions, at which the mean cell agrees best."""
        there = self._read(self.waves @ matrix.T.astype(np.int64)).mean(0)
        products = (np.conj(there) * self.spectra.mean(0)).sum(-1)
        best, step, span = np.full(len(directions), 0.5), 1 / 64, 32
        while step > 1e-4:
            steps = np.meshgrid(*[np.arange(-span, span + 1) * step] * len(directions))
            shares = best + np.stack(steps, -1).reshape(-1, len(directions))
            agreements = (np.exp(2j * np.pi * ((start + shares @ directions) @ self.waves.T)) @ products).real
            best, step, span = shares[int(agreements.argmax())], step / 3, 3
        return np.asarray(start + best @ directions)


def _cut_cells(image: Image, lattice: Lattice) -> tuple[Points, NDArray[np.float64]]:
    """Return where complete cells begin, in cells ``(n, 2)``, and their values ``(n, V, U, C)`` without a trend.

    The first cell begins where the picture holds most cells.
    """
    lengths = np.hypot(*lattice.matrix.T)
    counts = np.clip(np.ceil(lengths), 1, _SAMPLES).astype(np.int64)
    step = float((lengths / counts).max())
    if step > 1:
        image = scipy.ndimage.gaussian_filter(image, (step / 2, step / 2, 0), mode="nearest")
    uv = np.stack(np.meshgrid(*(np.arange(n) / n for n in counts)), -1)
    last = np.array(image.shape[1::-1]) - 1
    numbers, corners = lattice.cell_numbers((0, 0), last), uv[[[0], [-1]], [0, -1]].reshape(-1, 2)
    first = np.zeros((0, 2))
    for phase in itertools.product(np.arange(8) / 8, repeat=2):
        at = lattice.from_cell((numbers + phase)[:, np.newaxis] + corners)
        inside = ((at >= 0) & (at <= last)).all((1, 2))
        if inside.sum() > len(first):
            first = (numbers + phase)[inside]
    away = np.hypot(*(lattice.from_cell(first + 0.5) - last / 2).T)
    first = first[np.sort(np.argsort(away, kind="stable")[:MOST_CELLS])]
    values = interpolate(image, lattice.from_cell(first[:, np.newaxis, np.newaxis] + uv)).astype(np.float64)
    means, place = values.mean((1, 2)), np.column_stack([first - first[:1], np.ones(len(first))])
    slope = np.linalg.lstsq(place, means, rcond=None)[0][:2]
    return first, values - uv @ slope


def _list_turns(lattice: Lattice) -> Iterator[_Turn]:
    """Yield the turns that map a reduced lattice to itself: not the identity, and one of two opposite rotations."""
    for turn in itertools.product((-1, 0, 1), (-1, 0, 1), (-1, 0, 1), (-1, 0, 1)):
        if abs(_determinant(turn)) == 1 and turn != _IDENTITY:
            isometry = np.linalg.inv(lattice.matrix) @ _matrix(turn) @ lattice.matrix
            stretch = np.abs(np.linalg.svd(isometry, compute_uv=False) - 1).max()
            backward = _determinant(turn) > 0 and isometry[0, 1] < -0.1
            if stretch <= SLACK and not backward:
                yield turn


def _matrix(turn: _Turn) -> Points:
    return np.array(turn, np.float64).reshape(2, 2)


def _determinant(turn: _Turn) -> int:
    return turn[0] * turn[3] - turn[1] * turn[2]


def _generate(turns: Iterable[_Turn]) -> set[_Turn]:
    """Return the group that some turns generate."""
    held, new = set[_Turn](), {_IDENTITY, *turns}
    while new - held:
        held |= new
        new = {
            (a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h)
            for (a, b, c, d), (e, f, g, h) in itertools.product(held, held)
        }
    return held
