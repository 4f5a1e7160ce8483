"""Write the comparison as LaTeX tables for a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

from nrbench.errors import strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .statistics.expectations import PublishedComparison, compare_with_published
from .statistics.format import break_name, make_environment
from .statistics.frames import (
    PrintedTable,
    method_classes,
    print_improvements,
    print_methods,
    print_parameters,
    print_patches,
    print_published,
    print_rates,
    print_textures,
)
from .statistics.method_comparison import Comparison, ComparisonOptions, choose_rows, restrict_comparison
from .statistics.summaries import SummaryRow

_SPECIAL: Mapping[str, str] = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedbl{}", "'": r"{'}", "`": r"{`}", "-": "{-}",
    "[": "{[}", "]": "{]}", "*": "{*}",
    "\u2212": "$-$", "\u2013": "--", "\u2026": r"\dots{}", "\u221e": r"$\infty$",
    "\u00d7": r"$\times$", "\u00b0": r"$^\circ$", "\u2264": r"$\le$",
}  # fmt: skip
_LAST_LATIN = 0x17F
"""The last letter that every LaTeX prints with T1 fonts."""
_COLUMNS: Mapping[str, int] = {"column": 2, "text": 5, "page": 7}
"""Columns of scores or methods beside each other in a table of each width."""
_DELIMITERS = {
    **{"block_start_string": "<%", "block_end_string": "%>", "variable_start_string": "<<"},
    **{"variable_end_string": ">>", "comment_start_string": "<#", "comment_end_string": "#>"},
}


@dataclass(frozen=True)
class LatexTables(ComparisonOptions):
    r"""Tables for ``\input`` in a paper.

    ``summary.tex`` (methods by scores, and all parameters of the methods with a preset, a label or changed parameters),
    ``comparison.tex`` (textures by methods) and, for methods that copy patches, ``patches.tex`` (their shape, placement
    and stitching). If the run has methods with and without a preset, ``improvements.tex`` has them beside each other.

    If the run has analogues of the figures of the report of 2004, ``published.tex`` has its tables 2 and 3 with the
    published mark before the measured one, and the success rates over the same figures.

    They need ``\usepackage{booktabs}`` and ``\usepackage[T1]{fontenc}``, nothing else. Names are escaped. A dagger
    marks a reference, which is never ranked. A double dagger marks a baseline that is valid on that kind of texture. A
    raised g marks a method that received the true lattice; any other raised word is the detector that found its
    lattice. The marks are commands (``\nrbPreserved``, ``\nrbLost``, ``\nrbGiven``, ...). A paper can define its own
    before the input.

    Parameters
    ----------
    scores
        The columns of ``summary.tex``, by the names of the rows in ``summary.csv``; by default the headlines.
    methods, textures
        The methods of both tables and the textures of ``comparison.tex``, by names or patterns such as ``brick-*``;
        by default all. Ranks and means remain those of the whole run.
    width
        What the tables fit: ``column``, a column of a two-column article, with two columns of scores or methods;
        ``text``, the page of an article, with five; ``page``, the page of a two-column article, as ``table*``, with
        seven. Further columns follow in further tables. ``patches.tex``, ``improvements.tex`` and ``published.tex`` are
        not split, and never narrower than ``text``.
    intervals
        Whether ``summary.tex`` has intervals.
    bare
        Whether files hold the ``tabular`` alone, for a float and a caption of the paper's own; the caption is then a
        comment.
    """

    scores: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    textures: tuple[str, ...] = ()
    width: Literal["column", "text", "page"] = "text"
    intervals: bool = True
    bare: bool = False

    version: ClassVar[str] = "2"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; without a regularity score only ``patches.tex``, if at all."""
        comparison, patches = self.comparison(run), print_patches(run)
        wide = replace(self, width="page") if self.width == "column" else self
        texts = {"patches.tex": wide._fill(comparison, [patches])} if patches.rows else {}
        if comparison.scored and comparison.rows:
            shown = restrict_comparison(comparison, self.methods, self.textures)
            left = len(shown.methods) < len(comparison.methods)
            left_out = f"{len(shown.methods)} of the run's {len(comparison.methods)} methods." if left else ""
            methods = print_methods(shown, choose_rows(run, comparison, self.scores))
            texts["summary.tex"] = self._fill(shown, [methods, print_parameters(shown)], left_out)
            texts["comparison.tex"] = self._fill(shown, [print_textures(shown)], left_out)
            if (improvements := print_improvements(comparison)).rows:
                texts["improvements.tex"] = wide._fill(comparison, [improvements])
            if published := compare_with_published(run, comparison):
                tables = [*print_published(published), print_rates(published)]
                texts["published.tex"] = wide._fill(comparison, tables, published=published)
        if entries := bibliography(run):
            texts["methods.bib"] = f"{entries}\n"
        return write_files(directory, texts)

    def summary(self, comparison: Comparison) -> str:
        """Return the table of methods by scores, with the definitions of its marks."""
        return self._fill(comparison, [print_methods(comparison, choose_rows(comparison.run, comparison, self.scores))])

    def _fill(
        self,
        comparison: Comparison,
        tables: Sequence[PrintedTable],
        left_out: str = "",
        published: PublishedComparison | None = None,
    ) -> str:
        """Return the file of tables; the delimiters of its template leave braces and percent signs to LaTeX."""
        suite, columns = comparison.run.info.get("suite", {}), _COLUMNS[self.width]
        filters: dict[str, Any] = {
            **{"tex": escape_latex, "column_title": column_title, "stacked": _stack, "breakable": _breakable},
        }
        return (
            make_environment(filters, **_DELIMITERS)
            .get_template("tables.tex")
            .render(
                tables=[
                    (table, table.split_rows() if table.name == "improvements" else table.split_every(columns))
                    for table in tables
                    if table.rows
                ],
                report=self,
                comparison=comparison,
                published=published,
                left_out=left_out,
                suite=f"{suite.get('name', 'run')} {suite.get('version', '')} ({suite.get('hash', 'no hash')})",
            )
        )


