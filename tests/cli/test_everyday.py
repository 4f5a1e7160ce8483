"""What a person meets every day: progress, brief scores, columns of choice, runs that share a directory."""

from pathlib import Path

import numpy as np
import pytest
from commands import answer_json, call, refusal

import nrbench
from nrbench import run
from nrbench.api.run_reports import parse_formats
from nrbench.api.textures import Scores
from nrbench.cli.picture_commands import _score_line
from nrbench.cli.progress import live_progress, waiting
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.quality import Quality
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Detection, NoLatticeFound
from nrbench.running.runner import Options


@pytest.fixture
def brick(tmp_path: Path) -> Lattice:
    """Write ``brick.png`` and ``out.png``, two draws of a wall; return their lattice."""
    for name, seed in (("brick", 0), ("out", 1)):
        texture = nrbench.texture("brick", shape=(96, 96), seed=seed, color=0.2)
        write_image(tmp_path / f"{name}.png", texture.image)
    return Lattice(texture.lattice.t1, texture.lattice.t2)


def test_a_long_run_prints_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    """Without a terminal there is a line at each twentieth of the cells, and for each that failed."""
    with live_progress() as show:
        for done in range(1, 745):
            show(done, 744, f"cell {done}", done == 100)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 21
    assert "[100/744] cell 100" in lines and lines[-1] == "[744/744] cell 744"


def test_a_short_wait_shows_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A step shorter than two seconds prints nothing; a longer one prints a line, and the error passes."""
    with waiting("short"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("nrbench.cli.progress.PATIENCE", 0.01)
    with pytest.raises(KeyError), waiting("long") as progress:
        progress(0.5)
        progress(0.1)  # never goes back
        __import__("time").sleep(0.1)
        raise KeyError
    assert capsys.readouterr().err.startswith("long: 50 %, about 1 s left\n")


def test_synth_refuses_a_place_that_takes_no_file_before_it_starts(
    brick: Lattice, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A path that cannot be written, or is the sample's, is refused before the synthesis; nothing is changed."""
    monkeypatch.setattr("nrbench.synthesizers.quilting.Quilting.synthesize", lambda *_: pytest.fail("was called"))
    Path("folder.png").mkdir()
    before = sorted(Path().iterdir()), Path("brick.png").read_bytes()
    for place, why in (
        ("./brick.png", "is brick.png itself"),
        *([("/proc/x.png", "cannot be written")] if Path("/proc").is_dir() else []),
        ("folder.png", "is a directory"),
        ("no/x.png", "exist"),
    ):
        assert why in refusal(capsys, f"synth brick.png -m quilting --size 64x64 -o {place}")
    assert (sorted(Path().iterdir()), Path("brick.png").read_bytes()) == before


