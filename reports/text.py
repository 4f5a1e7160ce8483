"""The comparison as plain text, for the terminal and for a file."""

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

from .page.format import number, percent, plain, plural
from .statistics.baselines import LEGEND, SHARES, SIGN, NoCheat
from .statistics.comparison import Comparison, Entry, comparison
from .statistics.detections import Trust, detectors
from .statistics.statistics import Estimate
from .statistics.summary import Head
from .statistics.verdicts import PRESERVED

_SUPERSCRIPT = str.maketrans("0123456789,", "⁰¹²³⁴⁵⁶⁷⁸⁹˒")


@dataclass(frozen=True)
class TextTable:
    """The comparison as plain text: a verdict and a score for each texture and method, success rates at the foot.

    Where detectors found the lattices, a table below tells how far to trust each.

    Parameters
    ----------
    width
        Characters a line may have, at least 40; methods that do not fit follow in a further table below.
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
        """Return the comparison as text without color codes, lines ending in a newline."""
        found = comparison(run)
        console = Console(file=StringIO(), width=self.width, color_system=None, force_terminal=False, emoji=False)
        console.print(Text(headline(run, found)))
        if PRESERVED in run.columns:
            for table in _tables(found, console):
                console.print(table)
            for line in _below(found):
                console.print(Text(line))
        asked = detectors(run)
        if asked:
            console.print(_trusts(asked.trusts))
            console.print(Text(_TRUST))
        assert isinstance(console.file, StringIO)
        return "".join(f"{line.rstrip()}\n" for line in console.file.getvalue().splitlines())


def headline(run: Run, found: Comparison) -> str:
    """Return one line: the suite, its hash, and how the cells ended."""
    suite = run.info.get("suite", {})
    name = f"{suite.get('name', 'run')} {suite.get('version', '')}".rstrip()
    sizes = f"{plural(len(found.rows), 'texture')}, {plural(len(run.cells), 'cell')}"
    ended = ", ".join(f"{count} {status}" for status, count in found.counts.items())
    return f"{name} ({suite.get('hash', 'no hash')}): {sizes}" + (f": {ended}" if ended else "")


def _tables(found: Comparison, console: Console) -> Iterator[Table]:
    """Yield tables of as many columns as the console's width takes."""
    start = 0
    while start < len(found.heads):
        stop = start + 1
        while stop < len(found.heads) and _fits(_table(found, start, stop + 1), console):
            stop += 1
        yield _table(found, start, stop)
        start = stop


def _fits(table: Table, console: Console) -> bool:
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum <= console.width


def _table(found: Comparison, start: int, stop: int) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(Text("texture"), overflow="fold")
    table.add_column(Text("share"), justify="right")
    for one in found.summaries[start:stop]:
        table.add_column(_head(one.head, one.no_cheat), overflow="fold")
    for row in found.rows:
        share = "" if row.regular_share is None else f"{row.regular_share:.2f}"
        table.add_row(Text(row.texture), share, *_places(row.entries[start:stop]))
    table.add_section()
    for line in found.foot:
        if not line.name.startswith("rank"):
            table.add_row(Text(line.name), "", *(_estimate(one, line.rate) for one in line.estimates[start:stop]))
    return table


def _head(head: Head, no_cheat: NoCheat) -> Text:
    lines = [head.method, "" if head.lattice_source == "none" else head.lattice_source]
    return Text("\n".join([*lines, f"reference{no_cheat.sign}" if head.reference else ""]))


def _estimate(one: Estimate | None, rate: bool) -> Text:
    """Return two short lines: the value with how many textures it rests on, and its interval."""
    if one is None or one.value is None:
        return Text("–")
    value = f"{percent(one.value)} ({one.value * one.n:.3g}/{one.n})" if rate else number(one.value)
    short = f" ({one.n}/{one.of})" if not rate and one.n < one.of else ""
    if one.low is None or one.high is None:
        return Text(value + short)
    ends = f"{percent(one.low)[:-2]}–{percent(one.high)}" if rate else f"{number(one.low)}–{number(one.high)}"
    return Text(f"{value}{short}\n{ends}")


def _places(entries: Sequence[Entry | None]) -> Iterator[Text]:
    for entry in entries:
        notes = ",".join(map(str, entry.notes)).translate(_SUPERSCRIPT) if entry else ""
        sign = f" {SIGN}" if entry and entry.right else ""
        yield Text(f"{entry.text}{sign} {notes}".rstrip() if entry else "")


_TRUST = (
    "Shares over draws, with Wilson's 95 % intervals; no lattice where there is one counts as not exact. "
    "False: lattices found on stochastic textures. Error: median of the exact answers, px. "
    "Calibration: expected error of the confidence."
)


def _trusts(trusts: Sequence[Trust]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("detector", "exact", "false", "error", "calibration", "seconds"):
        table.add_column(name, overflow="fold")
    for one in trusts:
        numbers = (Text(number(value)) for value in (one.vector_error, one.calibration.error, one.seconds))
        table.add_row(Text(one.detector), _estimate(one.exact, True), _estimate(one.false, True), *numbers)
    return table


def _below(found: Comparison) -> Iterator[str]:
    """Yield the legend and the notes."""
    if not found.rows:
        yield "There are no cells."
        return
    yield ", ".join(f"{mark} {name}" for mark, name in found.legend) + "; beside the mark: regularity.score, 0 to 1."
    yield "Under a method: where its lattice comes from. References calibrate the scores and are never ranked."
    yield "At the foot: means over textures (of all, or n/N), and 95 % intervals over textures. share: regular share."
    if found.no_cheat:
        yield f"{SIGN} {LEGEND} ({SHARES})."
    for index, note in enumerate(found.notes, 1):
        yield f"{str(index).translate(_SUPERSCRIPT)} {plain(note)}"
