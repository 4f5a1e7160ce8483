"""The supervisor: run jobs in a worker process, one at a time, and record how each ends."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import os
import queue
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nrbench import plugins
from nrbench.errors import describe_error, storage_fault
from nrbench.jit import COMPILING, find_cache
from nrbench.running import guard
from nrbench.running.guard import Message, Reply
from nrbench.running.options import print_notice
from nrbench.running.phases import Request, perform
from nrbench.running.worker import GRACE, read_lines, start_worker
from nrbench.runs.store import CellFolder, Result
from nrbench.storage import temporary_folder

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
"""Set to 1 in every worker, before numpy loads there."""
KEEP_MEMORY = {
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(128 << 20),
    "MALLOC_TOP_PAD_": str(16 << 20),
}
"""Bytes from which the C library (glibc) maps an array by itself, returns freed memory to the system, and fetches more
memory than it needs. By default each array of an image is mapped and returned again, page by page."""
ROOM = 4 << 20
"""Bytes that must find room on the disk of a run for it to go on after an error of a disk."""
START = 900.0
"""Seconds that a worker may take to start. A busy machine compiles all kernels for minutes."""
KINDS = ("synthesizers", "detectors", "datasets", "metrics")
"""The kinds of plugins that run in child processes."""
_compiling = threading.Lock()
"""Held from the first notice on, so that a process gives it once."""


RunRequest = Callable[[Request], Reply]
"""Runs one request and returns how it ended: :meth:`Supervisor.run` or, in this process, :func:`run_here`."""


def run_job(job: Request, run: RunRequest) -> Result:
    """Detect a lattice, or synthesize and score a cell.

    Returns
    -------
    Result
        As written to ``result.json``, with the wall seconds of all phases.

    Raises
    ------
    OSError
        When the disk of the run is full or broken. This ends the run, because further cells would fail in the same way.
        A full disk elsewhere, such as that of a plugin's own files, is an error of the plugin.
    """
    start, where = time.monotonic(), CellFolder(Path(job.folder))
    phase, function = ("detect", "detect") if job.phase == "detect" else ("synthesize", "synthesize_cell")
    request = dataclasses.replace(job, phase=function, metrics=(), built_in=job.own_method)
    try:
        result = where.result()
        if result is None:
            result = _record(job, where, _checked(run(request), request))
        if result["status"] == "ok" and job.phase == "cell":
            phase = "score"
            _score(job, where, run)
    except Exception as error:
        if storage_fault(error) is not None and not _can_write(where.path):
            raise
        result = {"status": "crash", "message": describe_error(error), "phase": phase}
        with contextlib.suppress(OSError):
            where.write_result(result)
    return {**result, "wall": time.monotonic() - start}


def _record(job: Request, where: CellFolder, reply: Reply) -> Result:
    """Write how a detection or a synthesis ended, and return it."""
    result, detects = reply.result, job.phase == "detect"
    if result["status"] == "ok" and detects and "lattice" not in result:
        result = {"status": "crash", "message": "ended without an answer"}
    if result["status"] == "ok" and not detects and not where.output.is_file():
        result = {"status": "crash", "message": "ended without an output"}
    if not detects:
        result = {**result, "side_by_side": job.side_by_side}
        if result["status"] != "ok":
            result = {**result, "phase": "synthesize"}
    return where.write_result(result)


def _checked(reply: Reply, request: Request) -> Reply:
    """Return a reply in which a full disk is an error of the plugin; raise OSError if it is the disk of the run."""
    if reply.result["status"] != "storage":
        return reply
    if not _can_write(Path(request.folder)):
        raise OSError(errno.ENOSPC, reply.result["message"], request.folder)
    return dataclasses.replace(reply, result={**reply.result, "status": "error"})


def _can_write(folder: Path) -> bool:
    """Return whether a file of :data:`ROOM` bytes can be written in a folder."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM))
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        return False
    return True


def _score(job: Request, where: CellFolder, run: RunRequest) -> None:
    """Score by every metric that has not scored the cell yet; record the failure of one that kills the child.

    The metrics of nrbench share a process, and each third-party one has its own.
    """
    missing = where.missing_scores(job.metrics)
    own = [metric for metric in missing if plugins.lookup("metrics", metric).built_in]
    for group in (own, *([metric] for metric in missing if metric not in own)):
        left, built_in = group, job.built_in and group is own
        while left:
            request = dataclasses.replace(job, phase="score_cell", metrics=tuple(left), built_in=built_in)
            reply = _checked(run(request), request)
            left = [metric for metric in left if metric not in reply.scored]
            if left:
                why = reply.result["message"] or "the metric sent nothing"
                where.write_failed_score(left.pop(0), f"failed: {reply.result['status']}: {why}")


class Closed(BaseException):
    """The run was interrupted: the job that was running has no result."""


