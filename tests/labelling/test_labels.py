"""Labels: pages that hide what they show, answers that come back whole, and one clear error for all that is not."""

import base64
import csv
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from commands import call, refusal
from label_files import write_answers

from nrbench.errors import BadInput
from nrbench.labelling.labels import (
    ANSWERS,
    ELEMENTS,
    LATTICE,
    MORE,
    PRESERVED,
    QUESTIONS,
    WHOLE_SCORE,
    LabelPage,
    labelled_cells,
    make_page,
    page_html,
    read_labels,
    write_key,
)
from nrbench.pictures.files import read_image
from nrbench.runs.records import CellRecord, Run
from nrbench.streams import pixels_hash


def _verdicts(run: Run, label_page: LabelPage) -> list[list[str]]:
    """Return the automatic answers to the questions about each item; ``cannot say`` where there is none."""
    records = {record.key: record for record in run.cells}
    questions = [QUESTIONS[name] for name in label_page.questions]
    return [[one.automatic_answer(records[item.cell]) or ANSWERS[2] for one in questions] for item in label_page.items]


def _with_scores(record: CellRecord, **values: float | bool | None) -> CellRecord:
    return replace(record, values={name.replace("__", "."): value for name, value in values.items()})


def test_every_output_is_shown_and_a_share_twice(run: Run) -> None:
    """Each output of a texture with a lattice comes once, the share again, never twice in a row."""
    label_page = make_page(run, repeat=0.25, seed=1)
    first = [item.cell for item in label_page.items if not item.repeated]
    again = [item.cell for item in label_page.items if item.repeated]
    assert sorted(first) == sorted(record.key for record in labelled_cells(run)) and len(first) == 12
    assert len(again) == len(set(again)) == 3
    places = [item.cell for item in label_page.items]
    assert all(a != b for a, b in itertools.pairwise(places))
    seconds = {cell: [i for i, other in enumerate(places) if other == cell] for cell in again}
    assert all(not label_page.items[one[0]].repeated and label_page.items[one[1]].repeated for one in seconds.values())


def test_the_seed_decides(run: Run) -> None:
    """Equal seeds give an equal page, others another order and other names."""
    one, same, other = make_page(run, 0, seed=1), make_page(run, 0.0, seed=1), make_page(run, 0, seed=2)
    assert one == same
    assert one.name != other.name
    assert not {item.id for item in one.items} & {item.id for item in other.items}
    assert [item.cell for item in one.items] != [item.cell for item in other.items]


def test_a_page_asks_its_questions(run: Run) -> None:
    """Each question of the page stands in it once with its answers, and no other question does."""
    page = page_html(run.root, make_page(run, questions=["elements", "more"]))
    assert page.count('<div class="question"') == 2 and page.count('<button type="button" class="answer"') == 6
    for question in (ELEMENTS, MORE):
        assert page.count(f"<h2>{question.text}</h2>") == 1
        assert all(meaning in page for meaning in question.meanings)
    assert LATTICE.text not in page


def test_pictures_with_an_undecided_verdict_are_shown(run: Run) -> None:
    """A picture whose lattice was detected is shown even if the verdict is undecided; without a lattice it is not."""
    reasons = ("undecided: too few windows", "not applicable: no lattice in the truth")
    undecided, none = (
        replace(record, cell=replace(record.cell, lattice_truth=None), reasons={PRESERVED: reason})
        for record, reason in zip(run.cells[:2], reasons, strict=True)
    )
    vars(run)["cells"] = [undecided, none]
    assert labelled_cells(run) == [undecided]


def test_automatic_answer_about_the_lattice(run: Run) -> None:
    """The verdict preserved is yes, lost is no, and undecided or unscored is "cannot say"."""
    record = run.cells[0]
    values = {True: "yes", False: "no", None: "cannot say"}
    assert {known: LATTICE.automatic_answer(_with_scores(record, regularity__preserved=known)) for known in values} == (
        values
    )
    assert LATTICE.automatic_answer(_with_scores(record)) == "cannot say"


