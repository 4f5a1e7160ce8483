"""The command line: bad input is one line that says what, where and what to do, exit code 2, and nothing is lost."""

import json
from pathlib import Path

import numpy as np
import pytest
import skimage.data
import skimage.io
from commands import answer_json, call, refusal


@pytest.fixture(autouse=True)
def pictures(tmp_path: Path) -> Path:
    """Write pictures that no sane person would pass, and some good ones, into the current directory."""
    brick = skimage.data.brick()[:160, :160]
    (tmp_path / "text.png").write_text("this is no picture")
    (tmp_path / "folder").mkdir()
    skimage.io.imsave("tiny.png", np.zeros((4, 4, 3), np.uint8), check_contrast=False)
    skimage.io.imsave("constant.png", np.full((64, 64, 3), 99, np.uint8), check_contrast=False)
    skimage.io.imsave("tinted.png", np.full((64, 64, 3), (99, 120, 140), np.uint8), check_contrast=False)
    skimage.io.imsave("brick.png", brick)
    return tmp_path


BAD = {
    "synth text.png -m scatter --size 64x64 -o o.png": "text.png: is no picture",
    "synth brick.png --size 64x64 -o o.png": "Missing option '-m'",
    "synth tiny.png -m scatter --size 64x64 -o o.png": "at least 8 px a side",
    "synth brick.png -m scater --size 64x64 -o o.png": "did you mean 'scatter'",
    "synth brick.png -m scatter:blok=3 --size 64x64 -o o.png": "did you mean 'block'",
    "synth brick.png -m scatter --size 64 -o o.png": "write WIDTHxHEIGHT",
    "synth brick.png -m scatter --size 64x64 -o o.jpg": "end the name in .png or .tif",
    "synth brick.png -m oracle --size 64x64 -o o.png": "nrbench: ",
    "score brick.png tinted.png": "channels",
    "run nosuch": "no suite, TOML file or directory of that name",
    "run folder": "has no picture",
    "run core -t nosuch*": "matches no texture",
    "run core --lattice somewhere": "--lattice 'somewhere' is not known",
    "plan core -t brick-mild --lattice 3,0,6,0": "parallel",
    "plan bad.toml": "key 'textur' is not known (did you mean 'texture'?)",
    "report folder": "is no run",
    "show rgsf": "did you mean 'rsgf'",
    "list plugins": "is not one of",
    "rum": "verb 'rum' is not known (did you mean 'run'?)",
    "run --plugin missing.py": "there is no such file",
    "render brick:colour=0.2 -o out": "did you mean 'color'",
}


@pytest.mark.parametrize("line", BAD)
def test_bad_input_is_one_line_and_exit_2(line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every misuse ends with exit code 2 and one line that says what to do, without traceback or debris."""
    (tmp_path / "bad.toml").write_text('name = "bad"\n[[textur]]\nname = "x"\n')
    before = sorted(tmp_path.rglob("*"))
    assert call(line) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert BAD[line] in shown.err
    assert len(shown.err.splitlines()) == 1 and "Traceback" not in shown.err
    assert sorted(tmp_path.rglob("*")) == before


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    """`--debug`, anywhere on the line, adds the traceback."""
    assert "Traceback" in refusal(capsys, "lattice missing.png --debug")


def test_a_constant_image_has_no_lattice(capsys: pytest.CaptureFixture[str]) -> None:
    """`lattice` answers null with a reason, exit code 0."""
    answer = answer_json(capsys, "lattice constant.png --json")
    assert answer["lattice"] is None and "constant" in answer["reason"]


def test_run_prints_json_on_standard_output_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`run --json` prints one JSON document; progress goes to standard error; exit code 0 with a refusal in it."""
    line = "run default -t brick-strong -m oracle -m scatter:block=200 --sample 64x64 --size 64x64 --jobs 0 --out r"
    assert call(f"{line} --json") == 0
    shown = capsys.readouterr()
    found = json.loads(shown.out)
    assert found["status"]["ok"] >= 1
    assert shown.err


def test_failed_cells_give_exit_1_and_a_table(faulty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A failing method makes exit code 1, after the table was written; a refusal does not."""
    base = "run default -t brick-strong --sample 64x64 --size 64x64 --jobs 0 --no-report"
    assert call(f"{base} -m faulty -m fine --out r") == 1
    assert Path("r/tables/cells.csv").is_file()
    assert call(f"{base} -m faulty:how=refuse -m fine --out q") == 0


def test_plan_starts_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`plan` counts new cells before and cached ones after, and writes nothing."""
    line = "default -t brick-strong -m oracle --sample 64x64 --size 64x64 --out r"
    new = answer_json(capsys, f"plan {line} --json")["new"]
    assert new > 0 and not (tmp_path / "r").exists()
    assert call(f"run {line} --jobs 0 --no-report") == 0
    capsys.readouterr()
    assert call(f"plan {line} --json") == 0
    assert json.loads(capsys.readouterr().out)["cached"] == new


@pytest.mark.parametrize("kind", ["", "datasets", "detectors", "synthesizers", "metrics", "reports", "suites"])
def test_list(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """`list` names every plugin and suite, none of them broken."""
    assert call(f"list {kind}") == 0
    shown = capsys.readouterr().out
    assert "BROKEN" not in shown and len(shown.splitlines()) > 1


@pytest.mark.parametrize("name", ["rsgf", "gncc", "regularity", "brick", "html", "core"])
def test_show(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """`show` prints a plugin's page or a suite, as text and as JSON."""
    assert call(f"show {name}") == 0
    assert name in capsys.readouterr().out
    assert call(f"show {name} --json") == 0
    assert json.loads(capsys.readouterr().out)[0]["name"] == name
