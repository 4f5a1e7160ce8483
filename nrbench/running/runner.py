"""The runner: run the cells of a plan that have no result yet, many at a time."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import signal
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from types import FrameType
from typing import TypeVar

from nrbench import plugins
from nrbench.calling.method_calls import InvalidOutput
from nrbench.errors import BadInput, strip_control
from nrbench.imaging.convert import Image
from nrbench.pictures.files import write_image
from nrbench.plugins.forms import FoundLattice, Shape, Texture
from nrbench.plugins.registry import bent_finders
from nrbench.running.executors import Executor, executor, synthesize_here
from nrbench.running.guard import LIMITS, Limits
from nrbench.running.options import Options as Options
from nrbench.running.options import print_notice
from nrbench.running.phases import Request, read_output, read_texture
from nrbench.running.supervisor import RunRequest, Supervisor, third_party
from nrbench.runs.records import Run
from nrbench.runs.store import FAILED, CellFolder, Result, RunDirectory
from nrbench.storage import remove, temporary_folder, write_bytes, write_json, write_text
from nrbench.suites.cell import Cell, Recipe, hash_content, reader_of
from nrbench.suites.plan import Plan, PlannedSample, make_plan
from nrbench.suites.suite import Suite
from nrbench.work import REUSED

T = TypeVar("T")
TICK = 0.2
"""Seconds between two checks whether the run is to stop."""


def is_cached(directory: RunDirectory, cell: Cell, metrics: Iterable[str], retry_failed: bool = False) -> bool:
    """Return whether a cell's result and all of its scores are on disk."""
    where = directory.cell(cell.key)
    result = where.result()
    if result is None or (retry_failed and result["status"] in FAILED):
        return False
    if result["status"] != "ok":
        return True
    if where.lost_files(result) or (retry_failed and where.cut_files(result)):
        return False
    metrics = list(metrics)
    return not (where.missing_scores(metrics) or (retry_failed and where.failed_scores(metrics)))


def working_plugins(kind: str, tell: Callable[[str], None] = print_notice) -> list[str]:
    """Return the names of all plugins of a kind that load.

    Parameters
    ----------
    kind
        The kind.
    tell
        Called with a sentence about each third-party plugin that does not load.
    """
    listed = plugins.inventory(kind)
    for plugin in listed:
        if plugin.cls is None and not plugin.duplicate:
            why = plugin.error.strip().splitlines()[-1]
            tell(f"{plugins.FORMS[kind].noun} {plugin.name!r} of {plugin.distribution} is left out: {why}")
    return [plugin.name for plugin in listed if plugin.cls is not None]


def find_metrics(names: Iterable[str], tell: Callable[[str], None] = lambda text: None) -> list[str]:
    """Return the names of metrics, each once; if none is named, of all that load.

    Raises
    ------
    BadInput
        When a metric is not known or does not load.
    """
    return [plugins.find("metrics", name).name for name in dict.fromkeys(names)] or working_plugins("metrics", tell)


def plan_run(
    suite: Suite,
    textures: Sequence[str] = (),
    limits: Limits = LIMITS,
    progress: Callable[[float], None] = lambda done: None,
) -> Plan:
    """Draw every sample and list every cell, as :func:`~nrbench.suites.plan.make_plan` does.

    A third-party dataset draws in a child process: if it fails, hangs or kills its process, the cells of its texture
    fail, with the cause.

    Parameters
    ----------
    suite, textures, progress
        See :func:`~nrbench.suites.plan.make_plan`.
    limits
        The limits of the drawing of one texture.
    """
    with contextlib.closing(Supervisor(warm=False)) as supervisor:  # it starts a process when it is first used
        return make_plan(suite, textures, partial(draw_guarded, supervisor.run, limits), progress)


def draw_guarded(run: RunRequest, limits: Limits, recipe: Recipe, shape: Shape) -> tuple[Texture, Image | None]:
    """Draw a texture in a child process under limits; see :func:`~nrbench.suites.plan.draw_texture`.

    Raises
    ------
    BadInput
        If that fails. The error has the last lines that the dataset printed as a note.
    """
    with temporary_folder() as folder:
        write_json(CellFolder(folder).cell_file, {"recipe": recipe.as_dict(), "shape": list(shape)})
        request = Request("render", str(folder), limits.seconds, limits.mib, plugin_files=tuple(plugins.files()))
        result = run(request).result
        if result["status"] == "ok" and "texture" in result:
            return read_texture(folder, result["texture"])
        cause = result["message"] or "ended without an answer"
        error = BadInput(cause if result["status"] == "invalid" else f"dataset {recipe.dataset}: {cause}")
        error.add_note(CellFolder(folder).log_tail())
        raise error


