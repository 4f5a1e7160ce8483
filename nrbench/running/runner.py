"""The runner: takes a plan to its end, resumes what was interrupted, and starts nothing twice."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.files import write_image
from nrbench.plugins.forms import FoundLattice
from nrbench.running.executors import executor
from nrbench.running.scoring import failed_scores, score_file
from nrbench.runs.provenance import provenance
from nrbench.runs.records import FAILED, Run
from nrbench.runs.store import RUN_FILE, CellFolder, RunDirectory, read_json, write_json
from nrbench.suites.cell import Cell
from nrbench.suites.plan import Plan, Sample
from nrbench.suites.suite import Suite

Progress = Callable[[int, int, str], None]
"""Called with the number of cells done, of all, and the name of the last one with its status."""


@dataclass(frozen=True)
class Options:
    """How to run a plan; nothing here changes a result.

    Parameters
    ----------
    jobs
        Cells at the same time; 0 runs them in this process, without limits, for the debugger.
    scheduler
        Address of a Dask scheduler, instead of threads here.
    timeout
        Wall seconds of one synthesis, one detection, or one metric.
    memory
        MiB that one child may use above the idle worker.
    retry_failed
        Run cells again that failed before.
    reuse
        Another run, whose results with the same key are copied.
    argv
        The command line, for the records.
    """

    jobs: int = 1
    scheduler: str | None = None
    timeout: float = 120.0
    memory: float = 4096.0
    retry_failed: bool = False
    reuse: Path | None = None
    argv: Sequence[str] = ()


def _quiet(done: int, total: int, what: str) -> None:
    """Report progress to nobody."""


def is_cached(directory: RunDirectory, cell: Cell, metrics: Iterable[str], retry_failed: bool = False) -> bool:
    """Return whether a cell's result and all of its scores are there."""
    where = directory.cell(cell.key)
    result = where.result()
    if result is None or (retry_failed and result["status"] in FAILED):
        return False
    names = list(metrics)
    missing = [name for name in names if not score_file(where, name).is_file()]
    return result["status"] != "ok" or not (missing or (retry_failed and failed_scores(where, names)))


def working_metrics() -> list[str]:
    """Return the names of all metrics that load."""
    return [plugin.name for plugin in plugins.inventory("metrics") if plugin.cls is not None]


def metrics_of(suite: Suite) -> list[str]:
    """Return the names of the metrics that score a suite's cells: those that it names, else all that load.

    Raises
    ------
    BadInput
        When it names one that is not known or does not load.
    """
    return [plugins.find("metrics", name).name for name in dict.fromkeys(suite.metrics)] or working_metrics()


def execute(plan: Plan, root: Path, options: Options | None = None, progress: Progress = _quiet) -> Run:
    """Run every cell that is not there yet, and return the run.

    Parameters
    ----------
    plan
        What to run.
    root
        The run directory; made where it is not there.
    options
        How to run it.
    progress
        Called after each cell.

    Raises
    ------
    BadInput
        When ``root`` holds something else, another process is running in it, or the suite names an unknown metric.
    """
    options, metrics = options or Options(), metrics_of(plan.suite)
    directory = RunDirectory(root)
    if options.reuse is not None:
        RunDirectory(options.reuse).info()
    directory.claim()
    with _locked(directory):
        _write_info(directory, plan, options)
        _copy_from(options.reuse, directory, plan)
        with executor(options.jobs, options.scheduler) as (pool, run):
            placed = _Placed(directory, options, metrics, lambda job: pool.submit(run, job))
            cells = placed.with_detected(plan.cells)
            placed.run(cells, progress)
    return Run(root)


