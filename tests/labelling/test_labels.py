"""Labels: pages that hide what they show, answers that come back whole, and one clear error for all that is not."""

from __future__ import annotations

import base64
import csv
import itertools
import json
import re
import shlex
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from PIL.PngImagePlugin import PngInfo

import nrbench
from nrbench.cli.main import main
from nrbench.errors import BadInput
from nrbench.labelling.labels import (
    ANSWERS,
    LabelPage,
    labelled_cells,
    make_page,
    page_html,
    read_people,
    verdict_as_answer,
    without_metadata,
    write_key,
)
from nrbench.running.runner import Options
from nrbench.runs.records import Run
from nrbench.suites.suite import load_suite

from .browser import PROGRAM, Browser

METHODS = ("oracle", "tiling", "scatter")


def call(line: str) -> int:
    """Run a command line in this process and return its exit code."""
    with pytest.raises(SystemExit) as left:
        main(shlex.split(line))
    return int(left.value.code or 0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a small run once: two textures of known lattice, three methods, two draws."""
    root = tmp_path_factory.mktemp("labels") / "run"
    changes = {"sample": "64x64", "size": "96x96", "replicates": 2, "lattice": ("given",), "methods": METHODS}
    suite = load_suite("default").with_changes(metrics=["cost"])
    nrbench.run(suite, textures=("brick-strong", "hexagon-strong"), out=root, options=Options(jobs=0), **changes)
    return root


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Run:
    """Return a copy of the run, for one test."""
    return Run(Path(shutil.copytree(made, tmp_path / "run")))


def _answer(path: Path, sheet: LabelPage, answers: Sequence[str]) -> Path:
    rows = [[item.id, answer, 1.5, i] for i, (item, answer) in enumerate(zip(sheet.items, answers, strict=True), 1)]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([["item", "answer", "seconds", "order"], *rows])
    return path


def _verdicts(run: Run, sheet: LabelPage) -> list[str]:
    records = {record.key: record for record in run.cells}
    return [verdict_as_answer(records[item.cell]) for item in sheet.items]


def test_every_output_is_shown_and_a_share_twice(run: Run) -> None:
    """Each output of a texture with a lattice comes once, the share again, never twice in a row."""
    sheet = make_page(run, repeat=0.25, seed=1)
    first = [item.cell for item in sheet.items if not item.again]
    again = [item.cell for item in sheet.items if item.again]
    assert sorted(first) == sorted(record.key for record in labelled_cells(run)) and len(first) == 12
    assert len(again) == len(set(again)) == 3
    places = [item.cell for item in sheet.items]
    assert all(a != b for a, b in itertools.pairwise(places))
    seconds = {cell: [i for i, other in enumerate(places) if other == cell] for cell in again}
    assert all(not sheet.items[one[0]].again and sheet.items[one[1]].again for one in seconds.values())


@pytest.mark.parametrize("repeat", [0.0, 0.5, 1.0])
def test_any_share_can_be_shown_again(run: Run, repeat: float) -> None:
    """From none to all, the share is kept, and no output comes three times."""
    counts = Counter(item.cell for item in make_page(run, repeat=repeat).items)
    assert sorted(counts.values()) == [1] * round(12 * (1 - repeat)) + [2] * round(12 * repeat)


def test_the_seed_decides(run: Run) -> None:
    """Equal seeds give an equal page, others another order and other names."""
    one, same, other = make_page(run, 0, seed=1), make_page(run, 0.0, seed=1), make_page(run, 0, seed=2)
    assert one == same
    assert one.name != other.name
    assert not {item.id for item in one.items} & {item.id for item in other.items}
    assert [item.cell for item in one.items] != [item.cell for item in other.items]


def test_the_page_hides_what_it_shows(run: Run) -> None:
    """No method, texture, key or path stands in the page; pictures hold pixels only; nothing is fetched."""
    sheet = make_page(run)
    page = page_html(run.root, sheet)
    content = json.loads(re.search(r'id="content">(.*?)</script>', page, re.S)[1])  # type: ignore[index]
    rest = page.replace(json.dumps(content["pictures"], separators=(",", ":")), "")
    for record in run.cells:
        for word in (record.key, record.method, record.texture, record.key[:8], str(run.root)):
            assert word not in rest
    assert not re.search(r"https?:|src=|href=", re.sub(r"link\.href|\.src", "", rest))
    for picture in content["pictures"]:
        png = base64.b64decode(picture)
        assert {kind for kind in (b"tEXt", b"iTXt", b"zTXt", b"tIME", b"eXIf") if kind in png[:200]} == set()


def test_a_bare_picture_keeps_its_pixels(tmp_path: Path) -> None:
    """Texts are taken out of a PNG; what it shows stays."""
    note = PngInfo()
    note.add_text("Software", "method rsgf")
    pixels = np.random.default_rng(0).integers(0, 255, (9, 7, 3)).astype(np.uint8)
    PIL.Image.fromarray(pixels).save(tmp_path / "a.png", pnginfo=note)
    clean = without_metadata((tmp_path / "a.png").read_bytes())
    assert b"rsgf" not in clean
    (tmp_path / "b.png").write_bytes(clean)
    assert (np.asarray(PIL.Image.open(tmp_path / "b.png")) == pixels).all()


def test_answers_come_back(run: Run, tmp_path: Path) -> None:
    """What a page saved is read back cell by cell, with a byte order mark and without unanswered items too."""
    sheet = make_page(run, repeat=0.25)
    write_key(run.root, sheet)
    said = [ANSWERS[i % 3] for i in range(len(sheet.items))]
    path = _answer(tmp_path / "ada.csv", sheet, said)
    path.write_text("\ufeff" + "\n".join(path.read_text().splitlines()[:-2]), "utf-8")
    (person,) = read_people(run, [path])
    assert person.name == "ada"
    assert [one.answer for one in person.answers] == said[:-2]
    assert person.by_cell() == {i.cell: a for i, a in zip(sheet.items[:-2], said, strict=False) if not i.again}


def test_pages_of_several_seeds_meet(run: Run, tmp_path: Path) -> None:
    """Two people with pages of their own are compared output by output."""
    files = []
    for seed, name in ((1, "a"), (2, "b")):
        sheet = make_page(run, seed=seed)
        write_key(run.root, sheet)
        files.append(_answer(tmp_path / f"{name}.csv", sheet, _verdicts(run, sheet)))
    one, other = read_people(run, files)
    assert one.by_cell() == other.by_cell()


BAD = {
    "item,answer,seconds,order\nqqqqqqqqqq,lost,1,1\n": "on no page of this run",
    "item,answer,order\nx,lost,1\n": "expected columns item, answer, seconds, order",
    "item;answer;seconds;order\nx;lost;1;1\n": "expected columns item, answer, seconds, order",
    "": "got none",
    "item,answer,seconds,order\n": "has no answers",
    "item,answer,seconds,order\nITEM,broken,1,1\n": "use one of: preserved, lost, cannot say",
    "item,answer,seconds,order\nITEM,lost,soon,1\n": "must be numbers",
    "item,answer,seconds,order\nITEM,lost,-1,1\n": "is no answer as the page saves it",
    "item,answer,seconds,order\nITEM,lost,1,1,more\n": "is no answer as the page saves it",
    "item,answer,seconds,order\nITEM,lost,1,1\nITEM,lost,1,2\n": "is answered twice",
}


@pytest.mark.parametrize("content", BAD)
def test_a_bad_file_is_one_line_and_exit_2(content: str, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that no page saved is refused by name, before any report is written."""
    sheet = make_page(run)
    write_key(run.root, sheet)
    Path("p.csv").write_text(content.replace("ITEM", sheet.items[0].id))
    assert call("report run --labels p.csv") == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "p.csv" in error and BAD[content] in error
    assert not (run.root / "tables").exists()


def test_answers_to_another_run_are_refused(run: Run, tmp_path: Path) -> None:
    """Without a page of this run, or with the answers to another, the error says what to do."""
    sheet = make_page(run)
    path = _answer(tmp_path / "p.csv", sheet, _verdicts(run, sheet))
    with pytest.raises(BadInput, match="make one by `nrbench label"):
        read_people(run, [path])
    write_key(run.root, make_page(run, seed=7))
    with pytest.raises(BadInput, match=r"p\.csv, line 2: item .* is on no page of this run"):
        read_people(run, [path])
    with pytest.raises(BadInput, match="there is no such file"):
        read_people(run, [tmp_path / "missing.csv"])
    with pytest.raises(BadInput, match="is given twice"):
        read_people(run, [path, path])


def test_label_writes_page_and_key(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """`label` writes a page to the given path and its key to the run, and refuses invalid names, paths and runs."""
    assert call("label run -o page.html --repeat 0.5 --seed 4") == 0
    assert "18 items, 6 of them second showings" in capsys.readouterr().out
    assert Path("page.html").stat().st_size > 50_000
    assert len(list((run.root / "labels").glob("*.json"))) == 1
    for line, hint in {"-o page.png": "end the name in .html", "-o no/page.html": "make it first"}.items():
        assert call(f"label run {line}") == 2
        assert hint in capsys.readouterr().err
    assert call("label nowhere") == 2
    assert "is no run" in capsys.readouterr().err


def test_report_takes_the_files_after_labels(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """`report RUN --labels A B` adds the agreement to page and tables; one answer throughout has no kappa."""
    sheet = make_page(run)
    write_key(run.root, sheet)
    for name in ("a", "b"):
        _answer(Path(f"{name}.csv"), sheet, _verdicts(run, sheet))
    assert call("report run --format html,csv --labels a.csv b.csv") == 0
    with Path("run/tables/agreement.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == ["judge and people"] * 3 + ["people"] + ["self"] * 2
    assert {float(row["share_equal"]) for row in rows} == {1.0}
    assert {row["kappa"] for row in rows} == {""}
    assert "Automatic verdict and people" in Path("run/report/report.html").read_text("utf-8")
    assert call("report run other") == 2
    assert "only one run is reported" in capsys.readouterr().err


@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium")
def test_keys_label_in_a_browser(run: Run, tmp_path: Path) -> None:
    """Keys answer, the arrow goes back to correct, the page resumes after it was closed, and the saved file is read."""
    sheet = make_page(run, repeat=0.25)
    write_key(run.root, sheet)
    page, saved = tmp_path / "page.html", tmp_path / "saved"
    page.write_text(page_html(run.root, sheet), "utf-8")
    saved.mkdir()
    count = "document.getElementById('count').textContent"
    with Browser(tmp_path / "profile") as browser:
        browser.open(page)
        for key in ("Enter", "1", "2", "2", "ArrowLeft", "3"):
            browser.press(key)
        assert browser.script(count) == "4 of 15, 3 answered"
    with Browser(tmp_path / "profile") as browser:
        browser.open(page)
        browser.press("Enter")
        assert browser.script(count) == "4 of 15, 3 answered"
        for _ in range(12):
            browser.press("1")
        assert browser.script(count) == "15 of 15 answered"
        browser.downloads(saved)
        browser.script("document.getElementById('who').value = 'ada'; document.getElementById('save').click()")
        for _ in range(100):
            if any(path.suffix == ".csv" for path in saved.iterdir()):
                break
            browser.script("new Promise((done) => setTimeout(done, 50))")
    (person,) = read_people(run, [saved / f"labels-{sheet.name}-ada.csv"])
    assert [one.answer for one in person.answers] == ["preserved", "lost", "cannot say"] + ["preserved"] * 12
    assert [one.order for one in person.answers] == list(range(1, 16))
    assert all(0 <= one.seconds < 60 for one in person.answers)
