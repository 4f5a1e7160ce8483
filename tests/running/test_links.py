"""Links and files that are not regular inside a run: nothing is written through them or read from them."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest

from nrbench import load, run
from nrbench.cli.main import main
from nrbench.errors import BadInput
from nrbench.reports.page.pictures import PictureStore
from nrbench.reports.plots.marks import read_pixels
from nrbench.runs.store import RunDirectory, is_result_part
from nrbench.storage import find_strange, follow_no_link_below, make_folder, open_regular, read_json, write_json

SECRET = "not of this run\n" * 100


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """Write a file outside the run."""
    path = tmp_path / "secret.txt"
    path.write_text(SECRET, "utf-8")
    return path


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """Make a folder outside the run."""
    path = tmp_path / "outside"
    path.mkdir()
    return path


def run_one_cell(root: Path) -> Path:
    """Run one cell; return its folder."""
    made = run("core", methods=["tiling"], textures=["brick-mild"], lattice=["given"], metrics=["cost"], out=root)
    return made.cells[0].folder


def put_link(path: Path, target: Path) -> None:
    """Put a link in the place of a file or folder."""
    if path.is_dir():
        path.rename(path.parent / "moved")
    path.unlink(missing_ok=True)
    path.symlink_to(target)


@pytest.mark.parametrize("name", [".lock", "run.json", "tables", "cells", "lattices", "report"])
def test_a_link_in_a_run_directory_is_refused_with_its_path(
    name: str, tmp_path: Path, secret: Path, outside: Path
) -> None:
    """The message names the link, and what it leads to keeps its content."""
    (tmp_path / "run" / "cells").mkdir(parents=True)
    put_link(tmp_path / "run" / name, secret if name in (".lock", "run.json") else outside)
    with pytest.raises(BadInput, match=f"{name}: is a link"):
        run_one_cell(tmp_path / "run")
    assert secret.read_text() == SECRET and not list(outside.iterdir())


@pytest.mark.parametrize("name", ["log.txt", "output.png", "result.json", "cell.json", "scores", ""])
def test_a_cell_with_a_link_is_computed_again(name: str, tmp_path: Path, secret: Path, outside: Path) -> None:
    """Reports show the cell as invalid and name the link; the next run replaces it, and no target changes."""
    folder = run_one_cell(tmp_path / "run")
    put_link(folder / name if name else folder, outside if name in ("scores", "") else secret)
    [record] = load(tmp_path / "run").cells
    assert record.status == "invalid" and f"{name or folder.name}: is a link" in record.message
    assert run_one_cell(tmp_path / "run") == folder
    [record] = load(tmp_path / "run").cells
    assert record.status == "ok" and find_strange(folder) is None
    assert secret.read_text() == SECRET and not list(outside.iterdir())


def test_a_link_in_place_of_the_prepared_folders_is_refused(tmp_path: Path, outside: Path) -> None:
    """Nothing is removed where the link leads to: names with a dot there are no unfinished preparations."""
    (outside / ".kept").mkdir()
    (tmp_path / "run" / "cells").mkdir(parents=True)
    put_link(tmp_path / "run" / "prepared", outside)
    with pytest.raises(BadInput, match="prepared: is a link"):
        run_one_cell(tmp_path / "run")
    assert (outside / ".kept").is_dir()


def test_a_log_with_another_name_elsewhere_is_not_cut(tmp_path: Path) -> None:
    """A cell whose scores are missing writes a log of its own; a hard link is not written through."""
    folder = run_one_cell(tmp_path / "run")
    other = tmp_path / "long.txt"
    other.write_bytes(b"kept\n" * (4 << 20))
    (folder / "log.txt").unlink(missing_ok=True)
    os.link(other, folder / "log.txt")
    for score in (folder / "scores").glob("cost-*.json"):
        score.unlink()
    assert run_one_cell(tmp_path / "run") == folder
    assert other.stat().st_size == 20 << 20 and load(tmp_path / "run").cells[0].status == "ok"


def test_folders_too_deep_are_not_read_and_are_removed(tmp_path: Path) -> None:
    """A cell with a thousand folders in one another is invalid, and the next run replaces it."""
    folder = run_one_cell(tmp_path / "run")
    with contextlib.chdir(folder):
        for _ in range(1000):
            Path("a").mkdir()
            os.chdir("a")
    [record] = load(tmp_path / "run").cells
    assert record.status == "invalid" and "too deep" in record.message
    assert run_one_cell(tmp_path / "run") == folder
    assert load(tmp_path / "run").cells[0].status == "ok" and not (folder / "a").exists()


def test_a_run_directory_that_another_takes_the_place_of_is_left(tmp_path: Path) -> None:
    """Nothing is written into a folder that has the name of the run directory since it was claimed."""
    follow_no_link_below(tmp_path)  # of several such folders, the innermost counts
    directory = RunDirectory(tmp_path / "run")
    directory.claim()
    (tmp_path / "run").rename(tmp_path / "moved")
    (tmp_path / "run").mkdir()
    with pytest.raises(BadInput, match="another folder has taken its place"):
        write_json(directory.cell("abc").result_file, {})
    assert not list((tmp_path / "run").iterdir())


def test_a_named_pipe_does_not_stop_a_reader(tmp_path: Path) -> None:
    """``status`` ends where a pipe stands for the result of a cell."""
    folder = run_one_cell(tmp_path / "run")
    (folder / "result.json").unlink()
    os.mkfifo(folder / "result.json")
    with pytest.raises(SystemExit):
        main(["status", str(tmp_path / "run")])
    assert read_json(folder / "result.json") is None
    assert load(tmp_path / "run").cells[0].status == "invalid"


def test_cells_with_links_are_not_reused(tmp_path: Path, secret: Path) -> None:
    """A cell of another run whose output is a link is not copied."""
    folder = run_one_cell(tmp_path / "theirs")
    put_link(folder / "output.png", secret)
    ours = RunDirectory(tmp_path / "ours")
    ours.claim()
    ours.copy_cells(RunDirectory(tmp_path / "theirs"), [folder.name])
    assert not list(ours.cells.iterdir())


@pytest.mark.parametrize("action", ["write", "read", "remove", "make"])
def test_no_link_on_the_way_is_followed(action: str, tmp_path: Path, outside: Path) -> None:
    """A folder of a run that a link has replaced is neither written, read nor emptied through the link."""
    directory = RunDirectory(tmp_path / "run")
    directory.claim()
    (outside / "abc").mkdir()
    (outside / "abc" / "result.json").write_text("{}", "utf-8")
    put_link(directory.cells, outside)
    file = directory.cell("abc").result_file
    if action == "read":
        assert read_json(file) is None
    elif action == "remove":
        directory.cell("abc").clear()
    else:
        with pytest.raises(BadInput, match="cells: is a link"):
            write_json(file, {"a": 1}) if action == "write" else make_folder(directory.cells / "new")
    assert [path.name for path in outside.rglob("*")] == ["abc", "result.json"]
    assert (outside / "abc" / "result.json").read_text("utf-8") == "{}"


def test_a_folder_that_turns_into_a_link_while_files_are_written_is_not_followed(tmp_path: Path, outside: Path) -> None:
    """Whenever another process swaps the folder for a link, nothing arrives where the link leads."""
    directory = RunDirectory(tmp_path / "run")
    directory.claim()
    folder, stop = directory.cells / "abc", threading.Event()

    def swap() -> None:
        while not stop.is_set():
            shutil.rmtree(folder, ignore_errors=True)
            with contextlib.suppress(OSError):  # the writer has made the folder meanwhile
                folder.symlink_to(outside)
                folder.unlink()

    swapper = threading.Thread(target=swap)
    swapper.start()
    try:
        for k in range(300):
            with contextlib.suppress(BadInput, OSError):
                write_json(folder / f"{k}.json", {"k": k})
    finally:
        stop.set()
        swapper.join()
    assert not list(outside.iterdir())


def test_control_characters_of_a_foreign_run_are_not_read(tmp_path: Path) -> None:
    """Escapes for the terminal and marks of direction in run.json, a result and a log reach no reader."""
    folder, evil = run_one_cell(tmp_path / "run"), "a\x1b]52;c;aGFjaw==\x07\x1b[31mb\u202ec"
    for path, change in ((tmp_path / "run" / "run.json", {"label": evil}), (folder / "result.json", {"note": evil})):
        content = json.loads(path.read_text("utf-8"))
        for part in content.get("cells", [content]):
            part.update(change)
        path.write_text(json.dumps(content), "utf-8")
    (folder / "log.txt").write_text(evil, "utf-8")
    [record] = load(tmp_path / "run").cells
    assert (record.method, record.note, record.log_tail) == ("abc",) * 3


def test_a_damaged_run_file_is_named(tmp_path: Path) -> None:
    """A run.json that is no JSON is called damaged, not missing."""
    RunDirectory(tmp_path).claim()
    (tmp_path / "run.json").write_text("{", "utf-8")
    with pytest.raises(BadInput, match=r"run\.json: is damaged"):
        RunDirectory(tmp_path).info()


def test_only_regular_files_are_opened(tmp_path: Path, secret: Path) -> None:
    """A folder, a device and a link are refused, and a file is not truncated."""
    link = tmp_path / "link"
    link.symlink_to(secret)
    for path in (link, tmp_path, Path(os.devnull)):
        with pytest.raises(BadInput, match="no regular file"):
            open_regular(path)
    os.close(open_regular(secret, os.O_RDWR | os.O_CREAT))
    assert secret.read_text() == SECRET


def test_a_file_system_without_locks_is_no_other_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file takes the place of the lock: a second process is refused, and the file goes with the first."""
    import fcntl

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    directory = RunDirectory(tmp_path / "run")
    directory.claim()
    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.warns(RuntimeWarning, match="no locks"), directory.locked():
        with pytest.raises(BadInput, match=r"remove .*\.running"), directory.locked():
            pass
        assert (directory.root / ".running").exists()
    assert not (directory.root / ".running").exists()


