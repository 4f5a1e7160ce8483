"""Register windows of an image against the periodic image: displacements, their lattice, and their scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.relation import LatticeError, lattice_error
from nrbench.plugins.forms import Shape

from ..ncc.periodic import Periodic
from ..ncc.refinement import refine_displacements
from . import limits
from .exponential_tail import ExponentialTail

_FOLLOWS = 0.04
"""Distance, in s, below which a window follows an affine displacement: twice the scatter of fresh draws' windows."""
_NEARLY, _NEARLY_ALL = 0.95, 0.8
"""Limits of the fit of the drift. A candidate counts as equally good as the best one if it has at least the first share
of its followers. A drift that at least the second share of all windows follows is fitted once more."""
_BANDWIDTH = 0.04
"""Standard deviation, in s, of the Gaussian that weights displacements for the consensus, equal to :data:`_FOLLOWS`."""
_CANDIDATES = 64
"""Largest number of displacements from which the search for the consensus may start."""
_STEPS = 5
"""Steps of the mean shift. Few are enough, because each step reduces the error much if few windows lie elsewhere."""
_AT_ONCE = 256
"""Number of windows that are registered at a time, which limits the memory."""


@dataclass(frozen=True)
class RegisteredWindows:
    """Windows of an image, and the displacement of the content of each.

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
        ``(n,)``: weighted NCC of the window with the periodic image at that displacement.
    known_phase
        The displacement (x, y) px that the windows should have; None: the one that most of them share.
    """

    lattice: Lattice
    window: tuple[int, int]
    grid: tuple[int, int]
    corners: NDArray[np.intp]
    displacement: Points
    structure: NDArray[np.float64]
    known_phase: Points | None = None

    @cached_property
    def phase(self) -> Points:
        """The displacement (x, y) px that most windows share, or the known one."""
        return find_consensus(self.displacement, self.lattice) if self.known_phase is None else self.known_phase

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

        The phase is not used, because content that is bent everywhere has no common phase. At most
        :data:`_CANDIDATES` windows, evenly spaced, are paired with all.
        """
        if not len(self.corners):
            return 0.0
        few = self.displacement[:: -(-len(self.displacement) // _CANDIDATES)]
        apart = self.lattice.wrap(self.displacement[np.newaxis] - few[:, np.newaxis])
        return float(np.hypot(*np.moveaxis(apart, -1, 0)).mean() / self.lattice.s)

    @property
    def centers(self) -> Points:
        """``(n, 2)``: middles of the windows, (x, y) px."""
        return self.corners + (np.array(self.window[::-1]) - 1) / 2

    def subtract_drift(self, drift: Points) -> RegisteredWindows:
        """Return the windows without the affine displacement ``drift @ (x, y)``, so that it is no misplacement."""
        rest = self.lattice.wrap(self.displacement - self.centers @ drift.T)
        return replace(self, displacement=rest)

    def neighborhoods(self, size: int = 3) -> NDArray[np.float64]:
        """Return the length of the median offset of each block of ``size`` x ``size`` windows, over s, ``(m,)``.

        One window that locks onto a wrong peak does not change the median. Content that is displaced as a whole does.
        """
        if not len(self.corners):
            return np.zeros(0)
        rows, columns = (min(size, side) for side in self.grid)
        field = self.offsets.reshape(*self.grid, 2)
        blocks = np.lib.stride_tricks.sliding_window_view(field, (rows, columns), axis=(0, 1))
        middle = np.median(blocks, axis=(-2, -1)).reshape(-1, 2)
        return np.asarray(np.hypot(*middle.T) / self.lattice.s)

    def find_nearest(self, points: Points) -> NDArray[np.intp]:
        """Return the index of the window whose middle is nearest to each point (x, y), along each axis."""
        centers = self.centers.reshape(*self.grid, 2)
        column = np.abs(points[:, :1] - centers[0, :, 0]).argmin(1)
        row = np.abs(points[:, 1:] - centers[:, 0, 1]).argmin(1)
        return np.asarray(row * self.grid[1] + column)


def register_windows(image: Image, periodic: Periodic) -> RegisteredWindows:
    """Register windows, half a window apart, over one cell of displacements. They are 2 tiles wide unless stated.

    If the window at p shows the content that the periodic image has at q, its displacement is p - q. All windows are
    searched for in one patch of the periodic image that contains a whole cell of places q.
    """
    template = periodic.windows
    grid, corners = _place_windows(image.shape[:2], template.window)
    if not len(corners):
        return RegisteredWindows(periodic.lattice, template.window, grid, corners, np.zeros((0, 2)), np.zeros(0))
    planes = periodic.colors.planes(image)
    few = np.array_split(corners, len(corners) // _AT_ONCE + 1)
    at = np.concatenate([periodic.cell_search.find(planes, some)[0] for some in few])
    displacement, structure = refine_displacements(image, periodic.cell, corners, template.window, corners - at)
    return RegisteredWindows(
        periodic.lattice, template.window, grid, corners, periodic.lattice.wrap(displacement), structure
    )


def _place_windows(shape: tuple[int, int], window: tuple[int, int]) -> tuple[tuple[int, int], NDArray[np.intp]]:
    """Return rows, columns and corners of windows about half a window apart that reach all four borders."""
    starts = []
    for side, length in zip(shape, window, strict=True):
        count = int((side - length) / (length / 2)) + 1 if side >= length else 0
        starts.append(np.rint(np.linspace(0, side - length, count)).astype(np.intp))
    y, x = np.meshgrid(*starts, indexing="ij")
    return (len(starts[0]), len(starts[1])), np.stack([x.ravel(), y.ravel()], -1)


def find_consensus(displacement: Points, lattice: Lattice) -> Points:
    """Return the most common displacement, a robust circular mean in cell coordinates, by mean shift.

    Displacements form a torus, because they are defined modulo the lattice. Each is weighted by a Gaussian of its
    distance from the mean, so that distant ones have no influence. The search starts from the displacement with the
    most neighbors. If two halves of an image are out of step, a plain circular mean would lie between them; this mean
    lies in the larger half. Time is linear in the number of displacements.
    """
    if not len(displacement):
        return np.zeros(2)
    width, basis = _BANDWIDTH * lattice.s, lattice.reduced().matrix
    inverse = np.linalg.inv(basis)

    def wrap_near(apart: Points) -> Points:
        """Wrap displacements by rounding. This is exact near lattice points; others get no weight anyway."""
        return np.asarray(apart - np.rint(apart @ inverse) @ basis)

    few = displacement[:: -(-len(displacement) // _CANDIDATES)]
    apart = (wrap_near(displacement[np.newaxis] - few[:, np.newaxis]) ** 2).sum(-1)
    phase = few[np.exp(-apart / (2 * width**2)).sum(1).argmax()]
    for _ in range(_STEPS):
        offsets = wrap_near(displacement - phase)
        share = np.exp(-(offsets**2).sum(-1) / (2 * width**2))
        phase = phase + share @ offsets / max(share.sum(), 1e-12)
    return lattice.wrap(phase)


def fit_drift(windows: RegisteredWindows) -> Points:
    """Return the 2 x 2 matrix A of the affine part of the displacement: ``d = A (x, y) + constant``.

    Three candidates are compared: no drift; the median steps between neighboring windows modulo the lattice, which
    unwrap a drift over many cells; and the least-squares fit to the windows that follow these steps. The result is the
    candidate that most windows follow, or the simplest of those with nearly as many followers. It is fitted once more
    only if nearly all windows follow it, because two halves that are out of step are no drift. The result is zero for
    fewer than 3 x 3 windows.
    """
    none = np.zeros((2, 2))
    if min(windows.grid) < 3:
        return none
    steps = _median_steps(windows)
    candidates = [none, steps, _refine_drift(windows, steps)]
    followed = np.array([affine_residuals(windows, matrix)[1].sum() for matrix in candidates])
    best = int(np.argmax(followed >= _NEARLY * followed.max()))
    return (
        _refine_drift(windows, candidates[best])
        if followed[best] >= _NEARLY_ALL * len(windows.corners)
        else candidates[best]
    )


def _median_steps(windows: RegisteredWindows) -> Points:
    matrix = np.zeros((2, 2))
    field = windows.displacement.reshape(*windows.grid, 2)
    centers = windows.centers.reshape(*windows.grid, 2)
    for axis, along in ((1, 0), (0, 1)):
        steps = windows.lattice.wrap(np.diff(field, axis=axis)).reshape(-1, 2)
        length = np.diff(centers, axis=axis).reshape(-1, 2)[:, along]
        matrix[:, along] = np.median(steps / length[:, np.newaxis], 0)
    return matrix


def _refine_drift(windows: RegisteredWindows, matrix: Points) -> Points:
    for _ in range(3):
        offsets, inside, _ = affine_residuals(windows, matrix)
        if inside.sum() < 6:
            break
        design = np.column_stack([windows.centers[inside], np.ones(inside.sum())])
        matrix = matrix + np.linalg.lstsq(design, offsets[inside], rcond=None)[0][:2].T
    return matrix


def affine_residuals(windows: RegisteredWindows, matrix: Points) -> tuple[Points, NDArray[np.bool_], Points]:
    """Return each window's offset from an affine displacement, which windows follow it, and its constant part.

    The affine displacement is ``matrix @ (x, y) + constant``, and the constant is the consensus of the windows.
    """
    lattice = windows.lattice
    rest = lattice.wrap(windows.displacement - windows.centers @ matrix.T)
    constant = find_consensus(rest, lattice)
    offsets = lattice.wrap(rest - constant)
    return offsets, np.hypot(*offsets.T) < _FOLLOWS * lattice.s, constant


LEAST_FOLLOWERS = 0.5
"""Least share of windows on the output's own lattice for it to be compared with the true one."""


