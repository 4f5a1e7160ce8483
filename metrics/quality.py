"""Quality: one number for each output, by which methods are ranked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from nrbench.plugins.forms import Column, Metric, Observation, Score, Value

from .appearance import Appearance
from .integrity import Integrity
from .perception.limits import TABLE, Limit
from .randomness import Randomness
from .regularity import Regularity

PERILS: Mapping[str, type[Metric]] = {
    "regularity": Regularity,
    "integrity": Integrity,
    "randomness": Randomness,
    "appearance": Appearance,
}
"""The four perils, each with the metric that measures it."""


@dataclass(frozen=True)
class Quality:
    """The worst of four perils: regularity, integrity, randomness and appearance lost.

    Each peril has a score from 0 to 1, measured by the metric of its name. A fresh draw of the texture has 1 in all of
    them. The quality of an output is the smallest of its four scores, because a fault in one respect is not made good
    by another: wallpaper is perfectly regular, and a heap of bricks is perfectly random. The quality of a method is the
    mean over textures.

    Where a peril cannot be measured, the quality is the smallest of the others, and ``complete`` is False: the quality
    is then an upper bound. A peril that does not apply is no gap: where tiles do not vary, or where their detail hides
    a joint, joined elements look whole. A quality of 0 is complete, too, because no other peril can lower it: where the
    lattice is lost, integrity and randomness are not measured. The quality is None if the score of regularity is, and
    on textures without a lattice.
    """

    version: ClassVar[str] = "8"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    limits: ClassVar[tuple[Limit, ...]] = tuple(TABLE)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column("The worst of the four perils; 1 as a fresh draw.", better="higher"),
        "complete": Column("Whether all perils were measured; if not, the score is an upper bound.", better="higher"),
        "regularity": Column("Tiles in place, see regularity.score.", better="higher"),
        "integrity": Column("Wholeness of the elements, see integrity.score.", better="higher"),
        "randomness": Column("Randomness kept, see randomness.score.", better="higher"),
        "appearance": Column("Color, light and detail kept, see appearance.score.", better="higher"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the quality and the four perils; the record ``worst`` names the smallest."""
        # Appearance first, before the residual of a large picture is held.
        scores = {name: PERILS[name]().score(observation) for name in sorted(PERILS)}
        perils: dict[str, Value] = {name: scores[name].values["score"] for name in PERILS}
        reasons = {name: scores[name].reasons["score"] for name, value in perils.items() if value is None}
        if perils["regularity"] is None:
            return Score.missing(self.columns, reasons["regularity"])
        known = {name: float(value) for name, value in perils.items() if value is not None}
        worst = min(known, key=lambda name: known[name])
        measured = all(reason.startswith("not applicable") for reason in reasons.values())
        complete = measured or known[worst] == 0
        values: dict[str, Value] = {"score": known[worst], "complete": complete, **perils}
        return Score(values, reasons, records={"worst": worst})