def execute(
    plan: Plan,
    root: Path,
    options: Options | None = None,
    progress: OnStep = lambda step: None,
    lock: contextlib.ExitStack | None = None,
) -> Run:
    """Run every cell that has no result yet, and return the run.

    Parameters
    ----------
    plan
        What to run.
    root
        The run directory; it is made if it does not exist.
    options
        How to run it.
    progress
        Called after each cell with a :class:`~nrbench.running.runner.Step`.
    lock
        Keeps the directory locked after a complete run, until it is closed, for those who write reports.

    Raises
    ------
    BadInput
        When ``root`` holds something else, another process is running in it, or the suite names an unknown metric.
    ClusterLost
        When the cluster ended, or had no worker for too long. The cells that have ended are in ``root``.
    KeyboardInterrupt
        When ``options.stop`` was set before every cell had ended, after the cells that were running have.
    """
    options = options or Options()
    metrics = find_metrics(plan.suite.metrics, options.tell)
    directory = RunDirectory(root)
    if options.reuse is not None:
        RunDirectory(options.reuse).info()
    methods = sorted({cell.method for cell, _ in plan.cells})
    for name in (name for name in methods if plugins.lookup("synthesizers", name).in_session):
        options.tell(
            f"method {name}: is defined in this session, so it runs in this process without limits of time and memory; "
            "for limits put it into a file, and call nrbench.plugins.add_file(FILE)"
        )
    directory.claim()
    with contextlib.ExitStack() as locked:
        locked.enter_context(directory.locked())
        directory.write_info(plan, options.argv, metrics)
        for unfinished in (root / "prepared").glob(".*"):  # of preparations that were killed
            remove(unfinished)
        if options.reuse is not None:
            directory.copy_cells(RunDirectory(options.reuse), (cell.key for cell, _ in plan.cells))
        with executor(options.jobs, options.scheduler, options.worker_wait, options.tell) as pool:
            runner = _Runner(directory, options, metrics, pool)
            unique = {cell.key: (cell, sample) for cell, sample in plan.cells}  # methods of two names share a cell
            cells = runner.with_detected_lattices(list(unique.values()))
            pace = Pace([cell for cell, _ in cells])
            running: Counter[str] = Counter()
            ordered = _interleave(cells, pool.count_slots(), running)
            jobs = ((cell, runner.cell_job(cell, sample)) for cell, sample in ordered)
            for cell, future in runner.run_jobs(jobs):  # the folder of a cell is made just before it starts
                running[cell.texture] -= 1
                result = future.result()
                progress(pace.step(cell, result["status"], result.get("wall"), pool.count_slots()))
        REUSED.kept.clear()  # of cells that ran in this process
        if lock is not None:
            lock.enter_context(locked.pop_all())
    return Run(root)


