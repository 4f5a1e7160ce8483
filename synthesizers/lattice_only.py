"""A carrier: no synthesis, only the lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.plugins.forms import Synthesis, Task


@dataclass(frozen=True)
class LatticeOnly:
    """The sample itself, repeated or cut to the output's size: carries a lattice to the scores, and costs nothing.

    With it a comparison of detectors is an ordinary run: the detectors are the lattice axis, and what each answered
    stands in the cell. It judges nothing and finds nothing by itself; where a detector finds no lattice it goes on
    without one, because that is an answer too.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the sample, and the lattice that was handed over as the one used."""
        height, width = task.sample.shape[:2]
        rows, columns = np.arange(task.shape[0]) % height, np.arange(task.shape[1]) % width
        return Synthesis(task.sample[np.ix_(rows, columns)], task.lattice)
