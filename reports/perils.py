"""Plot the perils plane and the quality by level as vector graphics for a paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_bytes

from .plots.method_plots import plot_cost, plot_heat_map, plot_levels, plot_perils_plane, plot_ranks, timed_methods
from .plots.perils_points import perils_points
from .statistics.levels import compare_levels
from .statistics.method_comparison import compare_methods


@dataclass(frozen=True)
class PerilsPlane:
    """The perils plane, and where each method breaks, as SVG and PDF.

    ``perils.svg`` and ``perils.pdf`` hold the perils plane, with one point for each method. The horizontal axis says
    whether elements are in place, whole and alike: the smallest of ``quality.regularity``, ``quality.integrity`` and
    ``quality.appearance``. The vertical axis is ``quality.randomness``. Both are computed output by output and then
    averaged over textures. A fresh draw of the texture lies at (1, 1), wallpaper at (1, 0). Bars are 95 % intervals.
    Gray lines are contours of equal quality. Reference methods have diamonds and no rank.

    Randomness is not scored where the lattice is lost. A method that loses every lattice has an open sign below the
    plane. ``[k of n]`` behind a name says that the height rests on k of n textures. A double dagger marks a baseline
    that is valid on some of the textures.

    ``levels.svg`` and ``levels.pdf`` show the quality of each method by the level of a difficulty, with one panel for
    each difficulty. They are written if the suite has textures at two levels or more of one departure.

    ``ranks.svg`` and ``ranks.pdf`` show mean qualities, with bars over methods that do not differ, from 6 textures up;
    ``cost.*`` shows quality against time, ``heat-map.*`` the quality of every method on every texture.

    Parameters
    ----------
    width
        Width in inches, from 3 to 12; the text keeps its size.
    tests
        Whether to test which methods differ. Without tests there are no ``ranks.*``.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    width: float = 5.5
    tests: bool = True
    population: bool = False

    version: ClassVar[str] = "2"
    folder: ClassVar[str] = "report"

    def __post_init__(self) -> None:
        if not 3 <= self.width <= 12:
            raise BadInput(f"report perils: width is {self.width:g}; give 3 to 12 inches")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none if no method has a quality."""
        comparison = compare_methods(run, self.tests, population=self.population)
        points, panels = perils_points(comparison.summaries), compare_levels(run, comparison)
        paths = []
        for kind in ("svg", "pdf"):
            contents = {"perils": plot_perils_plane(kind, points, self.width)} if points else {}
            if panels:
                contents["levels"] = plot_levels(kind, panels, self.width)
            if comparison.tests:
                contents["ranks"] = plot_ranks(kind, comparison, self.width)
            if timed := timed_methods(comparison):
                contents["cost"] = plot_cost(kind, timed, self.width)
            if comparison.has_ranking:
                contents["heat-map"] = plot_heat_map(kind, comparison)
            for name, content in contents.items():
                path = directory / f"{name}.{kind}"
                write_bytes(path, content)
                paths.append(path)
        return paths

    def render(self, run: Run, kind: str) -> bytes:
        """Return the perils plane as a file of a kind: ``svg``, ``pdf`` or ``png``.

        Raises
        ------
        BadInput
            If no method of the run has a quality.
        """
        points = perils_points(compare_methods(run).summaries)
        if not points:
            raise BadInput(f"{run.root}: no method has a quality, so there is nothing to plot")
        return plot_perils_plane(kind, points, self.width)
