"""The verdict on textures whose geometry varies (types II and III): follow the local lattice, and test its field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from nrbench.imaging.convert import Image, mean_channels, quantize
from nrbench.imaging.mean_tile import Tile, Values, fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again, Shape, Texture
from nrbench.tracking.tracker import MeanTile

from ..bending.covariance import Covariance, Variogram
from ..bending.field_tests import Faults, FieldTests, measure_faults
from ..bending.tracked_image import (
    StraightenedImage,
    TrackedImage,
    leave_unchanged,
    straighten,
    track_image,
    track_references,
)
from ..ncc.periodic import Periodic, tile_box
from . import limits
from .exponential_tail import ExponentialTail
from .reference import (
    DRAWS,
    FIRST_DRAW,
    KnownLattice,
    Reference,
    ReferenceImage,
    canonical_lattice,
    draw_fresh_texture,
    ideal_of,
)
from .tiles import breakage_excess, displacement_excess
from .verdict import Verdict, compute_verdict

_TILES_A_SIDE = 12
"""Number of tiles along each side of a fresh draw, from which the covariance of the displacements is estimated."""
_SIDES = (128, 320)
"""Smallest and largest side of a fresh draw, px."""
_TAIL, _LINE_OVERLAP, _PATCH_OVERLAP = 0.9, 6.0, 4.0
"""Quantile of the statistics of fresh draws where their tail begins, and number of overlapping tests that count as one:
lines in many directions divide the same nodes."""
_GAP = 3.0
"""Distance, px, up to which pixels of the output that no pixel of the straightened output comes from are filled."""


@dataclass(frozen=True)
class Bending:
    """What is known about the displacements of a texture.

    Parameters
    ----------
    tile
        The mean tile that is followed.
    references
        Tracked images without faults.
    covariance
        Covariance of their displacement fields.
    """

    tile: MeanTile
    references: tuple[TrackedImage, ...]
    covariance: Covariance

    @classmethod
    def of(cls, images: Sequence[Image], tile: MeanTile) -> Bending:
        """Track images without faults."""
        references, covariance = track_references(images, tile)
        return cls(tile, references, covariance)

    def track(self, image: Image) -> TrackedImage:
        """Track an image."""
        return track_image(image, self.tile, self.references[0].level, self.covariance)

    def straighten(self, tracked: TrackedImage) -> StraightenedImage:
        """Return an image without its smooth displacement.

        An image in most of which the tile was not found is returned as it is. Straightening by a displacement that has
        no meaning would leave so small a part of the image that nothing could be decided.
        """
        if tracked.reliable_share < (1 - limits.GROSS_SHARE) * (1 - self.usual_untracked):
            return leave_unchanged(tracked)
        return straighten(tracked)

    @cached_property
    def usual_untracked(self) -> float:
        """Largest share of the places of a reference at which the tile was not found."""
        return max(1 - one.reliable_share for one in self.references)

    @cached_property
    def tests(self) -> tuple[FieldTests, ...]:
        """Tests of the references."""
        return tuple(measure_faults(one.field, one.covariance) for one in self.references)

    @cached_property
    def line_tail(self) -> ExponentialTail:
        """Tail of the statistics of lines in the references."""
        return _fit_tail([one.lines for one in self.tests], _LINE_OVERLAP)

    @cached_property
    def patch_tail(self) -> ExponentialTail:
        """Tail of the statistics of patches in the references."""
        return _fit_tail([one.patches for one in self.tests], _PATCH_OVERLAP)

    @cached_property
    def variogram(self) -> Variogram:
        """Variogram of the references."""
        return Variogram.of([one.field for one in self.references])


def _fit_tail(faults: Sequence[Faults], overlap: float) -> ExponentialTail:
    values = np.concatenate([one.statistic for one in faults])
    return ExponentialTail.fit(values if len(values) else np.zeros(1), _TAIL, overlap)


@dataclass(frozen=True)
class BentReference(Reference):
    """A reference whose images were straightened.

    Parameters
    ----------
    bending
        What is known about the displacements.
    """

    bending: Bending | None = None

    @property
    def displacements(self) -> Bending:
        """What is known about the displacements."""
        assert self.bending is not None
        return self.bending

    def straighten(self, image: Image) -> tuple[Image, Lattice]:
        """Return an image without its smooth displacement, and the lattice of its tiles."""
        straight = self.displacements.straighten(self.displacements.track(image))
        x, y = straight.corner
        return straight.image, self.lattice.shifted((-float(x), -float(y)))


def bent_reference_from_model(truth: Texture, lattice: Lattice, again: Again) -> BentReference:
    """Return the reference of a texture whose model displaces its content.

    Fresh draws are tracked and straightened. The variance of each pixel from tile to tile, and the regular share, are
    those of the straightened draws. Without fresh draws :class:`~.reference.NoFreshDraw` is raised.
    """
    lattice = canonical_lattice(lattice)
    side = np.ceil(np.clip(_TILES_A_SIDE * tile_box(lattice), *_SIDES)).astype(int)
    shape = (int(side[1]), int(side[0]))
    draws = [draw_fresh_texture(again, shape, FIRST_DRAW + k) for k in range(DRAWS)]
    whole = ideal_of(draws[0])
    bending = Bending.of([quantize(draw.image) for draw in draws], MeanTile.of(whole, lattice.reduced()))
    straight = [bending.straighten(one) for one in bending.references]
    folded = [_fold_departures(one, whole, lattice) for one in straight]
    counts = np.sum([tile.counts for tile in folded], 0)
    values = np.sum([tile.values * tile.counts[..., np.newaxis] for tile in folded], 0)
    variance = Tile(np.asarray(values / np.maximum(counts, 1e-9)[..., np.newaxis], np.float32), counts, lattice)

    def ideal(wanted: Shape) -> Values:
        if wanted[0] <= shape[0] and wanted[1] <= shape[1]:
            return np.asarray(whole[: wanted[0], : wanted[1]])
        return ideal_of(draw_fresh_texture(again, wanted, FIRST_DRAW))

    periodic = Periodic(lattice, ideal, variance)
    regular = float(whole.var((0, 1), dtype=np.float64).mean())
    share = regular / max(regular + float(variance.values.mean()), 1e-12)
    images = tuple(ReferenceImage(one.image, periodic) for one in straight)
    return BentReference("model", periodic, images, share, KnownLattice(lattice, "model"), bending=bending)


def _fold_departures(straight: StraightenedImage, ideal: Values, lattice: Lattice) -> Tile:
    """Return the mean tile of the squared departures of a straightened image from the ideal image."""
    (x, y), (height, width) = straight.corner, straight.image.shape[:2]
    departures = (straight.image - ideal[y : y + height, x : x + width]) ** 2
    return fold(mean_channels(departures)[..., np.newaxis], lattice.shifted((-float(x), -float(y))))


@dataclass(frozen=True, kw_only=True)
class BentVerdict(Verdict):
    """The verdict on an output of a texture whose geometry varies.

    The lattice is tracked through the output, and the output is straightened: the smooth part of the displacements is
    removed. All tests of :class:`~.verdict.Verdict` are then made on the straightened output, beside straightened fresh
    draws. Tests of the displacements themselves are added.

    Parameters
    ----------
    reference
        The reference; its images are straightened.
    straightened
        The straightened output.
    tests
        Tests of the displacement field of the output.
    """

    reference: BentReference
    straightened: StraightenedImage
    tests: FieldTests

    @property
    def bending(self) -> Bending:
        """What is known about the displacements of the texture."""
        return self.reference.displacements

    @cached_property
    def line_excess(self) -> NDArray[np.float64]:
        """For each line, the ratio of the phase step along it to its limits; above 1 there is a step."""
        return _fault_excess(self.tests.lines, self.bending.line_tail, limits.PHASE_STEP)

    @cached_property
    def patch_excess(self) -> NDArray[np.float64]:
        """For each patch, the ratio of its displacement to its limits; above 1 it is displaced."""
        return _fault_excess(self.tests.patches, self.bending.patch_tail, limits.DISPLACED_PATCH)

    @cached_property
    def untracked_share(self) -> float:
        """Share of the places of the output at which the tile was not found."""
        return 1 - self.straightened.tracked.reliable_share

    @cached_property
    def variogram(self) -> Variogram:
        """Variogram of the output."""
        return Variogram.of([self.tests.field])

    @property
    def amplitude_ratio(self) -> float:
        """Amplitude of the displacements over that of fresh draws."""
        return self.variogram.amplitude / max(self.bending.variogram.amplitude, 1e-6)

    @property
    def roughness_ratio(self) -> float:
        """Roughness of the displacements over that of fresh draws; the inverse of their correlation lengths' ratio."""
        return self.variogram.roughness / max(self.bending.variogram.roughness, 1e-6)

    @property
    def amplitude_tolerance(self) -> float:
        """Tolerance of the logarithm of the ratio of amplitudes: four standard deviations over fresh draws."""
        area = self.bending.covariance.correlation_area
        chance = area / max(self.variogram.area, 1e-6) + area / max(self.bending.variogram.area, 1e-6)
        return max(limits.AMPLITUDE_DEVIATIONS * math.sqrt(chance) / 2, limits.LEAST_AMPLITUDE_TOLERANCE)

    @property
    def too_regular(self) -> bool:
        """Whether the displacements are smaller than those of fresh draws. This is lost randomness."""
        return math.log(max(self.amplitude_ratio, 1e-6)) < -self.amplitude_tolerance

    @cached_property
    def displacement_excess(self) -> NDArray[np.float64]:
        """For each tile, the ratio of its better fit elsewhere to the limits; above 1 the tile is displaced.

        Where the texture is strained, tiles fit worse, and several neighbors at once. Therefore the limit is higher
        than on textures of constant geometry.
        """
        excess = displacement_excess(self.output.tiles, self._reference_tiles, 0.0)
        return excess * (limits.FAINT_TILE_SURPRISAL / limits.BENT_TILE_SURPRISAL)

    @cached_property
    def breakage_excess(self) -> NDArray[np.float64]:
        """For each tile, the ratio of its bad fit in its place to the limits; above 1 the tile is broken."""
        return breakage_excess(self.output.tiles, self._reference_tiles, limits.BENT_TILE_SURPRISAL)

    @cached_property
    def in_displaced_region(self) -> NDArray[np.bool_]:
        """Which tiles lie in a displaced region.

        These are the tiles in a window that is out of place or in a course that has slid, those of a displaced patch,
        and those on the smaller side of a phase step: the rest of the output has another phase.
        """
        field, lines, patches = self.tests.field, self.tests.lines, self.tests.patches
        reliable = field.reliable.ravel()
        if not reliable.any():
            return np.ones(len(self.output.tiles.centers), np.bool_)
        flags = np.asarray(patches.sets[self.patch_excess > 1].any(0))
        if (self.line_excess > 1).any():
            beyond = lines.sets[lines.statistic.argmax()]
            flags = flags | (beyond if beyond.sum() <= reliable.sum() / 2 else ~beyond & reliable)
        places = field.places.reshape(-1, 2)[reliable] * self.straightened.tracked.s
        _, node = cKDTree(places).query(self.locate_in_output(self.output.tiles.centers))
        return np.asarray(super().in_displaced_region | flags[reliable][node])

    @cached_property
    def step_power(self) -> float:
        """Surprisal that a phase step of 0.25 s would have on most lines, over the limit; below 1 it may be missed."""
        power = self.tests.lines.power
        if not len(power):
            return 0.0
        expected = math.sqrt(2 * float(np.median(power)) * limits.SURE_STEP**2)
        low = max(expected - limits.STEP_DEVIATIONS, 0.0) ** 2 / 2
        values = np.append(np.zeros(len(power) - 1), low)
        return float(self.bending.line_tail.surprisal(values)[-1]) / limits.FIELD_SURPRISAL

    @cached_property
    def lack_of_power(self) -> str:
        """The reason why a fault could stay undetected; empty if it could not.

        Windows of the straightened references may be off where the texture is strained. This matters less than for
        textures of constant geometry, because phase steps are detected in the displacement field.
        """
        rows, columns = self.output.windows.grid
        least = limits.LEAST_WINDOWS
        if min(rows, columns) < least:
            return f"the output holds {columns} x {rows} windows of 2 tiles, at least {least} x {least} are needed"
        if self.reference.regular_share < limits.LEAST_SHARE:
            return f"the regular share {self.reference.regular_share:.2f} is under {limits.LEAST_SHARE:g}"
        if self.reference_misplaced > limits.BENT_REFERENCE_MISPLACED:
            return (
                f"{self.reference_misplaced:.0%} of the windows of the fresh draws are not in place once straightened"
            )
        return ""

    @property
    def preserved(self) -> bool | None:
        """The verdict: True, False, or None if no fault was found and a phase step of 0.25 s could stay undetected."""
        preserved = super().preserved
        return None if preserved and self.step_power < 1 else preserved

    @property
    def doubt(self) -> str:
        """The reason why the verdict is undecided."""
        if self.lack_of_power or self.step_power >= 1:
            return super().doubt
        return "a phase step of 0.25 s could stay undetected among displacements as large as those of the texture"

    @property
    def geometry_score(self) -> float:
        """How far the displacements vary like those of fresh draws, in [0, 1]; 1 within the tolerance.

        This is the smaller over the larger amplitude of output and fresh draws. An output whose displacements are
        smaller is too regular: it has lost randomness, not regularity.
        """
        ratio = math.log(max(self.amplitude_ratio, 1e-6))
        return math.exp(min(self.amplitude_tolerance - abs(ratio), 0.0))

    def locate_in_output(self, points: Points) -> Points:
        """Return the places (x, y) px in the output of places in the straightened output."""
        height, width = self.straightened.sources.shape[:2]
        x, y = np.clip(np.rint(points), 0, (width - 1, height - 1)).astype(np.intp).T
        return np.asarray(self.straightened.sources[y, x] + points - np.rint(points))

    def map_to_output(self, values: NDArray[Any], shape: Shape) -> NDArray[Any]:
        """Return values of the pixels of the straightened output at the pixels of the output; -1 beyond it."""
        sources = np.rint(self.straightened.sources).astype(np.intp)
        mapped = np.full(shape, -1, values.dtype)
        known = np.zeros(shape, np.bool_)
        mapped[sources[..., 1], sources[..., 0]] = values
        known[sources[..., 1], sources[..., 0]] = True
        # Pixels that no pixel of the straightened output comes from take the value of a neighbor.
        distance, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
        return np.where(distance <= _GAP, mapped[tuple(nearest)], mapped)

    @property
    def misplacement_ratio(self) -> float | None:
        """Amplitude of the displacements over that of fresh draws."""
        return self.amplitude_ratio

    def describe_displacements(self) -> dict[str, Any]:
        """Return the records on displacements."""
        return {
            "displacements": {
                "amplitude": self.variogram.amplitude,
                "amplitude_ratio": self.amplitude_ratio,
                "roughness_ratio": self.roughness_ratio,
                "tolerance": self.amplitude_tolerance,
                "too_regular": self.too_regular,
                "not_tracked": self.untracked_share,
                "power_for_a_step": self.step_power,
            }
        }

    def compare_limits(self) -> dict[str, float]:
        """Return the ratio of each fault to its limit; above 1 regularity is lost."""
        tolerance = self.amplitude_tolerance
        usual_faults = super().compare_limits()
        return {
            **{name: excess * limits.BENT_FACTORS.get(name, 1.0) for name, excess in usual_faults.items()},
            "phase step": float(self.line_excess.max(initial=0.0)),
            "patch": float(self.patch_excess.max(initial=0.0)),
            "not tracked": self.untracked_share / (limits.MISPLACED_SHARE + 2 * self.bending.usual_untracked),
            "amplitude": math.log(max(self.amplitude_ratio, 1e-6)) / tolerance,
            "roughness": math.log(max(self.roughness_ratio, 1e-6)) / tolerance if not self.too_regular else 0.0,
        }

    def describe_faults(self) -> dict[str, str]:
        """Return a sentence for each fault."""
        lines, patches = self.tests.lines, self.tests.patches
        return {
            **super().describe_faults(),
            "phase step": f"a phase step of {_most_likely_distance(lines):.2f} s",
            "patch": f"a patch is off by {_most_likely_distance(patches):.2f} s from its neighbors",
            "not tracked": f"the tile was not found at {self.untracked_share:.0%} of its places",
            "amplitude": f"displacements are {self.amplitude_ratio:.1f} times as large as in fresh draws",
            "roughness": f"displacements are {self.roughness_ratio:.1f} times as rough as in fresh draws",
        }


def _most_likely_distance(faults: Faults) -> float:
    """Return the displacement, in s, of the most likely fault."""
    return float(faults.distance[faults.statistic.argmax()]) if len(faults.distance) else 0.0


def _fault_excess(faults: Faults, tail: ExponentialTail, least: float) -> NDArray[np.float64]:
    """Return the ratio of each fault to its limits; above 1 it is more than chance, and larger than ``least`` s."""
    surprisal = tail.surprisal(faults.statistic) / limits.FIELD_SURPRISAL
    return np.minimum(surprisal, faults.distance / least)


def compute_bent_verdict(output: Image, reference: BentReference) -> BentVerdict:
    """Return the verdict on an output of a texture whose geometry varies."""
    bending = reference.displacements
    straightened = bending.straighten(bending.track(output))
    verdict = compute_verdict(straightened.image, reference)
    tests = measure_faults(straightened.tracked.field, straightened.tracked.covariance)
    return BentVerdict(
        reference=reference,
        output=verdict.output,
        drift=verdict.drift,
        own_lattice=verdict.own_lattice,
        straightened=straightened,
        tests=tests,
    )
