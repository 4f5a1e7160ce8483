"""The perils plane as points: regularity kept against randomness kept, one a method, references as its corners."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from ..page.format import interval, number
from .baselines import NOWHERE, NoCheat
from .randomness_kept import KEPT
from .statistics import Estimate
from .summary import Head, Summary
from .verdicts import SCORE, column_label


@dataclass(frozen=True)
class Place:
    """One method with its lattice source in the plane.

    Parameters
    ----------
    head
        Which column of the comparison.
    regularity
        Mean of ``regularity.score`` over textures, with its interval: the horizontal place.
    randomness
        Mean of :func:`~nrbench.reports.statistics.randomness_kept.kept`: the vertical place. It rests on those textures only on which the
        randomness is scored, which it is not where regularity is lost; without value where there is none.
    no_cheat
        On how many of the textures that it rests on a reference is no cheat.
    """

    head: Head
    regularity: Estimate
    randomness: Estimate
    no_cheat: NoCheat = NOWHERE

    @property
    def known(self) -> bool:
        """Whether the point has a height."""
        return self.randomness.value is not None

    @property
    def words(self) -> str:
        """The place in one sentence."""
        height = f"{number(self.randomness.value)} {interval(self.randomness)}" if self.known else "not scored"
        basis = f" (on {self.randomness.n} of {self.regularity.n})" if self.known else ""
        across = f"{number(self.regularity.value)} {interval(self.regularity)}"
        right = f"; {self.no_cheat.words}" if self.no_cheat.n else ""
        return f"{self.head.label}: regularity {across}, randomness kept {height}{basis}{right}"


def places(summaries: Sequence[Summary]) -> list[Place]:
    """Return the places of every column whose regularity is scored, methods first."""
    found = [
        Place(one.head, one.means[SCORE], one.means[KEPT], one.no_cheat_scored)
        for one in summaries
        if {SCORE, KEPT} <= set(one.means)
    ]
    return [place for place in found if place.regularity.value is not None]


def partly(place: Place) -> str:
    """Return on how many textures a height rests, where that is not all of them; else nothing."""
    fewer = place.known and place.randomness.n < place.regularity.n
    return f" [{place.randomness.n} of {place.regularity.n}]" if fewer else ""


def caption(group: Sequence[Place]) -> str:
    """Return what stands beside the points of one method: name, lattice sources, what its height rests on, no cheat."""
    sources = ", ".join(place.head.lattice_source for place in group)
    return column_label(group[0].head.method, sources) + partly(group[0]) + group[0].no_cheat.sign


def wrapped(text: str, most: int = 24) -> str:
    """Return a caption in lines of ``most`` characters, broken between parameters, sources and counts only."""
    lines = [""]
    for part in re.split(r"(?<=[:,])(?! )|(?<= )(?=[(\[n])", text):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > most:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip() for line in lines)


def perils_table(found: Sequence[Place]) -> pd.DataFrame:
    """Return one row a place, with intervals and how many textures each number rests on."""
    parts = ("value", "low", "high", "n", "of")
    names = [f"{axis}_{part}" for axis in ("regularity", "randomness_kept") for part in parts]
    rows = [
        [place.head.method, place.head.lattice_source, place.head.reference]
        + [getattr(estimate, part) for estimate in (place.regularity, place.randomness) for part in parts]
        for place in found
    ]
    return pd.DataFrame(rows, columns=["method", "lattice_source", "reference", *names])
