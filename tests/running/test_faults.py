"""Whatever a plugin does, in any phase and on any executor, is a row with its cause and its log."""

import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from faults import no_orphans, registered_faults
from suites import wall_suite

from nrbench import run
from nrbench.running import guard, runner
from nrbench.running.phases import Request
from nrbench.running.runner import Options
from nrbench.running.supervisor import Supervisor
from nrbench.runs.records import CellRecord, Run

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits as Linux enforces them")

SECONDS = 5.0
"""The limit of each phase: enough for 300 MiB to be allocated on a machine that does much else."""
ENDINGS = {
    "raise": ("error", "RuntimeError: planted failure (faulty_plugins.py, line "),
    "stubborn": ("timeout", f"took longer than {SECONDS:g} s"),
    "segfault": ("crash", "died by SIGSEGV"),
    "exit": ("crash", "ended without an "),
    "hog": ("memory", "emory"),
    "mutate": ("error", "ValueError: assignment destination is read-only (faulty_plugins.py, line "),
}
"""What every phase makes of what is done to its process."""
HARMLESS = ("flood", "litter", "seed", "folder")
"""What is done beside a good answer, and must have no consequences."""
METHODS = {
    **ENDINGS,
    "refuse": ("refused", "planted refusal"),
    "full": ("error", "No space left"),
    "leave": ("crash", "exited with code 3 without a result"),
    "memory": ("memory", "memory"),
    "hide": ("timeout", f"took longer than {SECONDS:g} s; raise --timeout if it may"),
    "nan": ("invalid", "returned NaN or infinity in 1 of 4096 pixels"),
    "shape": ("invalid", "returned an image of the wrong shape: expected (64, 64, 3), got (63, 64, 3)"),
    "type": ("invalid", "expected floats in [0, 1], got dtype object"),
    "nothing": ("invalid", "returned NoneType instead of a Synthesis"),
    "lie": ("invalid", "returned a source map that is not true"),
}
DETECTORS = {**ENDINGS, "nothing": ("error", "returned NoneType"), "nan": ("error", "BadInput")}
JUDGES = {
    **{how: message for how, (_, message) in ENDINGS.items()},
    "exit": "failed: ok: the metric sent nothing",
    "nothing": "TypeError: returned NoneType instead of a Score",
    "nan": "ValueError: column 'value' is nan",
    "shape": "ValueError: values and declared columns differ in ['value']",
    "words": "a score is a finite number",
}
DATASETS = {
    "raise": "RuntimeError: planted failure (faulty_plugins.py, line ",
    "stubborn": f"dataset picture: took longer than {SECONDS:g} s; raise --timeout if it may",
    "segfault": "dataset picture: died by SIGSEGV",
    "exit": "dataset picture: ended without an answer",
    "group": "dataset picture: died by SIGKILL",
    "memory": "emory",
    "hog": "emory",
    "kind": "dataset picture: kind: expected one of 0, I, II, III, stochastic or None",
    "shape": "dataset picture: render returned the wrong shape",
}
BRIEF = ("stubborn", "segfault", "hog", "hide", "litter", "fine")
"""What is repeated where each child is a fresh interpreter, which takes a second."""


@pytest.fixture(scope="module", params=["threads", "fresh interpreters"])
def way(request: pytest.FixtureRequest, warm_executor: Any) -> Iterator[Any]:
    """Choose an executor; return its options, and which of the cases run on it."""
    limits = {"timeout": SECONDS, "memory": 300.0}
    with registered_faults(), pytest.MonkeyPatch.context() as patch:
        if request.param == "threads":
            patch.setattr(runner, "executor", warm_executor)
            yield {"jobs": 2, **limits}, lambda cases: list(cases)
        else:
            patch.setenv("NRBENCH_FORK", "no")
            yield {"jobs": 2, **limits}, lambda cases: [how for how in cases if how in BRIEF]


def no_litter(found: Run) -> bool:
    """Return whether the file that a plugin writes to a relative path is neither in the user's folder nor the run."""
    name = "left by a plugin.txt"
    return not Path(name).exists() and not list(found.root.rglob(name)) and not list(found.root.rglob("tmp"))


def is_logged(record: CellRecord, how: str) -> bool:
    """Return whether a cell's row shows the line that its plugin printed, or the end of the traceback after it."""
    return any(
        text in record.log_tail
        for text in (f"planted {how}", "planted failure", "is read-only", "MemoryError", "BadInput", "No space")
    )


def test_methods(way: Any, tmp_path: Path) -> None:
    """A method that fails in any way is a row with its status and cause; one that litters is fine, as others are."""
    options, chosen = way
    failing, fine = chosen(METHODS), [*chosen(HARMLESS), "fine"]
    suite = wall_suite([f"faulty:how={how}" for how in (*failing, *fine)], "cost")
    found = run(suite, out=tmp_path / "run", options=Options(**options))
    cells = {str(record.parameters["how"]): record for record in found.cells}
    for how in failing:
        status, message = METHODS[how]
        assert (cells[how].status, cells[how].phase) == (status, "synthesize"), (how, cells[how].message)
        assert message in cells[how].message, how
        assert is_logged(cells[how], how), how
        assert status != "invalid" or not (cells[how].folder / "output.png").exists(), how
    good = (cells["fine"].folder / "output.png").read_bytes()
    for how in fine:
        assert cells[how].status == "ok", (how, cells[how].message)
        assert (cells[how].folder / "output.png").read_bytes() == good
        assert cells[how].values["cost.seconds"] is not None
    assert no_orphans(found.root)
    assert no_litter(found)


