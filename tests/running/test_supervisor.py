"""Whatever a plugin does becomes a row with its cause, and touches no neighbor."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from commands import call, start
from faults import no_orphans, registered_faults
from suites import wall_suite, write_sleepers

from nrbench import plugins, run, synthesize
from nrbench.pictures.files import read_image
from nrbench.running import executors, guard, runner
from nrbench.running.phases import Request
from nrbench.running.runner import Options, Step
from nrbench.running.supervisor import Supervisor
from nrbench.runs.records import CellRecord, Run
from nrbench.suites.suite import Suite

WAYS = ("fork", "fresh interpreter")
FaultyRun = Callable[[Suite, Options], Run]


def server_of(supervisor: Supervisor) -> psutil.Process:
    """Return the process of a worker that forks the children. Its parent only watches it."""
    (server,) = psutil.Process(supervisor._worker.pid).children()
    return server


def is_scorer(child: psutil.Process) -> bool:
    """Return whether a child of a worker is its scorer, which works in the folder of all working directories."""
    with contextlib.suppress(psutil.Error):
        return Path(child.cwd()).name.startswith("nrbench-")
    return False


def test_damaged_files_are_made_again(faulty_run: FaultyRun) -> None:
    """A result or score that is empty, cut, garbled, too deep or of another shape is computed again."""
    suite, options = wall_suite(["fine"], "cost"), Options(jobs=0)
    done = faulty_run(suite, options)
    (record,) = done.cells
    score = next((record.folder / "scores").glob("cost-*.json"))
    result, good = record.folder / "result.json", score.read_bytes()
    damages = (b"", good[: len(good) // 2], b"\xff\xfe{", b"{}", b"[]", b"[" * 100_000, b'{"values": {}}')
    with registered_faults():
        for damage in damages:
            for file in (score, result):
                file.write_bytes(damage)
                (again,) = run(suite, out=done.root, options=options).cells
                assert again.status == "ok", (file.name, damage[:20])
                assert again.values["cost.seconds"] is not None
        (record.folder / "cell.json").write_bytes(b"\xff")
        assert [cell.status for cell in Run(done.root).cells] == ["ok"]


@pytest.mark.parametrize(
    "line",
    ['{"scored": ["cost"]}', '{"status": 3}', '{"message": null}', '{"peak_mib": "1"}', "[1]", "\udcff", "x"],
)
def test_what_is_no_message_is_ignored(line: str) -> None:
    """A line that a child writes in place of a message, with entries of other types, counts as no message."""
    assert guard.parse_message(line) is None


def test_only_a_full_disk_of_the_run_ends_it(faulty_run: FaultyRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of a disk is a row while the run can write; it ends the run, with no row, once it cannot."""
    suite = wall_suite(["faulty:how=full", "fine"], "cost")
    full, fine = faulty_run(suite, Options(jobs=0)).cells
    assert (full.status, fine.status) == ("error", "ok")
    assert "No space left" in full.message
    monkeypatch.setattr("nrbench.running.supervisor._can_write", lambda folder: False)
    with pytest.raises(OSError, match="No space left"):
        faulty_run(suite, Options(jobs=0))


def test_a_long_log_keeps_its_end(tmp_path: Path) -> None:
    """A log that floods the disk is cut; its end stays, and what follows is appended."""
    log = tmp_path / "log.txt"
    log.write_bytes(b"x" * guard.LONG_LOG + b"\nend\n")
    guard.shorten(log)
    assert log.stat().st_size < 2 * guard.SHORT_LOG
    assert log.read_bytes().endswith(b"x\nend\n")


def choose_way(way: str, patch: pytest.MonkeyPatch, warm_executor: Any) -> None:
    """Let runs fork (those of this process from the shared workers), or start a fresh interpreter for each child."""
    if way == "fork":
        patch.setattr(runner, "executor", warm_executor)
    else:
        patch.setenv("NRBENCH_FORK", "no")


@pytest.fixture(scope="module", params=WAYS)
def started(
    request: pytest.FixtureRequest, faulty_run: FaultyRun, warm_executor: Any, tmp_path_factory: Any
) -> dict[str, CellRecord]:
    """Run with a forking worker, and with a fresh interpreter for each child; return the cells by their methods."""
    program = tmp_path_factory.mktemp("started") / "tool.py"
    program.write_text(
        "import shutil, sys, time\nhoard = b'x' * (200 << 20)\nstart = time.process_time()\n"
        "while time.process_time() - start < 0.5:\n    pass\nshutil.copy(sys.argv[1], sys.argv[2])\n"
    )
    tool = f"command:run={sys.executable} {program} {{sample}} {{output}}"
    suite = wall_suite(["scatter", tool], "cost")
    with pytest.MonkeyPatch.context() as patch:
        choose_way(request.param, patch, warm_executor)
        cells = faulty_run(suite, Options(timeout=20)).cells
    return dict(zip(("scatter", "tool"), cells, strict=True))


