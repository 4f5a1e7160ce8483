"""Detect courses (rows of tiles along a lattice direction) that have slid along the periodic image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

from ..ncc.course_template import AXES, CourseGrid, CourseTemplate
from ..ncc.periodic import TOLERANCE, Periodic
from . import limits
from .exponential_tail import ExponentialTail
from .tiles import Tiles

Ratios = NDArray[np.float64]
_LEAST_LENGTH = 2.0
"""Number of cells that a course must contain to be measured."""
_LEAST_SCATTER = 0.1
"""Lower bound of the standard deviation of the gains of one direction, over their usual margin. The references may
contain too few courses to estimate it."""
_LEAST_MARGIN = 1e-3


@dataclass(frozen=True)
class Courses:
    """The courses of an image, half a cell apart, each compared with the periodic image slid along it.

    Parameters
    ----------
    first
        For each of four directions, the number of its first course: the position of its middle in half cells.
    gain
        For each direction, ``(n,)``: log-likelihood of the best place beyond the tolerance, less that of the course's
        own place, per pixel and channel; -inf where the course is too short.
    slide
        For each direction, ``(n,)``: px from the course's own place to the most likely place.
    beyond
        For each direction, ``bool (n,)``: whether the most likely place is beyond the tolerance.
    """

    first: tuple[int, ...]
    gain: tuple[Ratios, ...]
    slide: tuple[Ratios, ...]
    beyond: tuple[NDArray[np.bool_], ...]

    @property
    def worst_slide(self) -> float | None:
        """Slide, px, of the course with the largest gain; None if all courses are too short."""
        gain, slide = np.concatenate(self.gain), np.concatenate(self.slide)
        return float(slide[gain.argmax()]) if np.isfinite(gain).any() else None

    def values_at(self, values: list[Ratios], lattice: Lattice, points: Points) -> Ratios:
        """Return the values of the four courses whose middle lines are nearest to each point, ``(4, n)``.

        Parameters
        ----------
        values
            For each direction, one value a course.
        lattice
            The lattice of the courses.
        points
            ``(n, 2)``: (x, y) px.

        Returns
        -------
        Ratios
            ``(4, n)``; -inf where there is no course.
        """
        uv = lattice.to_cell(points)
        result = np.full((len(values), len(points)), -np.inf)
        for row, (across, _), first, value in zip(result, AXES, self.first, values, strict=True):
            course = np.rint(2 * uv @ np.array(across)).astype(np.intp) - first
            inside = (course >= 0) & (course < len(value))
            row[inside] = value[course[inside]]
        return result


def measure_courses(image: Image, lattice: Lattice, periodic: Periodic) -> Courses:
    """Compare each course of the image with the periodic image at every slide along the course.

    The comparison is a normal likelihood. Each pixel has the variance that its place in the cell has across tiles.
    Places that hardly vary, such as the joints between bricks of different colors or the gaps between yarns, therefore
    have the largest influence. Places that vary much have little influence.

    The likelihood depends only on sums of pixel values and of their squares over the cells of a course. This takes one
    pass over the image for each direction, and products along one cell.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The lattice of the periodic image, displaced to where the content of the image lies.
    periodic
        The periodic image that the image should follow.
    """
    columns = [
        _measure_direction(image, template.grid.with_lattice(lattice), template)
        for template in periodic.course_templates
    ]
    first, gain, slide, beyond = zip(*columns, strict=True)
    return Courses(first, gain, slide, beyond)


def course_slide_excess(courses: Courses, references: list[Courses], tiles: Tiles) -> Ratios:
    """Return for each tile the ratio of the worst of its courses to the limits; above 1 the course has slid.

    A course has slid if a place beyond the tolerance is more likely than its own place, and if its gain exceeds what
    the references' courses show. If the most likely place is within the tolerance, the course has not slid, and the
    ratio is at most 1.

    The limits are set for each direction alone, because courses along a yarn scatter more than others: all of their
    tiles share one color. Longer courses scatter less, so a larger output does not raise more false alarms.
    """
    ratios = []
    for direction, (gain, beyond) in enumerate(zip(courses.gain, courses.beyond, strict=True)):
        usual_gain = _finite(np.concatenate([one.gain[direction] for one in references]))
        ratio = _gain_ratio(gain, usual_gain) if len(usual_gain) else np.zeros(len(gain))
        ratios.append(np.where(beyond, ratio, np.minimum(ratio, 1)))
    return np.asarray(np.maximum(courses.values_at(ratios, tiles.lattice, tiles.centers), 0).max(0))


def _gain_ratio(gain: Ratios, usual_gain: Ratios) -> Ratios:
    """Return the ratio of the gains of one direction to the limits that the references' gains set."""
    usual = float(np.median(usual_gain))
    margin = max(-usual, _LEAST_MARGIN)
    scatter = max(float(usual_gain.std()), _LEAST_SCATTER * margin)
    return np.asarray(np.minimum((gain - usual) / scatter / limits.COURSE_DEVIATIONS, 1 + gain / margin))