@dataclass(frozen=True)
class OwnLattice:
    """The lattice of an output, and the share of windows that lie on it.

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
        """Return the comparison with the true lattice; None if too few windows lie on this one."""
        return lattice_error(self.lattice, truth, shape) if self.followers >= LEAST_FOLLOWERS else None


def fit_own_lattice(windows: RegisteredWindows, drift: Points) -> OwnLattice | None:
    """Return the lattice on which the output's content lies; None for fewer than 3 x 3 windows.

    The content at x belongs at x - d(x), where ``d = drift @ x + constant`` is fitted to the windows by least squares.
    A lattice point p of the periodic image therefore lies at ``(1 - drift)^-1 (p + constant)`` in the output.
    """
    if min(windows.grid) < 3:
        return None
    _, inside, constant = affine_residuals(windows, drift)
    return OwnLattice(displace_lattice(windows.lattice, drift, constant), float(inside.mean()))


def displace_lattice(lattice: Lattice, drift: Points, constant: Points) -> Lattice:
    """Return the lattice in an image whose content is displaced by ``drift @ x + constant``."""
    matrix = stretch_matrix(drift)
    t1, t2, origin = (matrix @ np.asarray(v) for v in (lattice.t1, lattice.t2, np.add(lattice.origin, constant)))
    return Lattice((t1[0], t1[1]), (t2[0], t2[1]), (origin[0], origin[1]))


def stretch_matrix(drift: Points) -> Points:
    """Return the 2 x 2 matrix ``(1 - drift)^-1`` that maps places in the periodic image to places in the output."""
    return np.asarray(np.linalg.inv(np.eye(2) - drift), np.float64)


_THIRD_QUARTILE = 0.75
"""Quantile that measures the scatter. A few windows that lock onto a wrong place do not affect it."""


def scatter_excess(windows: RegisteredWindows, references: Sequence[RegisteredWindows]) -> float:
    """Return the ratio of the windows' scatter to its limits; above 1 the content is bent.

    Under a smooth displacement most windows stay within the tolerance, but all are displaced by more than the windows
    of the references. The third quartile of the misplacement shows this; the share beyond the tolerance does not.
    """
    reference = np.concatenate([one.misplacement for one in references])
    if not len(reference) or not len(windows.misplacement):
        return 0.0
    usual, scatter = (float(np.quantile(some, _THIRD_QUARTILE)) for some in (reference, windows.misplacement))
    return min(scatter / max(usual, 1e-6) / limits.SCATTER_RATIO, scatter / limits.SCATTER)


def neighborhood_excess(
    windows: RegisteredWindows, references: Sequence[RegisteredWindows], limit: float, model: bool
) -> float:
    """Return the ratio of the displacement of the worst neighborhood to its limits; above 1 it is displaced.

    The displacement must exceed ``limit`` (in s). If ``model`` is True, there are enough references, and it must also
    exceed what their neighborhoods explain.
    """
    displacement = windows.neighborhoods()
    ratio = float(displacement.max(initial=0.0)) / limit
    if not model:
        return ratio
    usual = np.concatenate([one.neighborhoods() for one in references])
    surprisal = ExponentialTail.fit(usual, quantile=0.9, overlap=4).surprisal(displacement)
    return min(ratio, float(surprisal.max(initial=0.0)) / limits.NEIGHBORHOOD_SURPRISAL)