@pytest.mark.skipif(os.name == "nt", reason="children's processor time is not measured there")
def test_what_a_program_takes_is_the_methods_cost(started: dict[str, CellRecord]) -> None:
    """Processor time and memory of a program that `command` starts and waits for are in the row."""
    tool = started["tool"]
    assert tool.status == "ok", tool.message
    assert tool.values["cost.cpu_seconds"] is not None, tool.reasons
    assert tool.values["cost.cpu_seconds"] >= 0.5
    assert tool.values["cost.peak_mib"] >= 200


def test_methods_of_nrbench_share_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that start no programs of others do; each cell of others has its own."""
    seen, job = [], executors.run_job

    def run_job(request: Request, run: Any) -> Any:
        seen.append(request.own_method)
        return job(request, run)

    monkeypatch.setattr(executors, "run_job", run_job)
    suite = wall_suite(["scatter", "command:run=cp {sample} {output}"], "cost")
    run(suite, out=tmp_path / "run", options=Options(jobs=0))
    assert seen == [True, False]


def test_both_ways_of_starting_agree(started: dict[str, CellRecord], tmp_path: Path) -> None:
    """A forked child and a fresh interpreter give the output of this process."""
    here = run(wall_suite(["scatter"], "cost"), out=tmp_path / "here", options=Options(jobs=0)).cells[0]
    output = started["scatter"].folder / "output.png"
    assert output.read_bytes() == (here.folder / "output.png").read_bytes()


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
@pytest.mark.parametrize("way", WAYS)
def test_an_interrupted_run_ends_at_once_and_resumes(
    way: str, faulty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, warm_executor: Any
) -> None:
    """Ctrl-C twice ends a run at once with exit code 130; no process and no result of its cells remain."""
    choose_way(way, monkeypatch, warm_executor)
    suite = write_sleepers(tmp_path, 2)
    words = ["--plugin", str(faulty), "run", str(suite), "--jobs", "2", "--out", "run", "--no-report"]
    running = start(tmp_path, *words)
    cells = tmp_path / "run" / "cells"
    deadline = time.monotonic() + 120
    while running.poll() is None and [log.read_text() for log in cells.glob("*/log.txt")] != ["asleep\n"] * 2:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    children = psutil.Process(running.pid).children(recursive=True)
    running.send_signal(signal.SIGINT)
    time.sleep(0.3)
    assert running.poll() is None  # the cells may end
    running.send_signal(signal.SIGINT)
    try:
        assert running.wait(10) == 130
    finally:
        running.kill()
    assert len(children) >= 4  # each cell sleeps in one process, and has started another
    assert not psutil.wait_procs(children, timeout=5)[1]
    assert {file.name for file in cells.glob("*/*")} == {"cell.json", "sample.png", "log.txt"}
    (tmp_path / "awake").touch()
    assert call(*words) == 0
    assert [record.status for record in Run(tmp_path / "run").cells] == ["ok", "ok"]


def test_one_interrupt_lets_the_running_cells_end(faulty: Path, tmp_path: Path) -> None:
    """After the event is set no cell is started, those that run end with their results, and the rest resumes."""
    options = Options(jobs=0)

    def interrupt(step: Step) -> None:
        steps.append(step)
        options.stop.set()

    steps: list[Step] = []
    suite = wall_suite(["fine", "scatter", "tiling"], "cost")
    with pytest.raises(KeyboardInterrupt):
        run(suite, out=tmp_path / "run", options=options, progress=interrupt)
    assert 1 <= len(steps) < 3
    assert {cell.status for cell in Run(tmp_path / "run").cells} == {"ok", "missing"}
    steps.clear()
    run(suite, out=tmp_path / "run", options=Options(jobs=0), progress=steps.append)
    assert [step.done for step in steps] == [1, 2, 3]
    assert steps[-1].cached >= 1
    assert steps[-1].remaining == 0


def prepare(folder: Path, method: str, **parameters: Any) -> Path:
    """Make the folder of a cell that has not run; return it."""
    if not folder.is_dir():
        (record,) = run(wall_suite(["fine"], "cost"), out=folder.with_suffix(".run"), options=Options(jobs=0)).cells
        shutil.copytree(record.folder, folder)
    cell = json.loads((folder / "cell.json").read_text())
    (folder / "cell.json").write_text(json.dumps({**cell, "method": method, "parameters": parameters}))
    for name in ("result.json", "output.png"):
        (folder / name).unlink(missing_ok=True)
    return folder


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait until a condition holds; fail if it does not soon."""
    deadline = time.monotonic() + 5
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_worker_has_one_thread(supervisors: list[Supervisor]) -> None:
    """A warm worker, all plugins imported, has a single thread, so that it may fork."""
    for supervisor in supervisors:
        server = server_of(supervisor)
        assert server.num_threads() == 1
        wait_until(lambda server=server: bool(server.children()))


