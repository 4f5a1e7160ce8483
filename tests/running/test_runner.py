"""A run resumes, repeats nothing, and gives the same bytes in any order and number of workers."""

import json
import os
import shutil
import signal
import threading
import time
import tomllib
from concurrent.futures import wait
from pathlib import Path

import psutil
import pytest
from commands import call, start
from suites import scores

from nrbench import run
from nrbench.api.runs import changed
from nrbench.errors import BadInput
from nrbench.running import executors
from nrbench.running.phases import Request
from nrbench.running.runner import Options
from nrbench.runs.records import Run
from nrbench.runs.store import Result, RunDirectory
from nrbench.suites.cell import Cell
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import Suite, validated_suite

SUITE_TOML = """
name = "small"
sample = "64x64"
size = "96x80"
lattice = ["given"]
methods = ["oracle", "tiling", "scatter", "rsgf:block=16,border=4"]
replicates = 2
texture = [{ name = "wall", dataset = "brick", parameters = { color = 0.2, noise = 0.02 } }]
"""


def small(**more: object) -> Suite:
    """Return a suite of one wall and four methods."""
    return validated_suite({**tomllib.loads(SUITE_TOML), **more}, "test")


def test_methods_of_two_names_share_a_cell(tmp_path: Path) -> None:
    """A label and a preset that equals the defaults are rows of their own; the result is one."""
    methods = ["quilting", "quilting:preset=paper", "quilting:label=Efros 2001", "quilting:block=0"]
    done = run(small(methods=methods, metrics=["cost"], replicates=1), out=tmp_path, options=Options(jobs=0))
    assert done.table()["method"].tolist() == ["quilting", "quilting:preset=paper", "Efros 2001"]
    assert len({record.key for record in done.cells}) == len(list((tmp_path / "cells").iterdir())) == 1
    assert done.table()["seconds"].nunique() == 1


def test_cells_of_a_texture_go_to_one_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of two threads keeps to the jobs of one group; with one group left, both take its jobs."""
    submitted, both, taken = threading.Event(), threading.Barrier(2), []

    def take(job: Request, runner: object) -> Result:
        submitted.wait(60)
        both.wait(60)
        taken.append((job.group, threading.get_ident()))
        return {}

    monkeypatch.setattr(executors, "run_job", take)
    with executors.executor(2) as pool:
        futures = [pool.submit(Request("cell", "", 1, 1, group=group)) for group in "ab" * 8]
        submitted.set()
        wait(futures)
        assert len(set(taken)) == 2
        last = [pool.submit(Request("cell", "", 1, 1, group="a")) for _ in range(2)]
        assert [future.result() for future in last] == [{}, {}]


def outputs(found: Run) -> dict[str, bytes]:
    """Return the bytes of every output and source map, by cell."""
    return {
        f"{record.key}/{name}": path.read_bytes()
        for record in found.cells
        for name in ("output.png", "source.npz")
        if (path := record.folder / name).is_file()
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run the suite once, undisturbed, in this process."""
    return run(small(), out=tmp_path_factory.mktemp("whole") / "run", options=Options(jobs=0))


@pytest.fixture
def first(whole: Run, tmp_path: Path) -> Run:
    """Return a copy of the run, for one test."""
    return Run(Path(shutil.copytree(whole.root, tmp_path / "run")))


@pytest.mark.usefixtures("warm_workers")
def test_workers_and_order_change_nothing(whole: Run, tmp_path: Path) -> None:
    """With two workers, and in the reverse order, all outputs and scores have the bytes of this process."""

    def files(found: Run) -> dict[str, bytes]:
        kept = [*found.root.glob("cells/*/output.png"), *found.root.glob("cells/*/source.npz")]
        kept += [file for file in found.root.glob("cells/*/scores/*") if not file.name.startswith("cost-")]
        return {str(file.relative_to(found.root)): file.read_bytes() for file in kept}

    assert all(record.status == "ok" for record in whole.cells)
    assert len(files(whole)) > 20
    found = run(small(methods=small().methods[::-1]), out=tmp_path / "run", options=Options(jobs=2))
    assert files(found) == files(whole)
    assert sorted(scores(found), key=str) == sorted(scores(whole), key=str)


def test_a_directory_of_which_a_part_was_copied_is_completed(whole: Run, first: Run) -> None:
    """Files that are lost are made again: inputs, outputs, source maps and scores; the table is as before."""
    cells = sorted(first.cells, key=lambda record: record.method)
    lost = ["cell.json", "sample.png", "output.png", "source.npz", "result.json"]
    assert len(cells) > len(lost)
    for record, name in zip([cell for cell in cells if cell.method != "oracle"], lost, strict=False):
        (record.folder / name).unlink()
        for file in (record.folder / "scores").glob("*"):
            file.unlink()
    copier = next(record for record in cells if record.method == "tiling")
    os.truncate(copier.folder / "cell.json", 10)
    again = run(small(), out=first.root, options=Options(jobs=0))
    assert outputs(again) == outputs(whole)
    assert scores(again) == scores(whole)
    cut = next(record.folder / "source.npz" for record in cells if (record.folder / "source.npz").is_file())
    os.truncate(cut, 20)
    run(small(), out=first.root, options=Options(jobs=0, retry_failed=True))
    assert outputs(again) == outputs(whole)