@dataclass(frozen=True)
class _Runner:
    """Sends the cells of a plan through an executor."""

    directory: RunDirectory
    options: Options
    metrics: list[str]
    pool: Executor

    def with_detected_lattices(self, cells: list[tuple[Cell, PlannedSample]]) -> list[tuple[Cell, PlannedSample]]:
        """Run each detector of the lattice axis once for each sample; return the cells with the detected lattices."""
        wanted = {_detection_key(cell): (cell, sample) for cell, sample in cells if cell.detector and not cell.fault}
        jobs = ((key, self._detection_job(key, *wanted[key])) for key in wanted)
        results = {key: future.result() for key, future in self.run_jobs(jobs)}
        return [
            (_with_lattice(cell, results[key]) if (key := _detection_key(cell)) in results else cell, sample)
            for cell, sample in cells
        ]

    def _detection_job(self, key: str, cell: Cell, sample: PlannedSample) -> Request | Result:
        where = self.directory.lattice(key)
        result = where.result()
        if result is not None and not (self.options.retry_failed and result["status"] in FAILED):
            return result
        assert cell.detector is not None
        where.clear()
        where.path.mkdir(parents=True, exist_ok=True)
        _write_sample(where, sample)
        name, version, parameters = cell.detector
        write_json(where.cell_file, {"detector": name, "version": version, "parameters": parameters})
        return self._job("detect", where)

    def cell_job(self, cell: Cell, sample: PlannedSample) -> Request | Result:
        where, retry = self.directory.cell(cell.key), self.options.retry_failed
        result = where.result()
        if result is not None and is_cached(self.directory, cell, self.metrics, retry):
            return result
        again = retry and result is not None and (result["status"] in FAILED or not _has_its_output(where, result))
        if result is None or again or where.lost_files(result):
            where.clear()
        elif retry:
            for file in where.failed_scores(self.metrics):
                remove(file)
        _prepare(where, cell, sample)
        if cell.fault:
            log = sample.log or self.directory.lattice(_detection_key(cell)).log_tail()
            if log:
                write_text(where.log, log + "\n")
            phase = "render" if sample.size is None else "detect" if cell.detector else "given"
            if cell.fault_status == "error" and phase == "given":
                phase = "load"
            result = {"status": cell.fault_status, "message": cell.fault, "phase": phase}
            return {**where.write_result(result), "wall": 0.0}
        built_in = plugins.lookup("datasets", cell.recipe.dataset).built_in
        method = plugins.lookup("synthesizers", cell.method)
        finders = (*bent_finders(), *(cell.finder or ())[:1])
        own = built_in and method.built_in and all(plugins.lookup("detectors", str(each)).built_in for each in finders)
        return dataclasses.replace(
            self._job("cell", where, cell.texture, built_in), own_method=own and method.shared, here=method.in_session
        )

    def _job(self, phase: str, where: CellFolder, group: str = "", built_in: bool = False) -> Request:
        options = self.options
        return Request(
            phase,
            str(where.path),
            options.timeout,
            options.memory,
            metrics=tuple(self.metrics),
            plugin_files=tuple(plugins.files()),
            imports=tuple(third_party()[1]),
            side_by_side=float(options.jobs > 1 or options.scheduler is not None),
            group=group,
            built_in=built_in,
        )

    def run_jobs(self, jobs: Iterable[tuple[T, Request | Result]]) -> Iterator[tuple[T, Future[Result]]]:
        """Yield each finished job with its tag; few are submitted at a time, so that folders are made when needed."""
        running: dict[Future[Result], T] = {}
        waiting, more, stopped = iter(jobs), True, False
        while more or running:
            stopping = self.options.stop.is_set()
            if more and (stopping or len(running) < max(1, 4 * self.pool.count_slots())):
                tag, job = next(waiting, (None, None))
                more = job is not None and not (stopping and isinstance(job, Request))
                stopped |= job is not None and not more
                if job is not None and tag is not None and more:
                    running[self._start(job)] = tag
                    continue
            done, undone = wait(running, TICK, FIRST_COMPLETED)
            self.pool.check()
            for future in undone:
                if self.options.stop.is_set() and future.cancel():
                    running.pop(future)
                    stopped = True
            for future in done:
                yield running.pop(future), future
        if stopped:
            raise KeyboardInterrupt

    def _start(self, job: Request | Result) -> Future[Result]:
        if isinstance(job, Request):
            if job.here:
                synthesize_here(job)
            return self.pool.submit(job)
        known: Future[Result] = Future()
        known.set_result(job)
        return known


def _has_its_output(where: CellFolder, result: Result) -> bool:
    """Return whether the output of a cell is as its method returned it; also true if the method returned none."""
    try:
        return result["status"] != "ok" or (not where.cut_files(result) and read_output(where, result).size > 0)
    except (BadInput, InvalidOutput):
        return False


def _interleave(
    cells: list[tuple[Cell, PlannedSample]], slots: int, running: Counter[str]
) -> Iterator[tuple[Cell, PlannedSample]]:
    """Yield the cells, those of as many textures at a time as there are slots.

    Next is the texture of which the fewest cells wait or run. So each worker finds cells of its own texture, however
    fast it is, and learns no other one, which takes seconds.

    Parameters
    ----------
    cells, slots
        The cells, and the number of those that can run at the same time.
    running
        How many cells of each texture wait or run: this function counts those that it yields, the caller those that
        have ended.
    """
    textures = [list(own) for _, own in itertools.groupby(cells, lambda each: each[0].texture)]
    while textures:
        lane = min(textures[: max(1, slots)], key=lambda own: running[own[0][0].texture])
        running[lane[0][0].texture] += 1
        yield lane.pop(0)
        if not lane:
            textures.remove(lane)


def _detection_key(cell: Cell) -> str:
    return hash_content([cell.sample_hash, cell.detector])


def _with_lattice(cell: Cell, result: Result) -> Cell:
    """Return the cell with the detected lattice, or with a fault if its method needs a lattice and none was found."""
    why = result["message"] or "no reason given"
    if result["status"] != "ok":
        return dataclasses.replace(cell, fault=f"{cell.lattice_source}: failed: {why}", fault_status="error")
    detected = reader_of(FoundLattice).validate_python({"lattice": None, **result})
    cell = dataclasses.replace(cell, detected=detected, lattice_given=detected.lattice)
    needed = getattr(plugins.find("synthesizers", cell.method).cls, "needs_lattice", True)
    if detected.lattice is not None or not needed:
        return cell
    return dataclasses.replace(cell, fault=f"{cell.lattice_source}: no lattice: {why}", fault_status="refused")


