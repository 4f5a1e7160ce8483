"""Write the comparison as Markdown, for a README, an issue or a wiki."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .page.environment import make_environment
from .page.method_terms import list_patch_terms
from .statistics.expectations import compare_with_published
from .statistics.method_comparison import compare_methods
from .statistics.verdicts import count_reasons

_ACTIVE = re.compile(r"([\\`*_\[\]<>|~&@#]|:(?=//)|(?<=www)\.|^[-+=])")


@dataclass(frozen=True)
class MarkdownTables:
    """``comparison.md``: methods from the highest mean quality to the lowest, and textures by methods, as pipe tables.

    A further table says how methods that copy patches choose, place and join them (table 1 of the report of 2004). If
    the run has analogues of the report's figures, its tables 2 and 3 follow. Names and messages are escaped: nothing
    in them becomes markup or a link.

    Parameters
    ----------
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    tests: bool = True
    baseline: str = ""
    population: bool = False

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.md`` and return its path."""
        path = directory / "comparison.md"
        write_text(path, self.render(run))
        return [path]

    def render(self, run: Run) -> str:
        """Return the tables as text; every line ends in a newline."""
        template = make_environment({"escape_markdown": escape_markdown}).get_template("comparison.md")
        comparison = compare_methods(run, self.tests, self.baseline, self.population)
        published = compare_with_published(run, comparison)
        return template.render(
            comparison=comparison, reasons=count_reasons(run), patch_terms=list_patch_terms(run), published=published
        )


def escape_markdown(text: str) -> str:
    """Return text on one line in which nothing is markup."""
    return _ACTIVE.sub(r"\\\1", " ".join(strip_control(text).split()))
