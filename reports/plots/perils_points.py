"""The point of each method in the perils plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..statistics.estimates import Estimate
from ..statistics.format import format_interval, format_number
from ..statistics.summaries import Method, MethodSummary
from ..statistics.verdicts import RANDOMNESS, STRUCTURE, BaselineValidity


@dataclass(frozen=True)
class PerilsPoint:
    """One method with its lattice source in the perils plane.

    Parameters
    ----------
    method
        The method.
    structure
        Mean over textures of the smallest of ``quality.regularity``, ``quality.integrity`` and
        ``quality.appearance``: the horizontal coordinate.
    randomness
        Mean of ``quality.randomness`` over textures: the vertical coordinate. It rests only on the textures on which
        randomness is scored. It is not scored where the lattice is lost.
    validity
        On how many of the textures with a quality a baseline is valid.
    """

    method: Method
    structure: Estimate
    randomness: Estimate
    validity: BaselineValidity

    @property
    def has_height(self) -> bool:
        """Whether the randomness is scored on any texture."""
        return self.randomness.value is not None

    @property
    def rests_on(self) -> str:
        """``" [k of n]"`` if randomness is scored on k of the n textures with a quality; empty if on all."""
        fewer = self.has_height and self.randomness.n < self.structure.n
        return f" [{self.randomness.n} of {self.structure.n}]" if fewer else ""

    @property
    def words(self) -> str:
        """The point in one sentence."""
        randomness = f"{format_number(self.randomness.value)} {format_interval(self.randomness)}"
        height = f"{randomness} (on {self.randomness.n} of {self.structure.n})" if self.has_height else "not scored"
        across = f"{format_number(self.structure.value)} {format_interval(self.structure)}"
        valid = f"; {self.validity.words}" if self.validity.n else ""
        return f"{self.method.label}: in place, whole and alike {across}, randomness {height}{valid}"


def perils_points(summaries: Sequence[MethodSummary]) -> list[PerilsPoint]:
    """Return the point of every method that has a quality, in the order of the summaries."""
    points = [
        PerilsPoint(one.method, one.means[STRUCTURE], one.means[RANDOMNESS], one.validity_scored)
        for one in summaries
        if STRUCTURE in one.means
    ]
    return [point for point in points if point.structure.value is not None]
