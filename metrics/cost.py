"""What an output cost."""

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
    """Time and memory that the synthesis took, as the supervisor measured them.

    Reading the sample and writing the output do not count. Programs that the method starts and waits for do: their
    processor time is added to that of its own process (in steps of 10 ms), and of its memory and theirs the larger peak
    is taken; theirs is looked at ten times a second, so that of a program which ends sooner is not seen.
    """

    version: ClassVar[str] = "3"
    columns: ClassVar[Mapping[str, Column]] = {
        "seconds": _column("Wall time of the synthesis, with the detection that the method did itself.", "s"),
        "cpu_seconds": _column(
            "Processor time during the synthesis, all threads, programs that the method waits for included.", "s"
        ),
        "detection_seconds": _column(
            "Wall time spent in finding the lattice, by the method or by the detector that the lattice comes from.", "s"
        ),
        "peak_mib": _column(
            "Peak memory above that of the idle worker; of programs that the method starts, where it is more.", "MiB"
        ),
        "px_per_second": _column("Output pixels for each second of wall time.", "px/s", "higher"),
        "reliable": Column("No other cell ran at the same time, so the times are comparable."),
    }

    def score(self, observation: Observation) -> Score:
        """Return what was measured; None and the reason for the rest."""
        height, width = observation.output.shape[:2]
        seconds, cost = observation.seconds, observation.cost
        values: dict[str, Value] = {name: cost.get(name) for name in ("cpu_seconds", "detection_seconds", "peak_mib")}
        values["seconds"] = seconds
        values["px_per_second"] = height * width / seconds if seconds else None
        values["reliable"] = None if seconds is None else not cost.get("side_by_side")
        reasons = {name: "not measured by whatever made this output" for name, value in values.items() if value is None}
        if seconds == 0:
            reasons["px_per_second"] = "not measured: the synthesis took less time than the clock shows"
        return Score({name: values[name] for name in self.columns}, reasons)