KNOWN = {"family": "", "kind": None, "regular_share": None, "region": None, "lattice": None, "lattices": []}


@pytest.mark.parametrize(
    "part",
    [
        {"status": "banana"},
        {"seconds": "abc"},
        {"seconds": float("nan")},
        {"peak_mib": 10**400},
        {"lattice": 5},
        {"lattice_used": {"t1": [1, 2], "t2": [3, 4]}},
        {"lattice": {"t1": [1, 2, 3], "t2": [3, 4], "origin": [0, 0]}},
        {"lattice": {"t1": [9, 3], "t2": [9, 3], "origin": [0, 0]}},
        {"confidence": 2},
        {"made": {"output.png": -1}},
        {"made": {"é" * 200: 1}},
        {"texture": {**KNOWN, "regular_share": "abc"}},
        {"texture": {**KNOWN, "kind": 5}},
        {"texture": {**KNOWN, "region": ["a", 1, 2, 3]}},
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
    with pytest.raises(SystemExit):
        main(["status", str(tmp_path / "run")])
    assert "error: ab\n" in capsys.readouterr().out


def test_reports_show_no_picture_that_a_link_leads_to(tmp_path: Path) -> None:
    """The sample of a cell is no link to a private picture, nor a pipe that never ends."""
    folder = run_one_cell(tmp_path / "run")
    before, other = read_pixels(folder / "sample.png"), tmp_path / "private.png"
    (folder / "sample.png").rename(other)
    (folder / "sample.png").symlink_to(other)
    os.mkfifo(folder / "pipe.png")
    for name in ("sample.png", "pipe.png"):
        with pytest.raises(BadInput, match="no regular file"):
            read_pixels(folder / name)
    assert before.shape[2] == 3 and PictureStore(tmp_path).load(folder / "sample.png") is None


def test_a_name_of_a_megabyte_is_no_cell(tmp_path: Path) -> None:
    """Tables are not laid out for names that no suite has."""
    folder = run_one_cell(tmp_path / "run")
    content = read_json(tmp_path / "run" / "run.json") or {}
    content["cells"][0]["label"] = "L" * 1_000_000
    write_json(tmp_path / "run" / "run.json", content)
    with pytest.raises(BadInput, match=r"run\.json is damaged"):
        _ = load(tmp_path / "run").cells
    assert folder.is_dir()


SWAPPER = """
import os
from dataclasses import dataclass
from pathlib import Path
from nrbench.plugins.forms import Synthesis

@dataclass(frozen=True)
class Swapper:
    '''Puts a link in the place of the folder of its cell.'''
    uses_lattice = False

    def synthesize(self, task):
        '''Swap, and return the sample.'''
        cell = Path(os.readlink("/proc/self/fd/1")).parent
        cell.rename(cell.with_name("moved"))
        cell.symlink_to(cell.parents[2] / "outside")
        return Synthesis(task.sample)
"""


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="the method finds its folder by its log")
def test_a_method_that_swaps_its_cell_for_a_link_writes_nothing_outside(tmp_path: Path, outside: Path) -> None:
    """The output is not written through the link, and the cell is invalid."""
    (tmp_path / "swapper.py").write_text(SWAPPER)
    words = ["run", "core", "-m", "swapper", "-t", "brick-mild", "--sample", "64x64", "--size", "64x64", "--no-report"]
    with pytest.raises(SystemExit, match="1"):
        main(["--plugin", str(tmp_path / "swapper.py"), *words, "--out", str(tmp_path / "run")])
    assert not list(outside.iterdir())
    assert [record.status for record in load(tmp_path / "run").cells] == ["invalid"]
