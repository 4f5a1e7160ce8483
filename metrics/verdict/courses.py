"""Detect courses (rows of tiles along a lattice direction) that have slid along the periodic image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

from ..ncc.periodic import TOLERANCE, Periodic
from ..ncc.strip_template import AXES, Grid, StripTemplate
from . import limits
from .exponential_tail import ExponentialTail
from .tiles import Tiles

Ratios = NDArray[np.float64]
_LEAST_LENGTH = 2.0
"""Cells that a course must show to be looked at."""
_LEAST_SCATTER = 0.1
"""Scatter of a direction's courses, over their usual margin, that is assumed at least: references may be few."""
_LEAST_MARGIN = 1e-3


@dataclass(frozen=True)
class Strips:
    """The courses of an image, half a cell apart, each compared with the periodic image slid along it.

    Parameters
    ----------
    first
        For each of four directions, the number of its first course: its middle in halves of a cell.
    gain
        For each direction, ``(n,)``: by how much likelier a course is somewhere beyond the tolerance than in its place,
        as the mean log-likelihood ratio a pixel and channel; -inf where it is too short.
    slide
        For each direction, ``(n,)``: px from its place to where a course is likeliest of all.
    beyond
        For each direction, ``bool (n,)``: whether that is beyond the tolerance.
    """

    first: tuple[int, ...]
    gain: tuple[Ratios, ...]
    slide: tuple[Ratios, ...]
    beyond: tuple[NDArray[np.bool_], ...]

    @property
    def worst_slide(self) -> float | None:
        """How far, px, the course has slid that is likelier elsewhere by most; None where all are too short."""
        gain, slide = np.concatenate(self.gain), np.concatenate(self.slide)
        return float(slide[gain.argmax()]) if np.isfinite(gain).any() else None

    def at(self, values: list[Ratios], lattice: Lattice, points: Points) -> Ratios:
        """Return the courses' values for the four in whose middle each point (x, y) lies, ``(4, n)``; -inf for none."""
        uv = lattice.to_cell(points)
        found = np.full((len(values), len(points)), -np.inf)
        for row, (across, _), first, value in zip(found, AXES, self.first, values, strict=True):
            course = np.rint(2 * uv @ np.array(across)).astype(np.intp) - first
            inside = (course >= 0) & (course < len(value))
            row[inside] = value[course[inside]]
        return found


def strips(image: Image, lattice: Lattice, periodic: Periodic) -> Strips:
    """Slide the periodic image along each course of the image.

    Every pixel of a course is held against the periodic image by its likelihood: normal, with the variance that its
    place in the cell has across tiles. What hardly varies - the joint between bricks of any color, the gap between
    yarns - so tells most, wherever it is found and wherever it lacks, and yarns that differ tell little. Only sums of
    pixels and of their squares over the cells of a course are needed: one pass over the image a direction, then
    products along one cell.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The periodic image's, moved to where the image's content lies.
    periodic
        What the image should follow.
    """
    found = [_slid(image, one.grid.on(lattice), one) for one in periodic.courses]
    first, gain, slide, beyond = zip(*found, strict=True)
    return Strips(first, gain, slide, beyond)


def strip_excess(seen: Strips, references: list[Strips], tiles: Tiles) -> Ratios:
    """Return, for each tile, how far the worst of its courses exceeds its limits: above 1 it has slid.

    It is likelier elsewhere than in its place, by more than what is usual and the scatter of the references' courses
    let expect; one that is likeliest of all within the tolerance has not slid, however unlikely its exact place is.
    Each direction is taken by itself: courses along a yarn, whose color all of their tiles share, scatter widely.
    Longer courses scatter less, so that a larger output raises no more alarms.
    """
    ratios = []
    for direction, (gain, beyond) in enumerate(zip(seen.gain, seen.beyond, strict=True)):
        own = _finite(np.concatenate([one.gain[direction] for one in references]))
        ratio = _ratio(gain, own) if len(own) else np.zeros(len(gain))
        ratios.append(np.where(beyond, ratio, np.minimum(ratio, 1)))
    return np.asarray(np.maximum(seen.at(ratios, tiles.lattice, tiles.centers), 0).max(0))


def _ratio(gain: Ratios, own: Ratios) -> Ratios:
    """Return how far courses of one direction exceed the limits that the references' own set."""
    usual = float(np.median(own))
    margin = max(-usual, _LEAST_MARGIN)
    scatter = max(float(own.std()), _LEAST_SCATTER * margin)
    return np.asarray(np.minimum((gain - usual) / scatter / limits.STRIP_DEVIATIONS, 1 + gain / margin))


