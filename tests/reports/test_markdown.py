from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nrbench.reports.markdown import MarkdownTables, escape_markdown
from nrbench.runs.records import Run

Make = Callable[..., Any]


def _rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[part.strip() for part in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


@pytest.fixture(scope="module")
def text(every_ending: Run) -> str:
    """Return the tables of a run with every status."""
    return MarkdownTables().render(every_ending)


def test_nothing_in_a_name_is_markup() -> None:
    """Links, pictures, emphasis, code, HTML, mentions and addresses read as they are."""
    assert escape_markdown("[a](b) ![c](d) *e* _f_ `g` <h> i|j @k") == (
        r"\[a\](b) !\[c\](d) \*e\* \_f\_ \`g\` \<h\> i\|j \@k"
    )
    assert escape_markdown("http://x www.y") == r"http\://x www\.y"
    assert escape_markdown("a\nb\x1b[1m") == "a b"


def test_tables_are_even(text: str) -> None:
    """Every line of a table has as many entries as its title line, hostile names included."""
    rows = _rows(text)
    second = next(i for i, row in enumerate(rows) if row[0] == "texture")
    third = next(i for i, row in enumerate(rows) if "patch placement" in row)
    for table, least in ((rows[:second], 4), (rows[second:third], 4), (rows[third:], 3)):
        assert len(table) >= least
        assert {len(row) for row in table} == {len(table[0])}


def test_no_hostile_markup_survives(text: str) -> None:
    """The text contains no HTML tag but footnote marks."""
    assert set(re.findall(r"(?<!\\)<(\w+)", text)) == {"sup"}


def test_an_empty_run_says_so(make_run: Make, tmp_path: Path) -> None:
    """A run without cells gives one sentence."""
    (path,) = MarkdownTables().write(make_run([]), tmp_path)
    assert "There are no cells." in path.read_text("utf-8")