def _finite(values: Ratios) -> Ratios:
    return values[np.isfinite(values)]


def _measure_direction(
    image: Image, grid: CourseGrid, template: CourseTemplate
) -> tuple[int, Ratios, Ratios, NDArray[np.bool_]]:
    """Return the fields of :class:`Courses` for one direction."""
    sums, first = grid.sum_pixels(image, np.zeros(image.shape[:2], np.float32))
    halves = sums.reshape(-1, grid.rows // 2, *sums.shape[1:])
    likelihood = _compute_likelihood(halves, first, template)
    count = _sum_halves(halves[..., 0].sum((1, 2)))
    likelihood /= np.maximum(count, 1)[:, np.newaxis] * image.shape[2]
    far = grid.slides > max(TOLERANCE * grid.lattice.s, grid.slides[1])
    best = likelihood[:, far].max(1, initial=-np.inf)
    gain = np.where(count >= _LEAST_LENGTH * grid.lattice.area, best - likelihood[:, 0], -np.inf)
    likeliest = likelihood.argmax(1)
    return first + 1, gain, grid.slides[likeliest], far[likeliest]


def _compute_likelihood(halves: Ratios, first: int, template: CourseTemplate) -> Ratios:
    """Return the log-likelihood of every course at every slide by k samples, ``(courses, columns)``.

    The brightness of the course is free: each channel has the brightness that fits best, for every k. Light that
    changes slowly, or a color that is added everywhere, therefore does not change the place of a course.
    """
    channels, columns = halves.shape[-1] - 2, halves.shape[2]
    fit, weight = np.empty((2, len(halves), columns))
    differences = np.empty((channels, len(halves), columns))
    for half in (0, 1):
        which = slice((half + first) % 2, None, 2)
        fit[which], weight[which], differences[:, which] = template.compare_halves(halves[which], half)
    differences = np.stack([_sum_halves(one) for one in differences])
    return np.asarray((differences**2).sum(0) / np.maximum(_sum_halves(weight), 1e-9) - _sum_halves(fit)) / 2


def _sum_halves(values: Ratios) -> Ratios:
    """Return the sum over the two halves of each course. Neighboring courses share one half."""
    return np.asarray(values[1:] + values[:-1])


_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Linear functions of the cell coordinates that are constant along t1, t2, t2 - t1 and t1 + t2. The first three are the
shortest lattice vectors; the courses of running bond may run along the fourth."""
_LEAST_TILES = 4
"""Least number of windows of a course: two tiles, since windows are half a cell apart."""
_QUANTILE, _OVERLAP = 0.9, 8
"""Quantile of the references' courses at which their tail begins, and number of courses that show the same tiles:
courses are half a cell apart, in four directions."""


def course_gains(tiles: Tiles) -> Ratios:
    """Return for each direction and tile the mean gain over the tiles of its course, ``(4, n)``.

    The gain of a tile is its best NCC elsewhere less its NCC in its place. It is -inf where the course is too short.
    The means of longer courses do not scatter more than those of shorter ones.
    """
    at = np.rint(2 * tiles.lattice.to_cell(tiles.centers)).astype(np.intp)
    gains = np.full((len(_DIRECTIONS), len(at)), -np.inf)
    for row, direction in zip(gains, _DIRECTIONS, strict=True):
        _, course, count = np.unique(at @ direction, return_inverse=True, return_counts=True)
        mean = np.bincount(course, tiles.gain) / count
        row[:] = np.where(count >= _LEAST_TILES, mean, -np.inf)[course]
    return gains


def course_gain_excess(tiles: Tiles, references: list[Tiles]) -> Ratios:
    """Return for each tile the ratio of the worst of its courses to the limits; above 1 the course has slid.

    A course has slid if the mean gain of its tiles is positive and larger than the references' courses explain.
    """
    usual_gains = np.concatenate([_unique_gains(course_gains(other)) for other in references])
    gains = course_gains(tiles)
    if not len(usual_gains) or not np.isfinite(gains).any():
        return np.zeros(len(tiles.centers))
    tail = ExponentialTail.fit(usual_gains, _QUANTILE, _OVERLAP)
    # The surprisal counts every value; here each course counts once, although all of its tiles have its gain.
    correction = np.log(max(len(_unique_gains(gains)), 1)) - np.log(gains.size)
    surprisal = tail.surprisal(np.maximum(gains, usual_gains.min()).ravel()).reshape(gains.shape) - correction
    ratio = np.minimum(surprisal / limits.COURSE_SURPRISAL, 1 + gains / limits.COURSE_GAIN)
    return np.asarray(np.maximum(ratio, 0).max(0))


def _unique_gains(gains: Ratios) -> Ratios:
    """Return the gain of each course once."""
    return np.concatenate([np.unique(row[np.isfinite(row)]) for row in gains])
