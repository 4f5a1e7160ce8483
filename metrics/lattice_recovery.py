"""Compare the lattice that a method used with the true lattice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.lattice.relation import lattice_error
from nrbench.lattice.vertices import TOLERANCE, Vertex, displace_vertices, lay_vertices, match_vertices
from nrbench.plugins.forms import Column, FoundLattice, Observation, Score, Texture, Value


@dataclass(frozen=True)
class LatticeRecovery:
    """How well the lattice of the method agrees with the true one; see :mod:`nrbench.lattice.relation`.

    If the lattice comes from a detector, ``found`` and ``confidence`` are its answer. A detector that finds no lattice
    gives an answer too: ``exact`` is False if the texture has a lattice, and has no value if it has none. The vertices
    that it found in the sample are compared with the true ones (:func:`nrbench.lattice.vertices.match_vertices`): those
    of the model, bent as the sample is, or those that a person set in a photograph. A detector that does not follow a
    lattice gets the points of its lattice laid over the sample.

    Parameters
    ----------
    tolerance
        Largest error of a generating vector, px, at which two lattices count as the same.
    """

    tolerance: float = 1.0

    version: ClassVar[str] = "4"
    columns: ClassVar[Mapping[str, Column]] = {
        "found": Column("Whether the detector found a lattice."),
        "confidence": Column("Confidence of the detector in its lattice."),
        "exact": Column("Whether the method used the smallest lattice of the texture.", better="higher"),
        "index": Column(
            "True cells per cell of the method's lattice: 1, k for a supercell, 1/k for a subcell.",
            range=(0.0, math.inf),
            better="one",
        ),
        "vector_error": Column("Largest error of a generating vector.", "px", (0.0, math.inf), "lower"),
        "vector_error_in_s": Column("That error over the shortest true vector s.", "of s", (0.0, math.inf), "lower"),
        "angle": Column("Largest angle between a generating vector and the true one.", "deg", (0.0, 180.0), "lower"),
        "area_ratio": Column("Area of the method's cell over the true cell's.", "", (0.0, math.inf), "one"),
        "drift": Column(
            "Distance of the two lattices at one corner of the output if they coincide at the opposite one.",
            "px",
            (0.0, math.inf),
            "lower",
        ),
        "vertex_recall": Column("Share of the true vertices of the sample that the detector found.", better="higher"),
        "vertex_precision": Column("Share of the detector's vertices that are true.", better="higher"),
        "vertex_error": Column("Median distance of these from the true ones.", "of s", (0.0, TOLERANCE), "lower"),
    }

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < math.inf:
            raise BadInput(f"lattice_recovery: tolerance is {self.tolerance}; give a number of px above 0")

    def score(self, observation: Observation) -> Score:
        """Return the comparison with the truth; None if the truth or the method has no lattice."""
        detection, comparison = _score_detection(observation.detected), self._compare(observation)
        vertices = _score_vertices(observation)
        values = {**detection.values, **comparison.values, **vertices.values}
        return Score(
            values, {**detection.reasons, **comparison.reasons, **vertices.reasons}, records=comparison.records
        )

    def _compare(self, observation: Observation) -> Score:
        truth = observation.truth.lattice if observation.truth else None
        used = observation.lattice_used
        if truth is None or used is None:
            reason = "the truth has no lattice" if truth is None else "the method used no lattice"
            missed = truth is not None and observation.detected is not None and observation.detected.lattice is None
            values: dict[str, Value] = {**dict.fromkeys(_COMPARED), **({"exact": False} if missed else {})}
            return Score(values, {name: reason for name, value in values.items() if value is None})
        height, width = observation.output.shape[:2]
        error = lattice_error(used, truth, (height, width), self.tolerance)
        reasons = {} if error.index is not None else {"index": "the lattice is wrong, not a multiple of the true one"}
        measured = (error.relation == "exact", error.index, error.vector, error.vector / truth.s, error.angle)
        found = dict(zip(_COMPARED, (*measured, error.area_ratio, error.drift), strict=True))
        return Score(found, reasons, records={"class": error.label})


_VERTICES = tuple(name for name in LatticeRecovery.columns if name.startswith("vertex_"))
_COMPARED = tuple(name for name in LatticeRecovery.columns if name not in ("found", "confidence", *_VERTICES))


def true_vertices(truth: Texture) -> tuple[Vertex, ...]:
    """Return the vertices that a person set, else those of the model that drew a texture; none of other pictures."""
    if truth.vertices or truth.lattice is None or truth.kind is None:
        return truth.vertices
    if truth.displacement is None:
        return lay_vertices(truth.lattice, truth.image.shape[:2], truth.lattice.covering_radius)
    return displace_vertices(truth.lattice, truth.displacement)


def _score_vertices(observation: Observation) -> Score:
    detected, truth, shape = observation.detected, observation.truth, observation.sample.shape[:2]
    if detected is None:
        return Score(dict.fromkeys(_VERTICES), dict.fromkeys(_VERTICES, "no detector was used"))
    found = detected.vertices or (lay_vertices(detected.lattice, shape) if detected.lattice else ())
    match = match_vertices(found, true_vertices(truth) if truth else (), shape)
    values = dict(zip(_VERTICES, match, strict=True))
    return Score(values, {name: "no vertices can be compared" for name, value in values.items() if value is None})


def _score_detection(detected: FoundLattice | None) -> Score:
    names = ("found", "confidence")
    if detected is None:
        return Score(dict.fromkeys(names), dict.fromkeys(names, "no detector was used"))
    reasons = {} if detected.confidence is not None else {"confidence": f"none found: {detected.reason}"}
    return Score({"found": detected.lattice is not None, "confidence": detected.confidence}, reasons)
