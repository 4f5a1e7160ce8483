"""Whatever a plugin does becomes a row with its cause, and touches no neighbour."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nrbench.api import run
from nrbench.running.runner import Options
from nrbench.running.supervisor import Supervisor
from nrbench.runs.records import CellRecord
from nrbench.suites.suite import Suite, validated_suite

FAULTS = Path(__file__).parents[1] / "plugins" / "faulty_plugins.py"
HOWS = {
    "raise": ("error", "RuntimeError: planted failure"),
    "refuse": ("refused", "planted refusal"),
    "loop": ("timeout", "took longer than 2 s; raise --timeout if it may"),
    "segfault": ("crash", "died by SIGSEGV"),
    "exit": ("crash", "left with exit code 3"),
    "memory": ("memory", "memory"),
    "hog": ("memory", "memory"),
    "nan": ("invalid", "returned NaN or infinity in 1 of 4096 pixels"),
    "shape": ("invalid", "returned an image of shape (63, 64, 3); asked for (64, 64, 3)"),
    "nothing": ("invalid", "returned NoneType instead of a Synthesis"),
    "lie": ("invalid", "returned a source map that is not true"),
}


def small_suite(methods: list[str], **more: Any) -> Suite:
    """Return a suite of one brick wall, 64 x 64."""
    wall = {"name": "wall", "dataset": "brick", "parameters": {"color": 0.2}}
    return validated_suite(
        {"name": "small", "sample": "64x64", "size": "64x64", "methods": methods, "texture": [wall], **more}, "test"
    )


@pytest.fixture(params=["fork", "fresh interpreter"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run a test with a forking worker, and with a fresh interpreter a cell."""
    if request.param != "fork":
        monkeypatch.setenv("NRBENCH_FORK", "no")
    return str(request.param)


def test_every_fault_is_a_row(faulty: Path, tmp_path: Path) -> None:
    """A method that raises, loops, dies, hogs memory or returns rubbish has its status and cause; others are fine."""
    suite = small_suite([*(f"faulty:how={how}" for how in HOWS), "fine"])
    found = run(suite, out=tmp_path / "run", options=Options(jobs=2, timeout=2, memory=300))
    by_label: dict[str, CellRecord] = {record.method: record for record in found.cells}
    for how, (status, message) in HOWS.items():
        record = by_label["faulty" if how == "raise" else f"faulty:how={how}"]
        assert record.status == status, (how, record.result)
        assert message in record.message
    assert by_label["fine"].status == "ok"
    assert "planted failure" in by_label["faulty"].log_tail


@pytest.mark.skipif(os.name == "nt", reason="children's processor time is not told there")
def test_what_a_program_takes_is_the_methods_cost(tmp_path: Path, way: str) -> None:
    """Processor time and memory of a program that `command` starts and waits for stand in the row."""
    program = tmp_path / "tool.py"
    program.write_text(
        "import shutil, sys, time\nhoard = b'x' * (200 << 20)\nstart = time.process_time()\n"
        "while time.process_time() - start < 0.5:\n    pass\nshutil.copy(sys.argv[1], sys.argv[2])\n"
    )
    method = f"command:run={sys.executable} {program} {{sample}} {{output}}"
    (found,) = run(small_suite([method]), out=tmp_path / "run", options=Options(timeout=60)).cells
    assert found.status == "ok", found.message
    assert found.values["cost.cpu_seconds"] >= 0.5
    assert found.values["cost.peak_mib"] >= 200


@pytest.mark.parametrize("how", ["seconds", "text", "lattice", "pickle", "path", "source"])
def test_an_answer_of_no_declared_type_is_invalid(how: str, faulty: Path, tmp_path: Path) -> None:
    """Whatever a method hands back beside its image is checked before anything is written."""
    found = run(small_suite([f"odd:how={how}", "fine"]), out=tmp_path / "run", options=Options(jobs=0))
    odd, fine = found.cells
    assert (odd.status, fine.status) == ("invalid", "ok")
    assert not (odd.folder / "output.png").exists()


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
def test_an_interrupted_cell_has_no_result(tmp_path: Path) -> None:
    """Ctrl-C ends with exit code 130 and leaves the cells in flight unanswered, to be run again."""
    suite = tmp_path / "s.toml"
    suite.write_text(
        'name = "s"\nsample = "64x64"\nsize = "64x64"\nmethods = ["faulty:how=loop", "spawner"]\n'
        'texture = [{ name = "wall", dataset = "brick" }]\n'
    )
    program = "import sys; from nrbench.cli.main import main; main(sys.argv[1:])"
    words = ["--plugin", str(FAULTS), "run", str(suite), "--jobs", "2", "--memory", "1e6", "--out", "run"]
    started = subprocess.Popen(
        [sys.executable, "-c", program, *words],
        cwd=tmp_path,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # where the tests run in the background
    )
    cells = tmp_path / "run" / "cells"
    while started.poll() is None and len(list(cells.glob("*/log.txt"))) < 1:
        time.sleep(0.02)
    time.sleep(0.5)
    started.send_signal(signal.SIGINT)
    assert started.wait(60) == 130
    assert list(cells.glob("*/result.json")) == []


