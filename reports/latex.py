"""Write the comparison as LaTeX tables for a paper."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from nrbench import plugins
from nrbench.errors import BadInput, strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .statistics.comparison import (
    Comparison,
    Entry,
    Method,
    MethodSummary,
    PatchTerms,
    SummaryRow,
    compare_methods,
    list_patch_terms,
    other_score_rows,
)
from .statistics.estimates import Estimate
from .statistics.format import format_interval, format_number, format_signed
from .statistics.published import SENTENCE, FigureRow, PublishedComparison, compare_with_published
from .statistics.verdicts import BASELINE_LEGEND, QUALITY, RANKING, SHARES_LEGEND

_SPECIAL: Mapping[str, str] = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedbl{}", "'": r"{'}", "`": r"{`}", "-": "{-}",
    "[": "{[}", "]": "{]}", "*": "{*}",
    "\u2212": "$-$", "\u2013": "--", "\u2026": r"\dots{}", "\u221e": r"$\infty$",
    "\u00d7": r"$\times$", "\u00b0": r"$^\circ$",
}  # fmt: skip
_LAST_LATIN = 0x17F
"""The last letter that every LaTeX prints with T1 fonts."""
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
    "ValidBaseline": r"\ensuremath{^\ddagger}",
    "Given": r"\ensuremath{^{\mathrm g}}",
}


@dataclass(frozen=True)
class LatexTables:
    r"""Tables for ``\input`` in a paper.

    ``summary.tex`` (methods by scores), ``comparison.tex`` (textures by methods) and, for methods that copy patches,
    ``patches.tex`` (their shape, placement and stitching).

    If the run has analogues of the figures of the report of 2004, ``published.tex`` has its tables 2 and 3 with the
    published mark before the measured one, and the success rates over the same figures.

    They need ``\usepackage{booktabs}`` and ``\usepackage[T1]{fontenc}``, nothing else. Names are escaped. A dagger
    marks a reference, which is never ranked. A double dagger marks a baseline that is valid on that kind of texture. A
    raised g marks a method that received the true lattice; any other raised word is the detector that found its
    lattice. The marks are commands (``\nrbPreserved``, ``\nrbLost``, ``\nrbGiven``, ...). A paper can define its own
    before the input.

    Parameters
    ----------
    columns
        Methods side by side in ``comparison.tex``, at least 1; further methods follow below.
    scores
        The columns of ``summary.tex``, by the names of the rows in ``summary.csv``; by default the headlines.
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    """

    columns: int = 6
    scores: tuple[str, ...] = ()
    tests: bool = True
    baseline: str = ""

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def __post_init__(self) -> None:
        object.__setattr__(self, "scores", tuple(self.scores))
        if self.columns < 1:
            raise BadInput(f"report latex: columns is {self.columns}; give at least 1")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; without a regularity score only ``patches.tex``, if at all."""
        comparison, terms = compare_methods(run, self.tests, self.baseline), list_patch_terms(run)
        contents: dict[str, Iterable[str]] = {"patches": _patches(run, terms)} if terms else {}
        if comparison.scored and comparison.rows:
            contents["summary"] = _summary(run, comparison, self.scores)
            contents["comparison"] = _comparison(run, comparison, self.columns)
            if published := compare_with_published(run, comparison):
                contents["published"] = _published(run, published)
        written = [_write(directory / f"{name}.tex", _document(lines)) for name, lines in contents.items()]
        if entries := bibliography(run):
            written.append(_write(directory / "methods.bib", f"{entries}\n"))
        return written


def _write(path: Path, text: str) -> Path:
    write_text(path, text)
    return path


def _document(lines: Iterable[str]) -> str:
    return "".join(f"{line}\n" for line in (*_definitions(), *lines))


def latex_text(run: Run, comparison: Comparison, scores: Sequence[str] = ()) -> str:
    """Return the table of methods by scores, with the definitions of its marks."""
    return _document(_summary(run, comparison, scores))


