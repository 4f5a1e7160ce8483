"""The comparison as Markdown, for a README, an issue or a wiki."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.runs.records import Run
from nrbench.storage import write_aside

from .page.format import counted, interval, number, percent, plain, successes, tip
from .statistics.baselines import LEGEND, SHARES, SIGN, NoCheat
from .statistics.comparison import Comparison, Entry, comparison
from .statistics.statistics import Estimate
from .statistics.summary import Head, headlines
from .statistics.verdicts import MEANINGS, PRESERVED
from .text import headline

_ACTIVE = re.compile(r"([\\`*_\[\]<>|~&@#]|:(?=//)|(?<=www)\.|^[-+=])")


@dataclass(frozen=True)
class MarkdownTables:
    """``comparison.md``: each method in numbers, then textures by methods, as pipe tables with their legend.

    Names and messages are escaped, so that they read as they are and nothing in them is markup or a link.
    """

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write ``comparison.md`` and return its path."""
        path, content = directory / "comparison.md", self.render(run).encode("utf-8", "backslashreplace")
        write_aside(path, lambda aside: aside.write_bytes(content))
        return [path]

    def render(self, run: Run) -> str:
        """Return the tables as text, lines ending in a newline."""
        found = comparison(run)
        lines = [f"# {escaped(headline(run, found))}", ""]
        if found.rows and PRESERVED in run.columns:
            lines += [*_summary(run, found), *_textures(found), *_legend(run, found)]
        elif not found.rows:
            lines += ["There are no cells."]
        return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    """Return text on one line in which nothing is markup."""
    return _ACTIVE.sub(r"\\\1", " ".join(plain(text).split()))


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], numbers: int) -> Iterator[str]:
    """Yield a pipe table and an empty line; all columns after the first ``numbers`` are centred."""
    yield f"| {' | '.join(heads)} |"
    yield f"|{'|'.join([' --- '] * numbers + [' :-: '] * (len(heads) - numbers))}|"
    yield from (f"| {' | '.join(row)} |" for row in rows)
    yield ""


def _head(head: Head, no_cheat: NoCheat) -> str:
    source = "" if head.lattice_source == "none" else f" ({escaped(head.lattice_source)})"
    return f"*{escaped(head.method)}*{source} †{no_cheat.sign}" if head.reference else escaped(head.method) + source


def _summary(run: Run, found: Comparison) -> Iterator[str]:
    names = list(headlines(run))
    rows = [
        [_head(one.head, one.no_cheat), _rate(one.success), *(_mean(one.means[name]) for name in names)]
        for one in found.summaries
    ]
    yield from _table(["method", "preserved", *map(escaped, names)], rows, 1)


def _rate(one: Estimate) -> str:
    return f"**{percent(one.value)}** {interval(one, True)} {successes(one)}" if one.n else "–"


def _mean(one: Estimate) -> str:
    if not one.n:
        return "–"
    short = f" ({counted(one)})" if one.n < one.of else ""
    return f"**{number(one.value)}** {interval(one)}{short}".rstrip()


def _textures(found: Comparison) -> Iterator[str]:
    rows = [
        [
            escaped(row.texture),
            "–" if row.regular_share is None else f"{row.regular_share:.2f}",
            *map(_place, row.entries),
        ]
        for row in found.rows
    ]
    heads = [_head(one.head, one.no_cheat) for one in found.summaries]
    yield from _table(["texture", "regular share", *heads], rows, 2)


def _place(entry: Entry | None) -> str:
    if entry is None:
        return ""
    notes = ", ".join(map(str, entry.notes))
    sign = f" {SIGN}" if entry.right else ""
    return escaped(entry.text) + sign + (f" <sup>{notes}</sup>" if notes else "")


def _legend(run: Run, found: Comparison) -> Iterator[str]:
    marks = "; ".join(f"{escaped(mark)} {name}: {MEANINGS[name]}" for mark, name in found.legend)
    yield f"{marks}. Beside the mark: `regularity.score`, 0 to 1."
    yield "In parentheses: where the lattice comes from (given: the true one was handed over)."
    yield "† *reference*: calibrates the scores and is never ranked."
    if found.no_cheat:
        yield f"{SIGN} {LEGEND} ({SHARES})."
    yield "Means and 95 % intervals over textures."
    yield ""
    for name, column in headlines(run).items():
        yield f"- `{name}`: {escaped(' '.join(tip(column).split()))}"
    yield ""
    yield from (f"{number}. {escaped(note)}" for number, note in enumerate(found.notes, 1))
