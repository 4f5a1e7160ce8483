from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from nrbench.errors import BadInput
from nrbench.reports.text import TextTable
from nrbench.runs.records import Run

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def text(every_ending: Run) -> str:
    """Return the table of a run with every status, as the terminal shows it."""
    return TextTable().render(every_ending)


def test_no_line_is_wider_than_the_width(every_ending: Run, text: str) -> None:
    """Lines keep to the width; methods that do not fit follow below."""
    for width, table in (
        (40, TextTable(40).render(every_ending)),
        (60, TextTable(60).render(every_ending)),
        (120, text),
    ):
        assert max(map(len, table.splitlines())) <= width
        assert table.count("given") >= 1


def test_it_has_no_escapes_and_no_markup(make_cell: Make, make_run: Make) -> None:
    """Names are printed as they are: no markup, no colors, no terminal escapes from a method's note."""
    run = make_run([make_cell("[bold]b[/bold]:smile:", note="\x1b[31mred\x1b[0m\x07")])
    text = TextTable().render(run)
    assert "[bold]b[/bold]:smile:" in text
    assert "¹ red" in text
    assert not {"\x1b", "\x07"} & set(text)


def test_an_empty_run_says_so(make_run: Make) -> None:
    """A run without cells gives one sentence."""
    assert "There are no cells." in TextTable().render(make_run([]))


def test_a_single_failed_cell_is_a_table(make_cell: Make, make_run: Make) -> None:
    """A run of one failed cell gives a table with its status."""
    text = TextTable().render(make_run([make_cell(status="crash", message="signal 11")]))
    assert "! crash" in text
    assert "0 % (0/1)" in text


def test_a_width_too_small_is_refused() -> None:
    """A width below 40 is an error that states the minimum."""
    with pytest.raises(BadInput, match="at least 40"):
        TextTable(10)


def test_reasons_are_counted(every_ending: Run) -> None:
    """Each distinct reason for which cells have no verdict stands under the table, with the number of its cells."""
    text = TextTable(width=200).render(every_ending)
    assert "? 1 cell undecided: undecided: too little power" in text
    assert "(!) 1 cell unscored: failed: KeyError: 'x'" in text
    assert "N/A 1 cell refused: refused in score: refused because of" in text


def test_columns_of_choice(every_ending: Run) -> None:
    """The table of methods has the named columns only; an unknown one is refused with the nearest name."""
    text = TextTable(width=200, columns=("randomness.variation", "seconds")).render(every_ending)
    head = next(line for line in text.splitlines() if line.startswith("method") or " method " in line)
    assert "variation" in head and "seconds" in head and "score" not in head
    with pytest.raises(BadInput, match="did you mean 'seconds'"):
        TextTable(columns=("second",)).render(every_ending)
