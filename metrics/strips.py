"""Courses as a whole: strips of an image averaged along a lattice direction, slid along the periodic image's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.fold import Values, cell_coordinates
from nrbench.lattice.geometry import Lattice, Points

from . import limits
from .periodic import TOLERANCE, Periodic
from .surprise import Tail
from .tiles import Tiles

Ratios = NDArray[np.float64]
_AXES = (((0, 1), (1, 0)), ((1, 0), (0, 1)), ((1, 1), (0, 1)), ((1, -1), (0, 1)))
"""For the courses along t1, t2, t2 - t1 and t1 + t2: what of the cell coordinates counts across, and what along."""
_LEAST_LENGTH = 2.0
"""Cells that a course must show to be looked at."""
_QUANTILE, _OVERLAP = 0.9, 8
"""Where the tail of the references' courses begins, and how many courses see the same pixels: half a cell apart, in
four directions."""
_FLAT = 1e-9


@dataclass(frozen=True)
class Strips:
    """The courses of an image, half a cell apart, each compared with the periodic image slid along it.

    Parameters
    ----------
    first
        For each of four directions, the number of its first course: its middle in halves of a cell.
    gain
        For each direction, ``(n,)``: by how much NCC a course fits better beyond the tolerance than within; -inf where
        it is too short. Within it the sign does not count: a dark yarn among bright ones looks like one that has slid
        by half of its period, and is none.
    """

    first: tuple[int, ...]
    gain: tuple[Ratios, ...]

    def at(self, lattice: Lattice, points: Points) -> Ratios:
        """Return the gain of the four courses in whose middle each point (x, y) lies, ``(4, n)``; -inf for none."""
        uv = lattice.to_cell(points)
        found = np.full((len(self.gain), len(points)), -np.inf)
        for row, (across, _), first, gain in zip(found, _AXES, self.first, self.gain, strict=True):
            course = np.rint(2 * uv @ np.array(across)).astype(np.intp) - first
            inside = (course >= 0) & (course < len(gain))
            row[inside] = gain[course[inside]]
        return found


def strips(image: Image, lattice: Lattice, periodic: Periodic) -> Strips:
    """Average the image along each course, and slide the periodic image along it.

    What differs from tile to tile so averages out before anything is compared, and no neighboring course is in a
    course's window, however obliquely it runs. Time is linear in the pixels: one histogram a direction and channel.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The periodic image's, moved to where the image's content lies.
    periodic
        What the image should follow.
    """
    uv = cell_coordinates(lattice, image.shape[:2]).reshape(-1, 2)
    pixels = image.reshape(-1, image.shape[2])
    found = [_slid(uv, pixels, periodic, direction) for direction in range(len(_AXES))]
    return Strips(tuple(first for first, _ in found), tuple(gain for _, gain in found))


def strip_suspicion(seen: Strips, references: list[Strips], tiles: Tiles, regular_share: float) -> Ratios:
    """Return, for each tile, how far the worst of its courses exceeds its limits: above 1 it has slid.

    It fits elsewhere all but as well as in its place, or better, and by more than courses of the references ever do.
    """
    own, gains = (np.concatenate([one[np.isfinite(one)] for one in some]) for some in (_all(references), seen.gain))
    if not len(own) or not len(gains) or not len(tiles.centers):
        return np.zeros(len(tiles.centers))
    chances = np.log(len(gains)) - np.log(len(_AXES) * len(tiles.centers))
    at = seen.at(tiles.lattice, tiles.centers)
    values = np.maximum(at, own.min())
    surprise = Tail.fit(own, _QUANTILE, _OVERLAP).surprise(values.ravel()).reshape(at.shape) - chances
    sure = regular_share >= limits.STRICT_SHARE
    limit = limits.STRIP_SURPRISE if sure else limits.FAINT_STRIP_SURPRISE
    ratio = np.minimum(surprise / limit, 1 + (at - limits.STRIP_GAIN) / limits.COURSE_GAIN)
    return np.asarray(np.maximum(ratio, 0).max(0))


def _all(references: list[Strips]) -> list[Ratios]:
    return [gain for one in references for gain in one.gain]


def _slid(uv: Points, pixels: Values, periodic: Periodic, direction: int) -> tuple[int, Ratios]:
    """Return the number of the first course along one direction, and every course's gain."""
    grid = _grid(periodic.lattice, direction)
    means, counts, first = _averaged(uv, pixels, grid, direction)
    template, weights = _template(periodic, grid, direction)
    half = grid[0] // 2
    order = (np.arange(len(means)) + first * half) % grid[0]
    ncc = _correlations(means, weights[order] * counts, template[order], grid[0])[::half]
    length = np.lib.stride_tricks.sliding_window_view(counts.sum(1), grid[0]).sum(1)[::half] / periodic.lattice.area
    step = np.hypot(*_along(periodic.lattice, direction)) / grid[1]
    slide = np.minimum(np.arange(grid[1]), grid[1] - np.arange(grid[1])) * step
    near = slide <= max(TOLERANCE * periodic.lattice.s, step)
    gain = ncc[:, ~near].max(1, initial=-1.0) - np.abs(ncc[:, near]).max(1)
    return first + 1, np.where(length >= _LEAST_LENGTH, gain, -np.inf)


