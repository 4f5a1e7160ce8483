"""Integrity: whether the output's tiles are whole, or joined of parts that do not belong together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from nrbench.plugins.forms import Column, Observation, Score

from .verdict.verdict import judge, obstacle
from .whole_elements.broken import BROKEN_SURPRISE, Broken, find_broken
from .whole_elements.broken_map import broken_map, worst_tiles

LEAST_POWER = 0.1
"""Share of joined tiles that would be counted below which nothing is said."""


@dataclass(frozen=True)
class Integrity:
    """How many tiles are broken: joined of parts that do not belong together, as when a cut runs through a brick.

    A brick has one color. A method that cuts and blends inside bricks makes two-tone ones, which lie in their places,
    so regularity does not see them. Windows of one cell are cut around the elements, where the output shows them, and
    their mean is taken out. What a whole tile can then show is learned from fresh draws, what a joined one shows from
    tiles of fresh draws that are joined along straight cuts; directions along which only the latter vary are the
    evidence (see :class:`~nrbench.metrics.whole_elements.composite_tiles.Joint`), each half of the fresh draws measured by directions of the
    other. A tile is broken where its evidence exceeds what chance explains, the number of tiles accounted for
    (:class:`~nrbench.metrics.verdict.exponential_tail.Tail`). The tail tells, not the median: most tiles of a copier are copies.

    What blur, uneven light and smooth bending do to a whole tile is no evidence
    (:func:`~nrbench.metrics.whole_elements.alterations.alterations`), and tiles that a strong blur has emptied, with those around
    them, are left out: these are faults of appearance and of regularity. A warp beyond 0.15 s, which tears tiles out of
    shape, and a seam that drives values to black or white may still break some.

    Where the lattice's origin lies in the tile does not matter: the windows are put where most of a window varies with
    its middle, and once more half a cell aside along both vectors. Tiles that regularity calls displaced are left out,
    since they lie over other elements. Of a photograph the sample itself takes the place of fresh draws.
    """

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "broken_share": Column(
            "Share of the tiles in place that are joined of parts that do not belong together.", better="lower"
        ),
        "broken_tiles": Column("Number of such tiles.", "tiles", (0.0, math.inf), "lower"),
        "evidence_p90": Column(
            "90th percentile of the tiles' evidence of being joined, over that of fresh draws.",
            "",
            (0.0, math.inf),
            "lower",
        ),
        "power": Column("Share of fresh tiles, joined along random straight cuts, that would be counted."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and two pictures: the ``broken`` tiles in their places, and the ``worst`` of them."""
        judgement = judge(observation)
        if judgement is None or obstacle(judgement):
            return Score.missing(self.columns, obstacle(judgement, observation))
        broken = find_broken(judgement, observation.sample, observation.again)
        if isinstance(broken, str):
            return Score.missing(self.columns, broken)
        pictures = {"broken": broken_map(observation.output, broken)}
        if broken.number:
            pictures["worst"] = worst_tiles(observation.output, broken)
        if broken.power < LEAST_POWER:
            reason = f"undecided: only {broken.power:.0%} of tiles joined of two would be told from whole ones"
            score = Score.missing(self.columns, reason)
            reasons = {name: reason for name in self.columns if name != "power"}
            return Score({**score.values, "power": broken.power}, reasons, records=_records(broken))
        return Score(_values(broken), {}, pictures, _records(broken))


def _values(broken: Broken) -> dict[str, float | bool | None]:
    return {
        "broken_share": broken.share,
        "broken_tiles": float(broken.number),
        "evidence_p90": broken.evidence_p90,
        "power": broken.power,
    }


def _records(broken: Broken) -> dict[str, Any]:
    return {
        "tiles": broken.tiles,
        "limit": BROKEN_SURPRISE,
        "places": [[float(x), float(y)] for x, y in broken.places],
        "surprises": [float(value) for value in broken.surprises],
        "anchor": [float(value) for value in broken.anchor],
    }
