"""Write the comparison as LaTeX tables for a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from nrbench.errors import BadInput, strip_control
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .page.environment import make_environment
from .page.method_terms import list_patch_terms, method_classes
from .statistics.expectations import compare_with_published
from .statistics.method_comparison import Comparison, choose_rows, compare_methods
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
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    columns: int = 6
    scores: tuple[str, ...] = ()
    tests: bool = True
    baseline: str = ""
    population: bool = False

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def __post_init__(self) -> None:
        object.__setattr__(self, "scores", tuple(self.scores))
        if self.columns < 1:
            raise BadInput(f"report latex: columns is {self.columns}; give at least 1")

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; without a regularity score only ``patches.tex``, if at all."""
        comparison, terms = compare_methods(run, self.tests, self.baseline, self.population), list_patch_terms(run)
        texts = {"patches.tex": _fill(run, comparison, "patches", patch_terms=terms)} if terms else {}
        if comparison.scored and comparison.rows:
            texts["summary.tex"] = latex_text(run, comparison, self.scores)
            texts["comparison.tex"] = _fill(run, comparison, "comparison", columns=self.columns)
            if published := compare_with_published(run, comparison):
                texts["published.tex"] = _fill(run, comparison, "published", published=published)
        if entries := bibliography(run):
            texts["methods.bib"] = f"{entries}\n"
        for name, text in texts.items():
            write_text(directory / name, text)
        return [directory / name for name in texts]


def latex_text(run: Run, comparison: Comparison, scores: Sequence[str] = ()) -> str:
    """Return the table of methods by scores, with the definitions of its marks."""
    return _fill(run, comparison, "summary", lines=choose_rows(run, comparison, scores))


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
        {"tex": escape_latex, "column_title": _column_title},
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
        **content,
    )


def _column_title(line: SummaryRow) -> str:
    """Return the title of a column with its unit."""
    unit = "%" if line.rate else line.column.unit
    return line.title.replace("_", " ") + (f", {unit}" if unit else "")
