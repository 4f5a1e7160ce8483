"""Cost: time and memory of the synthesis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from nrbench.plugins.forms import Column, Observation, Score, Value


def _column(meaning: str, unit: str, better: Literal["higher", "lower"] = "lower") -> Column:
    return Column(meaning, unit, (0.0, math.inf), better)


@dataclass(frozen=True)
class Cost:
    """Time and memory of the synthesis, measured by the supervisor.

    Reading the sample and writing the output do not count. Programs that the method starts and waits for do count:
    their processor time is added (in steps of 10 ms), and the larger of both memory peaks is reported. Their memory is
    measured ten times a second, so the peak of a program that ends sooner is missed.
    """

    version: ClassVar[str] = "4"
    columns: ClassVar[Mapping[str, Column]] = {
        "seconds": _column("Wall time of the synthesis, including the lattice detection by the method itself.", "s"),
        "cpu_seconds": _column(
            "Processor time of the synthesis: all threads, and programs that the method waits for.", "s"
        ),
        "detection_seconds": _column(
            "Wall time of lattice detection, by the method or by the detector of the lattice axis.", "s"
        ),
        "prepare_seconds": _column(
            "Wall time in which the method prepared for the sample, once for all its cells.", "s"
        ),
        "peak_mib": _column(
            "Peak memory above that of the idle worker, or of programs that the method starts if that is more.", "MiB"
        ),
        "px_per_second": _column("Output pixels per second of wall time.", "px/s", "higher"),
        "reliable": Column("Whether no other cell ran at the same time, so that times are comparable."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the measurements, and a reason for each one that is missing."""
        height, width = observation.output.shape[:2]
        seconds, cost = observation.seconds, observation.cost
        values: dict[str, Value] = {name: cost.get(name) for name in self.columns}
        values["seconds"] = seconds
        values["px_per_second"] = height * width / seconds if seconds else None
        values["reliable"] = None if seconds is None else not cost.get("side_by_side")
        reasons = {name: "not measured when this output was made" for name, value in values.items() if value is None}
        if "prepare_seconds" in reasons:
            reasons["prepare_seconds"] = "the method does not prepare for a sample"
        if seconds == 0:
            reasons["px_per_second"] = "not measured: the synthesis took less time than the clock resolves"
        return Score(values, reasons)
