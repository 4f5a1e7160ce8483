"""Write the comparison as plain text, for the terminal and for a file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, ClassVar

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from nrbench.errors import BadInput, strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .statistics import verdicts
from .statistics.detections import compare_detectors
from .statistics.expectations import compare_with_published
from .statistics.format import break_name, format_number, format_percent, pluralize
from .statistics.frames import (
    PrintedTable,
    cell_text,
    print_detectors,
    print_improvements,
    print_methods,
    print_parameters,
    print_patches,
    print_published,
    print_textures,
)
from .statistics.method_comparison import Comparison, ComparisonOptions, Entry, choose_rows
from .statistics.summaries import Method, MethodSummary, Number, SummaryRow

_MOST_REASONS = 8
"""Number of reasons that are printed."""
_NAME_LETTERS = 20
"""Letters of a method's name in a line, if the name has a place to break."""
_GAP = 2
"""Space beside a column, characters."""
_SUPERSCRIPT = str.maketrans("0123456789,", "⁰¹²³⁴⁵⁶⁷⁸⁹˒")
_DETECTOR_LEGEND = (
    "Shares over draws, with Wilson's 95 % intervals. Exact: the smallest lattice of the texture was found. "
    "False: a lattice was found on a stochastic texture, which has none. Error: median over exact answers, px. "
    "Calibration: expected calibration error of the confidence."
)