def test_nothing_escapes(faulty: Path, tmp_path: Path, way: str) -> None:
    """A process of another session is killed with its cell, and forged messages reach no other cell."""
    mark = tmp_path / "mark"
    found = run(small_suite([f"escaper:mark={mark}", "fine"]), out=tmp_path / "run", options=Options(timeout=20))
    assert [record.status for record in found.cells] == ["ok", "ok"]
    assert found.cells[1].values["cost.seconds"] is not None
    if way == "fork":
        time.sleep(3.5)
        assert not mark.exists()


def test_a_metric_of_no_declared_type_is_none_and_tried_again(faulty: Path, tmp_path: Path) -> None:
    """A score that is no number is None with the reason, and `retry_failed` asks for it again."""
    options = Options(timeout=20, retry_failed=True)
    found = run(small_suite(["faulty:how=gray"]), out=tmp_path / "run", options=Options(timeout=20))
    assert "a score is a finite number" in found.cells[0].reasons["wordy.value"]
    file = next((found.cells[0].folder / "scores").glob("wordy-*.json"))
    before = file.stat().st_mtime_ns
    run(small_suite(["faulty:how=gray"]), out=tmp_path / "run", options=options)
    assert file.stat().st_mtime_ns > before


def test_a_metric_that_dies_spares_the_others(faulty: Path, tmp_path: Path) -> None:
    """A metric that kills its process is None with the cause; the next metrics still answer."""
    found = run(small_suite(["faulty:how=gray", "fine"]), out=tmp_path / "run", options=Options(timeout=20))
    gray, fine = found.cells
    assert gray.values["deadly.value"] is None
    assert gray.reasons["deadly.value"] == "failed: crash: died by SIGKILL"
    assert "cost.seconds" in gray.values and gray.values["cost.seconds"] is not None
    assert fine.values["deadly.value"] == 1.0


def test_what_a_method_leaves_running_is_killed(faulty: Path, tmp_path: Path) -> None:
    """A process that a timed-out method forked dies with it."""
    mark = tmp_path / "mark"
    found = run(small_suite([f"spawner:mark={mark}"]), out=tmp_path / "run", options=Options(timeout=1))
    assert found.cells[0].status == "timeout"
    time.sleep(4.5)
    assert not mark.exists()


@pytest.fixture
def supervisor() -> Iterator[Supervisor]:
    """Close a supervisor after the test."""
    with Supervisor() as one:
        yield one


def test_both_ways_of_starting_agree(faulty: Path, tmp_path: Path, way: str) -> None:
    """A forked child and a fresh interpreter give the same output, and the same status of a failure."""
    suite = small_suite(["scatter", "faulty:how=segfault", "faulty:how=loop"])
    found = run(suite, out=tmp_path / "run", options=Options(timeout=3))
    assert [record.status for record in found.cells] == ["ok", "crash", "timeout"]
    here = run(small_suite(["scatter"]), out=tmp_path / "here", options=Options(jobs=0))
    assert (found.cells[0].folder / "output.png").read_bytes() == (here.cells[0].folder / "output.png").read_bytes()


def test_a_worker_that_dies_is_replaced(supervisor: Supervisor, tmp_path: Path) -> None:
    """After its worker is killed a supervisor reports one crash, then goes on with a new worker."""
    found = run(small_suite(["oracle"]), out=tmp_path / "run", options=Options(jobs=0))
    request = {"phase": "score", "folder": str(found.cells[0].folder), "metrics": ["cost"], "seconds": 20, "mib": 500}
    assert supervisor.ask(request)["scored"] == ["cost"]
    assert supervisor._worker is not None
    supervisor._worker.kill()
    supervisor._worker.wait()
    assert supervisor.ask(request)["status"] == "crash"
    assert supervisor.ask(request)["scored"] == ["cost"]


def test_the_worker_has_one_thread(supervisor: Supervisor, tmp_path: Path) -> None:
    """A warm worker, all plugins imported, has a single thread: it may fork."""
    assert supervisor._start()
    assert supervisor._worker is not None
    tasks = list(Path(f"/proc/{supervisor._worker.pid}/task").iterdir())
    assert len(tasks) == 1


def test_results_are_json(faulty: Path, tmp_path: Path) -> None:
    """Every result on disk is plain JSON with a status."""
    found = run(small_suite(["fine", "faulty"]), out=tmp_path / "run", options=Options(jobs=0))
    for record in found.cells:
        assert json.loads((record.folder / "result.json").read_text())["status"] == record.status
