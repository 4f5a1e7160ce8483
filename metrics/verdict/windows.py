"""Windows of an image, registered against the periodic image: displacements, their lattice, and their scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.comparison import LatticeError, lattice_error
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

from ..ncc.periodic import Periodic
from ..ncc.refinement import refined
from . import limits
from .exponential_tail import ExponentialTail

_FOLLOWS = 0.04
"""Distance, in s, below which a window follows an affine displacement: twice the scatter of fresh draws' windows."""
_NEARLY, _NEARLY_ALL = 0.95, 0.8
"""An affine part with at least the first share of the most followers counts as equally good. One that at least the
second share of all windows follows is that of the whole image and is fitted once more."""
_BANDWIDTH = 0.04
"""Standard deviation, in s, of the Gaussian by which displacements count for the consensus: as :data:`_FOLLOWS`."""
_CANDIDATES = 64
"""Displacements from which the consensus may start."""
_STEPS = 5
"""Steps of the mean shift: the fewer windows are elsewhere, the more each step reduces the error, so few are enough."""
_AT_ONCE = 256
"""Windows registered at a time, which bounds memory."""


@dataclass(frozen=True)
class RegisteredWindows:
    """Windows of an image, and how far the content of each has moved.

    Parameters
    ----------
    lattice
        Reduced.
    window
        Height and width of the windows in px.
    grid
        Rows and columns of windows, half a window apart.
    corners
        ``(n, 2)``: (x, y) of each window's top-left pixel, row by row.
    displacement
        ``(n, 2)``: (x, y) px from the ideal place to the content, modulo the lattice.
    structure
        ``(n,)``: weighted NCC of the window with the periodic image there.
    """

    lattice: Lattice
    window: tuple[int, int]
    grid: tuple[int, int]
    corners: NDArray[np.intp]
    displacement: Points
    structure: NDArray[np.float64]

    @cached_property
    def phase(self) -> Points:
        """The displacement (x, y) px that most windows share."""
        return consensus(self.displacement, self.lattice)

    @cached_property
    def offsets(self) -> Points:
        """``(n, 2)``: displacement from the consensus, modulo the lattice, in px."""
        return self.lattice.wrap(self.displacement - self.phase)

    @cached_property
    def misplacement(self) -> NDArray[np.float64]:
        """``(n,)``: length of :attr:`offsets` over the shortest lattice vector."""
        return np.asarray(np.hypot(*self.offsets.T) / self.lattice.s)

    @cached_property
    def pairwise_displacement(self) -> float:
        """Mean distance between the displacements of two windows, modulo the lattice, over s.

        The phase is not used, because no phase is right for content that is bent everywhere. At most
        :data:`_CANDIDATES` windows, evenly spread, are paired with all.
        """
        if not len(self.corners):
            return 0.0
        few = self.displacement[:: -(-len(self.displacement) // _CANDIDATES)]
        apart = self.lattice.wrap(self.displacement[np.newaxis] - few[:, np.newaxis])
        return float(np.hypot(*np.moveaxis(apart, -1, 0)).mean() / self.lattice.s)

    @property
    def centers(self) -> Points:
        """``(n, 2)``: middles (x, y) of the windows in px."""
        return self.corners + (np.array(self.window[::-1]) - 1) / 2

    def without(self, drift: Points) -> RegisteredWindows:
        """Return the windows less an affine displacement ``drift @ (x, y)``, which then is no misplacement."""
        rest = self.lattice.wrap(self.displacement - self.centers @ drift.T)
        return replace(self, displacement=rest)

    def neighborhoods(self, size: int = 3) -> NDArray[np.float64]:
        """Return, for each block of ``size`` x ``size`` windows, the length of their median offset over s, ``(m,)``.

        A wrong peak of one window does not reach the median; content that moved together does.
        """
        if not len(self.corners):
            return np.zeros(0)
        rows, columns = (min(size, side) for side in self.grid)
        field = self.offsets.reshape(*self.grid, 2)
        blocks = np.lib.stride_tricks.sliding_window_view(field, (rows, columns), axis=(0, 1))
        middle = np.median(blocks, axis=(-2, -1)).reshape(-1, 2)
        return np.asarray(np.hypot(*middle.T) / self.lattice.s)

    def nearest(self, points: Points) -> NDArray[np.intp]:
        """Return the index of the window whose middle is nearest to each point (x, y), along each axis."""
        centers = self.centers.reshape(*self.grid, 2)
        column = np.abs(points[:, :1] - centers[0, :, 0]).argmin(1)
        row = np.abs(points[:, 1:] - centers[:, 0, 1]).argmin(1)
        return np.asarray(row * self.grid[1] + column)


def register_windows(image: Image, periodic: Periodic) -> RegisteredWindows:
    """Register windows 2 tiles wide, half a window apart, over one cell of displacements.

    If the window at p shows what the periodic image has at q, the content has moved by p - q. So every window is
    searched for in one patch of the periodic image that holds a whole cell of q.
    """
    template = periodic.windows
    grid, corners = _grid(image.shape[:2], template.window)
    if not len(corners):
        return RegisteredWindows(periodic.lattice, template.window, grid, corners, np.zeros((0, 2)), np.zeros(0))
    planes = periodic.colors.planes(image)
    few = np.array_split(corners, len(corners) // _AT_ONCE + 1)
    at = np.concatenate([periodic.places.find(planes, some)[0] for some in few])
    displacement, structure = refined(image, periodic.cell, corners, template.window, corners - at)
    return RegisteredWindows(
        periodic.lattice, template.window, grid, corners, periodic.lattice.wrap(displacement), structure
    )


def _grid(shape: tuple[int, int], window: tuple[int, int]) -> tuple[tuple[int, int], NDArray[np.intp]]:
    """Return rows, columns and corners of windows about half a window apart that reach all four borders."""
    starts = []
    for side, length in zip(shape, window, strict=True):
        count = int((side - length) / (length / 2)) + 1 if side >= length else 0
        starts.append(np.rint(np.linspace(0, side - length, count)).astype(np.intp))
    y, x = np.meshgrid(*starts, indexing="ij")
    return (len(starts[0]), len(starts[1])), np.stack([x.ravel(), y.ravel()], -1)


def consensus(displacement: Points, lattice: Lattice) -> Points:
    """Return the most common displacement, a robust circular mean in cell coordinates, by mean shift.

    On the torus of displacements modulo the lattice each displacement is weighted by a Gaussian of its distance from
    the mean, so that those elsewhere have no influence. The search starts from the displacement with the most others
    around it. A plain circular mean would lie between two halves that are out of step; this one lies in the larger
    half.
    Time is linear in the number of displacements.
    """
    if not len(displacement):
        return np.zeros(2)
    width, basis = _BANDWIDTH * lattice.s, lattice.reduced().matrix
    inverse = np.linalg.inv(basis)

    def near(apart: Points) -> Points:
        """Wrap exactly near lattice points; all other displacements stay long, so they get no weight."""
        return np.asarray(apart - np.rint(apart @ inverse) @ basis)

    few = displacement[:: -(-len(displacement) // _CANDIDATES)]
    apart = (near(displacement[np.newaxis] - few[:, np.newaxis]) ** 2).sum(-1)
    phase = few[np.exp(-apart / (2 * width**2)).sum(1).argmax()]
    for _ in range(_STEPS):
        offsets = near(displacement - phase)
        share = np.exp(-(offsets**2).sum(-1) / (2 * width**2))
        phase = phase + share @ offsets / max(share.sum(), 1e-12)
    return lattice.wrap(phase)


def fit_drift(placement: RegisteredWindows) -> Points:
    """Return the 2 x 2 matrix A of the affine part of the displacement: ``d = A (x, y) + constant``.

    Three candidates are compared: no drift, the median steps between neighboring windows modulo the lattice, which
    unwrap a drift over many cells, and the least-squares fit to the windows that follow these steps. The one that most
    windows follow is taken, or the simplest of those that nearly as many follow. It is fitted once more if nearly all
    windows follow it, because two halves that are out of step are no drift. Zero if there are fewer than 3 x 3
    windows.
    """
    none = np.zeros((2, 2))
    if min(placement.grid) < 3:
        return none
    steps = _median_steps(placement)
    found = [none, steps, _refined(placement, steps)]
    followed = np.array([affine_residuals(placement, matrix)[1].sum() for matrix in found])
    best = int(np.argmax(followed >= _NEARLY * followed.max()))
    return _refined(placement, found[best]) if followed[best] >= _NEARLY_ALL * len(placement.corners) else found[best]


def _median_steps(placement: RegisteredWindows) -> Points:
    matrix = np.zeros((2, 2))
    field = placement.displacement.reshape(*placement.grid, 2)
    centers = placement.centers.reshape(*placement.grid, 2)
    for axis, along in ((1, 0), (0, 1)):
        steps = placement.lattice.wrap(np.diff(field, axis=axis)).reshape(-1, 2)
        length = np.diff(centers, axis=axis).reshape(-1, 2)[:, along]
        matrix[:, along] = np.median(steps / length[:, np.newaxis], 0)
    return matrix


def _refined(placement: RegisteredWindows, matrix: Points) -> Points:
    for _ in range(3):
        offsets, inside, _ = affine_residuals(placement, matrix)
        if inside.sum() < 6:
            break
        design = np.column_stack([placement.centers[inside], np.ones(inside.sum())])
        matrix = matrix + np.linalg.lstsq(design, offsets[inside], rcond=None)[0][:2].T
    return matrix


def affine_residuals(placement: RegisteredWindows, matrix: Points) -> tuple[Points, NDArray[np.bool_], Points]:
    """Return each window's displacement less an affine one, which windows follow that one, and its constant part."""
    lattice = placement.lattice
    rest = lattice.wrap(placement.displacement - placement.centers @ matrix.T)
    constant = consensus(rest, lattice)
    offsets = lattice.wrap(rest - constant)
    return offsets, np.hypot(*offsets.T) < _FOLLOWS * lattice.s, constant


LEAST_FOLLOWERS = 0.5
"""Share of the windows that must follow one lattice for it to be the output's."""


@dataclass(frozen=True)
class OwnLattice:
    """A lattice, and how many windows lie on it.

    Parameters
    ----------
    lattice
        In the output's coordinates.
    followers
        Share of the windows within 0.04 s of it, in [0, 1].
    """

    lattice: Lattice
    followers: float

    def error(self, truth: Lattice, shape: Shape) -> LatticeError | None:
        """Return the comparison with the true lattice; None where too few windows follow this one."""
        return lattice_error(self.lattice, truth, shape) if self.followers >= LEAST_FOLLOWERS else None


def own_lattice(placement: RegisteredWindows, drift: Points) -> OwnLattice | None:
    """Return the lattice on which the output's content lies; None where there are fewer than 3 x 3 windows.

    The content at x came from x - d(x), with ``d = drift @ x + constant`` fitted by least squares to the windows; so a
    lattice point p of the periodic image is found at ``(1 - drift)^-1 (p + constant)``.
    """
    if min(placement.grid) < 3:
        return None
    _, inside, constant = affine_residuals(placement, drift)
    return OwnLattice(moved(placement.lattice, drift, constant), float(inside.mean()))


def moved(lattice: Lattice, drift: Points, constant: Points) -> Lattice:
    """Return where a lattice's points are found in an image whose content has moved by ``drift @ x + constant``."""
    matrix = spread(drift)
    t1, t2, origin = (matrix @ np.asarray(v) for v in (lattice.t1, lattice.t2, np.add(lattice.origin, constant)))
    return Lattice((t1[0], t1[1]), (t2[0], t2[1]), (origin[0], origin[1]))


def spread(drift: Points) -> Points:
    """Return the 2 x 2 matrix that takes places in the periodic image to where they are found: ``(1 - drift)^-1``."""
    return np.asarray(np.linalg.inv(np.eye(2) - drift), np.float64)


_THIRD_QUARTILE = 0.75
"""The quantile that measures the scatter: a few windows that lock onto a wrong place do not affect it."""


def scatter_excess(placement: RegisteredWindows, references: Sequence[RegisteredWindows]) -> float:
    """Return how far the windows' scatter exceeds its limits: above 1 the content is bent.

    Under a smooth displacement most windows stay within the tolerance, yet all are off by more than those of the
    references. The third quartile of the misplacement shows this; the share beyond the tolerance does not.
    """
    own = np.concatenate([one.misplacement for one in references])
    if not len(own) or not len(placement.misplacement):
        return 0.0
    usual, seen = (float(np.quantile(some, _THIRD_QUARTILE)) for some in (own, placement.misplacement))
    return min(seen / max(usual, 1e-6) / limits.SCATTER_RATIO, seen / limits.SCATTER)


def neighborhood_excess(
    placement: RegisteredWindows, references: Sequence[RegisteredWindows], limit: float, model: bool
) -> float:
    """Return how far the worst neighborhood exceeds its limits: above 1 it has moved.

    It is off by more than ``limit`` (in s) and, where a model gives enough references, by more than is likely for
    theirs.
    """
    found = placement.neighborhoods()
    far = float(found.max(initial=0.0)) / limit
    if not model:
        return far
    own = np.concatenate([one.neighborhoods() for one in references])
    surprise = ExponentialTail.fit(own, quantile=0.9, overlap=4).surprisal(found)
    return min(far, float(surprise.max(initial=0.0)) / limits.NEIGHBORHOOD_SURPRISAL)
