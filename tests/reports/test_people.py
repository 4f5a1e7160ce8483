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


def _file(path: Path, sheet: LabelPage, answers: Sequence[str]) -> Path:
    with path.open("w", newline="") as file:
        rows = [[item.id, answer, 1.0, i] for i, (item, answer) in enumerate(zip(sheet.items, answers, strict=True), 1)]
        csv.writer(file).writerows([["item", "answer", "seconds", "order"], *rows])
    return path


def _person(run: Run, path: Path, wrong: Callable[[int, bool], str | None], repeat: float = 0.0) -> Path:
    """Write the answers of a person who repeats the verdicts unless ``wrong(number, again)`` gives another answer."""
    sheet = make_page(run, repeat=repeat)
    write_key(run.root, sheet)
    verdicts = {record.key: verdict_as_answer(record) for record in run.cells}
    answers = [wrong(i, item.again) or verdicts[item.cell] for i, item in enumerate(sheet.items)]
    return _file(path, sheet, answers)


def test_full_agreement_is_one(judged: Run, tmp_path: Path) -> None:
    """A person who agrees with every verdict has kappa 1, an interval of one point, and no disagreements."""
    comparison = compare_people(judged, [_person(judged, tmp_path / "a.csv", lambda i, again: None)])
    assert comparison is not None
    (one,) = comparison.with_verdict
    assert (one.kappa.value, one.kappa.low, one.kappa.high, one.equal, one.n) == (1.0, 1.0, 1.0, 1.0, 40)
    assert comparison.disagreements == [] and comparison.between == []


def test_known_kappa(judged: Run, tmp_path: Path) -> None:
    """A person who reverses 10 of 40 balanced verdicts has 0.75 equal answers and kappa 0.5."""
    verdicts = {record.key: verdict_as_answer(record) for record in judged.cells}
    sheet = make_page(judged, repeat=0)
    turned = {"preserved": "lost", "lost": "preserved"}
    kinds = {word: [i for i, item in enumerate(sheet.items) if verdicts[item.cell] == word] for word in turned}
    chosen = {*kinds["preserved"][:5], *kinds["lost"][:5]}
    path = _person(
        judged, tmp_path / "a.csv", lambda i, again: turned[verdicts[sheet.items[i].cell]] if i in chosen else None
    )
    comparison = compare_people(judged, [path])
    assert comparison is not None
    assert comparison.with_verdict[0].kappa.value == pytest.approx(0.5)
    assert comparison.with_verdict[0].table == [[15, 5, 0], [5, 15, 0], [0, 0, 0]]
    assert len(comparison.disagreements) == 10 and all(one.opposite for one in comparison.disagreements)


def test_cannot_say_lowers_kappa_but_not_kappa_of_the_decided(judged: Run, tmp_path: Path) -> None:
    """Five times "cannot say" lowers kappa; over items that both decide it stays 1; the disputes come as not plain."""
    path = _person(judged, tmp_path / "a.csv", lambda i, again: "cannot say" if i < 5 else None)
    comparison = compare_people(judged, [path])
    assert comparison is not None
    one = comparison.with_verdict[0]
    assert one.kappa.value is not None and one.kappa.value < 1
    assert one.decided.value == 1.0
    assert [dispute.opposite for dispute in comparison.disagreements] == [False] * 5


def test_self_agreement_counts_second_showings_only(judged: Run, tmp_path: Path) -> None:
    """A person who reverses all second answers agrees with every verdict and never with themself."""
    other = {"preserved": "lost", "lost": "preserved"}
    verdicts = {record.key: verdict_as_answer(record) for record in judged.cells}
    sheet = make_page(judged, repeat=0.5)
    answers = lambda i, again: other[verdicts[sheet.items[i].cell]] if again else None  # noqa: E731
    comparison = compare_people(judged, [_person(judged, tmp_path / "a.csv", answers, repeat=0.5)])
    assert comparison is not None
    assert comparison.with_verdict[0].equal == 1.0
    assert (comparison.selves[0].n, comparison.selves[0].equal) == (20, 0.0)


def test_several_people_have_a_mean(judged: Run, tmp_path: Path) -> None:
    """Three people give the verdict with each person, every pair of people, and the means of both."""
    rng = np.random.default_rng(0)
    files = [
        _person(
            judged, tmp_path / f"{name}.csv", lambda i, again: ANSWERS[rng.integers(2)] if rng.random() < 0.4 else None
        )
        for name in "abc"
    ]
    comparison = compare_people(judged, files)
    assert comparison is not None
    table = agreement_table(comparison)
    assert list(table["kind"]) == ["judge and people"] * 4 + ["people"] * 4 + ["self"] * 3
    means = table[table["second"] == "mean of 3"]["kappa"].tolist()
    each = table.groupby("kind", sort=False)["kappa"].apply(lambda one: one.iloc[:3].mean()).tolist()
    assert means == pytest.approx(each[:2])
    assert len(labels_table(judged, files)) == 120


def test_the_page_shows_every_disagreement(judged: Run, tmp_path: Path) -> None:
    """The page shows each disagreement with its pictures, scores and answers."""
    path = _person(judged, tmp_path / "ada.csv", lambda i, again: "cannot say" if i < 3 else None)
    page = HtmlReport(labels=(path,)).render(judged, tmp_path)
    assert page.count('class="disagreement') == 3
    assert page.count("· ada: cannot say") == 3
    assert 'href="#people"' in page


def test_without_files_there_is_no_section(judged: Run, tmp_path: Path) -> None:
    """Without answer files the page has no section on people."""
    assert compare_people(judged, []) is None
    assert 'id="people"' not in HtmlReport().render(judged, tmp_path)