def test_synth_takes_a_detector(
    brick: Lattice, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--lattice DETECTOR` gives the lattice that the detector finds, and prints it as numbers to copy."""
    numbers = ",".join(map(repr, brick.numbers))
    monkeypatch.setattr("nrbench.detectors.consensus.Consensus.detect", lambda self, image: Detection(brick, 0.9))
    assert call("synth brick.png -m tiling --size 128x128 --lattice consensus -o found.png") == 0
    assert "--lattice 27.3,0,13.65,12.2  (consensus)" in capsys.readouterr().err
    assert call(f"synth brick.png -m tiling --size 128x128 --lattice {numbers} -o given.png") == 0
    np.testing.assert_array_equal(read_image("found.png"), read_image("given.png"))

    def refuse(self: object, image: object) -> Detection:
        raise NoLatticeFound("all is noise")

    monkeypatch.setattr("nrbench.detectors.consensus.Consensus.detect", refuse)
    assert "no lattice found (all is noise)" in refusal(
        capsys, "synth brick.png -m tiling --size 128x128 --lattice consensus -o none.png"
    )
    assert "did you mean 'consensus'" in refusal(
        capsys, "synth brick.png -m tiling --size 128x128 --lattice consensu -o none.png"
    )


def test_synth_warns_of_another_lattice(
    brick: Lattice, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A method whose own lattice is none of consensus brings a warning; the same lattice and a supercell do not."""
    doubled = Lattice((2 * brick.t1[0], 0), brick.t2)
    command = "synth brick.png -m shuffle --size 128x128 -o made.png"
    half = Lattice((brick.t1[0] / 2, 0), brick.t2)
    monkeypatch.setattr("nrbench.detectors.consensus.Consensus.detect", lambda self, image: Detection(brick, 0.9))
    for used, warns in ((brick, False), (doubled, False), (half, True)):
        found = nrbench.Synthesis(np.zeros((128, 128, 3), np.float32), lattice=used)
        monkeypatch.setattr("nrbench.synthesizers.shuffle.Shuffle.synthesize", lambda self, task, found=found: found)
        assert call(command) == 0
        assert ("warning" in capsys.readouterr().err) == warns


def test_score_is_brief(brick: Lattice, capsys: pytest.CaptureFixture[str]) -> None:
    """`score` prints the verdict first, then six numbers; `--metrics` prints all scores of the chosen metrics."""
    lattice = ",".join(map(repr, brick.numbers))
    assert call(f"score brick.png out.png --lattice {lattice}") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "the lattice is preserved" or lines[0].startswith("the lattice is not judged")
    assert [line.split()[0] for line in lines[1:7]] == [
        "regularity.preserved",
        *(f"quality.{name}" for name in ("score", "regularity", "integrity", "randomness", "appearance")),
    ]
    assert call(f"score brick.png out.png --lattice {lattice} --metrics quality") == 0
    whole = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines() if line.startswith("quality."))
    assert whole["quality.score"].startswith("≤") == (whole["quality.complete"] == "False")
    assert "--all" in lines[-1]
    shown = answer_json(capsys, "score brick.png out.png --metrics appearance --json")
    reasons = shown.pop("reasons")
    assert shown and all(name.startswith("appearance.") for name in shown)
    assert all(reasons[name] for name, value in shown.items() if value is None)
    assert call("score brick.png out.png --metrics appearanc") == 2
    assert call("score brick.png out.png --metrics appearance --all") == 2


def test_score_tells_which_silence_it_is(brick: Lattice, capsys: pytest.CaptureFixture[str]) -> None:
    """A peril without a score is no peril, or cannot be told, by its reason."""
    reasons = {"quality.integrity": "not applicable: joined ones look whole", "quality.randomness": "too few tiles"}
    values = {"quality.score": 0.9, "quality.complete": False, **dict.fromkeys(reasons), "source.entropy": None}
    scores = Scores(values, {**reasons, "source.entropy": "not applicable: one pixel"}, {})
    lines = [_score_line(scores, name).split(maxsplit=1) for name in values]
    assert dict(lines) == {
        **{"quality.score": "≤ 0.9", "quality.complete": "False", "source.entropy": "-"},
        **{"quality.integrity": "no peril", "quality.randomness": "cannot tell"},
    }


def test_formats_take_parameters() -> None:
    """A comma separates formats where the name of a report follows, and else belongs to the value."""
    assert parse_formats(["html,csv"]) == {"html": {}, "csv": {}}
    assert parse_formats(["perils:width=3.4,text:columns=quality,seconds,csv", "markdown"]) == {
        "perils": {"width": "3.4"},
        "text": {"columns": "quality,seconds"},
        "csv": {},
        "markdown": {},
    }
    with pytest.raises(BadInput, match="report 'pdf' is not known"):
        parse_formats(["html,pdf"])


def test_runs_that_share_a_directory(capsys: pytest.CaptureFixture[str]) -> None:
    """A narrower run says how many cells its tables leave out, and leaves no report that contradicts them."""
    run("core", methods=["quilting", "scatter"], textures="brick-mild", out="R", options=Options(jobs=0),
        size="128x128", metrics=["appearance"])  # fmt: skip
    suite = nrbench.load("R").info["suite"]["content"]
    assert suite["methods"] == ["quilting", "scatter"]
    Path("R/report").mkdir()
    Path("R/report/report.html").write_text("old")
    Path("suite.toml").write_text(
        'name = "core"\nversion = 1\nsample = "128x128"\nsize = "128x128"\nmethods = ["quilting"]\nlattice = ["own"]\n'
        'metrics = ["appearance"]\n[[texture]]\nname = "wall"\ndataset = "brick"\n'
    )
    assert call("run suite.toml --out R --jobs 0 --no-report --columns appearance.quarters,seconds") == 0
    printed = capsys.readouterr()
    assert "holds 2 more cells of an earlier command" in printed.err and "is removed" in printed.err
    assert not Path("R/report/report.html").exists() and "appearance.quarters" in printed.out
    assert call("run suite.toml --out R --jobs 0 --no-report") == 0
    assert "more cells" not in capsys.readouterr().err
    assert "did you mean 'appearance.quarters'" in refusal(
        capsys, "run suite.toml --out R --columns appearance.quarter"
    )
    assert call("run suite.toml --out R --columns quarters") == 2


def test_reports_of_a_run_that_cannot_be_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With -o they lie elsewhere, and the run stays as it is; without it, one line says what to do, as `run` does.

    The folder of another run is refused.
    """
    for name in ("R", "other"):
        run("core", methods="scatter", textures="brick-mild", out=name, options=Options(jobs=0), size="64x64",
            metrics=["cost"])  # fmt: skip
    before = sorted(Path("R").rglob("*"))
    assert call("report R --format text,html -o made/here") == 0
    assert capsys.readouterr().out.split() == ["made/here/tables/comparison.txt", "made/here/report/report.html"]
    assert "-o other: is another run" in refusal(capsys, "report R --format text -o other")
    assert sorted(Path("R").rglob("*")) == before
    written = nrbench.report("R", "text", output="R")
    assert written == [Path("R/tables/comparison.txt")]

    def refuse(dir: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("nrbench.storage.tempfile.TemporaryFile", refuse)
    for line, remedy in {
        "report R": "with -o DIR",
        "label R --questions more": "label a copy of the run",
        "site R -o S": "pass another -o",
        "run core -t brick-mild -m scatter --out R": "R takes its results",
    }.items():
        assert call(line) == 2
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1 and "cannot be written (Permission denied); " in error and remedy in error


def test_show_prints_the_file_of_a_suite(capsys: pytest.CaptureFixture[str]) -> None:
    """What `show SUITE --toml` prints is a suite with the same content."""
    assert call("show core --toml") == 0
    Path("mine.toml").write_text(capsys.readouterr().out, "utf-8")
    from nrbench.suites.suite import load_suite

    assert load_suite("mine.toml").hash == load_suite("core").hash
    assert call("show rsgf --toml") == 2
    assert call("show core --toml --json") == 2


def test_show_prints_the_limits_of_the_judge(capsys: pytest.CaptureFixture[str]) -> None:
    """`show limits` prints name, value, unit and origin of every limit that a metric declares, as text and as JSON."""
    (table,) = answer_json(capsys, "show limits --json")
    assert (table["kind"], table["name"]) == ("limits", "quality")
    assert [tuple(row.values()) for row in table["limits"]] == [tuple(limit) for limit in Quality.limits]
    assert call("show limits") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "limits of quality" and len(lines) == 1 + len(Quality.limits)
    for limit, line in zip(Quality.limits, lines[1:], strict=True):
        assert line.split()[0] == limit.name and f" {limit.value:g} " in line and line.endswith(limit.origin)
