"""A survey writes the lattices of a folder of pictures into truth.csv, and draws them on contact sheets."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from candidates import CHOSEN, Ranked

from nrbench import Lattice, plugins, texture
from nrbench.api.picture_folders import FIELDS, Survey
from nrbench.errors import BadInput
from nrbench.pictures.files import write_image
from nrbench.suites.suite import load_suite

PICTURES = Path("pictures")


@pytest.fixture(autouse=True)
def ranked(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Make the detector known as ``ranked``, and an empty folder for pictures."""
    PICTURES.mkdir()
    build = plugins.build
    monkeypatch.setattr(
        plugins, "build", lambda kind, name, *rest: Ranked() if name == "ranked" else build(kind, name, *rest)
    )
    yield


def add(name: str, brightness: float = 0.9, shape: tuple[int, int] = (40, 60)) -> None:
    """Write a picture of one brightness."""
    PIL.Image.fromarray(np.full(shape, round(255 * brightness), np.uint8)).save(PICTURES / name)


def survey(detector: str = "ranked", **options: object) -> Survey:
    """Run a survey of the folder."""
    made = Survey(PICTURES, detector, **options)
    made.run(lambda done, total, name: None)
    return made


def rows(path: Path = PICTURES / "truth.csv") -> dict[str, dict[str, str]]:
    """Return the lines of a table by file name."""
    with path.open(newline="", encoding="utf-8") as lines:
        return {row["file"]: row for row in csv.DictReader(lines)}


def test_run_reads_what_the_survey_wrote() -> None:
    """The detected lattices of models are those of `nrbench run FOLDER`; a noise has none, with the reason."""
    drawn = {name: texture(name, (96, 112), 1) for name in ("brick", "hexagon", "noise")}
    for name, each in drawn.items():
        write_image(PICTURES / f"{name}.png", each.image)
    survey("consensus")
    suite = {row.name: row for row in load_suite(PICTURES).texture}
    assert set(suite) == set(drawn)
    for name in ("brick", "hexagon"):
        found, truth = suite[name].parameters, drawn[name].lattice
        assert truth is not None and Lattice(found["t1"], found["t2"]).is_equivalent(truth, 0.2)
        assert 0.5 <= float(rows()[f"{name}.png"]["confidence"]) <= 1
    assert "t1" not in suite["noise"].parameters and rows()["noise.png"]["reason"]


def test_candidates_stand_in_the_table() -> None:
    """A line holds the chosen lattice and lists the first three candidates in the form that can be copied."""
    add("a.png")
    survey()
    row = rows()["a.png"]
    assert tuple(row) == FIELDS
    assert [row[name] for name in FIELDS[1:9]] == ["16.0", "0.0", "0.0", "12.0", "", "", "0.902", "ranked"]
    listed = row["candidates"].split("; ")
    assert listed[1:] == [
        "32.0,0.0,0.0,12.0 (0.200, double along t1)",
        "8.0,0.0,0.0,12.0 (0.100, half along t1)",
    ]
    assert listed[0] == "16.0,0.0,0.0,12.0 (0.902)" and Lattice.parse(listed[0].split()[0]) == CHOSEN


def test_a_low_confidence_is_for_people_to_decide() -> None:
    """Vectors of a confidence below the limit are not written as known; the limit can be chosen."""
    add("a.png", 0.4)
    assert survey().findings[0].is_doubtful
    row = rows()["a.png"]
    assert not row["t1x"] and row["confidence"] == "0.400" and row["candidates"] and "choose" in row["reason"]
    survey(existing="replace", least=0.3)
    assert rows()["a.png"]["t1x"] == "16.0" and not rows()["a.png"]["reason"]


def test_a_picture_without_a_lattice_is_a_line() -> None:
    """Its vectors are empty, its reason is that of the detector, and the rejected lattice is listed as such."""
    add("dark.png", 0.1)
    finding = survey().findings[0]
    assert not finding.failed and not finding.is_doubtful and finding.lattice is None
    row = rows()["dark.png"]
    assert row["reason"] == "the picture is dark" and "rejected" in row["candidates"] and not row["t1x"]


def test_what_fails_is_a_line_and_stops_nothing() -> None:
    """Text, a picture cut short, one pixel, transparency, and an error of the detector: the other pictures are done."""
    (PICTURES / "text.png").write_text("no picture")
    add("whole.png", shape=(64, 64))
    (PICTURES / "cut.png").write_bytes((PICTURES / "whole.png").read_bytes()[:60])
    add("one.png", shape=(1, 1))
    add("raises.png", shape=(13, 64))
    PIL.Image.new("RGBA", (20, 20)).save(PICTURES / "glass.png")
    done = survey()
    expected = {
        "text.png": "no picture that can be read",
        "cut.png": "cannot be read",
        "one.png": "1x1 px; at least 8 px",
        "raises.png": "failed: ArithmeticError: thirteen rows",
        "glass.png": "no opaque pixel",
    }
    for name, reason in expected.items():
        assert reason in rows()[name]["reason"] and "pictures/" not in rows()[name]["reason"]
    assert {finding.name for finding in done.findings if finding.failed} == set(expected)
    assert rows()["whole.png"]["t1x"]


def test_corrections_are_never_lost() -> None:
    """A table that exists is refused before any work; `keep` adds missing pictures to it; `replace` starts again."""
    add("a.png")
    add("b.png", 0.4)
    own = "file,note,t1x,t1y,t2x,t2y\na.png,mine,20,0,0,24\n"
    table = PICTURES / "truth.csv"
    table.write_text(own)
    with pytest.raises(BadInput, match=r"truth.csv: exists.*--keep.*--force.*-o"):
        Survey(PICTURES, "ranked")
    assert table.read_text() == own and not (PICTURES / "lattices").exists()
    kept = survey(existing="keep")
    assert {name: rows()["a.png"][name] for name in ("note", "t1x", "t2y", "confidence")} == {
        "note": "mine", "t1x": "20", "t2y": "24", "confidence": ""
    }  # fmt: skip
    assert rows()["b.png"]["confidence"] == "0.400"
    assert kept.findings[0].lattice == Lattice((20, 0), (0, 24)) and kept.findings[0].kept
    survey(existing="replace")
    assert rows()["a.png"]["t1x"] == "16.0" and "note" not in rows()["a.png"]


def test_an_interruption_keeps_what_was_found() -> None:
    """What was found before an interruption is in the table; `keep` then does the rest."""
    for name in "abc":
        add(f"{name}.png")

    def interrupt(done: int, total: int, name: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Survey(PICTURES, "ranked").run(interrupt)
    assert set(rows()) == {"a.png", "b.png"}
    seen: list[str] = []
    Survey(PICTURES, "ranked", existing="keep").run(lambda done, total, name: seen.append(name))
    assert set(rows()) == {"a.png", "b.png", "c.png"} and seen == ["a.png", "b.png", "c.png"]
