"""The verdict on regularity: compare windows, tiles and courses of an output with those of its references."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Shape

from ..ncc.periodic import TOLERANCE
from . import limits
from .courses import course_gain_excess, course_slide_excess
from .measurements import Measurements
from .reference import Reference, compare_mean_tiles
from .tiles import Tiles, breakage_excess, displacement_excess, elsewhere_excess, measure_tiles
from .windows import OwnLattice, fit_drift, fit_own_lattice, neighborhood_excess, register_windows, scatter_excess

Flags = NDArray[np.bool_]
Ratios = NDArray[np.float64]
_OVERLAP = 0.55
"""Two bad places count as one tile if their distance times this factor lies within the Voronoi cell. With a factor of
0.5 they would be one tile if their cells touch."""


@dataclass(frozen=True)
class Verdict:
    """The verdict on an output, and the statistics from which it follows.

    Parameters
    ----------
    reference
        The reference that the output is compared with.
    output
        Measurements of the output.
    drift
        2 x 2 matrix: the affine part of the output's displacement.
    own_lattice
        The least-squares lattice of the output; None if it has too few windows.
    tile_fit
        Without a model: how much of the periodic image the output contains as a whole, see
        :func:`~.reference.compare_mean_tiles`. It is 1 for a model.
    """

    reference: Reference
    output: Measurements
    drift: Points
    own_lattice: OwnLattice | None
    tile_fit: float = 1.0

    @property
    def references(self) -> tuple[Measurements, ...]:
        """Measurements of the reference images."""
        return self.reference.measurements

    @property
    def scatter(self) -> float:
        """Usual upper bound of the misplacement of the windows of the references, in s."""
        return self.reference.scatter

    @property
    def limit(self) -> float:
        """Limit of the misplacement of a window, in s: the tolerance, or twice the scatter of the references."""
        return float(np.clip(2 * self.scatter, TOLERANCE, 2 * limits.REFERENCE_SCATTER))

    @cached_property
    def misplaced_windows(self) -> Flags:
        """Which windows of the output are out of place."""
        return self.output.windows.misplacement > self.limit

    @cached_property
    def reference_misplaced(self) -> float:
        """Share of the references' windows that are out of place."""
        reference = self.reference.misplacement
        return float((reference > self.limit).mean()) if len(reference) else 1.0

    @property
    def neighborhood_limit(self) -> float:
        """Limit of the displacement of a neighborhood, in s. Without a model it exceeds what the sample shows.

        A quantile is taken instead of the largest displacement, because a part of the sample may contain so few windows
        that one of them is the median of a neighborhood.
        """
        if self.reference.source == "model" or not self.reference.windows:
            return self.limit
        displacement = np.concatenate([one.neighborhoods() for one in self.reference.windows])
        usual = float(np.quantile(displacement, limits.SAMPLE_QUANTILE))
        ratio = limits.NEIGHBORHOOD_RATIO if self.reference.consistent else limits.UNEVEN_RATIO
        return max(self.limit, ratio * usual)

    @property
    def resolution(self) -> float | None:
        """The smallest displacement of a neighborhood that would be called lost, in s; None if none would.

        A neighborhood consists of 3 x 3 windows. Windows that lock onto wrong places hide a displacement only if they
        are many.
        """
        too_few = min(self.output.windows.grid) < limits.LEAST_WINDOWS or not self.reference.windows
        return None if too_few or self.reference_misplaced > self._most_misplaced else self.neighborhood_limit

    @property
    def _most_misplaced(self) -> float:
        """Largest share of misplaced windows in the references with which the verdict has power."""
        return limits.REFERENCE_MISPLACED if self.reference.source == "model" else 2 * limits.SAMPLE_MISPLACED

    @cached_property
    def structure(self) -> float:
        """Median NCC of the output's windows over that of the references'."""
        reference = self._reference_structure
        return float(np.median(self.output.windows.structure) / max(np.median(reference), 1e-6))

    @cached_property
    def displacement_excess(self) -> Ratios:
        """For each tile, the ratio of its better fit elsewhere to the limits; above 1 the tile is displaced."""
        return displacement_excess(self.output.tiles, self._reference_tiles, self.reference.regular_share)

    @cached_property
    def breakage_excess(self) -> Ratios:
        """For each tile, the ratio of its bad fit in its place to the limits; above 1 the tile is broken."""
        return breakage_excess(self.output.tiles, self._reference_tiles)

    @property
    def worst_tile_displacement(self) -> float:
        """Displacement, in s, of the tile that gains most by a fit elsewhere."""
        tiles = self.output.tiles
        return float(np.hypot(*tiles.displacements[tiles.gain.argmax()]) / tiles.lattice.s)

    @property
    def _reference_tiles(self) -> list[Tiles]:
        return [image.tiles for image in self.references]

    @property
    def tile_excess(self) -> Ratios:
        """For each tile, the larger of its displacement and breakage excess."""
        return np.maximum(self.displacement_excess, self.breakage_excess)

    @cached_property
    def structure_spread(self) -> float | None:
        """Interquartile range of the NCC of the windows over that of the references; None if theirs is negligible."""
        reference = self._reference_structure
        usual, spread = (
            float(np.ptp(np.quantile(some, (0.25, 0.75)))) for some in (reference, self.output.windows.structure)
        )
        return spread / usual if usual > limits.LEAST_SPREAD else None

    @property
    def usual_misplacement(self) -> float:
        """Median misplacement of the references' windows, in s."""
        return float(np.median(self.reference.misplacement)) if len(self.reference.misplacement) else 0.0

    @property
    def _reference_structure(self) -> Ratios:
        """NCC of all windows of the references."""
        windows = self.reference.windows
        return np.concatenate([one.structure for one in windows]) if windows else np.ones(1)

    @property
    def misplacement_ratio(self) -> float | None:
        """Median misplacement of the output's windows over that of the references'; None if theirs is zero."""
        usual = self.usual_misplacement
        return float(np.median(self.output.windows.misplacement)) / usual if usual > 0 else None

    def describe_displacements(self) -> dict[str, Any]:
        """Return the records on displacements, if the geometry of the texture varies; else nothing."""
        return {}

    @property
    def displaced(self) -> Flags:
        """Which tiles fit better elsewhere than chance allows."""
        return self.displacement_excess > 1

    @property
    def broken(self) -> Flags:
        """Which tiles fit worse in their place than chance allows."""
        return self.breakage_excess > 1

    @cached_property
    def in_displaced_region(self) -> Flags:
        """Which tiles lie in a displaced region: in a window that is out of place, or in a course that has slid."""
        around = self.misplaced_windows[self.output.windows.find_nearest(self.output.tiles.centers)]
        return np.asarray(around | (self.course_excess > 1))

    @cached_property
    def course_excess(self) -> Ratios:
        """For each tile, the ratio of the slide of its worst course to the limits; above 1 the course has slid."""
        tiles, references = self.output.tiles, [image.courses for image in self.references]
        slide_excess = course_slide_excess(self.output.courses, references, tiles)
        return np.maximum(course_gain_excess(tiles, self._reference_tiles), slide_excess)

    @property
    def bad(self) -> Flags:
        """Which tiles are displaced or broken by themselves."""
        return self.displaced | self.broken

    @property
    def score(self) -> float:
        """Share of tiles in place and intact."""
        return float(1 - (self.bad | self.in_displaced_region).mean())

    @cached_property
    def excesses(self) -> dict[str, float]:
        """The ratio of each fault to its limit: above 1 regularity is lost."""
        return self.compare_limits()

    def compare_limits(self) -> dict[str, float]:
        """Return the ratio of each fault to its limit; :attr:`excesses` keeps it."""
        uneven = self.reference.source == "sample" and not self.reference.consistent
        most = (limits.UNEVEN_SHARE if uneven else limits.MISPLACED_SHARE) + 2 * self.reference_misplaced
        windows, references = self.output.windows, self.reference.windows
        model = self.reference.source == "model"
        excesses = {
            "misplaced windows": float(self.misplaced_windows.mean()) / most,
            "worst neighborhood": neighborhood_excess(windows, references, self.neighborhood_limit, model),
            "bent": scatter_excess(windows, references) if model else 0.0,
            "structure": (1 - self.structure) / (1 - limits.STRUCTURE),
            "tiles elsewhere": elsewhere_excess(self.output.tiles, self._reference_tiles),
            "courses": float(self.course_excess.max(initial=0.0)),
            "single tiles": float(self.tile_excess.max(initial=0.0)),
        }
        return excesses if model else {**excesses, "mean tile": self._mean_tile_excess}

    @property
    def _mean_tile_excess(self) -> float:
        """Ratio of the loss of the mean tile to its limit."""
        usual = min(self.reference.tile_fit, 1.0)
        return (usual - self.tile_fit) / (usual * (1 - limits.TILE_FIT)) if usual > 0 else 0.0

    @property
    def excess(self) -> float:
        """The largest ratio of a fault to its limit."""
        return max(self.excesses.values())

    @property
    def faults(self) -> tuple[str, ...]:
        """A sentence for each fault beyond its limit; empty if there is none."""
        sentences = self.describe_faults()
        return tuple(sentences[name] for name in self._decisive if self.excesses[name] > 1)

    def describe_faults(self) -> dict[str, str]:
        """Return a sentence for each fault, whether it is beyond its limit or not."""
        return {
            "misplaced windows": f"{self.misplaced_windows.mean():.0%} of the windows are out of place",
            "worst neighborhood": f"a neighborhood is off by {self.worst_neighborhood:.2f} s",
            "bent": "the content is bent",
            "structure": f"the structure is {self.structure:.2f} of the references'",
            "tiles elsewhere": "many tiles fit better elsewhere",
            "courses": "a course of tiles has slid",
            "single tiles": f"{len(self.bad_places)} tile(s) displaced or broken",
            "mean tile": f"the mean tile contains {max(self.tile_fit, 0):.0%} of the sample's pattern",
        }

    @property
    def _decisive(self) -> tuple[str, ...]:
        """The faults that count. Without a model those of tiles count only at a sufficient regular share.

        The windows of the sample must also lie in their places within the tolerance, because a tile counts as in place
        only within the tolerance. The mean tile counts only where windows cannot decide, see :attr:`gross`.
        """
        names = tuple(self.excesses)
        if self.reference.source == "model":
            return names
        tiles = ("tiles elsewhere", "courses", "single tiles")
        even = self.reference.consistent and self.limit <= TOLERANCE
        fine = even and self.reference.regular_share >= limits.LEAST_SHARE
        return tuple(name for name in names if name != "mean tile" and (fine or name not in tiles))

    @property
    def gross(self) -> bool:
        """Whether the output is lost although smaller faults could stay undetected.

        Most windows are misplaced, or, without a model, the mean tile of the output is not that of the sample.
        """
        misplaced = self.misplaced_windows.mean() if len(self.misplaced_windows) else 0.0
        if misplaced > limits.GROSS_SHARE + 2 * self.reference_misplaced:
            return True
        return self.reference.source == "sample" and self._mean_tile_excess > 1

    @cached_property
    def lack_of_power(self) -> str:
        """The reason why a fault could stay undetected; empty if it could not."""
        rows, columns = self.output.windows.grid
        if min(rows, columns) < limits.LEAST_WINDOWS:
            least = limits.LEAST_WINDOWS
            tiles = f"{self.reference.periodic.window_tiles:g}"
            return (
                f"the output holds {columns} x {rows} windows of {tiles} tiles, at least {least} x {least} are needed"
            )
        if self.reference.source == "sample":
            return self._lack_of_resolution
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
    def _lack_of_resolution(self) -> str:
        """The reason why, without a model, a displaced neighborhood could stay undetected; empty if it could not."""
        if not self.reference.windows:
            return "the sample is smaller than a window of 2 tiles"
        if self.resolution is None:
            return f"{self.reference_misplaced:.0%} of the windows of the sample lock onto a wrong place"
        if self.resolution > limits.LEAST_RESOLUTION:
            return (
                f"a neighborhood that is displaced by less than {self.resolution:.2f} s could stay undetected, because "
                f"windows of the sample are themselves off by up to {self.scatter:.2f} s"
            )
        return ""

    @property
    def lattice_doubtful(self) -> bool:
        """Whether the given lattice may be wrong because the sample has too little regularity."""
        return self.reference.source == "sample" and bool(self.lack_of_power)

    @property
    def preserved(self) -> bool | None:
        """The verdict: True, False, or None if no fault was found and none could have been detected."""
        model = self.reference.source == "model"
        if model and min(self.output.windows.grid) < limits.LEAST_WINDOWS:
            return None
        if self.lack_of_power:
            return False if self.gross else None
        if self.faults:
            return False
        return True if not model or self.reference.regular_share >= limits.SURE_SHARE else None

    @property
    def doubt(self) -> str:
        """The reason why the verdict is undecided, if it is."""
        share = self.reference.regular_share
        faint = f"a course that slid by 0.15 s could stay undetected at the regular share {share:.2f}"
        return self.lack_of_power or faint

    @property
    def geometry_score(self) -> float | None:
        """How far the displacements vary like those of fresh draws, in [0, 1]; None if the geometry does not vary."""
        return None

    def locate_in_output(self, points: Points) -> Points:
        """Return the places (x, y) px in the output of places in the measured image, which are the same here."""
        return points

    def map_to_output(self, values: NDArray[Any], shape: Shape) -> NDArray[Any]:
        """Return values of the pixels of the measured image at the pixels of the output, which are the same here."""
        return values

    @property
    def intact(self) -> bool | None:
        """The verdict on single tiles: True, False, or None if one bad tile could stay undetected."""
        if bool(self.bad.any()):
            return False
        undecided = self.lack_of_power or self.preserved is False or self.reference.regular_share < limits.INTACT_SHARE
        return None if undecided else True

    @cached_property
    def worst_neighborhood(self) -> float:
        """Largest median offset of 3 x 3 windows, in s."""
        return float(self.output.windows.neighborhoods().max(initial=0.0))

    @cached_property
    def bad_places(self) -> Points:
        """``(n, 2)``: middles (x, y) px of the bad tiles, worst first. Windows of one tile count once."""
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
        """Reason why output and reference cannot be compared; empty if they can."""
        if self.reference.regular_share < limits.NO_SHARE:
            return f"undecided: the lattice explains {self.reference.regular_share:.0%} of the sample's variance"
        draws = f"{self._reference_name} {'are' if self.reference.source == 'model' else 'is'}"
        for subject, images in (("output is", (self.output,)), (draws, self.references)):
            if not all(len(image.windows.corners) and image.tiles.whole.any() for image in images):
                return f"undecided: the {subject} smaller than a window of 2 tiles"
        return ""

    @property
    def _reference_name(self) -> str:
        return "fresh draws" if self.reference.source == "model" else "sample"


def compute_verdict(output: Image, reference: Reference) -> Verdict:
    """Return the verdict on an output.

    A drift that the uncertainty of the lattice allows is subtracted from all displacements.
    """
    prepared = reference.prepare_image(output)
    windows = register_windows(prepared, reference.periodic)
    drift = fit_drift(windows)
    allowed_drift = drift if reference.allows_drift(drift) else np.zeros((2, 2))
    aligned = windows.subtract_drift(allowed_drift)
    tiles = measure_tiles(prepared, reference.periodic, aligned.phase, allowed_drift)
    measurements = Measurements(output, prepared, reference.periodic, aligned, tiles)
    fit = 1.0
    if reference.source == "sample":
        fit = max(
            compare_mean_tiles(prepared, reference.periodic, reference.regular_share, one)
            for one in (allowed_drift, np.zeros((2, 2)))
        )
    return Verdict(reference, measurements, drift, fit_own_lattice(windows, drift), fit)
