"""The comparison as LaTeX tables, for a paper."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_aside

from .page.format import number, plain
from .statistics.baselines import LEGEND, SHARES, NoCheat
from .statistics.comparison import Comparison, Entry, comparison
from .statistics.statistics import Estimate
from .statistics.summary import Head, headlines
from .statistics.verdicts import PRESERVED

_SPECIAL: Mapping[str, str] = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedbl{}", "'": r"{'}", "`": r"{`}", "-": "{-}",
    "\u2212": "$-$", "\u2013": "--", "\u2026": r"\dots{}", "\u221e": r"$\infty$",
    "\u00d7": r"$\times$", "\u00b0": r"$^\circ$",
}  # fmt: skip
_MARKS: Mapping[str, tuple[str, str]] = {
    "preserved": ("Preserved", r"$\bullet$"),
    "lost": ("Lost", r"$\circ$"),
    "undecided": ("Undecided", "?"),
    "not applicable": ("NotApplicable", "--"),
    "refused": ("Refused", r"\textsc{n/a}"),
    "failed": ("Failed", "!"),
    "unscored": ("Unscored", "(!)"),
    "missing": ("Missing", r"$\cdot$"),
    "mixed": ("Mixed", r"$\sim$"),
}
_OTHER: Mapping[str, str] = {
    "Reference": r"\ensuremath{^\dagger}",
    "NoCheat": r"\ensuremath{^\ddagger}",
    "Given": r"\ensuremath{^{\mathrm g}}",
}


@dataclass(frozen=True)
class LatexTables:
    r"""``summary.tex`` (methods by scores) and ``comparison.tex`` (textures by methods), to be ``\input`` in a paper.

    They need ``\usepackage{booktabs}`` and ``\usepackage[T1]{fontenc}``, nothing else. Names are escaped. A dagger
    marks a reference, which is never ranked, a double dagger one that is no cheat there; a raised g a method that was
    handed the true lattice, any other raised word the detector that the lattice came from. The marks are commands
    (``\nrbPreserved``, ``\nrbLost``, ``\nrbGiven``, ...) that a paper may define otherwise before the input.

    Parameters
    ----------
    columns
        Methods side by side in ``comparison.tex``, at least 1; the others follow below.
    """

    columns: int = 6

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def __post_init__(self) -> None:
        if self.columns < 1:
            raise BadInput(f"report latex: columns is {self.columns}; give at least 1")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write both files and return their paths; none where the run judges no regularity."""
        found = comparison(run)
        if PRESERVED not in run.columns or not found.rows:
            return []
        contents = {"summary": _summary(run, found), "comparison": _comparison(run, found, self.columns)}
        return [_write(directory / f"{name}.tex", lines) for name, lines in contents.items()]


def _write(path: Path, lines: Iterator[str]) -> Path:
    content = "".join(f"{line}\n" for line in (*_definitions(), *lines)).encode("utf-8", "backslashreplace")
    write_aside(path, lambda aside: aside.write_bytes(content))
    return path


def escaped(text: str) -> str:
    """Return text on one line as LaTeX prints it: every special character is itself, and no ligature is made."""
    return "".join(_SPECIAL.get(letter, letter) for letter in " ".join(plain(text).split()))


def _definitions() -> Iterator[str]:
    yield r"% needs \usepackage{booktabs} and \usepackage[T1]{fontenc}; the marks may be defined before this is read"
    for name, sign in (*_MARKS.values(), *_OTHER.items()):
        yield rf"\providecommand{{\nrb{name}}}{{{sign}}}"


def _head(head: Head, no_cheat: NoCheat) -> str:
    source = {"none": "", "own": "", "given": r"\nrbGiven{}"}.get(head.lattice_source)
    raised = rf"\textsuperscript{{{escaped(head.lattice_source)}}}" if source is None else source
    name = rf"\textit{{{escaped(head.method)}}}\nrbReference{{}}" if head.reference else escaped(head.method)
    share = rf"\textsuperscript{{{no_cheat.share}}}" if no_cheat.share else ""
    return name + raised + (rf"\nrbNoCheat{{}}{share}" if no_cheat.n else "")


def _float(name: str, caption: str, spec: str, rows: Sequence[str]) -> Iterator[str]:
    yield from (r"\begin{table}", r"\centering\footnotesize\setlength{\tabcolsep}{4pt}")
    yield rf"\caption{{{caption}}}\label{{tab:nrbench-{name}}}\smallskip"
    yield rf"\begin{{tabular}}{{@{{}}{spec}@{{}}}}"
    yield from (r"\toprule", *rows, r"\bottomrule", r"\end{tabular}", r"\end{table}")


