"""Write the comparison as LaTeX tables for a paper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from nrbench.errors import BadInput, strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .page.environment import make_environment
from .page.method_terms import list_patch_terms, method_classes
from .statistics.expectations import compare_with_published
from .statistics.format import break_name
from .statistics.method_comparison import Comparison, choose_rows, compare_methods
from .statistics.selection import restrict_comparison
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
_WIDTHS: Mapping[str, float] = {"column": 229.0, "text": 345.0, "page": 469.0}
"""What tables must fit, pt: the widths of LaTeX's own class ``article`` at 10 pt."""
_GAP = 8.0
"""Space between columns, pt."""
_RAISED = 12.0
"""Width of the raised marks of a method, pt."""
_PAGE_LINES = 58
"""Lines of a table that a page has room for."""
_LEAST_CAPTION, _COLUMN_CAPTION = 8, 25
"""Such lines that the long caption takes, across the page or in one column, and in a column of two."""
_LINE_LETTERS = 12
_NARROW, _BROAD = frozenset(" .,:;()[]|'!ijltfrI/"), frozenset("mw%≤±–")


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
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    columns: int = 6
    scores: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    textures: tuple[str, ...] = ()
    width: Literal["column", "text", "page"] = "text"
    intervals: bool = True
    bare: bool = False
    tests: bool = True
    baseline: str = ""
    population: bool = False

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
        comparison, terms = compare_methods(run, self.tests, self.baseline, self.population), list_patch_terms(run)
        style: dict[str, Any] = {"width": self.width, "bare": self.bare}
        wide = {**style, "width": "page" if self.width == "column" else self.width}
        texts = {"patches.tex": _fill(run, comparison, "patches", patch_terms=terms, **wide)} if terms else {}
        if comparison.scored and comparison.rows:
            shown = restrict_comparison(comparison, self.methods, self.textures)
            if len(shown.methods) < len(comparison.methods):
                style["left_out"] = f"{len(shown.methods)} of the run's {len(comparison.methods)} methods."
            texts["summary.tex"] = latex_text(run, shown, self.scores, self.intervals, **style)
            parts = _comparison_parts(shown, self.columns, _WIDTHS[self.width])
            texts["comparison.tex"] = _fill(run, shown, "comparison", parts=parts, **style)
            if published := compare_with_published(run, comparison):
                texts["published.tex"] = _fill(run, comparison, "published", published=published, **wide)
        if entries := bibliography(run):
            texts["methods.bib"] = f"{entries}\n"
        for name, text in texts.items():
            write_text(directory / name, text)
        return [directory / name for name in texts]


def latex_text(
    run: Run,
    comparison: Comparison,
    scores: Sequence[str] = (),
    intervals: bool = True,
    width: str = "text",
    **style: Any,
) -> str:
    """Return the table of methods by scores, with the definitions of its marks."""
    lines = choose_rows(run, comparison, scores)
    widths = [max(_score_widths(line, intervals)) for line in lines]
    limit = _WIDTHS[width]
    parts = _split(_blocks(widths, _names_width(comparison), limit), len(comparison.summaries) * (1 + intervals), limit)
    return _fill(run, comparison, "summary", lines=lines, parts=parts, intervals=intervals, width=width, **style)


def _comparison_parts(comparison: Comparison, columns: int, limit: float) -> list[list[list[int]]]:
    """Return the tables of ``comparison.tex``, each as blocks of methods."""
    names = max(map(_text_width, ("texture", *(row.texture for row in comparison.rows)))) + _GAP + _text_width("share")
    heads = [max(map(_text_width, break_name(one.name, _LINE_LETTERS))) + _RAISED for one in comparison.methods]
    columns_of = [[row.entries[i] for row in comparison.rows] for i in range(len(comparison.methods))]
    entries = [max((15 + _text_width(one.detail) for one in column if one), default=0) for column in columns_of]
    blocks = _blocks(list(map(max, heads, entries)), names, limit, columns)
    return _split(blocks, len(comparison.rows), limit)


def _score_widths(line: SummaryRow, intervals: bool) -> Iterator[float]:
    """Yield the widths of the lines of a column of ``summary.tex``, pt."""
    for piece in break_name(_column_title(line), _LINE_LETTERS):
        yield _text_width(piece)
    for value, interval, shown in zip(line.values, line.intervals, line.shown, strict=True):
        count = shown is not None and (line.rate or shown.n < shown.of)
        yield _text_width(f"{value} /{shown.n}" if shown is not None and count else value)
        yield 0.9 * _text_width(interval) if intervals else 0.0


def _names_width(comparison: Comparison) -> float:
    return max(_text_width(one.name) for one in comparison.methods) + 2 * _RAISED


def _blocks(widths: Sequence[float], first: float, limit: float, most: int = 1000) -> list[list[int]]:
    """Return the numbers of columns in blocks that fit the width behind a ``first`` column, at least one in each."""
    blocks: list[list[int]] = []
    left = 0.0
    for index, width in enumerate(widths):
        left -= width + _GAP
        if left < 0 or len(blocks[-1]) == most:
            blocks.append([])
            left = limit - first - width - _GAP
        blocks[-1].append(index)
    return blocks


def _split(blocks: Sequence[list[int]], lines: int, limit: float) -> list[list[list[int]]]:
    """Return blocks of some lines in tables that fit the height of a page, at least one block in each.

    The first table has the long caption, which takes more lines in a column than across the page.
    """
    size = max(1, (_PAGE_LINES - _LEAST_CAPTION) // (lines + 5))
    caption = _COLUMN_CAPTION if limit == _WIDTHS["column"] else _LEAST_CAPTION
    first = max(1, (_PAGE_LINES - caption) // (lines + 5))
    return [list(blocks[:first]), *(list(blocks[i : i + size]) for i in range(first, len(blocks), size))]


def _text_width(text: str) -> float:
    """Return about the width of text in Computer Modern of 8 pt, pt."""
    return sum(2.6 if letter in _NARROW else 6.6 if letter in _BROAD or letter.isupper() else 4.4 for letter in text)


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


def _fill(run: Run, comparison: Comparison, table: str, **content: Any) -> str:
    """Return the file of a table; the delimiters of its template leave braces and percent signs to LaTeX."""
    environment = make_environment(
        {"tex": escape_latex, "column_title": _column_title, "break_name": partial(break_name, letters=_LINE_LETTERS)},
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
    )
    suite = run.info.get("suite", {})
    return environment.get_template("tables.tex").render(
        table=table,
        comparison=comparison,
        suite=f"{suite.get('name', 'run')} {suite.get('version', '')} ({suite.get('hash', 'no hash')})",
        **{"left_out": "", "width": "text", "bare": False, **content},
    )


def _column_title(line: SummaryRow) -> str:
    """Return the title of a column with its unit."""
    unit = "%" if line.rate else line.column.unit
    return line.title.replace("_", " ") + (f", {unit}" if unit else "")