def test_a_second_run_starts_nothing(first: Run, tmp_path: Path) -> None:
    """Running again touches no result, and adding a method keeps the others' results."""
    times = {record.key: (record.folder / "result.json").stat().st_mtime_ns for record in first.cells}
    more = small(methods=[*small().methods, "scatter:block=24"])
    second = run(more, out=tmp_path / "run", options=Options(jobs=0))
    again = {record.key: (record.folder / "result.json").stat().st_mtime_ns for record in second.cells}
    assert len(again) == len(times) + 2
    assert times.items() <= again.items()


@pytest.mark.usefixtures("warm_workers")
def test_killed_halfway_it_resumes_to_the_same_table(whole: Run, tmp_path: Path) -> None:
    """After SIGKILL no worker is left, and the same command completes the run to the table of an undisturbed one."""
    suite = tmp_path / "small.toml"
    suite.write_text(SUITE_TOML)
    words = ["run", str(suite), "--no-report", "--jobs", "2", "--out", "broken"]
    broken = start(tmp_path, *words)
    cells = tmp_path / "broken" / "cells"
    while broken.poll() is None and len(list(cells.glob("*/result.json"))) < 3:
        time.sleep(0.01)
    workers = psutil.Process(broken.pid).children(recursive=True)
    os.kill(broken.pid, signal.SIGKILL)
    broken.wait()
    assert len(workers) >= 2
    assert not psutil.wait_procs(workers, timeout=10)[1]
    assert len(list(cells.glob("*/result.json"))) < len(whole.cells)
    assert call(*words) == 0
    assert scores(Run(tmp_path / "broken")) == scores(whole)
    assert outputs(Run(tmp_path / "broken")) == outputs(whole)


def test_scores_are_keyed_apart(first: Run, tmp_path: Path) -> None:
    """With a score removed only that score is computed again; the synthesis is not repeated."""
    record = first.cells[0]
    result = (record.folder / "result.json").stat().st_mtime_ns
    score = next((record.folder / "scores").glob("cost-*.json"))
    score.unlink()
    run(small(), out=tmp_path / "run", options=Options(jobs=0))
    assert score.is_file()
    assert (record.folder / "result.json").stat().st_mtime_ns == result


def test_failures_are_kept_until_asked_to_retry(faulty: Path, tmp_path: Path) -> None:
    """A failed cell is not run again, unless asked for; then it is."""
    suite = small(methods=["faulty"], replicates=1, metrics=["cost"])
    key = run(suite, out=tmp_path / "run", options=Options(jobs=0)).cells[0].key
    result = tmp_path / "run" / "cells" / key / "result.json"
    written = result.stat().st_mtime_ns
    run(suite, out=tmp_path / "run", options=Options(jobs=0))
    assert result.stat().st_mtime_ns == written
    run(suite, out=tmp_path / "run", options=Options(jobs=0, retry_failed=True))
    assert result.stat().st_mtime_ns > written


def test_reuse_copies_results_of_equal_key(whole: Run, tmp_path: Path) -> None:
    """`reuse` copies results of equal cells from another run, and computes only what is new."""
    second = run(small(), out=tmp_path / "second", options=Options(jobs=0, reuse=whole.root))
    for old, new in zip(whole.cells, second.cells, strict=True):
        assert (old.folder / "result.json").read_bytes() == (new.folder / "result.json").read_bytes()


def test_a_detector_finds_each_lattice_once(tmp_path: Path) -> None:
    """With a detector on the lattice axis each sample has one detection, whose lattice every method is handed."""
    suite = small(lattice=["gncc:reject=none"], replicates=1, sample="128x128", metrics=["cost"])
    found = run(suite, out=tmp_path / "run", options=Options(jobs=0))
    assert len(list((tmp_path / "run" / "lattices").iterdir())) == 1
    handed = {str(record.lattice_given) for record in found.cells if record.lattice_source.startswith("gncc")}
    assert len(handed) == 1 and "None" not in handed


def test_a_directory_of_something_else_is_left_alone(tmp_path: Path) -> None:
    """A run directory in which another process runs, or that holds other files, is refused, and nothing changes."""
    directory = RunDirectory(tmp_path / "run")
    directory.claim()
    with directory.locked(), pytest.raises(BadInput, match=r"another nrbench is running in it; wait, or pass another"):
        run(small(), out=tmp_path / "run", options=Options(jobs=0))
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "mine.txt").write_text("mine")
    with pytest.raises(BadInput, match="holds something that is no run; pass an empty or new directory"):
        run(small(), out=tmp_path / "photos", options=Options(jobs=0))
    assert [path.name for path in (tmp_path / "photos").iterdir()] == ["mine.txt"]


def test_the_key_changes_with_what_decides_the_result_alone() -> None:
    """Seed, size, method parameter and lattice source change a key; the suite's description does not."""

    def keys(suite: Suite) -> list[str]:
        return [cell.key for cell, _ in make_plan(suite).cells]

    base = keys(small())
    assert len(set(base)) == len(base)
    assert keys(small(description="other words")) == base
    for change in ({"seed": 5}, {"size": "96x96"}, {"sample": "72x64"}):
        assert not set(keys(changed(small(), **change))) & set(base)
    assert keys(small(methods=["rsgf:block=18,border=4"]))[0] not in base


def test_a_cell_survives_json(tmp_path: Path) -> None:
    """A cell read back from its JSON is the same cell, with the same key."""
    for cell, _ in make_plan(small(lattice=["given", "own", "gncc:alpha=1.2"])).cells:
        back = Cell.from_dict(json.loads(json.dumps(cell.as_dict())))
        assert back.key == cell.key
        assert json.dumps(back.as_dict()) == json.dumps(cell.as_dict())
