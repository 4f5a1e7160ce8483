from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nrbench.errors import BadInput
from nrbench.reports.latex import LatexTables, escape_latex
from nrbench.runs.records import Run

Make = Callable[..., Any]


def _written(run: Run, directory: Path, columns: int = 6) -> dict[str, str]:
    return {path.stem: path.read_text("utf-8") for path in LatexTables(columns).write(run, directory)}


@pytest.fixture(scope="module")
def written(every_ending: Run) -> dict[str, str]:
    """Return the tables of a run with every status, by name."""
    return _written(every_ending, every_ending.root / "latex")


def test_special_characters_are_escape_latex() -> None:
    """Special characters are escaped; line breaks and terminal escapes are removed."""
    assert escape_latex("a_b & 50% of $x #1 {y} ~^\\") == (
        r"a\_b \& 50\% of \$x \#1 \{y\} \textasciitilde{}\textasciicircum{}\textbackslash{}"
    )
    assert escape_latex("a\n\x1b[31mb\tc") == "a b c"
    assert escape_latex("--") == "{-}{-}"


def test_tables_are_booktabs_and_closed(written: dict[str, str]) -> None:
    """Each file is one booktabs table with balanced braces and equally many columns in every line."""
    for text in (text for name, text in written.items() if name != "methods"):
        for rule in (r"\toprule", r"\midrule", r"\bottomrule"):
            assert rule in text
        bare = re.sub(r"\\[{}]", "", text)
        assert bare.count("{") == bare.count("}")
        lines = [re.sub(r"\\&", "", line) for line in text.splitlines() if line.endswith(r" \\")]
        assert len({line.count(" & ") for line in lines}) == 1


def test_references_and_given_lattices_are_marked(written: dict[str, str]) -> None:
    """A reference has a dagger, a method that received the lattice a g, a method that found it neither."""
    text = written["summary"]
    assert r"\textit{oracle}\nrbReference{} &" in text
    assert r"rsgf\nrbGiven{} &" in text
    assert "\nrsgf &" in text


def test_a_detector_is_named(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """A lattice that a detector found is marked by the detector's name."""
    text = _written(make_run([make_cell(lattice_source="gncc")]), tmp_path)["summary"]
    assert r"rsgf\textsuperscript{gncc} &" in text


def test_many_methods_follow_below(every_ending: Run, tmp_path: Path) -> None:
    """Methods beyond the number of columns follow in further blocks, which repeat every texture."""
    text = _written(every_ending, tmp_path, columns=2)["comparison"]
    assert text.count(r"brick & ") == 2 and text.count("texture & share") == 2


def test_columns_are_checked(make_run: Make, tmp_path: Path) -> None:
    """Fewer than one column is an error; a run without cells writes no file."""
    with pytest.raises(BadInput, match="give at least 1"):
        LatexTables(columns=0)
    assert LatexTables().write(make_run([]), tmp_path) == []


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdfLaTeX")
def test_pdflatex_reads_it(every_ending: Run, tmp_path: Path) -> None:
    """A paper with booktabs alone compiles with both tables, hostile names included."""
    paths = LatexTables().write(every_ending, tmp_path)
    body = "\n".join(rf"\input{{{path.name}}}" for path in paths)
    head = "\\documentclass{article}\n\\usepackage[T1]{fontenc}\n\\usepackage{booktabs}\n\\begin{document}\n"
    (tmp_path / "paper.tex").write_text(f"{head}{body}\n\\end{{document}}\n")
    line = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-draftmode", "paper.tex"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, timeout=60)
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:]
