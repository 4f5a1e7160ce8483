"""Write the comparison as plain text, for the terminal and for a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import ClassVar

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_aside

from .statistics.comparison import Comparison, Entry, MethodSummary, compare_methods
from .statistics.detections import DetectorSummary, compare_detectors
from .statistics.estimates import Estimate
from .statistics.format import format_number, format_percent, strip_control
from .statistics.verdicts import BASELINE_LEGEND, BASELINE_SIGN, PRESERVED, SHARES_LEGEND

_SUPERSCRIPT = str.maketrans("0123456789,", "⁰¹²³⁴⁵⁶⁷⁸⁹˒")
_DETECTOR_LEGEND = (
    "Shares over draws, with Wilson's 95 % intervals. Exact: the smallest lattice of the texture was found. "
    "False: a lattice was found on a stochastic texture, which has none. Error: median over exact answers, px. "
    "Calibration: expected calibration error of the confidence."
)


@dataclass(frozen=True)
class TextTable:
    """The comparison as plain text: verdict and score for each texture and method, and summary rows below.

    If detectors found the lattices, a second table shows the accuracy of each detector.

    Parameters
    ----------
    width
        Characters in a line, at least 40; methods that do not fit follow in a further table below.
    """

    width: int = 120

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"
    terminal: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.width < 40:
            raise BadInput(f"report text: width is {self.width}; give at least 40 characters")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.txt`` and return its path."""
        path, content = directory / "comparison.txt", self.render(run).encode("utf-8", "backslashreplace")
        write_aside(path, lambda aside: aside.write_bytes(content))
        return [path]

    def render(self, run: Run) -> str:
        """Return the comparison as text without color codes; every line ends in a newline."""
        comparison, detectors = compare_methods(run), compare_detectors(run)
        file = StringIO()
        console = Console(file=file, width=self.width, color_system=None, force_terminal=False, emoji=False)
        console.print(Text(comparison.title))
        if PRESERVED in run.columns:
            for table in _method_tables(comparison, console):
                console.print(table)
            for line in _legend(comparison):
                console.print(Text(line))
        if detectors:
            console.print(_detector_table(detectors.summaries))
            console.print(Text(_DETECTOR_LEGEND))
        return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def _method_tables(comparison: Comparison, console: Console) -> Iterator[Table]:
    """Yield tables of as many methods as fit into the width of the console."""
    start = 0
    while start < len(comparison.methods):
        stop = start + 1
        while stop < len(comparison.methods) and _fits(_method_table(comparison, start, stop + 1), console):
            stop += 1
        yield _method_table(comparison, start, stop)
        start = stop


def _fits(table: Table, console: Console) -> bool:
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum <= console.width


def _method_table(comparison: Comparison, start: int, stop: int) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(Text("texture"), overflow="fold")
    table.add_column(Text("share"), justify="right")
    for one in comparison.summaries[start:stop]:
        table.add_column(_method(one), overflow="fold")
    for row in comparison.rows:
        share = "" if row.regular_share is None else f"{row.regular_share:.2f}"
        table.add_row(Text(row.texture), share, *map(_entry, row.entries[start:stop]))
    table.add_section()
    for line in comparison.summary_rows:
        if not line.name.startswith("rank"):
            table.add_row(Text(line.name), "", *(_estimate(one, line.rate) for one in line.estimates[start:stop]))
    return table


def _method(one: MethodSummary) -> Text:
    method = one.method
    source = "" if method.lattice_source == "none" else method.lattice_source
    return Text("\n".join([method.name, source, f"reference{one.validity.sign}" if method.reference else ""]))


def _entry(entry: Entry | None) -> Text:
    if entry is None:
        return Text("")
    notes = ",".join(map(str, entry.notes)).translate(_SUPERSCRIPT)
    sign = f" {BASELINE_SIGN}" if entry.baseline_valid else ""
    return Text(f"{entry.text}{sign} {notes}".rstrip())


def _estimate(one: Estimate | None, rate: bool) -> Text:
    """Return two short lines: the value with the number of textures that it rests on, and its interval."""
    if one is None or one.value is None:
        return Text("–")
    value = f"{format_percent(one.value)} ({one.value * one.n:.3g}/{one.n})" if rate else format_number(one.value)
    short = f" ({one.n}/{one.of})" if not rate and one.n < one.of else ""
    if one.ends is None:
        return Text(value + short)
    low, high = map(format_percent if rate else format_number, one.ends)
    return Text(f"{value}{short}\n{low.removesuffix(' %')}–{high}")


def _detector_table(summaries: Sequence[DetectorSummary]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("detector", "exact", "false", "error", "calibration", "seconds"):
        table.add_column(name, overflow="fold")
    for one in summaries:
        numbers = (Text(format_number(value)) for value in (one.vector_error, one.calibration.error, one.seconds))
        table.add_row(Text(one.detector), _estimate(one.exact, True), _estimate(one.false, True), *numbers)
    return table


def _legend(comparison: Comparison) -> Iterator[str]:
    """Yield the legend and the notes."""
    if not comparison.rows:
        yield "There are no cells."
        return
    marks = ", ".join(f"{mark} {name}" for mark, name in comparison.legend)
    yield f"{marks}. Beside the mark: regularity.score, 0 to 1. share: regular share of the texture."
    yield "Under a method: the source of its lattice. References calibrate the scores and are never ranked."
    yield "Lower rows: means over textures with 95 % intervals. (n/N): the mean counts n of N textures."
    if comparison.has_valid_baseline:
        yield f"{BASELINE_SIGN} {BASELINE_LEGEND} ({SHARES_LEGEND})."
    for index, note in enumerate(comparison.notes, 1):
        yield f"{str(index).translate(_SUPERSCRIPT)} {strip_control(note)}"
