"""Write a static site that compares runs, such as those of several people."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .statistics.format import pluralize, render_page
from .statistics.method_comparison import compare_methods
from .statistics.summaries import MethodSummary
from .statistics.verdicts import QUALITY, tabulate_cells


@dataclass(frozen=True)
class SiteRow:
    """A method in one run, as a row of the site.

    Parameters
    ----------
    run, title
        The run, and its name on the site.
    summary
        The method in numbers.
    version
        The version of the method.
    textures
        Mean quality by texture; None where it has no value.
    """

    run: Run
    title: str
    summary: MethodSummary
    version: str
    textures: dict[str, float | None]

    @property
    def page(self) -> str:
        """The file of the method's page. All parameters and lattice sources of a method share a page."""
        return f"{re.sub(r'[^0-9A-Za-z._-]', '_', self.method)}.html"

    @property
    def method(self) -> str:
        """The method without its parameters."""
        return self.summary.method.plugin

    @property
    def suite(self) -> str:
        """The suite, its size and the results version."""
        suite = self.run.info.get("suite", {})
        results = self.run.info.get("results_version", "unknown")
        count = len({record.texture for record in self.run.cells})
        name = f"{suite.get('name', 'unknown')} {suite.get('version', '')}".rstrip()
        return f"{name}, {pluralize(count, 'texture')}, results version {results}"

    @property
    def group(self) -> tuple[str, ...]:
        """What other rows must have, too, for their numbers to be comparable: the suite and its textures."""
        textures = {f"{cell.texture} {cell.cell.recipe.shape} {cell.cell.shape}" for cell in self.run.cells}
        return (self.suite, *sorted(textures))

    @property
    def machine(self) -> str:
        """The processor and the number of cores."""
        machine = self.run.info.get("machine") or {}
        return f"{machine.get('processor', 'unknown')}, {machine.get('cores', '?')} cores"

    @property
    def fresh(self) -> bool:
        """Whether the system drew the seed."""
        return self.run.seed_text.startswith("fresh")

    @property
    def quality(self) -> float:
        """The mean quality, by which rows are sorted; below zero if it is not known."""
        estimate = self.summary.means.get("quality")
        return -1.0 if estimate is None or estimate.value is None else estimate.value


@dataclass(frozen=True)
class RunSite:
    """A static site: a leaderboard of all methods of several runs, and a page for each method.

    Each row of the leaderboard is a method in one run, with its quality and the version, the seed and the machine of
    the run. Rows of fresh seeds are marked. Only rows of equal textures, sizes and results version are comparable; they
    share a table. ``nrbench site`` writes it.

    Parameters
    ----------
    runs
        The directories of the runs. Nothing is written without them.
    """

    runs: tuple[Path, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "site"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``index.html`` and a page for each method, and return their paths; none without other runs.

        Raises
        ------
        BadInput
            If a path is no run.
        """
        if not self.runs:
            return []
        roots = list(dict.fromkeys(root.resolve() for root in (run.root, *self.runs)))
        rows = [row for root, title in zip(roots, _titles(roots), strict=True) for row in _read_rows(Run(root), title)]
        if not rows:
            raise BadInput("the runs hold no cells; nothing can be compared")
        rows.sort(key=lambda row: -row.quality)
        written = [_write_page(directory / "index.html", "index", rows)]
        for page in sorted({row.page for row in rows}):
            own = [row for row in rows if row.page == page]
            written.append(_write_page(directory / page, own[0].method, own))
        return written


def _titles(roots: Sequence[Path]) -> list[str]:
    """Return short names of the runs: the last folder, with the one above where two are alike."""
    names = [root.name for root in roots]
    return [root.name if names.count(root.name) == 1 else "/".join(root.parts[-2:]) for root in roots]


def _read_rows(run: Run, title: str) -> list[SiteRow]:
    cells = tabulate_cells(run)
    scores = cells[QUALITY] if QUALITY in cells else pd.Series(np.nan, cells.index)
    cells["value"] = scores.where(cells["status"].eq("ok"), 0.0)
    means = {
        label: rows.groupby("texture", sort=False)["value"].mean() for label, rows in cells.groupby("label", sort=False)
    }
    versions = {record.method: record.cell.version for record in run.cells}
    return [
        SiteRow(
            run,
            title,
            one,
            versions.get(one.method.name, "unknown"),
            {str(texture): None if np.isnan(mean) else float(mean) for texture, mean in means[one.label].items()},
        )
        for one in compare_methods(run).summaries
    ]


def _write_page(path: Path, name: str, rows: Sequence[SiteRow]) -> Path:
    tables = [[row for row in rows if row.group == group] for group in sorted({row.group for row in rows})]
    write_text(path, render_page("site.html", {"name": name, "tables": tables, "layers": []}, {}))
    return path
