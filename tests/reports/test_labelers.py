from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from label_files import write_answers

from nrbench.labelling.labels import ANSWERS, QUESTIONS, labels_table, make_page, write_key
from nrbench.plugins.forms import Column
from nrbench.reports.statistics.frames import agreement_table
from nrbench.reports.statistics.labelers import SUBSETS, QuestionComparison, compare_labelers, compare_orders
from nrbench.runs.records import Run

from .conftest import COLUMNS, Make

OTHER = {"yes": "no", "no": "yes"}


@pytest.fixture(scope="module")
def judged(makers: tuple[Make, Make]) -> Run:
    """Return a run of ten textures by four methods.

    Half of the outputs are preserved. The elements of the methods m0 and m1 are whole, those of m2 are broken, and
    those of m3 are not measured. The quality falls from m0 to m3.
    """
    make_cell, make_run = makers
    cells = [
        make_cell(
            f"t{i}",
            f"m{j}",
            preserved=(i + j) % 2 == 0,
            score=0.9 if (i + j) % 2 == 0 else 0.3,
            values={"integrity.score": whole, "quality.score": 0.9 - 0.2 * j},
            reasons={"integrity.score": "undecided: no power"} if whole is None else {},
        )
        for i in range(10)
        for j, whole in enumerate((1.0, 0.97, 0.4, None))
    ]
    score = Column("Share of whole elements.", better="higher")
    run: Run = make_run(cells, columns={**COLUMNS, "integrity.score": score})
    return run


def _automatic_answers(run: Run, question: str) -> dict[str, str]:
    """Return the automatic answer to a question by cell; ``yes`` where there is none."""
    return {record.key: QUESTIONS[question].automatic_answer(record) or "yes" for record in run.cells}


def _person(
    run: Run, path: Path, wrong: Callable[[int, bool], str | None], repeat: float = 0.0, question: str = "lattice"
) -> Path:
    """Write the answers of a person who repeats the verdicts unless ``wrong(number, again)`` gives another answer."""
    label_page = make_page(run, repeat=repeat, questions=[question])
    write_key(run.root, label_page)
    verdicts = _automatic_answers(run, question)
    answers = [[wrong(i, item.repeated) or verdicts[item.cell]] for i, item in enumerate(label_page.items)]
    return write_answers(path, label_page, answers)


def _compare(run: Run, *files: Path, question: str = "lattice") -> QuestionComparison:
    """Return the comparison for the only question that was answered."""
    comparison = compare_labelers(run, files)
    assert comparison is not None and list(comparison.questions) == [question]
    return comparison.questions[question]


def test_full_agreement_is_one(judged: Run, tmp_path: Path) -> None:
    """A person who agrees with every verdict has kappa 1, an interval of one point, and no disagreements."""
    comparison = _compare(judged, _person(judged, tmp_path / "a.csv", lambda i, again: None))
    (one,) = comparison.with_verdict
    assert (one.kappa.value, one.kappa.low, one.kappa.high, one.equal, one.n) == (1.0, 1.0, 1.0, 1.0, 40)
    assert comparison.disagreements == [] and comparison.between == []


def test_known_kappa(judged: Run, tmp_path: Path) -> None:
    """A person who reverses 10 of 40 balanced verdicts has 0.75 equal answers and kappa 0.5."""
    verdicts = _automatic_answers(judged, "lattice")
    known = [verdicts[item.cell] for item in make_page(judged, repeat=0, questions=["lattice"]).items]
    chosen = {i for word in OTHER for i in [i for i, one in enumerate(known) if one == word][:5]}
    path = _person(judged, tmp_path / "a.csv", lambda i, again: OTHER[known[i]] if i in chosen else None)
    comparison = _compare(judged, path)
    assert comparison.with_verdict[0].kappa.value == pytest.approx(0.5)
    assert comparison.with_verdict[0].table == [[15, 5, 0], [5, 15, 0], [0, 0, 0]]
    assert len(comparison.disagreements) == 10 and all(one.opposite for one in comparison.disagreements)


