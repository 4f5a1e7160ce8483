"""Compute the points of the perils plane: regularity against randomness kept, one point a method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from .estimates import Estimate
from .format import format_interval, format_number
from .summary import Method, MethodSummary
from .verdicts import RANDOMNESS_KEPT, SCORE, BaselineValidity


@dataclass(frozen=True)
class PerilsPoint:
    """One method with its lattice source in the perils plane.

    Parameters
    ----------
    method
        The method.
    regularity
        Mean of ``regularity.score`` over textures: the horizontal coordinate.
    randomness
        Mean of :func:`~nrbench.reports.statistics.verdicts.randomness_kept` over textures: the vertical coordinate. It
        rests only on the textures whose lattice is not lost, because randomness is not scored on the others.
    validity
        On how many of the textures with a regularity score a baseline is valid.
    """

    method: Method
    regularity: Estimate
    randomness: Estimate
    validity: BaselineValidity

    @property
    def has_height(self) -> bool:
        """Whether the randomness is scored on any texture."""
        return self.randomness.value is not None

    @property
    def rests_on(self) -> str:
        """``" [k of n]"`` if the height rests on k of the n textures with a regularity score; empty if on all."""
        fewer = self.has_height and self.randomness.n < self.regularity.n
        return f" [{self.randomness.n} of {self.regularity.n}]" if fewer else ""

    @property
    def words(self) -> str:
        """The point in one sentence."""
        kept = f"{format_number(self.randomness.value)} {format_interval(self.randomness)}"
        height = f"{kept} (on {self.randomness.n} of {self.regularity.n})" if self.has_height else "not scored"
        across = f"{format_number(self.regularity.value)} {format_interval(self.regularity)}"
        valid = f"; {self.validity.words}" if self.validity.n else ""
        return f"{self.method.label}: regularity {across}, randomness kept {height}{valid}"


def perils_points(summaries: Sequence[MethodSummary]) -> list[PerilsPoint]:
    """Return the point of every method whose regularity is scored, in the order of the summaries."""
    points = [
        PerilsPoint(one.method, one.means[SCORE], one.means[RANDOMNESS_KEPT], one.validity_scored)
        for one in summaries
        if {SCORE, RANDOMNESS_KEPT} <= set(one.means)
    ]
    return [point for point in points if point.regularity.value is not None]


def perils_table(points: Sequence[PerilsPoint]) -> pd.DataFrame:
    """Return one row a point, with intervals and the number of textures that each coordinate rests on."""
    parts = ("value", "low", "high", "n", "of")
    names = [f"{axis}_{part}" for axis in ("regularity", "randomness_kept") for part in parts]
    rows = [
        [point.method.name, point.method.lattice_source, point.method.reference]
        + [getattr(estimate, part) for estimate in (point.regularity, point.randomness) for part in parts]
        for point in points
    ]
    return pd.DataFrame(rows, columns=["method", "lattice_source", "reference", *names])