@pytest.mark.parametrize("way", WAYS)
def test_relative_paths_of_users_and_of_plugins(
    way: str, faulty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, warm_executor: Any
) -> None:
    """A relative path in a parameter starts from the user's folder; one that a plugin writes to is not in it."""
    choose_way(way, monkeypatch, warm_executor)
    Path("number.txt").write_text("0.5")
    Path("tool.py").write_text("import shutil, sys\nopen('copy.txt', 'w').close()\nshutil.copy(*sys.argv[1:])\n")
    made = run(wall_suite(["fine"], "cost"), out=tmp_path / "made", options=Options(jobs=0)).cells[0]
    (made.folder / "index.csv").write_text("sample,output\nsample.png,output.png\n")
    tool = f"command:run={sys.executable} tool.py {{sample}} {{output}}"
    others = [tool, f"precomputed:directory={made.folder.relative_to(tmp_path)}"]
    methods = ["reader:file=number.txt", *(others if way == "fork" else [])]
    before = set(tmp_path.iterdir())
    brighter, *copies = run(wall_suite(methods, "cost"), out=tmp_path / "run", options=Options(timeout=20)).cells
    for record in (brighter, *copies):
        assert record.status == "ok", record.message
    sample = read_image(made.folder / "sample.png")
    assert (read_image(brighter.folder / "output.png") == np.maximum(sample, np.float32(128 / 255))).all()
    assert all((read_image(record.folder / "output.png") == sample).all() for record in copies)
    assert brighter.parameters["file"] == "number.txt"  # the key of a cell does not depend on the place of its folder
    assert set(tmp_path.iterdir()) == {*before, tmp_path / "run"}


@pytest.mark.usefixtures("faulty")
def test_one_process_scores_many_cells(supervisors: list[Supervisor], tmp_path: Path) -> None:
    """Metrics of nrbench score cell after cell in one process; it is replaced when it dies or breaks a limit."""
    supervisor, *_ = supervisors
    cells = run(wall_suite(["oracle", "fine"], "cost"), out=tmp_path / "run", options=Options(jobs=0)).cells

    def scorers(metric: str, seconds: float = 20.0) -> tuple[set[int], list[str]]:
        endings = []
        for record in cells:
            shutil.rmtree(record.folder / "scores", ignore_errors=True)
            own = metric == "cost"
            reply = supervisor.run(Request("score_cell", str(record.folder), seconds, 500, (metric,), built_in=own))
            endings.append(reply.result["status"])
        children = server_of(supervisor).children()
        return {child.pid for child in children if is_scorer(child)}, endings

    (first, endings), whole = scorers("cost"), [record.values["cost.peak_mib"] for record in cells]
    assert endings == ["ok", "ok"]
    assert len(first) == 1
    assert scorers("judge-fine") == (first, ["ok", "ok"])  # in processes of their own
    assert scorers("cost") == (first, ["ok", "ok"])
    idle = psutil.Process(*first)
    assert not [file.path for file in idle.open_files() if file.path.startswith(str(tmp_path))]
    idle.kill()
    wait_until(lambda: idle.status() == psutil.STATUS_ZOMBIE)
    second, endings = scorers("cost")
    assert endings == ["ok", "ok"]
    assert len(second - first) == 1
    psutil.Process(*second).suspend()
    third, endings = scorers("cost", 2.0)
    assert endings == ["timeout", "ok"]
    assert len(third - second) == 1
    assert scorers("cost") == (third, ["ok", "ok"])
    assert [record.values["cost.peak_mib"] for record in Run(tmp_path / "run").cells] == whole


