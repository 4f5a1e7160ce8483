"""A run directory is a folder of files: anything else in it is refused by name, and what is damaged is found."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest
from commands import call

from nrbench import run
from nrbench.errors import BadInput
from nrbench.running.runner import Options
from nrbench.runs.store import RunDirectory, is_result_part
from nrbench.storage import read_json, write_json


def run_one_cell(root: Path) -> Path:
    """Run one cell; return its folder."""
    words: dict[str, Any] = {"methods": "tiling", "textures": "brick-mild", "lattice": "given", "metrics": ["cost"]}
    return run("core", size="64x64", out=root, options=Options(jobs=0), **words).cells[0].folder


@pytest.mark.skipif(os.name == "nt", reason="makes links and pipes")
@pytest.mark.parametrize("name", [".lock", "cells/other", "CELL/output.png"])
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_link_or_pipe_is_refused_by_name(
    name: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every verb that opens the run ends with exit code 2 and the path; what the link leads to is not changed."""
    folder = run_one_cell(tmp_path / "run")
    (tmp_path / "outside").mkdir()
    path = tmp_path / "run" / name.replace("CELL", f"cells/{folder.name}")
    path.unlink(missing_ok=True)
    path.symlink_to(tmp_path / "outside") if kind == "link" else os.mkfifo(path)
    words = ("run", "core", "-m", "tiling", "-t", "brick-mild", "--no-report", "--jobs", "0")
    verbs = (("status", f"{tmp_path}/run"), ("report", f"{tmp_path}/run"), (*words, "--out", f"{tmp_path}/run"))
    for verb in (*verbs, (*words, "--out", f"{tmp_path}/new", "--reuse", f"{tmp_path}/run")):
        assert call(*verb) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("[")]
        assert line == f"nrbench: {path}: is a link, a pipe or a device; remove it (a run holds files and folders only)"
    assert not list((tmp_path / "outside").iterdir())


def test_what_a_method_prepares_may_hold_links(tmp_path: Path) -> None:
    """The folder that a method prepared for a sample belongs to the method."""
    run_one_cell(tmp_path / "run")
    (tmp_path / "run" / "prepared" / "abc").mkdir(parents=True)
    (tmp_path / "run" / "prepared" / "abc" / "model").symlink_to(tmp_path)
    assert call("status", f"{tmp_path}/run") == 0


def test_a_damaged_run_file_is_named(tmp_path: Path) -> None:
    """A run.json that is no JSON is called damaged, not missing."""
    RunDirectory(tmp_path).claim()
    (tmp_path / "run.json").write_text("{", "utf-8")
    with pytest.raises(BadInput, match=r"run\.json: is damaged"):
        RunDirectory(tmp_path).info()


def test_a_file_system_without_locks_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing can be locked, a run goes on and says so."""
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    directory = RunDirectory(tmp_path / "run")
    directory.claim()
    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.warns(RuntimeWarning, match="has no locks; start no second run"), directory.locked():
        pass


KNOWN = {"family": "", "kind": None, "regular_share": None, "region": None, "lattice": None, "lattices": []}


@pytest.mark.parametrize(
    "part",
    [
        {"status": "banana"},
        {"seconds": "abc"},
        {"seconds": float("nan")},
        {"lattice": 5},
        {"lattice": {"t1": [1, 2, 3], "t2": [3, 4], "origin": [0, 0]}},
        {"made": {"output.png": -1}},
        {"texture": {**KNOWN, "regular_share": "abc"}},
        {"message": None},
    ],
)
def test_forged_entries_of_a_result_are_refused(part: dict[str, Any]) -> None:
    """An entry of a wrong type, an unknown status and a number without bounds make no result."""
    good = {"status": "ok", "message": "", "seconds": 1, "peak_mib": 2.5, "made": {"output.png": 7}, "texture": KNOWN}
    assert is_result_part(good) and not is_result_part({**good, **part})


def test_no_control_characters_of_a_run_reach_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Escapes and marks of direction in the message of a cell of somebody else are not printed."""
    folder = run_one_cell(tmp_path / "run")
    content = read_json(folder / "result.json") or {}
    write_json(folder / "result.json", {**content, "status": "error", "message": "a\x1b]52;c;aGk=\x07\u202eb"})
    assert call("status", f"{tmp_path}/run") == 0
    assert "error: ab\n" in capsys.readouterr().out