def _line(parts: Sequence[str]) -> str:
    return " & ".join(parts) + r" \\"


def _summary(run: Run, found: Comparison) -> Iterator[str]:
    columns = headlines(run)
    heads = ["preserved, \\%", *(_title(name, column.unit) for name, column in columns.items())]
    rows = [_line(["method", *(rf"\shortstack{{{head}}}" for head in heads)]), r"\midrule"]
    references = False
    for one in found.summaries:
        if one.head.reference and not references and len(rows) > 2:
            rows.append(r"\midrule")
        references = one.head.reference
        means = (_mean(one.means[name]) for name in columns)
        rows.append(_line([_head(one.head, one.no_cheat), _rate(one.success), *means]))
    caption = (
        f"{_suite(run)}: means over textures, 95\\,\\% intervals over textures below; preserved: share of "
        f"textures whose lattice is preserved, and of how many ({{\\itshape /n}} elsewhere: not of all). "
        f"{_signs(found)}"
    )
    yield from _float("summary", caption, "l" + "r" * len(heads), rows)


def _title(name: str, unit: str) -> str:
    """Return a column's head on two lines: its metric, then its name with its unit."""
    metric, _, column = name.rpartition(".")
    words = escaped(column.replace("_", " ")) + (f", {escaped(unit)}" if unit else "")
    return rf"{escaped(metric)}\\{words}" if metric else words


def _rate(one: Estimate) -> str:
    if one.value is None:
        return "--"
    ends = "" if one.low is None or one.high is None else f"[{100 * one.low:.0f}, {100 * one.high:.0f}]"
    return _stacked(rf"{100 * one.value:.0f} \textit{{/{one.n}}}", ends)


def _mean(one: Estimate) -> str:
    if one.value is None:
        return "--"
    ends = "" if one.low is None or one.high is None else f"[{number(one.low)}, {number(one.high)}]"
    part = rf" \textit{{/{one.n}}}" if one.n < one.of else ""
    return _stacked(_mathematical(number(one.value)) + part, _mathematical(ends))


def _stacked(value: str, ends: str) -> str:
    """Return a value with its interval below it."""
    return rf"\shortstack[r]{{{value}\\[-1pt]\scriptsize {ends}}}" if ends else value


def _mathematical(text: str) -> str:
    return re.sub("[\u2212\u2013\u221e]", lambda found: _SPECIAL[found[0]], text)


def _comparison(run: Run, found: Comparison, columns: int) -> Iterator[str]:
    signs = ", ".join(rf"\nrb{_MARKS[name][0]}{{}} {name}" for _, name in found.legend)
    caption = (
        f"{_suite(run)}: is the lattice preserved? {signs}; beside the mark the share of tiles in place and intact. "
        f"share: regular share of the texture. {_signs(found)}"
    )
    rows: list[str] = []
    for start in range(0, len(found.heads), columns):
        rows += [r"\midrule"] if rows else []
        rows += _block(found, start, min(start + columns, len(found.heads)), columns)
    yield from _float("comparison", caption, "lr" + "l" * min(columns, len(found.heads)), rows)


def _block(found: Comparison, start: int, stop: int, columns: int) -> Iterator[str]:
    blank = [""] * (min(columns, len(found.heads)) - (stop - start))
    heads = [_head(one.head, one.no_cheat) for one in found.summaries[start:stop]]
    yield _line(["texture", "share", *heads, *blank])
    yield r"\midrule"
    for row in found.rows:
        share = "--" if row.regular_share is None else f"{row.regular_share:.2f}"
        yield _line([escaped(row.texture), share, *map(_place, row.entries[start:stop]), *blank])


def _place(entry: Entry | None) -> str:
    if entry is None:
        return ""
    sign = r"\nrbNoCheat{}" if entry.right else ""
    return rf"\nrb{_MARKS[entry.verdict][0]}{{}} {escaped(entry.detail)}".rstrip() + sign


def _suite(run: Run) -> str:
    suite = run.info.get("suite", {})
    return escaped(f"{suite.get('name', 'run')} {suite.get('version', '')} ({suite.get('hash', 'no hash')})")


def _signs(found: Comparison) -> str:
    signs = r"\nrbReference{} reference, never ranked; \nrbGiven{} the true lattice was handed over."
    return rf"{signs} \nrbNoCheat{{}} {LEGEND} ({SHARES})." if found.no_cheat else signs
