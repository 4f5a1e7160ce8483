from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nrbench.labelling.labels import ANSWERS, LabelPage, make_page, verdict_as_answer, write_key
from nrbench.reports.html import HtmlReport
from nrbench.reports.statistics.people import agreement_table, compare_people, labels_table
from nrbench.runs.records import Run

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def judged(makers: tuple[Make, Make]) -> Run:
    """Return a run of ten textures by four methods, half of the outputs preserved."""
    make_cell, make_run = makers
    cells = [
        make_cell(f"t{i}", f"m{j}", preserved=(i + j) % 2 == 0, score=0.9 if (i + j) % 2 == 0 else 0.3)
        for i in range(10)
        for j in range(4)
    ]
    run: Run = make_run(cells)
    return run


def _file(path: Path, sheet: LabelPage, said: Sequence[str]) -> Path:
    with path.open("w", newline="") as file:
        rows = [[item.id, answer, 1.0, i] for i, (item, answer) in enumerate(zip(sheet.items, said, strict=True), 1)]
        csv.writer(file).writerows([["item", "answer", "seconds", "order"], *rows])
    return path


def _person(run: Run, path: Path, wrong: Callable[[int, bool], str | None], repeat: float = 0.0) -> Path:
    """Write a person who answers as the judge does, except where ``wrong(number, again)`` says something else."""
    sheet = make_page(run, repeat=repeat)
    write_key(run.root, sheet)
    judge = {record.key: verdict_as_answer(record) for record in run.cells}
    said = [wrong(i, item.again) or judge[item.cell] for i, item in enumerate(sheet.items)]
    return _file(path, sheet, said)


def test_full_agreement_is_one(judged: Run, tmp_path: Path) -> None:
    """A person who says what the judge says has kappa 1 with a point for an interval, and nothing is disputed."""
    found = compare_people(judged, [_person(judged, tmp_path / "a.csv", lambda i, again: None)])
    assert found is not None
    (one,) = found.judged
    assert (one.kappa.value, one.kappa.low, one.kappa.high, one.equal, one.n) == (1.0, 1.0, 1.0, 1.0, 40)
    assert found.disagreements == [] and found.between == []


def test_known_kappa(judged: Run, tmp_path: Path) -> None:
    """Turning ten of forty even answers round leaves 0.75 equal: kappa 0.5 within what the odds of the ten allow."""
    judge = {record.key: verdict_as_answer(record) for record in judged.cells}
    sheet = make_page(judged, repeat=0)
    turned = {"preserved": "lost", "lost": "preserved"}
    kinds = {word: [i for i, item in enumerate(sheet.items) if judge[item.cell] == word] for word in turned}
    chosen = {*kinds["preserved"][:5], *kinds["lost"][:5]}
    path = _person(
        judged, tmp_path / "a.csv", lambda i, again: turned[judge[sheet.items[i].cell]] if i in chosen else None
    )
    found = compare_people(judged, [path])
    assert found is not None
    assert found.judged[0].kappa.value == pytest.approx(0.5)
    assert found.judged[0].table == [[15, 5, 0], [5, 15, 0], [0, 0, 0]]
    assert len(found.disagreements) == 10 and all(one.opposite for one in found.disagreements)


def test_who_cannot_say_counts_against_kappa_but_not_among_the_decided(judged: Run, tmp_path: Path) -> None:
    """Five times "cannot say" lowers kappa; over items that both decide it stays 1; the disputes come as not plain."""
    path = _person(judged, tmp_path / "a.csv", lambda i, again: "cannot say" if i < 5 else None)
    found = compare_people(judged, [path])
    assert found is not None
    one = found.judged[0]
    assert one.kappa.value is not None and one.kappa.value < 1
    assert one.decided.value == 1.0
    assert [dispute.opposite for dispute in found.disagreements] == [False] * 5


def test_self_agreement_looks_at_second_showings_only(judged: Run, tmp_path: Path) -> None:
    """A person who changes every second answer agrees with the judge in full and with themself not at all."""
    other = {"preserved": "lost", "lost": "preserved"}
    judge = {record.key: verdict_as_answer(record) for record in judged.cells}
    sheet = make_page(judged, repeat=0.5)
    said = lambda i, again: other[judge[sheet.items[i].cell]] if again else None  # noqa: E731
    found = compare_people(judged, [_person(judged, tmp_path / "a.csv", said, repeat=0.5)])
    assert found is not None
    assert found.judged[0].equal == 1.0
    assert (found.selves[0].n, found.selves[0].equal) == (20, 0.0)


def test_several_people_have_a_mean(judged: Run, tmp_path: Path) -> None:
    """With three people there is the judge with each and with all, every pair and the mean over pairs."""
    rng = np.random.default_rng(0)
    files = [
        _person(
            judged, tmp_path / f"{name}.csv", lambda i, again: ANSWERS[rng.integers(2)] if rng.random() < 0.4 else None
        )
        for name in "abc"
    ]
    found = compare_people(judged, files)
    assert found is not None
    table = agreement_table(found)
    assert list(table["kind"]) == ["judge and people"] * 4 + ["people"] * 4 + ["self"] * 3
    means = table[table["second"] == "mean of 3"]["kappa"].tolist()
    each = table.groupby("kind", sort=False)["kappa"].apply(lambda one: one.iloc[:3].mean()).tolist()
    assert means == pytest.approx(each[:2])
    assert len(labels_table(judged, files)) == 120


def test_the_page_shows_every_dispute(judged: Run, tmp_path: Path) -> None:
    """Each disputed output is on the page as a picture with the judge's numbers and everybody's answer."""
    path = _person(judged, tmp_path / "ada.csv", lambda i, again: "cannot say" if i < 3 else None)
    page = HtmlReport(labels=(path,)).render(judged, tmp_path)
    assert page.count('class="disagreement') == 3
    assert page.count("· ada: cannot say") == 3
    assert 'href="#people"' in page


def test_without_files_there_is_no_section(judged: Run, tmp_path: Path) -> None:
    """No labels, no section."""
    assert compare_people(judged, []) is None
    assert 'id="people"' not in HtmlReport().render(judged, tmp_path)