@pytest.mark.usefixtures("faulty")
def test_one_process_runs_many_methods_of_nrbench(supervisors: list[Supervisor], tmp_path: Path) -> None:
    """Methods of nrbench run one after another in one process; the peak of a large cell is not that of the next."""
    folders = [prepare(tmp_path / name / "cell", "scatter") for name in ("small", "large", "again")]
    cell = json.loads((folders[1] / "cell.json").read_text())
    (folders[1] / "cell.json").write_text(json.dumps({**cell, "shape": [1024, 1024]}))
    requests = [Request("synthesize_cell", str(folder), 20, 500, built_in=True) for folder in folders]
    small, large, again = (supervisors[1].run(request).result for request in requests)
    kept = {child.pid for child in server_of(supervisors[1]).children()}
    assert [each["status"] for each in (small, large, again)] == ["ok"] * 3
    assert large["peak_mib"] > 20 > again["peak_mib"]
    assert small["output_hash"] == again["output_hash"]
    supervisors[1].run(requests[0])
    assert len(kept & {child.pid for child in server_of(supervisors[1]).children()}) >= 2  # one runs, one waits


def test_a_method_prepares_once_for_a_sample(supervisors: list[Supervisor], faulty: Path, tmp_path: Path) -> None:
    """What a method learned of a sample is found by all its cells, takes none of their time, and is made again if lost.

    The limit of time holds for the preparation and for the synthesis, each by itself.
    """
    suite = wall_suite([f"learner:marks={tmp_path}/marks"], "cost")

    def made(width: int) -> CellRecord:
        return run(suite.with_changes(size=(64, width)), out=tmp_path / "run", options=Options(jobs=0)).cells[0]

    first, second = made(64), made(80)
    assert first.note == second.note
    assert (tmp_path / "marks").read_text() == "(64, 64)\n"
    for cell in (first, second):
        assert cell.values["cost.seconds"] < 0.2 <= cell.values["cost.prepare_seconds"]
    (record,) = (tmp_path / "run" / "prepared").glob("*/.prepared.json")
    record.write_text("{}")
    made(96)
    assert (tmp_path / "marks").read_text() == "(64, 64)\n" * 2
    alone = synthesize("learner", first.folder / "sample.png", (32, 32), marks=str(tmp_path / "alone"))
    assert alone.note == first.note
    folder = prepare(tmp_path / "slow" / "cell", "learner", seconds=0.8, marks=str(tmp_path / "marks"))
    assert supervisors[0].run(Request("synthesize_cell", str(folder), 1.0, 500)).result["status"] == "ok"


@pytest.mark.usefixtures("faulty")
@pytest.mark.parametrize("who", ["server", "its parent", "both of them stopped"])
def test_a_worker_that_dies_is_replaced(who: str, supervisors: list[Supervisor], tmp_path: Path) -> None:
    """After its worker is killed a supervisor reports one crash, then goes on with a new worker.

    All that the worker has started ends with it: the scorer, the child that waits, and a process that a method has
    started in a session of its own, without the environment of the worker.
    """
    supervisor = supervisors[0]
    cell = run(wall_suite(["oracle"], "cost"), out=tmp_path / "run", options=Options(jobs=0)).cells[0]
    request = Request("score_cell", str(cell.folder), seconds=20, mib=500, metrics=("cost",), built_in=True)
    assert supervisor.run(request).scored == ("cost",)
    server = server_of(supervisor)
    wait_until(lambda: len(server.children()) >= 2)
    folder = prepare(tmp_path / "cell", "faulty", how="hide")
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(supervisor.run, Request("synthesize_cell", str(folder), 20, 500))
        wait_until(lambda: "child" in (folder / "log.txt").read_text() if (folder / "log.txt").exists() else False)
        children = server.children(recursive=True)
        keeper = psutil.Process(server.ppid())
        if who == "both of them stopped":
            keeper.suspend()
            server.suspend()
            supervisor.close()
        else:
            (server if who == "server" else keeper).kill()
        assert running.result().result["status"] == "crash"
    assert len(children) >= 3
    assert not psutil.wait_procs([server, keeper, *children], timeout=5)[1]
    assert no_orphans(folder)
    assert supervisor.run(request).scored == ("cost",)


def test_a_worker_imports_no_other_methods_than_those_of_the_run() -> None:
    """The kernels of the others would take seconds to compile; without a plan it imports all."""
    program = "from nrbench import plugins; from nrbench.running import worker; worker.load_kernels = print; "
    program += "worker.warm('', {}); print(*(p.name for p in plugins.inventory('synthesizers') if p.is_loaded))"
    every = sum(each.built_in for each in plugins.inventory("synthesizers"))
    for methods, count in ((["rsgf"], 1), ([], every)):
        named = [("synthesizers", name) for name in methods]
        imported = subprocess.check_output([sys.executable, "-c", program.format(named)], text=True).split()
        assert len(imported) == count and "rsgf" in imported