def bibliography(run: Run) -> str:
    """Return the BibTeX entries of the papers of a run's methods, each once, in the order of the run."""
    names = dict.fromkeys(record.cell.method for record in run.cells)
    installed = set(plugins.names("synthesizers"))
    papers = [getattr(plugins.find("synthesizers", name).cls, "paper", "") for name in names if name in installed]
    return "".join(f"{strip_control(paper).strip()}\n\n" for paper in dict.fromkeys(papers) if paper).rstrip("\n")


def escape_latex(text: str) -> str:
    """Return text on one line, escaped so that LaTeX prints every character and makes no ligature."""
    return "".join(map(_escape_letter, " ".join(strip_control(text).split())))


def _escape_letter(letter: str) -> str:
    r"""Return a letter as LaTeX; one that T1 fonts lack as ``\nrbUnicode{code}{letter}``."""
    plain = ord(letter) <= _LAST_LATIN or letter in _SPECIAL
    return _SPECIAL.get(letter, letter) if plain else rf"\nrbUnicode{{{ord(letter):04X}}}{{{letter}}}"


def _definitions() -> Iterator[str]:
    yield r"% needs \usepackage{booktabs} and \usepackage[T1]{fontenc}; a paper can define these marks before this file"
    for name, sign in (*_MARKS.values(), *_OTHER.items()):
        yield rf"\providecommand{{\nrb{name}}}{{{sign}}}"
    yield r"\providecommand{\nrbUnicode}[2]{{\scriptsize U+#1}}% LuaLaTeX and XeLaTeX can print the letter itself, #2"
    yield r"\providecommand{\nrbBest}[1]{\textbf{#1}}"
    yield r"\providecommand{\nrbTie}[1]{\textbf{#1}}"


def _method(one: MethodSummary) -> str:
    name, source, validity = escape_latex(one.method.name), one.method.lattice_source, one.validity
    raised = {"none": "", "own": "", "given": r"\nrbGiven{}"}.get(source)
    if raised is None:
        raised = rf"\textsuperscript{{{escape_latex(source)}}}"
    share = rf"\textsuperscript{{{validity.share}}}" if validity.share else ""
    valid = rf"\nrbValidBaseline{{}}{share}" if validity.n else ""
    return (rf"\textit{{{name}}}\nrbReference{{}}" if one.method.reference else name) + raised + valid


def _float(name: str, caption: str, spec: str, rows: Sequence[str]) -> Iterator[str]:
    yield from (r"\begin{table}", r"\centering\footnotesize\setlength{\tabcolsep}{4pt}")
    yield rf"\caption{{{caption}}}\label{{tab:nrbench-{name}}}\smallskip"
    yield rf"\begin{{tabular}}{{@{{}}{spec}@{{}}}}"
    yield from (r"\toprule", *rows, r"\bottomrule", r"\end{tabular}", r"\end{table}")


def _line(parts: Sequence[str]) -> str:
    return " & ".join(parts) + r" \\"


def _summary(run: Run, comparison: Comparison, scores: Sequence[str]) -> Iterator[str]:
    lines = _chosen_rows(run, comparison, scores)
    heads = [_column_title(line) for line in lines]
    rows = [_line(["method", *(rf"\shortstack{{{head}}}" for head in heads)]), r"\midrule"]
    references = False
    for i, one in enumerate(comparison.summaries):
        if one.method.reference and not references and len(rows) > 2:
            rows.append(r"\midrule")
        references = one.method.reference
        rows.append(_line([_method(one), *(_value(line, i, one) for line in lines)]))
    ranking = (
        "Methods are ranked by quality, the worst of regularity, integrity and randomness of each output; a failed or "
        "refused output has quality 0. "
    )
    if comparison.leading_legend:
        ranking += rf"\nrbBest{{Best}} and \nrbTie{{tied}}: {escape_latex(comparison.leading_legend)}. "
    caption = (
        f"{_suite(run)}: means over {len(comparison.rows)} textures, with 95\\,\\% intervals over textures below. "
        f"{ranking * comparison.has_ranking}Preserved: share of textures whose lattice is preserved. "
        f"{{\\itshape /n}}: the value rests on n textures. {_signs(comparison)}"
    )
    yield from _float("summary", caption, "l" + "r" * len(heads), rows)