@dataclass(frozen=True)
class TextTable(ComparisonOptions):
    """The comparison as plain text: methods from the highest mean quality to the lowest, then textures by methods.

    Below them stand all parameters of methods with a preset, a label or changed parameters, the methods as published
    beside the same methods by default, and how methods that copy patches choose, place and stitch them (table 1 of the
    report of 2004). If the run has analogues of figures of that report, its tables 2 and 3 follow, with the measured
    verdicts.

    If detectors found the lattices, a last table shows the accuracy of each detector.

    Parameters
    ----------
    width
        Characters in a line, at least 40; columns that do not fit follow in a further table below.
    columns
        The scores of the table of methods, as in ``columns.csv``; empty for the headlines.
    """

    width: int = 120
    columns: tuple[str, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"
    terminal: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.width < 40:
            raise BadInput(f"report text: width is {self.width}; give at least 40 characters")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.txt`` and return its path."""
        return write_files(directory, {"comparison.txt": self.render(run)})

    def render(self, run: Run) -> str:
        """Return the comparison as text without color codes; every line ends in a newline."""
        comparison, detectors = self.comparison(run), compare_detectors(run)
        lines = choose_rows(run, comparison, self.columns)
        file = StringIO()
        console = Console(file=file, width=self.width, color_system=None, force_terminal=False, emoji=False)
        console.print(Text(comparison.title))
        if comparison.scored or self.columns:
            console.print(Text(comparison.estimand))
            _print(console, print_methods(comparison, lines))
            if comparison.scored:
                _print(console, print_textures(comparison))
            parameters = (f"{name}: {values}" for name, values in print_parameters(comparison).rows)
            for line in [*_legend(comparison), *_reasons(run), *map(strip_control, parameters)]:
                console.print(Text(line))
        for table in (print_improvements(comparison), print_patches(run)):
            if table.rows:
                console.print(Text(f"\n{table.title}"))
                _print(console, table)
        if published := compare_with_published(run, comparison):
            for table in print_published(published):
                console.print(Text(f"{table.title} of the report of 2004: published, then measured"))
                _print(console, table)
            console.print(Text(f"{published.sentence} {published.agreement}"))
        if detectors:
            _print(console, print_detectors(detectors.summaries))
            console.print(Text(_DETECTOR_LEGEND))
        return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def _print(console: Console, table: PrintedTable) -> None:
    """Print a table in parts as wide as the console."""
    columns = zip(map(_head, table.heads), *(map(_cell, row) for row in table.rows), strict=True)
    widths = [max(cell_len(line) for text in column for line in text.splitlines() or [""]) + _GAP for column in columns]
    console.print(*map(_lay_out, table.split(widths, console.width)), sep="")


def _lay_out(table: PrintedTable) -> Table:
    """Return a table for the console. A word wider than its column is continued on the next line, never cut."""
    laid = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for head in table.heads:
        laid.add_column(Text(_head(head)), overflow="fold", justify="right" if head == "share" else "left")
    for i, row in enumerate(table.rows):
        if i in table.rules:
            laid.add_section()
        laid.add_row(*(Text(_cell(cell)) for cell in row))
    return laid


def _head(head: Any) -> str:
    if isinstance(head, MethodSummary):
        return _method(head, "\n")
    return head.title.replace(" ", "\n") if isinstance(head, SummaryRow) else str(getattr(head, "label", head))


def _cell(cell: Any) -> str:
    if isinstance(cell, MethodSummary):
        return _method(cell, " ")
    if isinstance(cell, Number):
        return _number(cell)
    if isinstance(cell, Method):
        return "\n".join(break_name(cell.label, 2 * _NAME_LETTERS))
    return _entry(cell) if isinstance(cell, Entry) else cell_text(cell)


def _method(one: MethodSummary, separator: str) -> str:
    """Return the name with the sign of the leading group, and below it the source of the lattice or "reference"."""
    method = one.method
    source = "" if method.lattice_source == "none" else method.lattice_source
    reference = f"reference{one.validity.sign}" if method.reference else ""
    name = f"{method.name} {verdicts.LEADING_SIGN}" if one.leading else method.name
    return "\n".join([*break_name(name, _NAME_LETTERS), separator.join(filter(None, (source, reference)))]).rstrip()


def _entry(entry: Entry) -> str:
    notes = ",".join(map(str, entry.notes)).translate(_SUPERSCRIPT)
    sign = f" {verdicts.BASELINE_SIGN}" if entry.baseline_valid else ""
    return f"{entry.text}{sign} {notes}".rstrip()


def _number(number: Number) -> str:
    """Return two short lines: the value with the number of textures that it rests on, and its interval."""
    one, value = number.shown, number.text
    if number.rate and one.value is not None:
        value += f" ({one.value * one.n:.3g}/{one.n})"
    elif number.partial:
        value += f" ({one.n}/{one.of})"
    if one.ends is None or not number.interval:
        return value
    low, high = map(format_percent if number.rate else format_number, one.ends)
    return f"{value}\n{low.removesuffix(' %')}–{high}"


def _legend(comparison: Comparison) -> Iterator[str]:
    """Yield the legend and the notes."""
    if not comparison.rows:
        yield "There are no cells."
        return
    marks = ", ".join(f"{mark} {name}" for mark, name in comparison.legend)
    if comparison.has_ranking:
        yield "Methods are ranked by their mean quality over textures. A failed or refused cell has quality 0."
        if comparison.leading_legend:
            yield comparison.leading_sentence
        yield "Quality: the worst of regularity, integrity, randomness and appearance. 1 is as good as a fresh draw."
        if comparison.has_bounds:
            yield f"{verdicts.BOUND_SIGN} {verdicts.BOUND_LEGEND}."
    yield "(n/N): the mean counts n of N textures. A rate counts outputs and has Wilson's interval. –: not measured."
    yield "References calibrate the scores and are never ranked. Under a method: the source of its lattice."
    yield f"{marks}. Beside the mark: {comparison.score}. share: regular share of the texture."
    if comparison.has_valid_baseline:
        yield f"{verdicts.BASELINE_SIGN} {verdicts.BASELINE_LEGEND} ({verdicts.SHARES_LEGEND})."
    for index, note in enumerate(comparison.notes, 1):
        yield f"{str(index).translate(_SUPERSCRIPT)} {strip_control(note)}"


def _reasons(run: Run) -> Iterator[str]:
    """Yield the reasons for which cells have no verdict, each with the number of its cells."""
    reasons = verdicts.count_reasons(run)
    for word, reason, count in reasons[:_MOST_REASONS]:
        yield f"{verdicts.MARKS[word]} {pluralize(count, 'cell')} {word}: {strip_control(reason)}"
    if len(reasons) > _MOST_REASONS:
        cells = sum(count for *_, count in reasons[_MOST_REASONS:])
        yield f"and {pluralize(cells, 'cell')} for {len(reasons) - _MOST_REASONS} other reasons: see cells.csv"