def test_detectors(way: Any, tmp_path: Path) -> None:
    """A detector that fails in any way makes the cells of its lattice fail with the cause; the others get theirs."""
    options, chosen = way
    failing, fine = chosen(DETECTORS), [*chosen(HARMLESS), "fine"]
    axis = [f"probe:how={how}" for how in (*failing, *fine)]
    found = run(wall_suite(["follower"], "cost", lattice=axis), out=tmp_path / "run", options=Options(**options))
    for record, how in zip(found.cells, (*failing, *fine), strict=True):
        if how in fine:
            assert record.status == "ok", (how, record.message)
            assert record.lattice_given is not None
        else:
            assert (record.status, record.phase) == ("error", "detect"), how
            assert DETECTORS[how][1] in record.message, (how, record.message)
            assert is_logged(record, how), how
    assert no_orphans(found.root)
    assert no_litter(found)


def test_metrics(way: Any, tmp_path: Path) -> None:
    """A metric that fails in any way is None with the reason; the cell is fine, and so are the other metrics."""
    options, chosen = way
    failing, fine = chosen(JUDGES), [*chosen(HARMLESS), "fine"]
    metrics = [*(f"judge-{how}" for how in (*failing, *fine)), "cost"]
    found = run(wall_suite(["faulty:how=fine"], *metrics), out=tmp_path / "run", options=Options(**options))
    (record,) = found.cells
    assert record.status == "ok"
    for how in failing:
        name = f"judge-{how}.value"
        assert record.values[name] is None, how
        assert record.reasons[name].startswith("failed: ")
        assert JUDGES[how] in record.reasons[name], (how, record.reasons[name])
    for how in fine:
        assert record.values[f"judge-{how}.value"] == 1.0, (how, record.reasons.get(f"judge-{how}.value"))
    assert record.values["cost.seconds"] is not None
    assert found.ends()[0].reasons == {f"judge-{how}": record.reasons[f"judge-{how}.value"] for how in failing}
    log = (record.folder / "log.txt").read_text()
    flooded = [*failing, *fine].index("flood") if "flood" in fine else -1
    assert all(f"planted {how}" in log for how in [*failing, *fine][flooded + 1 :])
    assert len(log) < 2 * guard.SHORT_LOG
    assert no_orphans(found.root)
    assert no_litter(found)


@pytest.mark.usefixtures("faulty")
def test_datasets(supervisors: list[Supervisor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A texture whose dataset fails is a failed cell with its cause and log; one whose dataset litters is drawn."""
    kept = SimpleNamespace(run=supervisors[0].run, close=lambda: None)  # its end is not that of the test
    monkeypatch.setattr("nrbench.running.runner.Supervisor", lambda **_: kept)
    fine = ("flood", "seed", "folder", "fine")  # the textures are drawn again for the scores, in this process
    rows = [{"name": how, "dataset": "picture", "parameters": {"how": how}} for how in (*DATASETS, *fine)]
    options = Options(jobs=0, timeout=SECONDS, memory=300)
    found = run(wall_suite(["fine"], "cost", texture=rows), out=tmp_path / "run", options=options)
    for record in found.cells:
        if record.texture in fine:
            assert record.status == "ok", (record.texture, record.message)
            assert record.family == "gray"
        else:
            assert (record.status, record.phase) == ("error", "render")
            assert DATASETS[record.texture] in record.message, record.message
            assert is_logged(record, record.texture)
    assert no_litter(found)


@pytest.mark.usefixtures("faulty")
def test_limits_are_kept_within_a_tenth(supervisors: list[Supervisor], tmp_path: Path) -> None:
    """A child ends within 10 % of its limit of time, and holds no more than 10 % above its limit of memory.

    Files in memory count; what is only reserved does not, and what several processes share counts once.
    """
    suite = wall_suite([f"faulty:how={how}" for how in ("busy", "hog", "creep", "fill", "share")])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nrbench.running.runner._Runner.run_jobs", lambda self, jobs: list(jobs)[:0])  # none runs
        found = run(suite, out=tmp_path / "run", options=Options(jobs=0))
    busy, *growing, share = (Path(record.folder) for record in found.cells)
    supervisors[0].run(Request("synthesize_cell", str(busy), 0.1, 300))  # the worker is warm
    taken = [3.4]
    while len(taken) < 4 and min(taken) > 3.3:  # again, where a busy machine delays the process that watches
        start = time.monotonic()
        assert supervisors[0].run(Request("synthesize_cell", str(busy), 3.0, 300)).result["status"] == "timeout"
        taken.append(time.monotonic() - start)
    assert 3.0 <= min(taken) <= 3.3
    for folder in growing:
        held: list[int] = []
        while len(held) < 6 and min(held, default=331) > 330:  # again, for the same reason
            result = supervisors[0].run(Request("synthesize_cell", str(folder), 20, 300)).result
            assert result["status"] == "memory" and "--memory" in result["message"]
            held.append(int(re.findall(r"holds (\d+) MiB", (folder / "log.txt").read_text())[-1]))
        assert 240 <= min(held) <= 330, folder
    assert supervisors[0].run(Request("synthesize_cell", str(share), 20, 300)).result["status"] == "ok"
