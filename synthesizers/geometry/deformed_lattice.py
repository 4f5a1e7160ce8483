"""The lattice of a sample as it lies in the sample: where each vertex was found, and whether it departs at all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking.tracker import MeanTile, Track, track_lattice

PARTS: Final = 2
"""Parts into which each step of about s is divided; twice as many knots halve the error of the straightened sample."""
LEAST_CORRELATION: Final = 0.5
"""Correlation with the mean tile from which a tile counts as found."""
LEAST_FOUND: Final = 0.5
"""Share of the tiles that must be found."""
LEAST_POINTS: Final = 9
"""Whole tiles that the sample must hold."""


@dataclass(frozen=True, eq=False)
class DeformedLattice:
    """Where the vertices of a lattice, and points between them, lie in a sample.

    Parameters
    ----------
    lattice
        The regular lattice, reduced, in pixels of the sample.
    knots
        A finer lattice, on which the displacements are known.
    numbers
        ``(n, 2)``: cell coordinates on ``knots`` of the points whose content was found inside the sample. Where both
        are multiples of :data:`PARTS` they are vertices.
    displacements
        ``(n, 2)`` px: how far the content that belongs at each point lies from it, less the mean.
    amplitude
        Root mean square displacement of whole tiles without its affine part, px; 0 if there is an obstacle.
    obstacle
        Why the displacements cannot be relied on; empty if they can.
    """

    lattice: Lattice
    knots: Lattice
    numbers: NDArray[np.int64]
    displacements: Points
    amplitude: float
    obstacle: str = ""

    @cached_property
    def places(self) -> Points:
        """``(n, 2)``: places (x, y) px of the points before they are displaced."""
        return self.knots.from_cell(self.numbers)

    @cached_property
    def mesh(self) -> Lattice:
        """The lattice of the vertices: steps of about s along both vectors."""
        return Lattice.from_basis(PARTS * self.knots.matrix, self.knots.origin)

    @cached_property
    def is_vertex(self) -> NDArray[np.bool_]:
        """``(n,)``: which points are vertices."""
        return np.asarray((self.numbers % PARTS == 0).all(1))


def knot_lattice(lattice: Lattice) -> Lattice:
    """Return a lattice whose vectors are those of ``lattice``, reduced, divided into parts about s / 2 long."""
    lattice = lattice.reduced()
    parts = PARTS * np.maximum(np.rint(np.hypot(*lattice.matrix.T) / lattice.s), 1)
    return Lattice.from_basis(lattice.matrix / parts[:, np.newaxis], lattice.origin)


def find_deformed_lattice(sample: Image, lattice: Lattice) -> DeformedLattice:
    """Track the lattice through the sample, in place of the user who moves its vertices by hand (report, appendix A).

    The report uses vertices alone. The tracker also measures between them.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    lattice
        The regular lattice. Its phase need not fit.
    """
    lattice = lattice.reduced()
    knots = knot_lattice(lattice)
    tile = MeanTile.of(sample, lattice)
    if tile.flat:
        return DeformedLattice(
            lattice, knots, np.zeros((0, 2), np.int64), np.zeros((0, 2)), 0.0, "the mean tile is flat"
        )
    track = track_lattice(sample, lattice, tile)
    last = np.array(sample.shape[1::-1]) - 1.0
    numbers = knots.cell_numbers(-last, 2 * last)
    places = knots.from_cell(numbers)
    found = places + track.nodes.interpolate(track.field, places)
    inside = ((found >= 0) & (found <= last)).all(1)
    moved = (found - places)[inside]
    obstacle = _obstacle(track)
    amplitude = 0.0 if obstacle else _amplitude(track)
    return DeformedLattice(lattice, knots, numbers[inside], moved - moved.mean(0), amplitude, obstacle)


def _obstacle(track: Track) -> str:
    found, share = len(track.numbers), track.tracked_share(LEAST_CORRELATION)
    if found < LEAST_POINTS:
        return f"the sample holds {found} whole tiles, at least {LEAST_POINTS} are needed"
    if share < LEAST_FOUND:
        return f"the mean tile was found at only {share:.0%} of the places"
    return ""


def _amplitude(track: Track) -> float:
    """Return the unbiased root mean square distance of the whole tiles from their best affine fit, px."""
    places = track.locate(track.numbers)
    design = np.column_stack([track.numbers, np.ones(len(places))])
    rest = places - design @ np.linalg.lstsq(design, places, rcond=None)[0]
    return math.sqrt(float((rest**2).sum() / (len(rest) - design.shape[1])))
