"""Deformation: how far content has moved off its lattice, how smoothly, and whether it folds over."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nrbench.plugins.forms import Column, Observation, Score, Value
from nrbench.tracking.tracker import Track

from .deformations.deformation_field import DeformationField, parts
from .deformations.tracks import LEAST_CORRELATION, Tracks, obstacle, tracks

LEAST_AMPLITUDE = 0.02
"""Amplitude, of s, below which displacements are mostly errors of the tracker: they have no length worth a name."""
Better = Literal["higher", "lower", "one", "none"]
Answer = float | str
"""A value, or why there is none."""


def _column(meaning: str, unit: str = "", better: Better = "none") -> Column:
    return Column(meaning, unit, (0.0, math.inf), better)


def _of(image: str) -> dict[str, Column]:
    """Return the columns that describe one image, and say which."""
    start = "" if image == "output" else f"{image}_"
    rms, far = "Root mean square displacement, its affine part left out, in the", "Distance at which displacements"
    return {
        f"{start}amplitude": _column(f"{rms} {image}, over the shortest lattice vector s.", "of s"),
        f"{start}amplitude_px": _column(f"{rms} {image}.", "px"),
        f"{start}length": _column(f"{far} correlate by 1/e in the {image}, over s.", "of s"),
        f"{start}length_px": _column(f"{far} correlate by 1/e in the {image}.", "px"),
        f"{start}folded": Column(f"Share of the {image}'s cells that are turned over.", better="none"),
    }


@dataclass(frozen=True)
class Deformation:
    """The displacement field of sample and output, followed through their pixels.

    The lattice is tracked tile by tile (:mod:`nrbench.tracking.tracker`): correlation with the mean tile under a window
    of 1.5 tiles, unwrapped by continuity, refined by windows down to 1 tile. Of the places p of all lattice points at
    least half a tile inside the image, the best regular fit (affine, least squares) is left out. *Amplitude* is the
    root of sum |p - fit|^2 / (n - 3); *length* the distance at which the autocorrelation of p - fit falls to 1/e
    (interpolated between steps of s / 2); *folded* the share of cells one of whose corners has a negative Jacobian.
    Sample and output are compared in parts of equal size (the smaller of both), since a fit to a small image takes
    more; a fresh draw, where there is one and the texture is deformed at all, over the whole.

    What it follows: smooth displacements with slopes up to about 0.3, to within 10 % up to an amplitude of 0.25 s
    (``benchmarks/deformation_validation.py``); above, tiles lock onto neighbors and the amplitude saturates. Parts of a
    tile that move by themselves count as their mean. A region moved by a whole lattice vector has not moved.
    """

    version: ClassVar[str] = "1"
    columns: ClassVar[Mapping[str, Column]] = {
        **_of("output"),
        **_of("sample"),
        "amplitude_ratio": _column(
            "Amplitude in the output over that in equally large parts of the sample.", "", "one"
        ),
        "length_ratio": _column("Correlation length in the output over that in the sample, parts alike.", "", "one"),
        "amplitude_to_fresh": _column("Amplitude in the output over that in a fresh draw.", "", "one"),
        "length_to_fresh": _column("Correlation length in the output over that in a fresh draw.", "", "one"),
        "tracked": Column("Share of the output where the texture's tile was found.", better="higher"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        found = tracks(observation)
        why = obstacle(found)
        if found is None or why:
            return _not_measured(self.columns, found, why)
        answers = {
            **_described(found.output, ""),
            **_described(found.sample, "sample_"),
            **_compared(found),
            **_against_fresh(found),
            "tracked": found.output.tracked(LEAST_CORRELATION),
        }
        values: dict[str, Value] = {name: None if isinstance(one, str) else one for name, one in answers.items()}
        reasons = {name: one for name, one in answers.items() if isinstance(one, str)}
        return Score(values, reasons, records={"points": len(found.output.numbers)})


def _not_measured(columns: Mapping[str, Column], found: Tracks | None, why: str) -> Score:
    """Return None and the reason for all columns but the share that was tracked, which may be the reason."""
    values: dict[str, Value] = dict.fromkeys(columns)
    if found is not None:
        values["tracked"] = found.output.tracked(LEAST_CORRELATION)
    return Score(values, {name: why for name, value in values.items() if value is None})


def _described(track: Track, start: str) -> dict[str, Answer]:
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


def _compared(found: Tracks) -> dict[str, Answer]:
    """Return amplitude and length in equally large parts of output and sample, the first over the second."""
    shapes = [track.image.shape[:2] for track in (found.output, found.sample)]
    shape = min(shapes[0][0], shapes[1][0]), min(shapes[0][1], shapes[1][1])
    both = [
        parts(DeformationField.of(track), one, shape)
        for track, one in zip((found.output, found.sample), shapes, strict=True)
    ]
    return _ratios(both[0], both[1], ("amplitude_ratio", "length_ratio"), "sample")


def _against_fresh(found: Tracks) -> dict[str, Answer]:
    names = ("amplitude_to_fresh", "length_to_fresh")
    if found.again is None:
        return dict.fromkeys(names, "not measured: the texture has no fresh draws")
    fields = [DeformationField.of(track) for track in (found.output, found.sample)]
    if max(field.amplitude for field in fields) < LEAST_AMPLITUDE * found.output.lattice.s:
        return dict.fromkeys(names, "not applicable: neither sample nor output is deformed")
    fresh = [DeformationField.of(track) for track in found.fresh]
    return _ratios([fields[0]], fresh, names, "fresh draws")


def _ratios(
    one: Sequence[DeformationField], other: Sequence[DeformationField], names: tuple[str, str], which: str
) -> dict[str, Answer]:
    """Return the ratio of amplitudes and of correlation lengths, each the root mean square or the median of several."""
    if not one or not other:
        return dict.fromkeys(names, f"not measured: no part of output and {which} alike holds enough tiles")
    sizes = [math.sqrt(float(np.mean([field.amplitude**2 for field in fields]))) for fields in (one, other)]
    if sizes[1] < LEAST_AMPLITUDE * other[0].lattice.s:
        return dict.fromkeys(names, f"not applicable: hardly any deformation in the {which}")
    lengths = [_typical(fields) for fields in (one, other)]
    if lengths[0] is None or lengths[1] is None:
        long = "not measured: displacements are too small, or correlate across the whole part"
        return {names[0]: sizes[0] / sizes[1], names[1]: long}
    return {names[0]: sizes[0] / sizes[1], names[1]: lengths[0] / lengths[1]}


def _typical(fields: Sequence[DeformationField]) -> float | None:
    lengths = [length for length in map(_length, fields) if isinstance(length, float)]
    return float(np.median(lengths)) if lengths else None
