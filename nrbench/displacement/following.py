"""Follow a lattice through a whole image from several starts, and sharpen the mean tile on the way."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, shrink, smooth_inside
from nrbench.imaging.mean_tile import Values, explained_share, fold, interpolate
from nrbench.lattice.geometry import Lattice, Points

from .growth import Knots, Start, grow_from, grow_on
from .renumbering import renumber, similarity

_FINEST: Final = 14.0
"""px; an image is shrunk as far as its s stays above this. Time then does not grow with s."""
_SMOOTH = 0.04
"""Standard deviation, in s, of the Gaussian that smooths the image."""
_CELLS = 3.0
"""Sides, in cells, of the part of an image whose mean tile a start takes."""
_MIDDLES = (0.5, 0.25, 0.75)
"""Places of these parts, in units of the image's sides, in the order in which they are tried."""
_FIRST_LEVEL = 0.55
"""Correlation from which a knot is known, while the tile is that of a few cells."""
_MOST_STARTS: Final = 3
"""Number of starts from which a lattice is followed in full, unless a caller needs speed more than the last bends."""
_GOOD = 0.9
"""Similarity of the image and the mean tile from which no further start is tried."""
_FIRST_SHARE = 0.65
"""Correlation, over the median of the first way, from which a knot is known on the second one."""
_LEVELS = (0.95, 0.85, 0.75, 0.65)
"""Correlation, over the median of the round before, from which a knot is known, in each round of the growth."""
_FLAT = 1e-7
"""Variance of a mean tile, of values in [0, 1], below which there is nothing to follow: less than a gray step."""
_LEAST_KNOTS = 8
_MOST_ROUNDS = 5
"""Number of times, at most, that all knots are found again with a new mean tile."""
_MOST_RENUMBERED = 3
"""Number of times, at most, that parts of a followed lattice are numbered again."""
_KEPT = 0.99
"""Share of the similarity that they must keep."""
_SIZE_EXPONENT = 0.06
"""As in the detector ``consensus``."""
_GAIN = 0.01
"""Gain of the score below which they are not found again."""


def find_knots(
    image: Image, lattice: Lattice, near: Points | None = None, most_starts: int = _MOST_STARTS
) -> Knots | None:
    """Return where the points of a lattice lie in an image, however it is bent; None if they are not found.

    The mean tile is at first that of the whole image, or that of a few cells; the start from which the lattice can be
    followed farthest is used. The image is then straightened, its mean tile computed, and the lattice followed again.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The lattice near some place; its origin does not matter.
    near
        (x, y) px: the place, from which alone the lattice is followed at first; None: several places are tried.
    most_starts
        Number of starts, those from which the lattice is at first followed farthest, from which it is followed in full.
    """
    lattice = Lattice.from_basis(lattice.reduced().matrix)
    small, shrunk, factor = _shrink(image, lattice)
    at = None if near is None else (near - (factor - 1) / 2) / factor
    starts = _starts(small, shrunk) if at is None else [_local_start(small, shrunk, at)]
    first = [grow_from(small, start, (_FIRST_LEVEL,), fine=False) for start in starts]
    best, highest = None, 0.0
    for knots in sorted(first, key=lambda each: -rate_knots(each, small))[:most_starts]:
        found = _sharpened(small, knots)
        alike = 0.0 if found is None else similarity(found, small.shape[:2])
        if alike > highest:
            best, highest = found, alike
        if highest > _GOOD:
            break
    return None if best is None else best.resized(factor)


def _sharpened(image: Values, knots: Knots) -> Knots | None:
    """Follow a lattice again, with the mean tile of the image straightened by its knots, until this gains little."""
    highest = 0.0
    for number in range(1 + _MOST_ROUNDS):
        if not _are_enough(knots):
            return None
        levels = _levels_of(knots, _LEVELS if number else (_FIRST_SHARE,))
        found = grow_from(image, _restart(image, knots), levels, fine=number > 0)
        score = rate_knots(found, image)
        if number > 1 and score < highest + _GAIN:
            knots = found if score > highest else knots
            break
        knots, highest = found, score
    return _finished(image, knots)


def follow_roughly(image: Image, lattice: Lattice) -> Knots | None:
    """Return the places of the points of a lattice, origin included, in an image that is about straight.

    The mean tile is that of the whole image. The points lie about s apart. None if they are not found.
    """
    lattice = lattice.reduced()
    small, shrunk, factor = _shrink(image, lattice)
    start = _whole_start(small, shrunk.shifted((np.array(lattice.origin) - (factor - 1) / 2) / factor))
    if start is None:
        return None
    knots = grow_from(small, start, (_FIRST_LEVEL,), fine=False)
    return knots.resized(factor) if _are_enough(knots) else None


