"""The supervisor: runs one job at a time in a worker process, and turns whatever happens into a result."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from nrbench import plugins
from nrbench.running import guard
from nrbench.running.jobs import run
from nrbench.running.worker import Reply, Request, perform, summarize

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
GRACE = 10.0
"""Seconds that a worker may take, beyond the limit it enforces itself, before it is killed."""
START = 120.0
"""Seconds that a worker may take to start."""


class Closed(BaseException):
    """The run is being ended: the job that was under way has no result."""


class Supervisor:
    """Owns one warm worker, and restarts it when it dies.

    Where forking is unsafe or absent each request gets a fresh interpreter: same contract, slower.
    """

    def __init__(self) -> None:
        self._worker: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._pump: threading.Thread | None = None
        self._forks = True
        self._closed = False

    def ask(self, request: Request) -> Reply:
        """Run one request under its limits; raises nothing for what the plugin does, :class:`Closed` once ended."""
        self._check_open()
        if self._forks and self._worker is None:
            self._forks = self._start()
        if not self._forks:
            return _fresh(request)
        assert self._worker is not None and self._worker.stdin is not None
        try:
            self._worker.stdin.write(json.dumps(request) + "\n")
            self._worker.stdin.flush()
        except OSError:
            return self._crash("the worker process was gone")
        return self._answer(request)

    def _answer(self, request: Request) -> Reply:
        parts = max(1, len(request.get("metrics", ())))
        line = self._line(request["seconds"] * parts + GRACE)
        self._check_open()
        reply = guard.parsed(line) if line is not None else None
        return reply if reply is not None and "status" in reply else self._crash("the worker process itself died")

    def _crash(self, message: str) -> Reply:
        self._check_open()
        self.close()
        return {"status": "crash", "message": message, "scored": []}

    def _check_open(self) -> None:
        if self._closed:
            raise Closed

    def _start(self) -> bool:
        """Start the worker; return whether it can fork."""
        self._worker = subprocess.Popen(
            _command(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=worker_environment(),
            start_new_session=True,
        )
        self._lines = queue.Queue()
        self._pump = threading.Thread(target=_pump, args=(self._worker.stdout, self._lines), daemon=True)
        self._pump.start()
        hello = guard.parsed(self._line(START) or "")
        forks = bool(hello and hello.get("fork"))
        if not forks:
            self.close()
        return forks

    def _line(self, seconds: float) -> str | None:
        with contextlib.suppress(queue.Empty):
            return self._lines.get(timeout=seconds)
        return None

    def close(self) -> None:
        """Kill the worker and what it runs."""
        if self._worker is not None:
            guard.sweep(self._worker.pid)
            self._worker.wait()
            for pipe in (self._worker.stdin, self._worker.stdout if self._drained() else None):
                with contextlib.suppress(OSError):
                    pipe.close() if pipe else None
            self._worker = None

    def end(self) -> None:
        """Kill the worker for good: a job under way raises :class:`Closed`, and no further one starts."""
        self._closed = True
        self.close()

    def _drained(self) -> bool:
        """Wait a little for the reader to see the pipe's end: something that escaped may hold it open."""
        if self._pump is not None:
            self._pump.join(1.0)
        return self._pump is None or not self._pump.is_alive()

    def __enter__(self) -> Supervisor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def worker_environment() -> dict[str, str]:
    """Return the environment of a worker: one thread, no surprises from the current directory."""
    return {**os.environ, **dict.fromkeys(THREAD_VARIABLES, "1"), "PYTHONSAFEPATH": "1", "MPLBACKEND": "Agg"}


def _command(*options: str) -> list[str]:
    return [sys.executable, "-c", "from nrbench.running.worker import main; main()", *options, *plugins.files()]


def _pump(stream: IO[str], lines: queue.Queue[str | None]) -> None:
    with contextlib.suppress(ValueError, OSError):
        for line in stream:
            lines.put(line)
        stream.close()
    lines.put(None)


def _fresh(request: Request) -> Reply:
    """Run one request in an interpreter of its own, watched from here."""
    with (Path(request["folder"]) / "log.txt").open("ab") as log:
        child = subprocess.Popen(
            _command("--once"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=worker_environment(),
            start_new_session=True,
        )
    assert child.stdin is not None and child.stdout is not None
    lines: queue.Queue[str | None] = queue.Queue()
    threading.Thread(target=_pump, args=(child.stdout, lines), daemon=True).start()
    with contextlib.suppress(OSError):
        child.stdin.write(json.dumps(request) + "\n")
        child.stdin.close()
    watch = guard.Watch(
        child.pid, lambda seconds: _from_queue(lines, seconds), lambda: child.poll() is not None, _with_start(request)
    )
    broken = watch.broken()
    guard.sweep(child.pid)
    code = child.wait()
    if broken:
        return summarize(guard.Ending(watch.messages, *broken))
    if code != 0:
        return summarize(guard.Ending(watch.messages, "crash", guard.explain_exit(code)))
    return summarize(guard.Ending(watch.messages, started=watch.started))


def _with_start(request: Request) -> guard.Limits:
    """Return the limits of a fresh interpreter: its own start and imports come on top."""
    return guard.Limits(request["seconds"] + GRACE, request["mib"] + 512)


def _from_queue(lines: queue.Queue[str | None], seconds: float) -> list[dict[str, Any]] | None:
    try:
        line = lines.get(timeout=seconds)
    except queue.Empty:
        return []
    message = guard.parsed(line) if line is not None else None
    return None if line is None else [message] if message is not None else []


class Local:
    """The debuggable twin of :class:`Supervisor`: runs each request in this very process, without limits."""

    def ask(self, request: Request) -> Reply:
        """Run one request here; an exception that a phase does not catch comes through."""
        messages: list[dict[str, Any]] = []
        perform(request, messages.append)
        return summarize(guard.Ending(messages))

    def close(self) -> None:
        """Do nothing: there is no process to end."""


_own = threading.local()
_all: list[Supervisor] = []


def run_job(job: Mapping[str, Any]) -> dict[str, Any]:
    """Run one job by this thread's own supervisor (here, or in a process on a cluster)."""
    for file in job.get("plugins", ()):
        plugins.add_file(file)
    if not hasattr(_own, "supervisor"):
        _own.supervisor = Supervisor()
        _all.append(_own.supervisor)
    supervisor: Supervisor = _own.supervisor
    return run(job, supervisor)


def run_job_here(job: Mapping[str, Any]) -> dict[str, Any]:
    """Run one job in this process, for the debugger."""
    return run(job, Local())


def close_all() -> None:
    """End every worker that this process started."""
    while _all:
        _all.pop().end()
