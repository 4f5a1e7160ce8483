"""Where a cheat is none: the kinds of texture on which what a reference row does is right."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.runs.records import CellRecord

SIGN = "‡"
NO_CHEAT = "not a cheat here"
LEGEND = f"{NO_CHEAT}: on this kind of texture, what the reference does is right"
SHARES = "k/n: on k of n textures"
"""What :attr:`NoCheat.share` says."""


@dataclass(frozen=True)
class NoCheat:
    """On how many textures a reference row is no cheat.

    Parameters
    ----------
    n, of
        Textures of the kinds that it is right on, and all.
    """

    n: int
    of: int

    @property
    def words(self) -> str:
        """The count in words; empty where it is a cheat everywhere, or none at all."""
        if not self.n:
            return ""
        return NO_CHEAT if self.n == self.of else f"not a cheat on {self.n} of {self.of}"

    @property
    def share(self) -> str:
        """``"k/n"`` where it is a cheat on some textures and none on others; else empty."""
        return f"{self.n}/{self.of}" if 0 < self.n < self.of else ""

    @property
    def sign(self) -> str:
        """A space, the footnote's sign, and the share; empty where the words are."""
        return f" {SIGN} {self.share}".rstrip() if self.n else ""


NOWHERE = NoCheat(0, 0)
"""A cheat wherever it stands, or none at all."""


def is_right(record: CellRecord) -> bool | None:
    """Return whether what a reference row does is right on its texture, as its class declares by ``right_on``.

    None where there is nothing to say: for methods and references that are no cheats, for textures of unknown kind, and
    for a plugin that is not registered where the run is read.
    """
    kinds = _right_on(record.cell.method) if record.reference else frozenset()
    return record.kind in kinds if kinds and record.kind else None


def _right_on(method: str) -> frozenset[str]:
    try:
        return frozenset(getattr(plugins.find("synthesizers", method).cls, "right_on", ()))
    except BadInput:
        return frozenset()


def no_cheat(cells: pd.DataFrame) -> NoCheat:
    """Return on how many textures one column of the comparison is no cheat.

    Parameters
    ----------
    cells
        Its rows of :func:`~nrbench.reports.statistics.verdicts.frame`.
    """
    right = cells.groupby("texture")["right"].any()
    return NoCheat(int(right.sum()), len(right))


def sentence(record: CellRecord) -> str:
    """Return why a cell's reference row is no cheat on its texture; empty where it is one."""
    if not is_right(record):
        return ""
    kind = "a stochastic texture" if record.kind == "stochastic" else f"a texture of type {record.kind}"
    return f"{NO_CHEAT}: on {kind}, what this reference does is right"