def test_cannot_say_lowers_kappa_but_not_kappa_of_the_decided(judged: Run, tmp_path: Path) -> None:
    """Five times "cannot say" lowers kappa; over items that both decide it stays 1; the disputes come as not plain."""
    comparison = _compare(judged, _person(judged, tmp_path / "a.csv", lambda i, again: "cannot say" if i < 5 else None))
    one = comparison.with_verdict[0]
    assert one.kappa.value is not None and one.kappa.value < 1
    assert one.decided.value == 1.0
    assert [dispute.opposite for dispute in comparison.disagreements] == [False] * 5


def test_self_agreement_counts_second_showings_only(judged: Run, tmp_path: Path) -> None:
    """A person who reverses all second answers agrees with every verdict and never with themself."""
    verdicts = _automatic_answers(judged, "lattice")
    known = [verdicts[item.cell] for item in make_page(judged, repeat=0.5, questions=["lattice"]).items]
    path = _person(judged, tmp_path / "a.csv", lambda i, again: OTHER[known[i]] if again else None, repeat=0.5)
    comparison = _compare(judged, path)
    assert comparison.with_verdict[0].equal == 1.0
    assert (comparison.selves[0].n, comparison.selves[0].equal) == (20, 0.0)


def test_several_people_have_a_mean(judged: Run, tmp_path: Path) -> None:
    """Three people give the verdict with each person, every pair of people, and the means of both."""
    rng = np.random.default_rng(0)
    answer = lambda i, again: ANSWERS[rng.integers(2)] if rng.random() < 0.4 else None  # noqa: E731
    files = [_person(judged, tmp_path / f"{name}.csv", answer) for name in "abc"]
    comparison = compare_labelers(judged, files)
    table = agreement_table(comparison)
    assert set(table["question"]) == {"lattice"}
    assert list(table["kind"]) == ["judge and labelers"] * 4 + ["labelers"] * 4 + ["self"] * 3
    means = table[table["second"] == "mean of 3"]["kappa"].tolist()
    each = table.groupby("kind", sort=False)["kappa"].apply(lambda one: one.iloc[:3].mean()).tolist()
    assert means == pytest.approx(each[:2])
    assert len(labels_table(judged, files)) == 120


def _answers_by_method(judged: Run, path: Path, *answers: str) -> Path:
    """Write the answers of a person who answers the question ``more`` by the method, m0 to m3."""
    methods = {record.key: int(record.method[1]) for record in judged.cells}
    label_page = make_page(judged, repeat=0, questions=["more"])
    return _person(judged, path, lambda i, again: answers[methods[label_page.items[i].cell]], question="more")


def test_more_of_the_same_is_compared_by_rank(judged: Run, tmp_path: Path) -> None:
    """The order of the methods by quality and by the share of yes gives tau, whatever the level of both."""
    best = _answers_by_method(judged, tmp_path / "a.csv", "yes", "yes", "no", "no")
    worst = _answers_by_method(judged, tmp_path / "b.csv", "no", "no", "no", "yes")
    one, other, both = _compare(judged, best, worst, question="more").ranks[::3]
    assert (one.ordered.value, other.ordered.value) == (1.0, 0.0)
    assert (one.first, one.second, one.n, one.tau.n) == ("judge", "a", 40, 10)
    assert one.tau.value == pytest.approx(4 / np.sqrt(6 * 4))
    assert other.tau.value == pytest.approx(-3 / np.sqrt(6 * 3))
    assert (both.second, both.n) == ("all labelers", 40)
    # The shares of yes are 1/2, 1/2, 0 and 1/2: two pairs agree with the order of the quality, and one does not.
    assert both.tau.value == pytest.approx(1 / np.sqrt(6 * 3))
    assert both.ordered.value == pytest.approx(2 / 3)


