"""What the baselines that keep the lattice share: every output pixel shows some equivalent point of the sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Kind, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from ..sampling.patches import resample


class LatticeBaseline:
    """A baseline that knows the lattice, and whose output pixels each show one point of the sample."""

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    finder: ClassVar[str] = "gncc"
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest pixel.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no tile to repeat")
        locate, note = self.find_tiles(task, lattice)
        image, source = resample(task, locate)
        return Synthesis(image, lattice, source, detection_seconds=seconds, note=note)

    def find_tiles(self, task: Task, lattice: Lattice) -> tuple[Callable[[Points], Points], str]:
        """Return a function from pixels (x, y) of the output to points of the sample, and a note."""
        raise NotImplementedError
