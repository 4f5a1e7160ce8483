"""Plot the perils plane and the quality by level as vector graphics for a paper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .page.plots import plot_cost, plot_heat_map, plot_levels, plot_perils_plane, plot_ranks, timed_methods
from .statistics.expectations import compare_levels
from .statistics.method_comparison import ComparisonOptions
from .statistics.summaries import perils_points


@dataclass(frozen=True)
class PerilsPlane(ComparisonOptions):
    """The perils plane, and where each method breaks, as SVG and PDF.

    ``perils.svg`` and ``perils.pdf`` hold the perils plane, with one point for each method. The horizontal axis says
    whether elements are in place, whole and alike: the smallest of ``quality.regularity``, ``quality.integrity`` and
    ``quality.appearance``. The vertical axis is ``quality.randomness``. Both are computed output by output and then
    averaged over textures. A fresh draw of the texture lies at (1, 1), wallpaper at (1, 0). Bars are 95 % intervals.
    Gray lines are contours of equal quality. Reference methods have diamonds and no rank.

    Randomness is not scored where the lattice is lost. A method that loses every lattice has an open sign below the
    plane, and one whose quality is an upper bound an open sign in its color. ``[k of n]`` behind a name says that the
    height rests on k of n textures. A double dagger marks a baseline that is valid on some of the textures.

    ``levels.svg`` and ``levels.pdf`` show the quality of each method by the level of a difficulty, with one panel for
    each difficulty. They are written if the suite has textures at two levels or more of one departure.

    ``ranks.svg`` and ``ranks.pdf`` show mean qualities, with bars over methods that do not differ, from 6 textures up
    and with tests;
    ``cost.*`` shows quality against time, ``heat-map.*`` the quality of every method on every texture.

    Parameters
    ----------
    width
        Width in inches, from 3 to 12; the text keeps its size.
    """

    width: float = 5.5

    version: ClassVar[str] = "3"

    def __post_init__(self) -> None:
        if not 3 <= self.width <= 12:
            raise BadInput(f"report perils: width is {self.width:g}; give 3 to 12 inches")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none if no method has a quality."""
        comparison = self.comparison(run)
        points, panels = perils_points(comparison.summaries), compare_levels(run, comparison)
        files: dict[str, bytes] = {}
        kinds = ("svg", "pdf")
        if points:
            files |= plot_perils_plane.files("perils", kinds, points, self.width)
        if panels:
            files |= plot_levels.files("levels", kinds, panels, self.width)
        if comparison.tests:
            files |= plot_ranks.files("ranks", kinds, comparison, self.width)
        if timed := timed_methods(comparison):
            files |= plot_cost.files("cost", kinds, timed, self.width)
        if comparison.has_ranking:
            files |= plot_heat_map.files("heat-map", kinds, comparison)
        return write_files(directory, files)

    def plot(self, run: Run, kind: str) -> bytes:
        """Return the perils plane as a file of a kind: ``svg``, ``pdf`` or ``png``.

        Raises
        ------
        BadInput
            If no method of the run has a quality.
        """
        points = perils_points(self.comparison(run).summaries)
        if not points:
            raise BadInput(f"{run.root}: no method has a quality, so there is nothing to plot")
        return plot_perils_plane(kind, points, self.width)