@dataclass(frozen=True)
class _Placed:
    """Cells on their way through an executor."""

    directory: RunDirectory
    options: Options
    metrics: list[str]
    submit: Callable[[dict[str, Any]], Future[dict[str, Any]]]

    def with_detected(self, cells: list[tuple[Cell, Sample]]) -> list[tuple[Cell, Sample]]:
        """Detect each sample's lattice once for each detector of the axis, and hand it to the cells."""
        wanted = {_detection_key(c): (c, s) for c, s in cells if c.detector and not c.fault}
        found = {}
        jobs = ((key, self._detection_job(key, *wanted[key])) for key in wanted)
        for key, future in self._flow(jobs):
            found[key] = future.result()
        return [(_handed(c, found[_detection_key(c)]) if _detection_key(c) in found else c, s) for c, s in cells]

    def _detection_job(self, key: str, cell: Cell, sample: Sample) -> dict[str, Any]:
        where = self.directory.lattice(key)
        known = where.result()
        if known is not None and not (self.options.retry_failed and known["status"] in FAILED):
            return {"kind": "known", "result": known}
        assert cell.detector is not None and sample.texture is not None
        where.clear()
        write_image(_made(where).sample, sample.texture.image)
        name, version, parameters = cell.detector
        write_json(where.cell_file, {"detector": name, "version": version, "parameters": parameters})
        return self._job("detect", where)

    def run(self, cells: list[tuple[Cell, Sample]], progress: Progress) -> None:
        """Run every cell; each is prepared on disk just before it starts."""
        jobs = (((cell, i), self._cell_job(cell, sample)) for i, (cell, sample) in enumerate(cells))
        for done, ((cell, _), future) in enumerate(self._flow(jobs), 1):
            status = future.result()["status"]
            progress(done, len(cells), f"{cell.texture} / {cell.label} ({cell.lattice_source}): {status}")

    def _cell_job(self, cell: Cell, sample: Sample) -> dict[str, Any]:
        where = self.directory.cell(cell.key)
        if is_cached(self.directory, cell, self.metrics, self.options.retry_failed):
            return {"kind": "known", "result": where.result()}
        result = where.result()
        if result is None or (self.options.retry_failed and result["status"] in FAILED):
            _prepare(where, cell, sample)
        elif self.options.retry_failed:
            for file in failed_scores(where, self.metrics):
                file.unlink()
        if cell.fault:
            phase = "detect" if sample.texture and cell.detector else "render" if not sample.texture else "given"
            write_json(where.result_file, {"status": cell.fault_status, "message": cell.fault, "phase": phase})
            return {"kind": "known", "result": where.result()}
        return self._job("cell", where)

    def _job(self, kind: str, where: CellFolder) -> dict[str, Any]:
        options = self.options
        return {
            "kind": kind,
            "folder": str(where.path.resolve()),
            "metrics": self.metrics,
            "seconds": options.timeout,
            "mib": options.memory,
            "plugins": plugins.files(),
            "side_by_side": float(options.jobs > 1 or options.scheduler is not None),
        }

    def _flow(self, jobs: Iterable[tuple[Any, dict[str, Any]]]) -> Iterator[tuple[Any, Future[dict[str, Any]]]]:
        """Keep a few jobs in flight, so that folders are not made long before they are needed."""
        most = 64 if self.options.scheduler else max(1, 2 * self.options.jobs)
        flying: dict[Future[dict[str, Any]], Any] = {}
        for tag, job in jobs:
            flying[self._start(job)] = tag
            while len(flying) >= most:
                yield from _landed(flying)
        while flying:
            yield from _landed(flying)

    def _start(self, job: dict[str, Any]) -> Future[dict[str, Any]]:
        if job["kind"] != "known":
            return self.submit(job)
        known: Future[dict[str, Any]] = Future()
        known.set_result(job["result"])
        return known


def _landed(flying: dict[Future[dict[str, Any]], Any]) -> Iterator[tuple[Any, Future[dict[str, Any]]]]:
    done, _ = wait(flying, return_when=FIRST_COMPLETED)
    for future in done:
        yield flying.pop(future), future


def _detection_key(cell: Cell) -> str:
    text = json.dumps([cell.sample_hash, cell.detector], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def _handed(cell: Cell, reply: dict[str, Any]) -> Cell:
    """Return the cell with what its detector answered; without a lattice, only methods that do without go on."""
    why = reply["message"] or "no reason given"
    if reply["status"] != "ok":
        return dataclasses.replace(cell, fault=f"{cell.lattice_source}: failed: {why}", fault_status="error")
    found = FoundLattice.from_dict(reply)
    cell = dataclasses.replace(cell, detected=found, lattice_given=found.lattice)
    needed = getattr(plugins.find("synthesizers", cell.method).cls, "needs_lattice", True)
    if found.lattice is not None or not needed:
        return cell
    return dataclasses.replace(cell, fault=f"{cell.lattice_source}: no lattice: {why}", fault_status="refused")


def _made(where: CellFolder) -> CellFolder:
    where.path.mkdir(parents=True, exist_ok=True)
    return where


def _prepare(where: CellFolder, cell: Cell, sample: Sample) -> None:
    where.clear()
    if sample.texture is not None:
        write_image(_made(where).sample, sample.texture.image)
    again = sample.again if cell.reference else None
    if again is not None:
        write_image(where.again, again)
    write_json(where.cell_file, cell.as_dict())


def _write_info(directory: RunDirectory, plan: Plan, options: Options) -> None:
    suite = plan.suite
    shown = {"name": suite.name, "version": suite.version, "hash": suite.hash, "description": suite.description}
    known = read_json(directory.root / RUN_FILE) or {}
    content = {
        "created": known.get("created", datetime.now(UTC).isoformat(timespec="seconds")),
        "suite": {**shown, "seed": suite.seed, "content": suite.model_dump(mode="json")},
        **provenance(options.argv),
        "plugin_files": plugins.files(),
        "cells": [cell.as_dict() for cell, _ in plan.cells],
    }
    if known != json.loads(json.dumps(content)):
        write_json(directory.root / RUN_FILE, content)


def _copy_from(reuse: Path | None, directory: RunDirectory, plan: Plan) -> None:
    """Copy finished cells of another run that have the same key."""
    if reuse is None:
        return
    other = RunDirectory(reuse)
    other.info()
    for cell, _ in plan.cells:
        theirs, ours = other.cell(cell.key), directory.cell(cell.key)
        if theirs.result() is not None and ours.result() is None:
            ours.clear()
            aside = ours.path.with_name(f".{cell.key}")
            shutil.rmtree(aside, ignore_errors=True)
            shutil.copytree(theirs.path, aside)
            aside.rename(ours.path)


@contextlib.contextmanager
def _locked(directory: RunDirectory) -> Iterator[None]:
    """Keep a second process out of the run directory; the system lets go of the lock however this one ends."""
    with (directory.root / ".lock").open("w") as lock:
        try:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass
        except OSError:
            raise BadInput(f"{directory.root}: another nrbench is running in it; wait, or pass another --out") from None
        yield
