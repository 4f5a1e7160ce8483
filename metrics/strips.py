"""Courses as a whole: strips of an image along a lattice direction, slid along the periodic image's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.lattice.geometry import Lattice, Points

from . import limits
from .periodic import TOLERANCE, Periodic
from .strip_template import AXES, Grid, StripTemplate
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
    beyond
        For each direction, ``bool (n,)``: whether a course is likeliest of all beyond the tolerance.
    """

    first: tuple[int, ...]
    gain: tuple[Ratios, ...]
    beyond: tuple[NDArray[np.bool_], ...]

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
    correlations along one cell.

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
    first, gain, beyond = zip(*found, strict=True)
    return Strips(first, gain, beyond)


def strip_suspicion(seen: Strips, references: list[Strips], tiles: Tiles) -> Ratios:
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


def _slid(image: Image, grid: Grid, template: StripTemplate) -> tuple[int, Ratios, NDArray[np.bool_]]:
    """Return the number of the first course along one direction, every course's gain, and where it lies beyond."""
    sums, first = grid.sums(image, np.zeros(image.shape[:2], np.float32))
    order = (np.arange(len(sums)) + first * (grid.rows // 2)) % grid.rows
    likelihood = _likelihood(sums, order, template)
    count = _windowed(sums[..., 0].sum(1), grid.rows)
    likelihood /= np.maximum(count, 1)[:, np.newaxis] * image.shape[2]
    far = grid.slides > max(TOLERANCE * grid.lattice.s, grid.slides[1])
    best = likelihood[:, far].max(1, initial=-np.inf)
    gain = np.where(count >= _LEAST_LENGTH * grid.lattice.area, best - likelihood[:, 0], -np.inf)
    return first + 1, gain, best > likelihood[:, ~far].max(1)


def _likelihood(sums: Ratios, order: NDArray[np.intp], template: StripTemplate) -> Ratios:
    """Return the log-likelihood of every course on the template slid by k samples along it, ``(courses, columns)``.

    Each channel is held against the template at whatever brightness of the course fits best, for every k: light that
    changes slowly, or a color that is added everywhere, moves no course.
    """
    constant, precision, slopes = (one[order] for one in template.spectra)
    seen = np.fft.rfft(sums, axis=1)
    count, values, squares = seen[..., 0], seen[..., 1:-1], seen[..., -1]
    fit = count * constant + squares * precision - 2 * (values * slopes).sum(-1)
    lacks = values * precision[..., np.newaxis] - count[..., np.newaxis] * slopes
    spectra = np.concatenate([fit[..., np.newaxis], (count * precision)[..., np.newaxis], lacks], -1)
    found = _windowed(np.fft.irfft(spectra, sums.shape[1], axis=1), template.grid.rows)
    return np.asarray((found[..., 2:] ** 2).sum(-1) / np.maximum(found[..., 1], 1e-9) - found[..., 0]) / 2


def _windowed(values: NDArray[np.float64], height: int) -> NDArray[np.float64]:
    """Return the sum over each course's ``height`` rows, half of which it shares with the next."""
    halves = values.reshape(-1, height // 2, *values.shape[1:]).sum(1)
    return np.asarray(halves[1:] + halves[:-1])
