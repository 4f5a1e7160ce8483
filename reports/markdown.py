"""Write the comparison as Markdown, for a README, an issue or a wiki."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .statistics.expectations import compare_with_published
from .statistics.format import make_environment
from .statistics.frames import (
    print_improvements,
    print_methods,
    print_parameters,
    print_patches,
    print_published,
    print_textures,
)
from .statistics.method_comparison import ComparisonOptions
from .statistics.verdicts import count_reasons

_ACTIVE = re.compile(r"([\\`*_\[\]<>|~&@#]|:(?=//)|(?<=www)\.|^[-+=])")


@dataclass(frozen=True)
class MarkdownTables(ComparisonOptions):
    """``comparison.md``: methods from the highest mean quality to the lowest, and textures by methods, as pipe tables.

    Below them stand all parameters of methods with a preset, a label or changed parameters, the methods as published
    beside the same methods by default, and how methods that copy patches choose, place and stitch them (table 1 of the
    report of 2004). If the run has analogues of figures of that report, its tables 2 and 3 follow, with the measured
    verdicts. Names and messages are escaped: nothing in them becomes markup or a link.
    """

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.md`` and return its path."""
        return write_files(directory, {"comparison.md": self.render(run)})

    def render(self, run: Run) -> str:
        """Return the tables as text; every line ends in a newline."""
        template = make_environment({"escape_markdown": escape_markdown}).get_template("comparison.md")
        comparison = self.comparison(run)
        published = compare_with_published(run, comparison)
        return template.render(
            comparison=comparison,
            methods=print_methods(comparison, comparison.summary_rows),
            textures=print_textures(comparison),
            more=[print_improvements(comparison), print_patches(run)],
            parameters=print_parameters(comparison).rows,
            published=published,
            published_tables=print_published(published) if published else [],
            reasons=count_reasons(run),
        )


def escape_markdown(text: str) -> str:
    """Return text on one line in which nothing is markup."""
    return _ACTIVE.sub(r"\\\1", " ".join(strip_control(text).split()))


def pipe_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of escaped texts."""
    lines = (heads, ["---"] * len(heads), *rows)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