def _chosen_rows(run: Run, comparison: Comparison, scores: Sequence[str]) -> Sequence[SummaryRow]:
    """Return the rows of the named scores in their order, or the headlines if none is named."""
    if not scores:
        return comparison.summary_rows
    rows = {row.name: row for row in (*comparison.summary_rows, *other_score_rows(run, comparison.summaries))}
    for row in comparison.summary_rows:
        rows.setdefault(row.title, row)
    if unknown := [name for name in scores if name not in rows]:
        raise BadInput(f"report latex: scores: no column {unknown[0]!r} in this run; give some of: {', '.join(rows)}")
    return [rows[name] for name in scores]


def _column_title(line: SummaryRow) -> str:
    """Return the title of a column, on two lines if it names a metric or has parentheses, with its unit."""
    unit = "\\%" if line.rate else escape_latex(line.column.unit)
    words = escape_latex(line.title.replace("_", " ")) + (f", {unit}" if unit else "")
    return words.replace(" (", r"\\(").replace(".", r"\\")


def _value(line: SummaryRow, index: int, method: MethodSummary) -> str:
    """Return one number of a method above its interval; its quality is marked if it is in the leading group."""
    one = line.shown[index]
    if one is None or one.value is None:
        return "--"
    value = f"{100 * one.value:.0f}" if line.rate else _mathematical(format_number(one.value))
    if method.leading and line.name == RANKING and not line.variant:
        value = rf"\nrb{'Best' if method.rank == 1 else 'Tie'}{{{value}}}"
    part = rf" \textit{{/{one.n}}}" if line.rate or one.n < one.of else ""
    return _stacked(value + part, _mathematical(format_interval(one, as_percent=line.rate)))


def _stacked(value: str, ends: str) -> str:
    """Return a value above its interval."""
    return rf"\shortstack[r]{{{value}\\[-1pt]\scriptsize {ends}}}" if ends else value


def _mathematical(text: str) -> str:
    return re.sub("[\u2212\u2013\u221e]", lambda match: _SPECIAL[match[0]], text)


def _comparison(run: Run, comparison: Comparison, columns: int) -> Iterator[str]:
    signs = ", ".join(rf"\nrb{_MARKS[name][0]}{{}} {name}" for _, name in comparison.legend)
    score = "quality" if comparison.score == QUALITY else "share of tiles in place"
    caption = (
        f"{_suite(run)}: is the lattice preserved? {signs}. Beside the mark: {score}. "
        f"Share: regular share of the texture. {_signs(comparison)}"
    )
    rows: list[str] = []
    for start in range(0, len(comparison.methods), columns):
        rows += [r"\midrule"] if rows else []
        rows += _block(comparison, start, min(start + columns, len(comparison.methods)), columns)
    yield from _float("comparison", caption, "lr" + "l" * min(columns, len(comparison.methods)), rows)


def _block(comparison: Comparison, start: int, stop: int, columns: int) -> Iterator[str]:
    blank = [""] * (min(columns, len(comparison.methods)) - (stop - start))
    heads = [_method(one) for one in comparison.summaries[start:stop]]
    yield _line(["texture", "share", *heads, *blank])
    yield r"\midrule"
    for row in comparison.rows:
        share = "--" if row.regular_share is None else f"{row.regular_share:.2f}"
        yield _line([escape_latex(row.texture), share, *map(_entry, row.entries[start:stop]), *blank])