def _along(lattice: Lattice, direction: int) -> Points:
    t1, t2 = lattice.matrix
    return np.asarray((t1, t2, t2 - t1, t1 + t2)[direction])


def _grid(lattice: Lattice, direction: int) -> tuple[int, int]:
    """Return samples across a course, an even number, and along one cell of it: about one a pixel."""
    length = float(np.hypot(*_along(lattice, direction)))
    return 2 * max(round(lattice.area / length / 2), 2), max(round(length), 4)


def _averaged(
    uv: Points, pixels: Values, grid: tuple[int, int], direction: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Return the mean over a course's cells of every sample, ``(rows, U, C)``, how many pixels, and the first half."""
    across, along = (uv @ np.array(axis, np.float64) for axis in _AXES[direction])
    row = np.floor(across * grid[0]).astype(np.intp)
    first = int(row.min()) // (grid[0] // 2)
    row -= first * (grid[0] // 2)
    index = row * grid[1] + np.minimum((along % 1.0 * grid[1]).astype(np.intp), grid[1] - 1)
    rows = max(-(-(int(row.max()) + 1) // (grid[0] // 2)), 2) * (grid[0] // 2)
    counts = np.bincount(index, minlength=rows * grid[1]).astype(np.float64)
    sums = np.stack([np.bincount(index, channel, rows * grid[1]) for channel in pixels.T], -1)
    means = sums / np.maximum(counts, 1)[:, np.newaxis]
    return means.reshape(rows, grid[1], -1), counts.reshape(rows, grid[1]), first


def _template(
    periodic: Periodic, grid: tuple[int, int], direction: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return one cell of the periodic image on the same grid, less its mean, and what each sample counts for."""
    image, weights = periodic.large
    uv = cell_coordinates(periodic.lattice, image.shape[:2]).reshape(-1, 2)
    pixels = np.concatenate([image, weights[..., np.newaxis]], -1).reshape(-1, image.shape[2] + 1)
    across, along = (uv @ np.array(axis, np.float64) % 1.0 for axis in _AXES[direction])
    index = (across * grid[0]).astype(np.intp) % grid[0] * grid[1] + (along * grid[1]).astype(np.intp) % grid[1]
    counts = np.bincount(index, minlength=grid[0] * grid[1])
    sums = np.stack([np.bincount(index, channel, grid[0] * grid[1]) for channel in pixels.T], -1)
    tile = (sums / np.maximum(counts, 1)[:, np.newaxis]).reshape(*grid, -1)
    return tile[..., :-1] - tile[..., :-1].mean((0, 1)), tile[..., -1]


def _correlations(
    means: NDArray[np.float64], weights: NDArray[np.float64], template: NDArray[np.float64], height: int
) -> NDArray[np.float64]:
    """Return the weighted NCC of each course with the template at every slide, ``(rows - height + 1, U)``.

    Every row's own mean is taken out: sliding along it changes nothing of it, and the color of a yarn or a row is in
    it. Courses that show little of what the others show count for as little: theirs is divided by the mean energy.
    """
    w = weights[..., np.newaxis]
    total = np.maximum(weights.sum(1), _FLAT)[:, np.newaxis]
    means = means - (w * means).sum(1, keepdims=True) / total[..., np.newaxis]
    cross = _cyclic(w * means, template).sum(-1)
    power = (w * means**2).sum((1, 2))[:, np.newaxis]
    energy = _cyclic(w, template**2).sum(-1) - (_cyclic(w, template) ** 2).sum(-1) / total
    cross, power, energy = (_windowed(one, height) for one in (cross, power, energy))
    mass = np.maximum(_windowed(total, height), _FLAT)
    usual = mass * (energy.sum() / (mass.sum() * energy.shape[1]))
    return np.asarray(cross / np.sqrt(np.maximum(power, _FLAT) * np.maximum(np.maximum(energy, usual), _FLAT)))


def _cyclic(values: NDArray[np.float64], template: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, row by row, the sum of values times the template slid by k samples along the row, for every k."""
    spectrum = np.fft.rfft(values, axis=1) * np.conj(np.fft.rfft(template, axis=1))
    return np.fft.irfft(spectrum, template.shape[1], axis=1)


def _windowed(values: NDArray[np.float64], height: int) -> NDArray[np.float64]:
    """Return the sum over ``height`` rows from every row on."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), values.cumsum(0)])
    return np.asarray(total[height:] - total[:-height])
