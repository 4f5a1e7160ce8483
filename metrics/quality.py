"""Quality: one number for each output, by which methods are ranked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from nrbench.plugins.forms import Column, Observation, Score, Value

from .integrity import Integrity
from .randomness import Randomness
from .regularity import Regularity

LOST = 0.25
"""Factor of the regularity of an output that lost its lattice: if its second half is out of step, nobody calls it half
good."""


@dataclass(frozen=True)
class Quality:
    """The worst of three perils: regularity lost, integrity lost, randomness lost.

    Each peril has a score from 0 to 1. A fresh draw of the texture has 1 in all of them. They are measured by the
    metrics of the same names. The quality of an output is the smallest of its three scores, because a fault in one
    respect is not made good by another: wallpaper is perfectly regular, and a heap of bricks is perfectly random. The
    quality of a method is the mean over textures.

    *Regularity* is the share of tiles in place, ``regularity.score``. It counts a quarter if the verdict is that the
    lattice is lost. *Integrity* is ``integrity.score``, *randomness* is ``randomness.score``.

    Randomness is not measured where the lattice is lost. Integrity is not measured where elements cannot be told from
    composite ones, and randomness not where a texture does not vary. The quality is then the smallest of the others.
    It is None if the verdict on regularity is undecided, and on textures without a lattice.
    """

    version: ClassVar[str] = "5"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column("The worst of regularity, integrity and randomness; 1 as a fresh draw.", better="higher"),
        "regularity": Column("Share of tiles in place; a quarter of it if the lattice is lost.", better="higher"),
        "integrity": Column("Wholeness of the elements, see integrity.score.", better="higher"),
        "randomness": Column("Randomness kept, see randomness.score.", better="higher"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the quality and the three perils; the record ``worst`` names the smallest."""
        regularity = Regularity().score(observation)
        if regularity.values["preserved"] is None:
            return Score.missing(self.columns, regularity.reasons["preserved"])
        share = regularity.values["score"]
        if share is None:
            return Score.missing(self.columns, regularity.reasons["score"])
        perils: dict[str, Value] = {"regularity": share if regularity.values["preserved"] else LOST * share}
        reasons: dict[str, str] = {}
        for name, metric in (("integrity", Integrity()), ("randomness", Randomness())):
            score = metric.score(observation)
            perils[name] = score.values["score"]
            if perils[name] is None:
                reasons[name] = score.reasons["score"]
        known = {name: float(value) for name, value in perils.items() if value is not None}
        worst = min(known, key=lambda name: known[name])
        return Score({"score": known[worst], **perils}, reasons, records={"worst": worst})