def _write_sample(where: CellFolder, sample: PlannedSample) -> None:
    write_bytes(where.sample, _encode_sample(sample))
    if sample.known is not None:
        write_image(where.known, sample.known[..., None].astype("float32"))


@lru_cache(maxsize=4)  # the cells of a few samples follow each other
def _encode_sample(sample: PlannedSample) -> bytes:
    with temporary_folder() as folder:
        return write_image(folder / "sample.png", sample.image()).read_bytes()


def _prepare(where: CellFolder, cell: Cell, sample: PlannedSample) -> None:
    """Write the files that a cell's child processes read. What is there may be damaged."""
    where.path.mkdir(parents=True, exist_ok=True)
    if sample.size is not None:
        _write_sample(where, sample)
    again = sample.again() if cell.reference else None
    if again is not None:
        write_image(where.again, again)
    write_json(where.cell_file, cell.as_dict())


@dataclass(frozen=True)
class Step:
    """A cell that has ended.

    Parameters
    ----------
    done, total
        Number of cells that have ended, this one included, and of all.
    cached, failed
        How many of those that have ended had their results on disk, and how many failed.
    texture, method, lattice_source
        What the cell is.
    status
        How it ended.
    remaining
        Estimated wall seconds until the run ends; None before they can be estimated.
    """

    done: int
    total: int
    cached: int
    failed: int
    texture: str
    method: str
    lattice_source: str
    status: str
    remaining: float | None = None

    @property
    def text(self) -> str:
        """The cell and its status in words."""
        return strip_control(f"{self.texture} / {self.method} ({self.lattice_source}): {self.status}")

    @property
    def remaining_text(self) -> str:
        """The time until the run ends, rounded, in words; empty if it is unknown or none is left."""
        if self.remaining is None or self.done == self.total:
            return ""
        seconds = max(1, round(self.remaining))
        if seconds < 100:
            return f"about {seconds} s left"
        return f"about {round(seconds / 60)} min left" if seconds < 6000 else f"about {round(seconds / 3600)} h left"


OnStep = Callable[[Step], None]
"""Called after each cell."""


@dataclass
class Pace:
    """Counts the cells of a run, and estimates the time that the others will take.

    The first cell of a texture also pays for what is learned of the texture, and the first cells of all for the start
    of the workers. So the first cells of textures have a mean of their own, without those of the first workers, and all
    other cells that of their method. There is no estimate before all means are known that it needs.

    Parameters
    ----------
    cells
        All cells of the run.
    """

    cells: list[Cell]
    _seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    _first_seconds: list[float] = field(default_factory=list)
    _counts: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._unopened = {cell.texture: cell.label for cell in reversed(self.cells)}
        self._left = Counter(cell.label for cell in self.cells) - Counter(self._unopened.values())

    def step(self, cell: Cell, status: str, seconds: float | None, slots: int) -> Step:
        """Count a cell that has ended.

        Parameters
        ----------
        cell, status
            The cell, and how it ended.
        seconds
            The wall seconds that it took; None if it was cached.
        slots
            Number of cells that run at the same time, at present.
        """
        first = self._unopened.pop(cell.texture, None)
        if first is not None:  # the cells of a texture may end in another order
            self._left[first] += 1
        self._left[cell.label] -= 1
        self._counts.update(done=1, cached=int(seconds is None), failed=int(status in FAILED))
        if seconds is not None:
            (self._seconds[cell.label] if first is None else self._first_seconds).append(seconds)
        done, cached, failed = (self._counts[name] for name in ("done", "cached", "failed"))
        what = (cell.texture, cell.label, cell.lattice_source, status)
        return Step(done, len(self.cells), cached, failed, *what, self._remaining(slots))

    def _remaining(self, slots: int) -> float | None:
        """Return the seconds left; None as long as a mean is unknown."""
        started = self._first_seconds[max(1, slots) :]
        counts = [(count, self._seconds.get(label, [])) for label, count in self._left.items() if count]
        counts += [(len(self._unopened), started)] if self._unopened else []
        if not all(times for _, times in counts):
            return None
        total = sum(count * sum(times) / len(times) for count, times in counts)
        return total / max(1, min(slots, sum(count for count, _ in counts)))


@contextmanager
def first_interrupt(tell: Callable[[], None]) -> Iterator[threading.Event]:
    """Yield an event that the first interrupt (Ctrl-C) sets; the second one raises KeyboardInterrupt.

    Outside the main thread, where no signal can be caught, and in a process that ignores interrupts, the event stays
    unset.

    Parameters
    ----------
    tell
        Called at the first interrupt.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield stop
        return

    def handle(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, before)
        stop.set()
        tell()

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
