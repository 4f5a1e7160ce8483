"""No synthesis, only the lattice: compares lattice detectors in an ordinary run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.plugins.forms import Synthesis, Task


@dataclass(frozen=True)
class LatticeOnly:
    """The sample itself, repeated or cut to the output's size: passes a lattice on to the scores, without synthesis.

    With it a comparison of lattice detectors is an ordinary run: the detectors are the suite's lattice sources, and
    each cell holds the lattice that one of them found. Where a detector finds no lattice, the cell has none, since "no
    lattice" is a result too.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the sample, and the given lattice as the lattice used."""
        height, width = task.sample.shape[:2]
        rows, columns = np.arange(task.shape[0]) % height, np.arange(task.shape[1]) % width
        return Synthesis(task.sample[np.ix_(rows, columns)], task.lattice)