def probe(image: Image, lattice: Lattice, near: Points) -> float:
    """Return the score of a first, coarse way from one place through an image: how far its lattice can be followed.

    Parameters
    ----------
    image, lattice, near
        As for :func:`find_knots`.
    """
    lattice = Lattice.from_basis(lattice.reduced().matrix)
    small, shrunk, factor = _shrink(image, lattice)
    start = _local_start(small, shrunk, (near - (factor - 1) / 2) / factor)
    return rate_knots(grow_from(small, start, (_FIRST_LEVEL,), fine=False), small)


def follow_on(image: Image, knots: Knots, basis: Points) -> Knots | None:
    """Return where the points of another lattice lie in an image, given the knots of a first one.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    knots
        The places of the first lattice.
    basis
        2 x 2: rows: cell coordinates, in the first lattice, of the vectors of the other one.
    """
    mean = knots.mean_lattice()
    lattice = Lattice.from_basis(basis @ mean.matrix).reduced()
    small, _, factor = _shrink(image, lattice)
    places = (knots.places - (factor - 1) / 2) / factor
    first = Knots(knots.parts, knots.first, places, knots.slopes / factor, knots.correlation)
    change = lattice.matrix @ np.linalg.inv(mean.matrix)
    found = grow_from(small, _restart(small, first, change), _levels_of(first))
    last = _finished(small, found)
    return None if last is None else last.resized(factor)


def rate_knots(knots: Knots, image: Values) -> float:
    """Return the share of an image that knots cover, times their mean correlation."""
    height, width = image.shape[:2]
    return float(min(knots.area / (height * width), 1.0) * knots.quality)


def merit(image: Image, knots: Knots) -> float:
    """Return how well the lattice of knots explains an image, to compare different lattices.

    The share of the straightened image's variance that is explained if each tile is predicted by all others, times the
    share of the image that is covered, times the number of tiles to the power 0.06: the smaller of two similar lattices
    is preferred, as by the detector ``consensus``. Unlike correlations under windows this does not favor small cells.
    """
    lattice = knots.mean_lattice()
    straight, corner, inside = straighten_pixels(image, knots, lattice)
    tiles = float(inside.sum()) / lattice.area
    if tiles <= 2:
        return 0.0
    rest = 1 - explained_share(straight, lattice.shifted(-corner), inside)
    explained = 1 - rest * (tiles + 1) / (tiles - 1)
    covered = min(knots.area / (image.shape[0] * image.shape[1]), 1.0)
    return float(explained * covered * tiles**_SIZE_EXPONENT)


def _are_enough(knots: Knots) -> bool:
    """Return whether knots tell how a lattice lies in an image."""
    return bool(knots.known.sum() >= _LEAST_KNOTS and knots.spans_plane)


def _levels_of(knots: Knots, shares: tuple[float, ...] = _LEVELS) -> tuple[float, ...]:
    """Return correlations that are given as shares of the median over the known knots."""
    median = float(np.median(knots.correlation[knots.known]))
    return tuple(share * median for share in shares)


def _shrink(image: Image, lattice: Lattice) -> tuple[Values, Lattice, int]:
    """Return the image, shrunk and smoothed, the lattice in its pixels, and the factor."""
    factor = max(1, int(lattice.s / _FINEST))
    sigma = _SMOOTH * lattice.s / factor
    return _smooth(shrink(image, factor), sigma), Lattice.from_basis(lattice.matrix / factor), factor


