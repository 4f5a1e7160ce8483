"""The lattice that a method used, against the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.lattice.comparison import LatticeError, lattice_error
from nrbench.plugins.forms import Column, FoundLattice, Observation, Score, Value


@dataclass(frozen=True)
class LatticeRecovery:
    """How well the method's lattice agrees with the true one; see :mod:`nrbench.lattice.comparison`.

    Where the lattice comes from a detector, ``found`` and ``confidence`` are what it answered. That there is none is an
    answer: not exact where the texture has a lattice, right where it has none.

    Parameters
    ----------
    tolerance
        The largest error of a generating vector, px, at which the lattice still counts as the same.
    """

    tolerance: float = 1.0

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "found": Column("The detector that the lattice comes from found one."),
        "confidence": Column("How sure that detector is of it."),
        "exact": Column("The method used the smallest lattice of the texture.", better="higher"),
        "index": Column(
            "True cells in a cell of the method's lattice: 1, k for a supercell, 1/k for a subcell.",
            range=(0.0, math.inf),
            better="one",
        ),
        "vector_error": Column("Larger error of the two generating vectors.", "px", (0.0, math.inf), "lower"),
        "angle": Column("Larger angle between generating vectors and true ones.", "deg", (0.0, 180.0), "lower"),
        "area_ratio": Column("Area of the method's cell over the true cell's.", "", (0.0, math.inf), "one"),
        "drift": Column(
            "How far the two lattices, matched at one corner of the output, are apart at the opposite corner.",
            "px",
            (0.0, math.inf),
            "lower",
        ),
    }

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < math.inf:
            raise BadInput(f"lattice_recovery: tolerance is {self.tolerance}; give a number of px above 0")

    def score(self, observation: Observation) -> Score:
        """Return the comparison; None where the truth has no lattice, or the method none that it was asked for."""
        answers, why = _answers(observation.detected)
        compared, why_not, records = self._compared(observation)
        return Score({**answers, **compared}, {**why, **why_not}, records=records)

    def _compared(self, observation: Observation) -> tuple[dict[str, Value], dict[str, str], dict[str, str]]:
        """Return values, reasons and records of the comparison with the truth."""
        truth = observation.truth.lattice if observation.truth else None
        used = observation.lattice_used
        if truth is None or used is None:
            reason = "the truth has no lattice" if truth is None else "the method used no lattice"
            missed = truth is not None and observation.detected is not None and observation.detected.lattice is None
            values: dict[str, Value] = {**dict.fromkeys(_COMPARED), **({"exact": False} if missed else {})}
            return values, {name: reason for name, value in values.items() if value is None}, {}
        height, width = observation.output.shape[:2]
        error = lattice_error(used, truth, (height, width), self.tolerance)
        reasons = {} if error.index is not None else {"index": "the lattice is wrong, not a multiple of the true one"}
        return _values(error), reasons, {"class": error.label}


_COMPARED = tuple(name for name in LatticeRecovery.columns if name not in ("found", "confidence"))


def _answers(detected: FoundLattice | None) -> tuple[dict[str, Value], dict[str, str]]:
    """Return what a detector answered, and why there is nothing to say of it."""
    if detected is None:
        return {"found": None, "confidence": None}, dict.fromkeys(("found", "confidence"), "no detector was asked")
    values: dict[str, Value] = {"found": detected.lattice is not None, "confidence": detected.confidence}
    return values, {} if detected.confidence is not None else {"confidence": f"none found: {detected.reason}"}


def _values(error: LatticeError) -> dict[str, Value]:
    return {
        "exact": error.relation == "exact",
        "index": error.index,
        "vector_error": error.vector,
        "angle": error.angle,
        "area_ratio": error.area_ratio,
        "drift": error.drift,
    }
