"""Deformation: amplitude, correlation length and folds of the displacement fields of sample and output."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nrbench.plugins.forms import Column, Observation, Score, Value
from nrbench.tracking.tracker import Track

from .deformations.tracked_lattices import LEAST_CORRELATION, DeformationField, Tracks, track_images

LEAST_AMPLITUDE = 0.02
"""Amplitude, in units of s, below which displacements are mostly errors of the tracker."""
Answer = float | str
"""A value, or the reason why there is none."""


def _column(meaning: str, unit: str = "", better: Literal["one", "none"] = "none") -> Column:
    return Column(meaning, unit, (0.0, math.inf), better)


def _columns_of(image: str) -> dict[str, Column]:
    """Return the columns that describe the sample or the output."""
    start = "" if image == "output" else f"{image}_"
    rms, far = "Root mean square displacement, without its affine part, in the", "Distance at which displacements"
    return {
        f"{start}amplitude": _column(f"{rms} {image}, over the shortest lattice vector s.", "of s"),
        f"{start}amplitude_px": _column(f"{rms} {image}.", "px"),
        f"{start}length": _column(f"{far} correlate by 1/e in the {image}, over s.", "of s"),
        f"{start}length_px": _column(f"{far} correlate by 1/e in the {image}.", "px"),
        f"{start}folded": Column(f"Share of the {image}'s cells that are folded over."),
    }


@dataclass(frozen=True)
class DeformationAmplitude:
    """Displacement fields of sample and output, measured in their pixels.

    The lattice is tracked tile by tile (:mod:`nrbench.tracking.tracker`): the image is correlated with the mean tile
    under a window of 1.5 tiles, the displacements are unwrapped by continuity and refined by windows down to 1 tile.
    Let p be the places of all lattice points that lie at least half a tile inside the image, and fit their best regular
    fit (affine, least squares). The *amplitude* is the root of sum |p - fit|^2 / (n - 3). The *length* is the distance
    at which the autocorrelation of p - fit falls to 1/e, interpolated between steps of s / 2. *Folded* is the share of
    cells with a negative Jacobian at one of their corners. Sample and output are compared in parts of equal size (the
    smaller of both), since an affine fit removes more from a small image. If the texture is deformed at all and has
    fresh draws, the whole output is also compared with one of them.

    The tracker follows smooth displacements with slopes up to about 0.3, to within 10 % up to an amplitude of 0.25 s
    (see docs/measurements/validation.md). Above that tiles lock onto their neighbors and the amplitude saturates.
    Parts of a tile that move independently count by their mean. A region that is displaced by a whole lattice vector
    does not count as displaced.
    """

    version: ClassVar[str] = "1"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        **_columns_of("output"),
        **_columns_of("sample"),
        "amplitude_ratio": _column(
            "Amplitude in the output over that in equally large parts of the sample.", "", "one"
        ),
        "length_ratio": _column(
            "Correlation length in the output over that in equally large parts of the sample.", "", "one"
        ),
        "amplitude_to_fresh": _column("Amplitude in the output over that in a fresh draw.", "", "one"),
        "length_to_fresh": _column("Correlation length in the output over that in a fresh draw.", "", "one"),
        "tracked": Column("Share of the output in which the texture's tile was found.", better="higher"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        tracks = observation.shared(track_images)
        if isinstance(tracks, str):
            return Score.missing(self.columns, tracks)
        tracked = tracks.output.tracked_share(LEAST_CORRELATION)
        if tracks.obstacle:
            reasons = {name: tracks.obstacle for name in self.columns if name != "tracked"}
            return Score({**dict.fromkeys(self.columns), "tracked": tracked}, reasons)
        answers = {
            **_describe(tracks.output, ""),
            **_describe(tracks.sample, "sample_"),
            **_compare_parts(tracks),
            **_compare_fresh(tracks),
            "tracked": tracked,
        }
        values: dict[str, Value] = {name: None if isinstance(one, str) else one for name, one in answers.items()}
        reasons = {name: one for name, one in answers.items() if isinstance(one, str)}
        return Score(values, reasons, records={"points": len(tracks.output.numbers)})


def _describe(track: Track, start: str) -> dict[str, Answer]:
    """Return amplitude, correlation length and folded cells of one image."""
    field, s = DeformationField.of(track), track.lattice.s
    length, folded = _length(field), field.folded
    return {
        f"{start}amplitude": field.amplitude / s,
        f"{start}amplitude_px": field.amplitude,
        f"{start}length": length / s if isinstance(length, float) else length,
        f"{start}length_px": length,
        f"{start}folded": folded if folded is not None else "not measured: no whole cell was tracked",
    }


def _length(field: DeformationField) -> float | str:
    if field.amplitude < LEAST_AMPLITUDE * field.lattice.s:
        return f"not applicable: displacements of less than {LEAST_AMPLITUDE:g} s are mostly errors of the tracker"
    length = field.correlation_length
    return length if length is not None else "not measured: displacements correlate across the whole image"


def _compare_parts(tracks: Tracks) -> dict[str, Answer]:
    """Return amplitude and length of the output over those of the sample, both in parts of equal size."""
    both = tracks.output, tracks.sample
    (height, width), (other_height, other_width) = (track.image.shape[:2] for track in both)
    shape = min(height, other_height), min(width, other_width)
    output, sample = (DeformationField.of(track).parts(track.image.shape[:2], shape) for track in both)
    return _ratios(output, sample, ("amplitude_ratio", "length_ratio"), "sample")


def _compare_fresh(tracks: Tracks) -> dict[str, Answer]:
    names = ("amplitude_to_fresh", "length_to_fresh")
    if tracks.again is None:
        return dict.fromkeys(names, "not measured: the texture has no fresh draws")
    output, sample = (DeformationField.of(track) for track in (tracks.output, tracks.sample))
    if max(output.amplitude, sample.amplitude) < LEAST_AMPLITUDE * output.lattice.s:
        return dict.fromkeys(names, "not applicable: neither sample nor output is deformed")
    fresh = [DeformationField.of(track) for track in tracks.fresh]
    return _ratios([output], fresh, names, "fresh draws")


def _ratios(
    one: Sequence[DeformationField], other: Sequence[DeformationField], names: tuple[str, str], other_name: str
) -> dict[str, Answer]:
    """Return the ratio of the root mean square amplitudes, and that of the median correlation lengths."""
    if not one or not other:
        return dict.fromkeys(names, f"not measured: no part of output and {other_name} holds enough tiles")
    sizes = [math.sqrt(float(np.mean([field.amplitude**2 for field in fields]))) for fields in (one, other)]
    if sizes[1] < LEAST_AMPLITUDE * other[0].lattice.s:
        return dict.fromkeys(names, f"not applicable: hardly any deformation in the {other_name}")
    lengths = [[value for value in map(_length, fields) if isinstance(value, float)] for fields in (one, other)]
    if not all(lengths):
        reason = "not measured: displacements are too small, or correlate across the whole part"
        return {names[0]: sizes[0] / sizes[1], names[1]: reason}
    return {names[0]: sizes[0] / sizes[1], names[1]: float(np.median(lengths[0])) / float(np.median(lengths[1]))}
