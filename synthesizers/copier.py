"""A reference: ideal copying, with the help of the texture's model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nrbench.plugins.forms import Refused, Synthesis, Task


@dataclass(frozen=True)
class Copier:
    """Ideal copying: each element is drawn uniformly from the sample's equal places, and joined without error.

    The model of the texture cuts the elements (bricks, threads, tiles) out of the sample and joins the copies. No
    method has this help, so the row shows how far copying can go. Each copy keeps the color, the damage, the
    displacement and the grain of its element. Lighting and smooth warps belong to no element and are drawn afresh.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the first recomposition of the sample.

        Raises
        ------
        Refused
            When no model of the texture is known, or the model has no elements.
        """
        made = task.recompose(task.shape, 0) if task.recompose is not None else None
        if made is None:
            raise Refused("no model of this texture is known that could copy its elements one by one")
        return Synthesis(made.image)