def test_answers_that_cannot_be_said_are_no_part_of_the_order(judged: Run, tmp_path: Path) -> None:
    """A method about which nobody decides has no place in the order; if nothing is left, there is no number."""
    some = _answers_by_method(judged, tmp_path / "a.csv", "yes", "cannot say", "no", "no")
    none = _answers_by_method(judged, tmp_path / "b.csv", *["cannot say"] * 4)
    same = _answers_by_method(judged, tmp_path / "c.csv", *["yes"] * 4)
    ranks = [_compare(judged, answers, question="more").ranks[0] for answers in (some, none, same)]
    assert [one.n for one in ranks] == [30, 0, 40]
    assert [one.ordered.value for one in ranks[:2]] == [1.0, None]
    assert [one.tau.value for one in ranks[1:]] == [None, None] and ranks[2].tau.n == 0


def test_orders_of_parts_of_the_outputs() -> None:
    """References and methods that do not lead are left out in turn; each part has its own rank correlation."""
    scores = {"oracle": (1.0, 5), "a": (0.9, 3), "b": (0.8, 4), "c": (0.1, 1)}
    rows = [[f"t{i}", name, name == "oracle", *both] for i in range(4) for name, both in scores.items()]
    outputs = pd.DataFrame(rows, columns=["texture", "label", "reference", "score", "answer"])
    outputs.loc[0, "score"] = np.nan
    every, ranked, leading = compare_orders(outputs, ("a", "b"), "ada")
    assert (every.n, ranked.n, leading.n) == (15, 12, 8)
    assert [one.spearman.value for one in (ranked, leading)] == pytest.approx([0.5, -1.0])
    assert every.spearman.value is not None and 0.5 < every.spearman.value < 0.8
    assert (ranked.tau.value, leading.tau.value, leading.ordered.value) == pytest.approx((1 / 3, -1.0, 0.0))
    # All textures are equal, so resamples of whole textures have no spread; resamples of outputs would have.
    assert ranked.spearman.ends == pytest.approx((0.5, 0.5))


def test_more_of_the_same_has_no_kappa_with_the_judge(judged: Run, tmp_path: Path) -> None:
    """There is no automatic answer, so no kappa and no disagreement; two people still have a kappa."""
    files = [_answers_by_method(judged, tmp_path / f"{name}.csv", "yes", "yes", "no", "no") for name in "ab"]
    comparison = _compare(judged, *files, question="more")
    assert comparison.with_verdict == [] and comparison.disagreements == []
    assert comparison.between[0].kappa.value == 1.0
    table = labels_table(judged, files)
    assert table["judge"].isna().all() and table["score"].min() == pytest.approx(0.3)


def test_questions_are_compared_one_by_one(judged: Run, tmp_path: Path) -> None:
    """People who answered different questions are compared only on the questions that they answered."""
    files = [_person(judged, tmp_path / f"{name}.csv", lambda i, again: None) for name in "ab"]
    files.append(_person(judged, tmp_path / "c.csv", lambda i, again: "no" if i < 4 else None, question="more"))
    comparison = compare_labelers(judged, files)
    assert comparison is not None and list(comparison.questions) == ["lattice", "more"]
    assert list(comparison.labelers) == ["a", "b", "c"] and comparison.outputs == 40
    table = agreement_table(comparison)
    columns = ["question", "kind", "first", "second"]
    assert table[columns].apply(tuple, axis=1).tolist() == [
        ("lattice", "judge and labelers", "judge", "a"),
        ("lattice", "judge and labelers", "judge", "b"),
        ("lattice", "judge and labelers", "judge", "mean of 2"),
        ("lattice", "labelers", "a", "b"),
        ("lattice", "self", "a", "shown again"),
        ("lattice", "self", "b", "shown again"),
        *[("more", "judge and labelers", "judge", "c")] * 3,
        ("more", "self", "c", "shown again"),
    ]
    assert table["kappa"].notna().tolist() == [True] * 4 + [False] * 6
    assert table["tau"].notna().tolist() == [False] * 6 + [True] * 3 + [False]
    assert table["outputs"].tolist() == [""] * 6 + list(SUBSETS) + [""]