def _stack(name: str, side: str, letters: int = 12, source: str = "none") -> str:
    """Return a name in lines of at most so many letters, with the source of the lattice raised behind it or below."""
    lines = [escape_latex(line) for line in break_name(name, letters)]
    found = [] if source in ("none", "own", "given") else break_name(source, letters)
    raised = [rf"\textsuperscript{{{escape_latex(line)}}}" for line in found]
    if source == "given" or len(source) < letters:
        lines[-1] += r"\nrbGiven{}" if source == "given" else "".join(raised)
        raised = []
    text = r"\\".join([*lines, *raised])
    return rf"\shortstack[{side}]{{{text}}}" if r"\\" in text else text


def _breakable(text: str) -> str:
    """Return escaped text in which LaTeX may also break words, behind signs."""
    return " ".join(r"\allowbreak{}".join(map(escape_latex, break_name(word, 12))) for word in text.split())


def column_title(line: SummaryRow) -> str:
    """Return the title of a column with its unit."""
    unit = "%" if line.rate else line.column.unit
    return line.title.replace("_", " ") + (f", {unit}" if unit else "")


def bibliography(run: Run) -> str:
    """Return the BibTeX entries of the papers of a run's methods, each once, in the order of the run."""
    papers = [getattr(cls, "paper", "") for cls in method_classes(run.cells).values()]
    return "".join(f"{strip_control(paper).strip()}\n\n" for paper in dict.fromkeys(papers) if paper).rstrip("\n")


def escape_latex(text: str) -> str:
    r"""Return text on one line, escaped so that LaTeX prints every character and makes no ligature.

    A letter that T1 fonts lack becomes ``\nrbUnicode{code}{letter}``.
    """
    return "".join(
        _SPECIAL.get(letter, letter if ord(letter) <= _LAST_LATIN else rf"\nrbUnicode{{{ord(letter):04X}}}{{{letter}}}")
        for letter in " ".join(strip_control(text).split())
    )
