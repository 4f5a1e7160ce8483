"""Deformation: amplitude, correlation length and folds of the displacements in sample and output."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from nrbench.imaging.convert import quantize
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import examine
from .judgment.texture_reference import FIRST_DRAW
from .registration.node_field import NodeField

LEAST_AMPLITUDE = 0.02
"""Amplitude, in units of s, below which displacements are mostly errors of measurement."""
_LARGEST = 320
"""Largest side of a fresh draw that is followed, px."""
_FLAT = 1e-7
"""Variance of a mean tile, of values in [0, 1], below which there is nothing to follow."""
LEAST_FOUND = 0.5
"""Share of a picture in which the texture must be found."""
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
    """Displacements in sample and output, measured in their pixels.

    The lattice is followed through both (:func:`~.registration.node_field.follow_lattice`). Let p be the places of
    all lattice points, and of points between them, and fit their best regular fit (affine, least squares). The
    *amplitude* is the root of sum |p - fit|^2 / (n - 3). The *length* is the distance at which the autocorrelation of p
    - fit falls to 1/e. *Folded* is the share of the cells between four neighbors with a negative Jacobian at one of
    their corners. Sample and output are compared in parts of equal size (the smaller of both), since an affine fit
    removes more from a small image. If the texture is deformed at all and has fresh draws, the whole output is also
    compared with one.

    Parts of a tile that move independently count by their mean. A region that is displaced by a whole lattice vector
    does not count as displaced.
    """

    version: ClassVar[str] = "2"
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
        lattice = examine(observation).known_lattice.lattice
        if lattice is None:
            return Score.missing(self.columns, examine(observation).known_lattice.reason)
        if float(fold(observation.sample, lattice).values.var((0, 1)).sum()) < _FLAT:
            return Score.missing(self.columns, "not applicable: the mean tile is flat")
        output, sample = (NodeField.of(image, lattice) for image in (observation.output, observation.sample))
        tracked = {"tracked": output.covered if output is not None else 0.0}
        obstacle = _find_obstacle(output, "output") or _find_obstacle(sample, "sample")
        if output is None or sample is None or obstacle:
            return Score({**dict.fromkeys(self.columns), **tracked}, dict.fromkeys([*self.columns][:-1], obstacle))
        answers = {
            **_describe(output, ""),
            **_describe(sample, "sample_"),
            **_compare_parts(output, sample),
            **_compare_fresh(output, sample, observation, lattice),
            **tracked,
        }
        values: dict[str, Value] = {name: None if isinstance(one, str) else one for name, one in answers.items()}
        reasons = {name: one for name, one in answers.items() if isinstance(one, str)}
        return Score(values, reasons, records={"points": int(output.known.sum())})


def _find_obstacle(field: NodeField | None, name: str) -> str:
    """Return why nothing can be measured in an image; empty if something can."""
    share = 0.0 if field is None else field.covered
    return "" if share >= LEAST_FOUND else f"not measured: the tile was found in only {share:.0%} of the {name}"


def _describe(field: NodeField, start: str) -> dict[str, Answer]:
    """Return amplitude, correlation length and folded cells of one image."""
    length, folded = _length(field), field.folded
    return {
        f"{start}amplitude": field.amplitude / field.s,
        f"{start}amplitude_px": field.amplitude,
        f"{start}length": length / field.s if isinstance(length, float) else length,
        f"{start}length_px": length,
        f"{start}folded": folded if folded is not None else "not measured: no whole cell was found",
    }


def _length(field: NodeField) -> Answer:
    if field.amplitude < LEAST_AMPLITUDE * field.s:
        return f"not applicable: displacements of less than {LEAST_AMPLITUDE:g} s are mostly errors of measurement"
    length = field.correlation_length
    return length if length is not None else "not measured: displacements correlate across the whole image"


def _compare_parts(output: NodeField, sample: NodeField) -> dict[str, Answer]:
    """Return amplitude and length of the output over those of the sample, both in parts of equal size."""
    shape = min(output.extent[0], sample.extent[0]), min(output.extent[1], sample.extent[1])
    return _ratios(output.parts(shape), sample.parts(shape), ("amplitude_ratio", "length_ratio"), "sample")


def _compare_fresh(
    output: NodeField, sample: NodeField, observation: Observation, lattice: Lattice
) -> dict[str, Answer]:
    names = ("amplitude_to_fresh", "length_to_fresh")
    if observation.again is None:
        return dict.fromkeys(names, "not measured: the texture has no fresh draws")
    if max(output.amplitude, sample.amplitude) < LEAST_AMPLITUDE * output.s:
        return dict.fromkeys(names, "not applicable: neither sample nor output is deformed")
    height, width = (min(side, _LARGEST) for side in observation.output.shape[:2])
    draw = observation.again((height, width), FIRST_DRAW)
    fresh = None if draw is None else NodeField.of(quantize(draw.image), lattice)
    if fresh is None:
        return dict.fromkeys(names, "not measured: the lattice cannot be followed through a fresh draw")
    return _ratios([output], [fresh], names, "fresh draws")


def _ratios(
    one: Sequence[NodeField], other: Sequence[NodeField], names: tuple[str, str], other_name: str
) -> dict[str, Answer]:
    """Return the ratio of the root mean square amplitudes, and that of the median correlation lengths."""
    sizes = [math.sqrt(float(np.mean([field.amplitude**2 for field in fields]))) for fields in (one, other)]
    if sizes[1] < LEAST_AMPLITUDE * other[0].s:
        return dict.fromkeys(names, f"not applicable: hardly any deformation in the {other_name}")
    lengths = [[value for value in map(_length, fields) if isinstance(value, float)] for fields in (one, other)]
    if not all(lengths):
        reason = "not measured: displacements are too small, or correlate across the whole part"
        return {names[0]: sizes[0] / sizes[1], names[1]: reason}
    return {names[0]: sizes[0] / sizes[1], names[1]: float(np.median(lengths[0])) / float(np.median(lengths[1]))}
