"""Write the outputs of chosen methods on chosen textures as one figure for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_bytes

from .plots.picture_grid import plot_pictures
from .statistics.method_comparison import Comparison, ComparisonRow, compare_methods
from .statistics.selection import match_names
from .statistics.summaries import Method


@dataclass(frozen=True)
class PictureGrid:
    """Samples and outputs side by side, as ``figure.pdf`` and ``figure.png``.

    Each row is a texture: its sample, then the output of each method, in the same scale. Below each output stand the
    mark of the verdict and the quality. The corner of an output shows its worst place magnified, and a frame shows
    where it lies; outputs without a defect that the metrics located have none.

    Parameters
    ----------
    textures
        Names of textures, or patterns such as ``brick-*``; by default the four on which the shown methods differ
        most.
    methods
        Names of methods, names with the source of the lattice in parentheses, or patterns; by default the five best
        ranked ones.
    replicate
        Number of the draw.
    width
        Width in inches, from 2 to 12; 3.3 and 7 are the widths of a column and of a page in common styles.
    insets
        Whether to magnify the worst places.
    """

    textures: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    replicate: int = 0
    width: float = 7.0
    insets: bool = True

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def __post_init__(self) -> None:
        for name in ("textures", "methods"):
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))
        if not 2 <= self.width <= 12:
            raise BadInput(f"report figure: width is {self.width:g}; give 2 to 12 inches")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none if the run has no cells."""
        comparison = compare_methods(run)
        methods = choose_methods(comparison, self.methods)
        rows = choose_textures(comparison, self.textures, methods)
        if not rows or not methods:
            return []
        paths = []
        for kind in ("pdf", "png"):
            content = plot_pictures(kind, comparison, rows, methods, self.replicate, self.width, self.insets)
            path = directory / f"figure.{kind}"
            write_bytes(path, content)
            paths.append(path)
        return paths


def choose_textures(
    comparison: Comparison, patterns: tuple[str, ...], methods: Sequence[Method]
) -> list[ComparisonRow]:
    """Return the rows that a pattern names, or the four on which the scores of the methods differ most."""
    if not patterns:
        shown = [i for i, method in enumerate(comparison.methods) if method in methods]

        def spread(row: ComparisonRow) -> float:
            scores = [entry.score for i in shown if (entry := row.entries[i]) and entry.score is not None]
            return max(scores) - min(scores) if scores else -1.0

        best = sorted(comparison.rows, key=spread, reverse=True)[:4]
        return [row for row in comparison.rows if row in best]
    return match_names("texture", patterns, [((row.texture,), row) for row in comparison.rows])


def choose_methods(comparison: Comparison, patterns: tuple[str, ...]) -> list[Method]:
    """Return the methods that a pattern names, or the five best that are no references."""
    if not patterns:
        return [method for method in comparison.methods if not method.reference][:5]
    return match_names("method", patterns, [((method.label, method.name), method) for method in comparison.methods])