class Supervisor:
    """Owns one warm worker, and replaces it when it dies.

    Parameters
    ----------
    tell
        Called with a sentence when the start of the worker takes minutes, because kernels are compiled.
    warm
        Whether the worker imports plugins before it forks the children. One that does not is ready at once, and its
        children begin with a plugin's import; this is best for a few requests.
    """

    def __init__(self, tell: Callable[[str], None] = print_notice, *, warm: bool = True) -> None:
        self._tell, self._warm = tell, warm
        self._imports: tuple[list[str], list[tuple[str, str]]] = ([], [])
        self._worker: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._reader: threading.Thread | None = None
        self.ended = False
        self._stack = contextlib.ExitStack()

    def run(self, request: Request) -> Reply:
        """Run one request under its limits.

        The reply reports how the request ended, whatever the plugin does. Raises :class:`Closed` after :meth:`end`.
        """
        self._check_open()
        if self._worker is not None and self._warm and self._imports != third_party():
            self.close()  # on a cluster a worker outlives a run, and the next one may bring other plugins
        if self._worker is None:
            self._start()
        self._check_open()
        assert self._worker is not None and self._worker.stdin is not None
        try:
            self._worker.stdin.write(request.to_json() + "\n")
            self._worker.stdin.flush()
        except OSError:
            return self._crash("the worker process had ended")
        line = None
        with contextlib.suppress(queue.Empty):
            line = self._lines.get(timeout=request.seconds * max(2, len(request.metrics)) + 2 * GRACE)
        self._check_open()
        return Reply.from_json(line or "") or self._crash("the worker process died")

    def _crash(self, message: str) -> Reply:
        self._check_open()
        self.close()
        return Reply({"status": "crash", "message": message})

    def _check_open(self) -> None:
        if self.ended:
            self.close()
            raise Closed

    def _start(self) -> None:
        """Start the worker, and wait until it is ready."""
        find_cache()  # which warns if it does not last
        self._imports = third_party()
        folder = self._stack.enter_context(temporary_folder())
        (files, named), known = self._imports, plugins.inventory("synthesizers")
        methods = [("synthesizers", plugin.name) for plugin in known if plugin.built_in and plugin.is_loaded]
        content: dict[str, Any] = {"once": False, "warm": self._warm, "folder": str(folder)}
        content |= {"files": files, "imports": [*named, *methods]}
        self._worker = start_worker(content, stderr=subprocess.DEVNULL, env=worker_environment())
        self._lines, self._reader = read_lines(self._worker)
        first = self._read_first_message()
        if first.get("compiling"):
            start, tells = time.monotonic(), _compiling.acquire(blocking=False)  # one of several workers
            if tells:
                self._tell(COMPILING)
            first = self._read_first_message()
            if tells:
                self._tell(f"the kernels are compiled ({time.monotonic() - start:.0f} s)")
        if first.get("threads"):
            self._tell("a plugin starts threads when it is imported, so each cell imports its plugins anew")

    def _read_first_message(self) -> Mapping[str, Any]:
        with contextlib.suppress(queue.Empty):
            return guard.parse_message(self._lines.get(timeout=START) or "") or {}
        return {}

    def close(self) -> None:
        """Kill the worker and all that it started."""
        worker, self._worker = self._worker, None  # two threads may close at the same time
        if worker is not None:
            guard.kill_children(worker.pid)
            worker.kill()
            worker.wait()
            assert self._reader is not None and worker.stdin is not None
            self._reader.join(1.0)  # it closes the output
            with contextlib.suppress(OSError):
                worker.stdin.close()
        stack, self._stack = self._stack, contextlib.ExitStack()
        stack.close()

    def end(self) -> None:
        """Kill the worker for good: a running job raises :class:`Closed`, and no further one starts."""
        self.ended = True
        self.close()


def third_party() -> tuple[list[str], list[tuple[str, str]]]:
    """Return the third-party plugins that a worker imports before it forks: files, and kind and name of the others."""
    known = [plugin for kind in KINDS for plugin in plugins.inventory(kind) if plugin.is_loaded]
    known = [plugin for plugin in known if not (plugin.built_in or plugin.in_session)]
    apart = any(plugin.in_file and not plugin.shared for plugin in known)
    named = [(plugin.kind, plugin.name) for plugin in known if plugin.shared and not (plugin.in_file and apart)]
    return [] if apart else plugins.files(), named


def run_here(request: Request) -> Reply:
    """Run one request in this process, without limits, for the debugger."""
    messages: list[Message] = []
    with np.errstate():  # so that no plugin changes it for the next one
        perform(request, messages.append)
    return Reply.of(messages)


def worker_environment() -> dict[str, str]:
    """Return the environment of a worker: one thread, freed memory kept, no imports from the working directory."""
    fixed = {**dict.fromkeys(THREAD_VARIABLES, "1"), "PYTHONSAFEPATH": "1", "MPLBACKEND": "Agg"}
    return {**KEEP_MEMORY, **os.environ, **fixed}


_own = threading.local()
_all: list[Supervisor] = []


def own_supervisor(tell: Callable[[str], None] = print_notice) -> Supervisor:
    """Return the supervisor of this thread. It is made when needed, and again after its end."""
    known: Supervisor | None = getattr(_own, "supervisor", None)
    if known is None or known.ended:
        known = _own.supervisor = Supervisor(tell)
        _all.append(known)
    return known


def close_all() -> None:
    """End every worker that this process started."""
    while _all:
        _all.pop().end()
