"""Write what changed between an earlier run and this one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import ClassVar

from nrbench.errors import strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .markdown import escape_markdown
from .statistics.run_changes import HEADS, LEGEND, RunChanges, compare_runs


@dataclass(frozen=True)
class Changes:
    """What changed since another run: ``changes.md`` and ``changes.json``.

    For each method that both runs have, each score is compared on the textures that both runs have. Cells are paired by
    texture and draw. The table holds both means, the mean difference with its 95 % interval over textures, and whether
    the score is better, worse, the same, or moved within noise. ``nrbench compare`` prints the same table.

    Parameters
    ----------
    baseline
        The directory of the other run. Nothing is written without it.
    columns
        The scores; empty for the headlines, the share of preserved lattices and the seconds.
    """

    baseline: Path | None = None
    columns: tuple[str, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none without a baseline."""
        if self.baseline is None:
            return []
        changes = self.compare(run)
        texts = {"changes.md": self.markdown(changes), "changes.json": json.dumps(changes.as_dict(), indent=1) + "\n"}
        for name, text in texts.items():
            write_text(directory / name, text)
        return [directory / name for name in texts]

    def compare(self, run: Run) -> RunChanges:
        """Return the changes from the baseline to a run.

        Raises
        ------
        BadInput
            If the baseline is no run, or neither run has a score that was named.
        """
        baseline = Run(self.baseline or Path())
        _ = baseline.info
        return compare_runs(baseline, run, self.columns)

    def text(self, changes: RunChanges) -> str:
        """Return the changes as a plain table with aligned columns."""
        rows = [HEADS, *(change.cells for change in changes.changes)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        lines.insert(1, "─" * max(map(len, lines)))
        title = f"{changes.first.root} -> {changes.second.root}"
        return "\n".join([title, "", *lines, "", fill(LEGEND, 110), *_notes(changes)])

    def markdown(self, changes: RunChanges) -> str:
        """Return the changes as a Markdown table for a pull request."""
        rows = [HEADS, ["---"] * len(HEADS), *([*map(escape_markdown, change.cells)] for change in changes.changes)]
        table = [f"| {' | '.join(row)} |" for row in rows]
        title = f"**{escape_markdown(str(changes.first.root))} → {escape_markdown(str(changes.second.root))}**"
        notes = [f"- {escape_markdown(line)}" for line in _notes(changes)]
        return "\n".join([title, "", *table, "", LEGEND, *(["", *notes] if notes else [])]) + "\n"


def _notes(changes: RunChanges) -> Sequence[str]:
    return [strip_control(note) for note in changes.notes]