@pytest.mark.parametrize(
    ("score", "answer"),
    [(1.0, "yes"), (WHOLE_SCORE, "yes"), (WHOLE_SCORE - 1e-6, "no"), (0.2, "no"), (None, "cannot say")],
)
def test_automatic_answer_about_the_elements(run: Run, score: float | None, answer: str) -> None:
    """It is no if the score is below that of whole elements, else yes if measured."""
    assert ELEMENTS.automatic_answer(_with_scores(run.cells[0], integrity__score=score)) == answer


def test_elements_of_which_a_joint_cannot_be_seen_are_whole(run: Run) -> None:
    """No peril is yes where the lattice is preserved; a score that cannot be told is "cannot say"."""
    reason, silent = "not applicable: joined ones look whole", {"integrity__score": None}
    for why, preserved, answer in ((reason, True, "yes"), (reason, False, "cannot say"), ("few", True, "cannot say")):
        record = _with_scores(run.cells[0], **silent, regularity__preserved=preserved)
        assert ELEMENTS.automatic_answer(replace(record, reasons={"integrity.score": why})) == answer


def test_more_of_the_same_has_no_automatic_answer(run: Run) -> None:
    """No value of the quality is called yes or no."""
    assert {MORE.automatic_answer(_with_scores(run.cells[0], quality__score=value)) for value in (0.0, 1.0, None)} == (
        {None}
    )


def test_the_page_hides_what_it_shows(run: Run) -> None:
    """No method, texture, key or path stands in the page; pictures hold pixels only; nothing is fetched."""
    label_page = make_page(run)
    page = page_html(run.root, label_page)
    content = json.loads(re.search(r'id="content">(.*?)</script>', page, re.S)[1])
    rest = page.replace(json.dumps(content["pictures"], separators=(",", ":")), "")
    for record in run.cells:
        for word in (record.key, record.method, record.texture, record.key[:8], str(run.root)):
            assert word not in rest
    assert not re.search(r"https?:|src=|href=", re.sub(r"link\.href|\.src", "", rest))
    for picture in content["pictures"]:
        png = base64.b64decode(picture)
        assert {kind for kind in (b"tEXt", b"iTXt", b"zTXt", b"tIME", b"eXIf") if kind in png[:200]} == set()


def test_answers_come_back(run: Run, tmp_path: Path) -> None:
    """What a page saved is read back cell by cell, with a byte order mark and without unanswered items too."""
    label_page = make_page(run, repeat=0.25)
    write_key(run.root, label_page)
    said = [[ANSWERS[(i + i * k) % 3] for k in range(3)] for i in range(len(label_page.items))]
    path = write_answers(tmp_path / "ada.csv", label_page, said)
    path.write_text("\ufeff" + "\n".join(path.read_text().splitlines()[:-2]), "utf-8")
    labels = read_labels(run, [path])
    assert set(labels["labeler"]) == {"ada"}
    assert labels["answer"].tolist() == [answer for three in said for answer in three][:-2]
    assert labels["question"].tolist() == (list(QUESTIONS) * len(said))[:-2]
    for k, question in enumerate(QUESTIONS):
        answered = list(zip(label_page.items, said, strict=True))[: None if k == 0 else -1]
        for again in (False, True):
            part = labels[labels["question"].eq(question) & labels["again"].eq(again)]
            found = dict(zip(part["key"], part["answer"], strict=True))
            assert found == {item.cell: three[k] for item, three in answered if item.repeated == again}


HEAD = "item,question,answer,seconds,order,labeled_by\n"
BAD = {
    f"{HEAD}qqqqqqqqqq,more,no,1,1,person\n": "on no page of this run",
    "item,answer,order\nx,lost,1\n": "expected columns item, question, answer, seconds, order, labeled_by",
    HEAD: "has no answers",
    f"{HEAD}ITEM,more,lost,1,1,person\n": "use one of: yes, no, cannot say",
    f"{HEAD}ITEM,more,no,soon,1,person\n": "must be numbers",
    f"{HEAD}ITEM,more,no,1,1,person\nITEM,more,yes,1,2,person\n": "more, is answered twice",
    f"{HEAD}ITEM,more,no,1,1,person,and\n": "is no answer as the page saves it",
    f"{HEAD}ITEM,more,no,1,1,person\nITEM,lattice,yes,1,2,model\n": "labeled_by must be one word for all answers",
}


