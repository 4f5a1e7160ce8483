"""The verdict: whether an output kept its lattice, from its windows and tiles and those of references."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

from ..ncc.periodic import TOLERANCE
from . import limits
from .courses import course_excess
from .measurements import Measurements
from .own_lattice import OwnLattice, own_lattice
from .reference import Reference
from .scatter import neighborhood_excess, scatter_excess
from .single_tiles import breakage_excess, displacement_excess, elsewhere_excess
from .strips import strip_excess
from .tiles import Tiles, inspect
from .window_registration import fit_drift, register_windows

Flags = NDArray[np.bool_]
Ratios = NDArray[np.float64]
_OVERLAP = 0.55
"""Tiles whose distance times this stays within the Voronoi cell overlap: 0.5 would be tiles that touch."""


@dataclass(frozen=True)
class Verdict:
    """An output beside its references.

    Parameters
    ----------
    reference
        What it is compared with.
    output
        The output.
    drift
        2 x 2 matrix: the affine part of the output's displacement.
    own
        The least-squares lattice of the output; None where it has too few windows.
    """

    reference: Reference
    output: Measurements
    drift: Points
    own: OwnLattice | None

    @property
    def references(self) -> tuple[Measurements, ...]:
        """Measurements of the reference images."""
        return self.reference.measurements

    @cached_property
    def scatter(self) -> float:
        """How far (in s) 95 % of the references' windows are from their place at most."""
        own = np.concatenate([look.windows.misplacement for look in self.references])
        return float(np.quantile(own, 0.95)) if len(own) else 0.0

    @property
    def limit(self) -> float:
        """How far (in s) a window may be from its place: the tolerance, or twice what the references' are."""
        return float(np.clip(2 * self.scatter, TOLERANCE, 2 * limits.REFERENCE_SCATTER))

    @cached_property
    def misplaced(self) -> Flags:
        """Which windows of the output are out of place."""
        return self.output.windows.misplacement > self.limit

    @cached_property
    def reference_misplaced(self) -> float:
        """Share of windows out of place in the references."""
        own = np.concatenate([look.windows.misplacement for look in self.references])
        return float((own > self.limit).mean()) if len(own) else 1.0

    @cached_property
    def structure(self) -> float:
        """Median NCC of the output's windows over that of the references'."""
        own = np.concatenate([look.windows.structure for look in self.references])
        return float(np.median(self.output.windows.structure) / max(np.median(own), 1e-6))

    @cached_property
    def displacement_excess(self) -> Ratios:
        """For each tile, how far it exceeds the limits of fitting better elsewhere: above 1 it is displaced."""
        return displacement_excess(self.output.tiles, self._reference_tiles, self.reference.regular_share)

    @cached_property
    def breakage_excess(self) -> Ratios:
        """For each tile, how far it exceeds the limits of fitting badly in its place: above 1 it is broken."""
        return breakage_excess(self.output.tiles, self._reference_tiles)

    @property
    def worst_tile_displacement(self) -> float:
        """How far, in s, the tile lies from its place that fits better elsewhere by most."""
        tiles = self.output.tiles
        return float(np.hypot(*tiles.moved[tiles.gain.argmax()]) / tiles.lattice.s)

    @property
    def _reference_tiles(self) -> list[Tiles]:
        return [look.tiles for look in self.references]

    @property
    def tile_excess(self) -> Ratios:
        """For each tile, how far it exceeds the limits of being displaced or broken, whichever is worse."""
        return np.maximum(self.displacement_excess, self.breakage_excess)

    @cached_property
    def structure_spread(self) -> float | None:
        """Interquartile range of the output's windows' NCC over that of the references'; None where theirs is none."""
        own = np.concatenate([look.windows.structure for look in self.references])
        usual, seen = (float(np.ptp(np.quantile(some, (0.25, 0.75)))) for some in (own, self.output.windows.structure))
        return seen / usual if usual > limits.LEAST_SPREAD else None

    @property
    def usual_misplacement(self) -> float:
        """Median misplacement of the references' windows, in s."""
        return float(np.median(np.concatenate([look.windows.misplacement for look in self.references])))

    @property
    def displaced(self) -> Flags:
        """Which tiles fit better elsewhere than chance allows."""
        return self.displacement_excess > 1

    @property
    def broken(self) -> Flags:
        """Which tiles fit worse in their place than chance allows."""
        return self.breakage_excess > 1

    @cached_property
    def moved(self) -> Flags:
        """Which tiles lie in a window that is out of place, or in a course that has slid."""
        around = self.misplaced[self.output.windows.nearest(self.output.tiles.centers)]
        return np.asarray(around | (self.course_excess > 1))

    @cached_property
    def course_excess(self) -> Ratios:
        """For each tile, how far its worst course exceeds the limits of having slid."""
        tiles, own = self.output.tiles, [look.strips for look in self.references]
        slid = strip_excess(self.output.strips, own, tiles)
        return np.maximum(course_excess(tiles, self._reference_tiles), slid)

    @property
    def bad(self) -> Flags:
        """Which tiles are displaced or broken by themselves."""
        return self.displaced | self.broken

    @property
    def score(self) -> float:
        """Share of tiles in place and intact."""
        return float(1 - (self.bad | self.moved).mean())

    @cached_property
    def excesses(self) -> dict[str, float]:
        """Each fault in words, and how far it exceeds its limit: above 1 regularity is lost."""
        most = limits.MISPLACED_SHARE + 2 * self.reference_misplaced
        placement, references = self.output.windows, [look.windows for look in self.references]
        model = self.reference.source == "model"
        return {
            f"{self.misplaced.mean():.0%} of the windows are out of place": float(self.misplaced.mean()) / most,
            f"a neighborhood is off by {self.worst_neighborhood:.2f} s": neighborhood_excess(
                placement, references, self.limit, model
            ),
            "the content is bent": scatter_excess(placement, references) if model else 0.0,
            f"the structure is {self.structure:.2f} of the references'": (1 - self.structure) / (1 - limits.STRUCTURE),
            "many tiles fit better elsewhere": elsewhere_excess(self.output.tiles, self._reference_tiles),
            "a course of tiles has slid": float(self.course_excess.max(initial=0.0)),
            f"{len(self.bad_places)} tile(s) displaced or broken": float(self.tile_excess.max(initial=0.0)),
        }

    @property
    def excess(self) -> float:
        """How far the worst fault exceeds its limit."""
        return max(self.excesses.values())

    @property
    def faults(self) -> tuple[str, ...]:
        """Why regularity is lost; empty where nothing is wrong."""
        return tuple(fault for fault, excess in self.excesses.items() if excess > 1)

    @cached_property
    def lack_of_power(self) -> str:
        """Why the judge would not have seen a fault; empty where it would."""
        rows, columns = self.output.windows.grid
        if min(rows, columns) < limits.LEAST_WINDOWS:
            least = limits.LEAST_WINDOWS
            return f"the output holds {columns} x {rows} windows of 2 tiles, at least {least} x {least} are needed"
        if self.reference.regular_share < limits.LEAST_SHARE:
            return f"the regular share {self.reference.regular_share:.2f} is under {limits.LEAST_SHARE:g}"
        if self.scatter > limits.REFERENCE_SCATTER:
            return f"windows of the {self._reference_name} are themselves off by up to {self.scatter:.2f} s"
        if self.reference_misplaced > limits.REFERENCE_MISPLACED:
            return (
                f"{self.reference_misplaced:.0%} of the windows of the {self._reference_name} lock onto a wrong place"
            )
        return ""

    @property
    def lattice_doubtful(self) -> bool:
        """Whether the lattice was given for a sample in which the judge is blind: it may as well be a wrong one."""
        return self.reference.source == "sample" and bool(self.lack_of_power)

    @property
    def preserved(self) -> bool | None:
        """The verdict: True, False, or None where nothing is seen and nothing would be."""
        if min(self.output.windows.grid) < limits.LEAST_WINDOWS:
            return None
        if self.lack_of_power:
            return False if self.misplaced.mean() > limits.GROSS_SHARE + 2 * self.reference_misplaced else None
        return False if self.faults else (self.reference.regular_share >= limits.SURE_SHARE or None)

    @property
    def intact(self) -> bool | None:
        """The verdict on single tiles: True, False, or None where one bad tile might not be seen, or all are."""
        if bool(self.bad.any()):
            return False
        blind = self.lack_of_power or self.preserved is False or self.reference.regular_share < limits.INTACT_SHARE
        return None if blind else True

    @cached_property
    def worst_neighborhood(self) -> float:
        """Largest median offset of 3 x 3 windows, in s."""
        return float(self.output.windows.neighborhoods().max(initial=0.0))

    @cached_property
    def bad_places(self) -> Points:
        """``(n, 2)``: middles (x, y) px of the bad tiles, worst first; those of one tile are counted once."""
        tiles = self.output.tiles
        index = np.flatnonzero(self.bad)
        index = index[np.argsort(tiles.here[index], kind="stable")]
        places: list[Points] = []
        for center in tiles.centers[index]:
            apart = _OVERLAP * (np.array(places).reshape(-1, 2) - center)
            if (np.abs(tiles.lattice.wrap(apart) - apart).max(1) > 1e-6).all():
                places.append(center)
        return np.array(places).reshape(-1, 2)

    @property
    def obstacle(self) -> str:
        """Why output and reference cannot be compared; empty if they can."""
        if self.reference.regular_share < limits.NO_SHARE:
            return f"undecided: the lattice explains {self.reference.regular_share:.0%} of the sample's variance"
        for name, images in (("output", (self.output,)), (self.reference.source, self.references)):
            if not all(len(image.windows.corners) and image.tiles.whole.any() for image in images):
                return f"undecided: the {name} is smaller than a window of 2 tiles"
        return ""

    @property
    def _reference_name(self) -> str:
        return "fresh draws" if self.reference.source == "model" else "sample"


def compare(output: Image, reference: Reference) -> Verdict:
    """Return the verdict on an output; a drift that the uncertainty of the lattice allows is left out."""
    seen = reference.view(output)
    windows = register_windows(seen, reference.periodic)
    drift = fit_drift(windows)
    left_out = drift if reference.forgiven(drift) else np.zeros((2, 2))
    placed = windows.without(left_out)
    tiles = inspect(seen, reference.periodic, placed.phase, left_out)
    measurements = Measurements(output, seen, reference.periodic, placed, tiles)
    return Verdict(reference, measurements, drift, own_lattice(windows, drift))