def _entry(entry: Entry | None) -> str:
    if entry is None:
        return ""
    sign = r"\nrbValidBaseline{}" if entry.baseline_valid else ""
    return rf"\nrb{_MARKS[entry.verdict][0]}{{}} {escape_latex(entry.detail)}".rstrip() + sign


def _published(run: Run, published: PublishedComparison) -> Iterator[str]:
    names = [_published_method(method) for method in published.methods]
    for regular, number, words in ((True, 2, "regular textures"), (False, 3, "near-regular textures")):
        rows = published.table(regular)
        if not rows:
            continue
        lines = [_line(["figure", "description", *names]), r"\midrule"]
        for row in rows:
            places = [_published_place(row, i, method) for i, method in enumerate(published.methods)]
            lines.append(_line([str(row.figure.number), escape_latex(row.figure.description), *places]))
        caption = (
            f"{_suite(run)}: the report's table {number}, {words}. The published verdict, then the measured one: "
            rf"\nrbPreserved{{}} preserved, \nrbLost{{}} lost, \nrbUndecided{{}} no verdict, a number: share of "
            rf"replicates that preserve, in percent; \nrbRefused{{}}: the report did not run it. {SENTENCE}"
        )
        yield from _float(f"published-{number}", caption, "rl" + "c" * len(names), lines)
    heads = ["figures", "method", "published, all", "published", "measured", "difference"]
    lines = [_line(heads), r"\midrule"]
    for one in published.rates:
        rates = [_rate(rate) for rate in (one.published, one.same, one.measured)]
        difference = _mathematical(f"{format_signed(one.difference.value)} {format_interval(one.difference)}".rstrip())
        lines.append(_line([escape_latex(one.group), _published_method(one.method), *rates, difference]))
    caption = (
        f"{_suite(run)}: success rates in percent as published and as measured. The last three columns rest on the "
        "same n figures, those with a measured verdict; the difference is a share from $-1$ to 1. "
        "95\\,\\% bootstrap intervals over figures, Wilson's for rates if all figures agree. "
        f"{SENTENCE}"
    )
    yield from _float("published-rates", caption, "llrrrr", lines)


def _published_method(method: Method) -> str:
    return escape_latex(method.name) + (r"\nrbGiven{}" if method.lattice_source == "given" else "")


def _published_place(row: FigureRow, index: int, method: Method) -> str:
    word, share = row.figure.verdicts.get(method.base), row.measured[index]
    known = {1.0: "preserved", 0.0: "lost", None: "undecided"}
    marks = [_MARKS[name][0] if name else None for name in (word or "refused", known.get(share))]
    return " ".join(rf"\nrb{mark}{{}}" if mark else f"{100 * (share or 0):.0f}" for mark in marks)


def _rate(one: Estimate) -> str:
    if one.value is None:
        return "--"
    ends = _mathematical(format_interval(one, as_percent=True))
    return rf"{100 * one.value:.0f} {ends} \textit{{/{one.n}}}"


def _patches(run: Run, terms: Sequence[PatchTerms]) -> Iterator[str]:
    caption = f"{_suite(run)}: how methods that copy patches choose their shape and size, place them and stitch them."
    rows = [_line(["method", "patch shape/size", "patch placement", "patch stitching"]), r"\midrule"]
    rows += [
        _line([escape_latex(part) for part in (one.method, one.shape, one.placement, one.stitching)]) for one in terms
    ]
    yield from _float("patches", caption, "l" + r"p{0.26\linewidth}" * 3, rows)


def _suite(run: Run) -> str:
    suite = run.info.get("suite", {})
    return escape_latex(f"{suite.get('name', 'run')} {suite.get('version', '')} ({suite.get('hash', 'no hash')})")


def _signs(comparison: Comparison) -> str:
    signs = r"\nrbReference{} reference, never ranked. \nrbGiven{} the method received the true lattice."
    valid = rf" \nrbValidBaseline{{}} {BASELINE_LEGEND} ({SHARES_LEGEND})."
    return signs + valid * comparison.has_valid_baseline