def _smooth(values: Values, sigma: float) -> Values:
    """Return the values ``(H, W, C)`` that :func:`scipy.ndimage.gaussian_filter` gives, to the bit.

    Importing that function takes longer than all else that a sample with a given lattice needs.
    """
    reach = int(4 * sigma + 0.5)
    weights = np.exp(-0.5 / sigma**2 * np.arange(-reach, reach + 1) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        edges = [(reach, reach) if each == axis else (0, 0) for each in range(3)]
        padded = np.moveaxis(np.pad(values, edges, "symmetric"), axis, 0)
        values = np.moveaxis(smooth_inside(padded, weights), 0, axis)
    return values


def _starts(image: Values, lattice: Lattice) -> Iterator[Start]:
    """Yield the starts from which a lattice of unknown place is followed for the first time."""
    size = np.array(image.shape[1::-1], np.float64)
    whole = _whole_start(image, lattice)
    if whole is None:
        return
    yield whole
    for y, x in itertools.product(_MIDDLES, repeat=2):
        yield _local_start(image, lattice, size * (x, y))


def _whole_start(image: Values, lattice: Lattice) -> Start | None:
    """Return the start whose tile is the mean of all cells, at a lattice point near the middle; None if flat."""
    tile = fold(image, lattice)
    if float(tile.values.var((0, 1)).sum()) < _FLAT:
        return None
    cell = np.rint(lattice.to_cell(np.array(image.shape[1::-1]) / 2))
    return Start(tile, cell, lattice.from_cell(cell), lattice.matrix.T)


def _local_start(image: Values, lattice: Lattice, middle: Points) -> Start:
    """Return the start whose tile is the mean of a few cells around ``middle`` (x, y) px."""
    half = _CELLS / 2 * np.abs(lattice.matrix).sum(0)
    low = np.maximum(np.floor(middle - half), 0).astype(int)
    high = np.minimum(np.ceil(middle + half) + 1, image.shape[1::-1]).astype(int)
    tile = fold(image[low[1] : high[1], low[0] : high[0]], lattice.shifted(middle - low))
    return Start(tile, np.zeros(2), middle, lattice.matrix.T)


def _restart(image: Values, knots: Knots, change: Points | None = None) -> Start:
    """Return the start whose tile is that of the straightened image, at the knot with the best surroundings.

    Parameters
    ----------
    image, knots
        The image, and the places of a lattice in it.
    change
        2 x 2: rows: cell coordinates of the vectors of the lattice to follow; None: it is the same one.
    """
    change = np.eye(2) if change is None else change
    lattice = knots.mean_lattice()
    other = Lattice.from_basis(change @ lattice.matrix, lattice.origin)
    straight, corner, inside = straighten_pixels(image, knots, lattice)
    tile = fold(straight, other.shifted(-corner), inside if inside.any() else None)
    surroundings = scipy.ndimage.uniform_filter(knots.correlation, 3, mode="constant")
    at = np.unravel_index(np.argmax(np.where(knots.known, surroundings, -1)), knots.known.shape)
    cell = knots.cells[at] @ np.linalg.inv(change)
    return Start(tile, cell, knots.places[at], knots.slopes[at] @ change.T)


def _finished(image: Values, knots: Knots) -> Knots | None:
    """Return knots after their last round, None if they are too few; parts that are whole vectors off are corrected."""
    if not _are_enough(knots):
        return None
    knots = _renumbered(image, knots)
    found = grow_on(image, _restart(image, knots).tile, knots, _levels_of(knots, _LEVELS[-1:]), last=True)
    return found if _are_enough(found) else None


def _renumbered(image: Values, knots: Knots) -> Knots:
    """Return knots of which fewer parts are whole vectors off, or the given ones.

    The lattice is followed on from the renumbered parts, with the mean tile of these parts alone. The result is used if
    it fits the image better, or about as well and no part of it is off.
    """
    parts = renumber(knots)
    for _ in range(_MOST_RENUMBERED):
        if parts is None or not _are_enough(parts):
            break
        found = grow_on(image, _restart(image, parts).tile, parts, _levels_of(parts))
        before, after = (similarity(each, image.shape[:2]) for each in (knots, found))
        parts = renumber(found)
        if after <= before * (_KEPT if parts is None else 1):
            break
        knots = found
    return knots


def straighten_pixels(image: Values, knots: Knots, lattice: Lattice) -> tuple[Values, Points, NDArray[np.bool_]]:
    """Return an image without its deformation, on the plane of a lattice.

    Returns
    -------
    Values
        ``(h, w, C)``: all of the plane where knots are known, and more.
    Points
        (x, y): the point of the plane that the first pixel shows.
    NDArray[np.bool_]
        ``bool (h, w)``: the pixels that are known.
    """
    points = lattice.from_cell(knots.cells[knots.known])
    low, high = np.floor(points.min(0)), np.ceil(points.max(0))
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    cells = lattice.to_cell(np.stack([x, y], -1))
    sources = knots.locate(cells)
    inside = knots.is_near(cells) & ((sources >= 0) & (sources <= np.array(image.shape[1::-1]) - 1)).all(-1)
    return interpolate(image, sources), low, inside
