"""Write the comparison as LaTeX tables for a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from nrbench.errors import BadInput, strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .page.environment import make_environment
from .statistics.expectations import PublishedComparison, compare_with_published
from .statistics.format import break_name
from .statistics.frames import (
    PrintedTable,
    cell_text,
    method_classes,
    print_methods,
    print_patches,
    print_published,
    print_rates,
    print_textures,
)
from .statistics.method_comparison import Comparison, ComparisonOptions, Entry, choose_rows, restrict_comparison
from .statistics.summaries import MethodSummary, Number, SummaryRow

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
_WIDTHS: Mapping[str, float] = {"column": 229.0, "text": 345.0, "page": 469.0}
"""What tables must fit, pt: the widths of LaTeX's own class ``article`` at 10 pt."""
_GAP = 8.0
"""Space between columns, pt."""
_MARK, _RAISED = 15.0, 12.0
"""Widths of the mark of a verdict, and of the raised marks of a method, pt."""
_PAGE_LINES = 58
"""Lines of a table that a page has room for."""
_LEAST_CAPTION, _COLUMN_CAPTION = 8, 25
"""Such lines that the long caption takes, across the page or in one column, and in a column of two."""
_LINE_LETTERS = 12
_NARROW, _BROAD = frozenset(" .,:;()[]|'!ijltfrI/"), frozenset("mw%≤±–")
_DELIMITERS = {
    **{"block_start_string": "<%", "block_end_string": "%>", "variable_start_string": "<<"},
    **{"variable_end_string": ">>", "comment_start_string": "<#", "comment_end_string": "#>"},
}


@dataclass(frozen=True)
class LatexTables(ComparisonOptions):
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
        Methods side by side in ``comparison.tex``, at least 1, or fewer if no more fit; further methods follow below.
    scores
        The columns of ``summary.tex``, by the names of the rows in ``summary.csv``; by default the headlines.
    methods, textures
        The methods of both tables and the textures of ``comparison.tex``, by names or patterns such as ``brick-*``;
        by default all. Ranks and means remain those of the whole run.
    width
        What the tables must fit: ``column``, 229 pt, a column of a two-column article; ``text``, 345 pt, the page of
        an article; ``page``, 469 pt, the page of a two-column article, as ``table*``. Columns that do not fit follow
        below, and what is too high for a page follows in a further table. ``patches.tex`` and ``published.tex`` are
        never narrower than ``text``.
    intervals
        Whether ``summary.tex`` has intervals.
    bare
        Whether files hold the ``tabular`` alone, for a float and a caption of the paper's own; the caption is then a
        comment.
    """

    columns: int = 6
    scores: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    textures: tuple[str, ...] = ()
    width: Literal["column", "text", "page"] = "text"
    intervals: bool = True
    bare: bool = False

    version: ClassVar[str] = "2"
    folder: ClassVar[str] = "tables"

    def __post_init__(self) -> None:
        for name in ("scores", "methods", "textures"):
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))
        if self.columns < 1:
            raise BadInput(f"report latex: columns is {self.columns}; give at least 1")
        if self.width not in _WIDTHS:
            raise BadInput(f"report latex: width is {self.width!r}; give one of {', '.join(_WIDTHS)}")

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
            texts["summary.tex"] = self._fill(shown, [methods], left_out)
            texts["comparison.tex"] = self._fill(shown, [print_textures(shown)], left_out)
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
        suite = comparison.run.info.get("suite", {})
        broken = partial(break_name, letters=_LINE_LETTERS)
        filters: dict[str, Any] = {"tex": escape_latex, "column_title": column_title, "break_name": broken}
        return (
            make_environment(filters, **_DELIMITERS)
            .get_template("tables.tex")
            .render(
                tables=[(table, self._lay_out(table)) for table in tables],
                report=self,
                comparison=comparison,
                published=published,
                left_out=left_out,
                suite=f"{suite.get('name', 'run')} {suite.get('version', '')} ({suite.get('hash', 'no hash')})",
            )
        )

    def _lay_out(self, table: PrintedTable) -> list[list[list[int]]]:
        """Return the columns of each block of each part of a table that fits a page.

        Columns that do not fit follow in further blocks below, and what is too high for a page in further parts. The
        first part has the long caption, which takes more lines in a column than across the page.
        """
        columns = zip(map(_head_width, table.heads), *(map(_cell_width, row) for row in table.rows), strict=True)
        widths = [max(column) + _GAP for column in columns]
        most, limit = self.columns if table.name == "comparison" else 1000, _WIDTHS[self.width] + _GAP
        blocks = table.split(widths, limit, most)
        lines = (1 + (self.intervals and table.name == "summary")) * len(table.rows) + 5
        size = max(1, (_PAGE_LINES - _LEAST_CAPTION) // lines)
        caption = _COLUMN_CAPTION if self.width == "column" else _LEAST_CAPTION
        first = max(1, (_PAGE_LINES - caption) // lines)
        parts = [blocks[:first], *(blocks[i : i + size] for i in range(first, len(blocks), size))]
        return parts


def _head_width(head: Any) -> float:
    """Return about the width of the head of a column, pt."""
    name = head.method.name if isinstance(head, MethodSummary) else str(getattr(head, "name", head))
    text = column_title(head) if isinstance(head, SummaryRow) else name
    mark = _RAISED if isinstance(head, MethodSummary) else 0.0
    return max(map(_text_width, break_name(text, _LINE_LETTERS))) + mark


def _cell_width(cell: Any) -> float:
    """Return about the width of a cell, pt."""
    if isinstance(cell, MethodSummary):
        return _text_width(cell.method.name) + 2 * _RAISED
    if isinstance(cell, Number):
        count = f" /{cell.shown.n}" if cell.partial else ""
        return max(_text_width(cell.text + count), 0.9 * _text_width(cell.interval))
    return _MARK + _text_width(cell.detail) if isinstance(cell, Entry) else _text_width(cell_text(cell))


def _text_width(text: str) -> float:
    """Return about the width of text in Computer Modern of 8 pt, pt."""
    return sum(2.6 if letter in _NARROW else 6.6 if letter in _BROAD or letter.isupper() else 4.4 for letter in text)


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
