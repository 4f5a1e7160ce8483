"""Write the comparison as plain text, for the terminal and for a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from typing import ClassVar

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from nrbench.errors import BadInput, strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .statistics import verdicts
from .statistics.detections import DetectorSummary, compare_detectors
from .statistics.estimates import Estimate
from .statistics.expectations import compare_with_published
from .statistics.format import format_interval, format_number, format_percent, format_value, pluralize
from .statistics.method_comparison import Comparison, Entry, choose_rows, compare_methods
from .statistics.summaries import MethodSummary, SummaryRow

_MOST_REASONS = 8
"""Number of reasons that are printed."""
_SUPERSCRIPT = str.maketrans("0123456789,", "⁰¹²³⁴⁵⁶⁷⁸⁹˒")
_DETECTOR_LEGEND = (
    "Shares over draws, with Wilson's 95 % intervals. Exact: the smallest lattice of the texture was found. "
    "False: a lattice was found on a stochastic texture, which has none. Error: median over exact answers, px. "
    "Calibration: expected calibration error of the confidence."
)


@dataclass(frozen=True)
class TextTable:
    """The comparison as plain text: methods from the highest mean quality to the lowest, then textures by methods.

    If the run has analogues of figures of the report of 2004, its tables 2 and 3 follow, with the measured verdicts.

    If detectors found the lattices, a last table shows the accuracy of each detector.

    Parameters
    ----------
    width
        Characters in a line, at least 40; columns that do not fit follow in a further table below.
    columns
        The scores of the table of methods, as in ``columns.csv``; empty for the headlines.
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    width: int = 120
    columns: tuple[str, ...] = ()
    tests: bool = True
    baseline: str = ""
    population: bool = False

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"
    terminal: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.width < 40:
            raise BadInput(f"report text: width is {self.width}; give at least 40 characters")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.txt`` and return its path."""
        path = directory / "comparison.txt"
        write_text(path, self.render(run))
        return [path]

    def render(self, run: Run) -> str:
        """Return the comparison as text without color codes; every line ends in a newline."""
        comparison, detectors = compare_methods(run, self.tests, self.baseline, self.population), compare_detectors(run)
        lines = choose_rows(run, comparison, self.columns)
        file = StringIO()
        console = Console(file=file, width=self.width, color_system=None, force_terminal=False, emoji=False)
        console.print(Text(comparison.title))
        if comparison.scored or self.columns:
            console.print(Text(comparison.estimand))
            console.print(*_split_table(partial(_summary_table, comparison, lines), len(lines), console), sep="")
            methods = len(comparison.methods) if comparison.scored else 0
            console.print(*_split_table(partial(_texture_table, comparison), methods, console), sep="")
            for line in [*_legend(comparison), *_reasons(run)]:
                console.print(Text(line))
        if published := compare_with_published(run, comparison):
            for regular in (True, False):
                if published.table(regular):
                    heads, *rows = published.lines(regular)
                    table = _make_table(*heads)
                    for row in rows:
                        table.add_row(*map(Text, row))
                    console.print(Text(f"{published.titles[regular]} of the report of 2004: published, then measured"))
                    console.print(table)
            console.print(Text(f"{published.sentence} {published.agreement}"))
        if detectors:
            console.print(_detector_table(detectors.summaries))
            console.print(Text(_DETECTOR_LEGEND))
        return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def _split_table(build: Callable[[int, int], Table], count: int, console: Console) -> Iterator[Table]:
    """Yield tables of as many of ``count`` columns as fit into the width of the console."""
    start = 0
    while start < count:
        stop = start + 1
        while stop < count and _fits(build(start, stop + 1), console):
            stop += 1
        yield build(start, stop)
        start = stop


def _fits(table: Table, console: Console) -> bool:
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum <= console.width


def _make_table(*heads: str | Text) -> Table:
    """Return an empty table. A word wider than its column is continued on the next line, never cut."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for head in heads:
        table.add_column(head, overflow="fold", justify="right" if str(head) == "share" else "left")
    return table


def _summary_table(comparison: Comparison, lines: Sequence[SummaryRow], start: int, stop: int) -> Table:
    """Return one row a method, with some of its numbers; references stand apart."""
    table = _make_table("method", *(Text(line.title.replace(" ", "\n")) for line in lines[start:stop]))
    for i, one in enumerate(comparison.summaries):
        if one.method.reference and i and not comparison.summaries[i - 1].method.reference:
            table.add_section()
        table.add_row(
            _method(one, " "), *(_estimate(line.shown[i], line.values[i], line.rate) for line in lines[start:stop])
        )
    return table


def _texture_table(comparison: Comparison, start: int, stop: int) -> Table:
    table = _make_table("texture", "share", *map(_method, comparison.summaries[start:stop]))
    for row in comparison.rows:
        share = "" if row.regular_share is None else f"{row.regular_share:.2f}"
        table.add_row(Text(row.texture), share, *map(_entry, row.entries[start:stop]))
    return table


def _method(one: MethodSummary, separator: str = "\n") -> Text:
    """Return the name with the sign of the leading group, and below it the source of the lattice or "reference"."""
    method = one.method
    source = "" if method.lattice_source == "none" else method.lattice_source
    reference = f"reference{one.validity.sign}" if method.reference else ""
    name = f"{method.name} {verdicts.LEADING_SIGN}" if one.leading else method.name
    return Text("\n".join([name, separator.join(filter(None, (source, reference)))]).rstrip())


def _entry(entry: Entry | None) -> Text:
    if entry is None:
        return Text("")
    notes = ",".join(map(str, entry.notes)).translate(_SUPERSCRIPT)
    sign = f" {verdicts.BASELINE_SIGN}" if entry.baseline_valid else ""
    return Text(f"{entry.text}{sign} {notes}".rstrip())


def _estimate(one: Estimate | None, value: str, rate: bool) -> Text:
    """Return two short lines: the value with the number of textures that it rests on, and its interval."""
    if one is None or one.value is None:
        return Text(value)
    if rate:
        value += f" ({one.value * one.n:.3g}/{one.n})"
    short = f" ({one.n}/{one.of})" if not rate and one.n < one.of else ""
    if one.ends is None or not format_interval(one, rate):
        return Text(value + short)
    low, high = map(format_percent if rate else format_number, one.ends)
    return Text(f"{value}{short}\n{low.removesuffix(' %')}–{high}")


def _detector_table(summaries: Sequence[DetectorSummary]) -> Table:
    table = _make_table("detector", "exact", "false", "error", "calibration", "seconds")
    for one in summaries:
        numbers = (Text(format_number(value)) for value in (one.vector_error, one.calibration.error, one.seconds))
        table.add_row(
            Text(one.detector),
            *(_estimate(rate, format_value(rate, True), True) for rate in (one.exact, one.false)),
            *numbers,
        )
    return table


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