def _finite(values: Ratios) -> Ratios:
    return values[np.isfinite(values)]


def _slid(image: Image, grid: Grid, template: StripTemplate) -> tuple[int, Ratios, Ratios, NDArray[np.bool_]]:
    """Return the first course's number along one direction, and every course's gain, slide, and whether it is far."""
    sums, first = grid.sums(image, np.zeros(image.shape[:2], np.float32))
    halves = sums.reshape(-1, grid.rows // 2, *sums.shape[1:])
    likelihood = _likelihood(halves, first, template)
    count = _doubled(halves[..., 0].sum((1, 2)))
    likelihood /= np.maximum(count, 1)[:, np.newaxis] * image.shape[2]
    far = grid.slides > max(TOLERANCE * grid.lattice.s, grid.slides[1])
    best = likelihood[:, far].max(1, initial=-np.inf)
    gain = np.where(count >= _LEAST_LENGTH * grid.lattice.area, best - likelihood[:, 0], -np.inf)
    likeliest = likelihood.argmax(1)
    return first + 1, gain, grid.slides[likeliest], far[likeliest]


def _likelihood(halves: Ratios, first: int, template: StripTemplate) -> Ratios:
    """Return the log-likelihood of every course on the template slid by k samples along it, ``(courses, columns)``.

    Each channel is held against the template at whatever brightness of the course fits best, for every k: light that
    changes slowly, or a color that is added everywhere, moves no course.
    """
    channels, columns = halves.shape[-1] - 2, halves.shape[2]
    fit, weight = np.empty((2, len(halves), columns))
    lacks = np.empty((channels, len(halves), columns))
    for half in (0, 1):
        which = slice((half + first) % 2, None, 2)
        fit[which], weight[which], lacks[:, which] = template.correlated(halves[which], half)
    lacks = np.stack([_doubled(one) for one in lacks])
    return np.asarray((lacks**2).sum(0) / np.maximum(_doubled(weight), 1e-9) - _doubled(fit)) / 2


def _doubled(values: Ratios) -> Ratios:
    """Return the sum over each course's two halves, one of which it shares with the next."""
    return np.asarray(values[1:] + values[:-1])


_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""What stays the same, in cell coordinates, along t1, t2, t2 - t1 and t1 + t2: the shortest vectors; the courses of
running bond may run along the fourth."""
_LEAST_TILES = 4
"""Windows of a course, half a cell apart, below which it is left out: two tiles."""
_QUANTILE, _OVERLAP = 0.9, 8
"""Where the tail of the references' courses begins, and how many courses see the same tiles: half a cell apart, in
four directions."""


def course_gains(tiles: Tiles) -> Ratios:
    """Return, for each direction and tile, the mean over its course of how much better tiles fit elsewhere, ``(4, n)``.

    -inf where the course is too short. Longer courses scatter no more than shorter ones, whatever their tiles share.
    """
    at = np.rint(2 * tiles.lattice.to_cell(tiles.centers)).astype(np.intp)
    gains = np.full((len(_DIRECTIONS), len(at)), -np.inf)
    for row, direction in zip(gains, _DIRECTIONS, strict=True):
        _, course, count = np.unique(at @ direction, return_inverse=True, return_counts=True)
        mean = np.bincount(course, tiles.gain) / count
        row[:] = np.where(count >= _LEAST_TILES, mean, -np.inf)[course]
    return gains


def course_excess(tiles: Tiles, references: list[Tiles]) -> Ratios:
    """Return, for each tile, how far the worst of its courses exceeds its limits: above 1 the course has slid.

    Its tiles fit better elsewhere on the whole, by more than courses of the references ever do.
    """
    own = np.concatenate([_once(course_gains(other)) for other in references])
    gains = course_gains(tiles)
    if not len(own) or not np.isfinite(gains).any():
        return np.zeros(len(tiles.centers))
    tail = ExponentialTail.fit(own, _QUANTILE, _OVERLAP)
    chances = np.log(max(len(_once(gains)), 1)) - np.log(gains.size)
    surprise = tail.surprisal(np.maximum(gains, own.min()).ravel()).reshape(gains.shape) - chances
    ratio = np.minimum(surprise / limits.COURSE_SURPRISAL, 1 + gains / limits.COURSE_GAIN)
    return np.asarray(np.maximum(ratio, 0).max(0))


def _once(gains: Ratios) -> Ratios:
    """Return each course's gain once."""
    return np.concatenate([np.unique(row[np.isfinite(row)]) for row in gains])
