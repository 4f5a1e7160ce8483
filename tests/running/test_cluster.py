"""Runs on a Dask cluster: a real scheduler and real workers, on this machine."""

import dataclasses
import os
import signal
import time
from pathlib import Path
from typing import Any

import psutil
import pytest
from commands import call, start
from faults import registered_faults
from machines import machines
from suites import scores, wall_suite, write_sleepers

from nrbench import run
from nrbench.errors import BadInput
from nrbench.running import executors
from nrbench.running.runner import Options, Step, _Runner
from nrbench.runs.records import Run

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")


def outputs(found: Run) -> list[bytes]:
    """Return the bytes of every output."""
    return [(record.folder / "output.png").read_bytes() for record in found.cells]


def place_of(record: Any) -> str:
    """Return the name of the worker that ran a cell of the method ``place``."""
    return str(record.result["note"])


def test_a_run_survives_its_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that joins late is used, one that is killed loses nothing, and the results are those of a local run.

    The relative path of a parameter starts from the folder of the user, which is not that of the workers.
    """
    (tmp_path / "user").mkdir()
    monkeypatch.chdir(tmp_path / "user")
    Path("number.txt").write_text("0.5")
    suite = wall_suite(
        ["tiling", "scatter", "reader:file=number.txt"], "cost", "source", lattice=["given"], replicates=2
    )
    with registered_faults(), machines(tmp_path, "first") as made:
        local = run(suite, out=tmp_path / "local", options=Options(jobs=0))
        steps: list[Step] = []

        def follow(step: Step) -> None:
            steps.append(step)
            if step.done == 1:
                made.start_worker("late")
                made.wait_for_workers(2)
            if step.done >= 2 and "first" in made.processes and has_run("late"):
                made.kill("first")

        def has_run(name: str) -> bool:
            return name in {place_of(one) for one in Run(tmp_path / "run").cells if one.result.get("note")}

        options = Options(scheduler=made.address, timeout=30)
        places = wall_suite(["place"], "cost", "source", replicates=20, size="96x96")
        many = run(places, out=tmp_path / "run", options=options, progress=follow)
        assert {record.status for record in many.cells} == {"ok"}
        assert {place_of(record) for record in many.cells} == {"first", "late"}
        assert "first" not in made.processes
        assert steps[0].remaining is None and steps[1].remaining is not None  # the first cell starts a worker
        away = run(suite, out=tmp_path / "away", options=options)
        assert {record.status for record in away.cells} == {"ok"}
        assert scores(away, "note") == scores(local, "note")
        assert outputs(away) == outputs(local)
        faults = wall_suite([f"faulty:how={how}" for how in ("stubborn", "segfault", "litter")], "cost", "source")
        limited = run(faults, out=tmp_path / "limited", options=dataclasses.replace(options, timeout=3))
        assert [record.status for record in limited.cells] == ["timeout", "crash", "ok"]
        with monkeypatch.context() as patch:
            patch.setattr(executors, "code_hash", lambda files: "0123456789ab")
            with pytest.raises(BadInput, match=r"the worker tcp://.* has other code than this machine; install"):
                run(suite, out=tmp_path / "other", options=options)
        with monkeypatch.context() as patch:
            job = _Runner._job
            away_from = {"folder": "/no/such/folder"}
            patch.setattr(_Runner, "_job", lambda self, *words: dataclasses.replace(job(self, *words), **away_from))
            with pytest.raises(BadInput, match=r"the worker tcp://.* does not see /no/such/folder; pass an --out"):
                run(suite, out=tmp_path / "unseen", options=options)


def test_a_run_that_is_stopped_takes_its_jobs_back(tmp_path: Path) -> None:
    """After a second interrupt the worker kills the cell that runs, and is ready for the next run."""
    with registered_faults() as faults, machines(tmp_path, "only") as made:
        suite = write_sleepers(tmp_path, 3)
        words = ["--plugin", str(faults), "run", str(suite), "--out", "run", "--no-report", "--scheduler", made.address]
        running = start(tmp_path, *words)
        deadline = time.monotonic() + 120
        while running.poll() is None and "asleep\n" not in [
            log.read_text() for log in tmp_path.glob("run/cells/*/log.txt")
        ]:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        worker = psutil.Process(made.processes["only"].pid)
        children = worker.children(recursive=True)
        running.send_signal(signal.SIGINT)
        time.sleep(0.5)
        assert running.poll() is None
        running.send_signal(signal.SIGINT)
        assert running.wait(15) == 130
        assert len(children) >= 3
        assert not psutil.wait_procs(children, timeout=10)[1]
        (tmp_path / "awake").touch()
        assert call(*words) == 0
        assert [record.status for record in Run(tmp_path / "run").cells] == ["ok"] * 3
