"""The reference that calibrates all scores: a fresh draw of the same texture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nrbench.plugins.forms import Refused, Synthesis, Task


@dataclass(frozen=True)
class Oracle:
    """A fresh draw of the sample's own texture model at the output's size: the reference of all scores.

    For a photograph it is another region, which does not touch the sample.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the first fresh draw.

        Raises
        ------
        Refused
            When the texture's model is not known, or the photograph holds no such region.
        """
        if task.again is None:
            raise Refused("no fresh draws of this texture: neither its model nor the rest of its picture is known")
        fresh = task.again(task.shape, 0)
        if fresh is None:
            height, width = task.shape
            raise Refused(f"the picture has no room for a region of {width}x{height} px that the sample does not touch")
        return Synthesis(fresh.image)