@pytest.mark.parametrize("content", BAD)
def test_a_bad_file_is_one_line_and_exit_2(content: str, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that no page saved is refused by name, before any report is written."""
    label_page = make_page(run)
    write_key(run.root, label_page)
    Path("p.csv").write_text(content.replace("ITEM", label_page.items[0].id))
    assert call("report run --labels p.csv") == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "p.csv" in error and BAD[content] in error
    assert not (run.root / "tables").exists()


def test_answers_to_another_run_are_refused(run: Run, tmp_path: Path) -> None:
    """Without a page of this run, or with the answers to another, the error says what to do."""
    label_page = make_page(run)
    path = write_answers(tmp_path / "p.csv", label_page, _verdicts(run, label_page))
    with pytest.raises(BadInput, match="make one by `nrbench label"):
        read_labels(run, [path])
    write_key(run.root, make_page(run, seed=7))
    with pytest.raises(BadInput, match=r"p\.csv, line 2: item .* is on no page of this run"):
        read_labels(run, [path])
    with pytest.raises(BadInput, match=r"cannot be read .*No such file"):
        read_labels(run, [tmp_path / "missing.csv"])
    with pytest.raises(BadInput, match="is given twice"):
        read_labels(run, [path, path])


def test_label_writes_page_and_key(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """`label` writes a page to the given path and its key to the run, and refuses invalid names, paths and runs."""
    assert call("label run -o page.html --repeat 0.5 --seed 4") == 0
    out = capsys.readouterr().out
    assert "18 items, 6 of them second showings" in out and "questions: lattice, elements, more" in out
    assert Path("page.html").stat().st_size > 50_000
    assert len(list((run.root / "labels").glob("*.json"))) == 1
    for line, hint in {"-o page.png": "end the name in .html", "-o no/page.html": "make it first"}.items():
        assert hint in refusal(capsys, f"label run {line}")
    for names, hint in {"colors": "use some of: lattice, elements, more", "more,more": "is given twice"}.items():
        assert hint in refusal(capsys, f"label run --questions {names}")
    assert call("label run -o page.html --questions more,lattice") == 0
    assert "questions: more, lattice" in capsys.readouterr().out
    assert Path("page.html").read_text("utf-8").count('<div class="question"') == 2
    assert "is no run" in refusal(capsys, "label nowhere")


def test_report_takes_the_files_after_labels(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """`report RUN --labels A B` adds the agreement to page and tables; one answer throughout has no kappa.

    Two labelers with pages of their own are compared output by output.
    """
    for seed, name in enumerate("ab"):
        label_page = make_page(run, seed=seed)
        write_key(run.root, label_page)
        write_answers(Path(f"{name}.csv"), label_page, _verdicts(run, label_page))
    assert call("report run --format html,csv --labels a.csv b.csv") == 0
    with Path("run/tables/agreement.csv").open() as file:
        rows = list(csv.DictReader(file))
    rest = ["labelers"] + ["self"] * 2
    kinds = {name: ["judge and labelers"] * (9 if name == "more" else 3) + rest for name in QUESTIONS}
    assert [(row["question"], row["kind"]) for row in rows] == [
        (name, kind) for name in QUESTIONS for kind in kinds[name]
    ]
    graded = [row for row in rows if row["question"] == "more" and row["kind"] == "judge and labelers"]
    assert {row["tau"] for row in rows} == {""}
    assert {row["share_equal"] for row in graded} == {""}
    assert {float(row["share_equal"]) for row in rows if row not in graded} == {1.0}
    assert {row["kappa"] for row in rows} == {""}
    with Path("run/tables/labels.csv").open() as file:
        labels = list(csv.DictReader(file))
    assert len(labels) == 2 * 3 * len(label_page.items)
    assert {row["judge"] for row in labels if row["question"] == "more"} == {""}
    hashes = {record.key: pixels_hash(read_image(record.folder / "output.png")) for record in run.cells}
    assert all(row["pixels"] == hashes[row["key"]] for row in labels)
    assert "Automatic verdict and labels" in Path("run/report/report.html").read_text("utf-8")
    assert "only one run is reported" in refusal(capsys, "report run other")
