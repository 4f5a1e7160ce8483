"""The worker process: it imports every plugin, loads every kernel, and then forks one child for each phase.

The worker computes nothing itself and has a single thread, so that forking is safe.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import json
import os
import select
import shutil
import signal
import sys
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

from nrbench import plugins
from nrbench.jit import load_kernels
from nrbench.running import clauses, guard, phases
from nrbench.running.guard import Message
from nrbench.runs.store import Result

LONGEST = 70
"""Bytes of the path of a folder of temporary files; Python's ``multiprocessing`` adds up to 35 for its sockets."""
DEFERRED = (
    *("scipy.cluster.vq", "scipy.fft", "scipy.interpolate", "scipy.linalg", "scipy.ndimage", "scipy.optimize"),
    *("scipy.signal", "scipy.sparse", "scipy.spatial.distance", "scipy.special", "scipy.stats", "skimage.color"),
)
"""Modules that scipy and scikit-image import on first use. A worker imports them before it forks."""


@dataclass(frozen=True)
class Request:
    """One phase of one cell, to be run under limits.

    Parameters
    ----------
    phase
        What to do; see :mod:`nrbench.running.phases`.
    folder
        The cell's folder.
    seconds, mib
        Limits, see :class:`~nrbench.running.guard.Limits`.
    metrics
        The metrics of the phase ``score``.
    name
        The name of the folder of temporary files where the cell's folder has a long path.
    """

    phase: Literal["render", "detect", "synthesize", "score", "report", "check"]
    folder: str
    seconds: float
    mib: float
    metrics: tuple[str, ...] = ()
    name: str = dataclasses.field(default_factory=lambda: f"nrbench-{uuid.uuid4().hex[:12]}")

    @property
    def log(self) -> Path:
        """The file of what the phase prints."""
        return Path(self.folder) / "log.txt"

    @property
    def temporary(self) -> Path:
        """The folder of the phase's temporary files, which is removed when the phase has ended.

        It lies in the cell's folder, unless that has a long path: the path of a socket has 107 bytes at most.
        """
        near = Path(self.folder) / "tmp"
        return near if len(os.fsencode(near)) <= LONGEST else Path(tempfile.gettempdir(), self.name)

    def to_json(self) -> str:
        """Return the request as one line of JSON."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, line: str) -> Request:
        """Read a request from :meth:`to_json`."""
        content = json.loads(line)
        return cls(**{**content, "metrics": tuple(content["metrics"])})


@dataclass(frozen=True)
class Reply:
    """How a request ended.

    Parameters
    ----------
    result
        At least ``status`` and ``message``.
    scored
        The metrics that are done.
    """

    result: Result
    scored: tuple[str, ...] = ()

    def to_json(self) -> str:
        """Return the reply as one line of JSON."""
        return json.dumps({**self.result, "metrics": self.scored})

    @classmethod
    def from_json(cls, line: str) -> Reply | None:
        """Read a reply from :meth:`to_json`; None for any other text."""
        content: Any = guard.parse_message(line)
        if content is None or "status" not in content:
            return None
        scored = tuple(content.pop("metrics", ()))
        return cls(content, scored)

    @classmethod
    def of(cls, ending: guard.Ending) -> Reply:
        """Return the reply that follows from how a child ended."""
        scored = tuple(message["scored"] for message in ending.messages if "scored" in message)
        results = [message for message in ending.messages if "status" in message]
        if ending.status != "ended":
            return cls({"status": ending.status, "message": ending.message}, scored)
        if not results:
            return cls({"status": "ok", "message": ""}, scored)
        result = cast("Result", results[-1])
        if "peak_mib" in result:
            result = {**result, "peak_mib": max(result["peak_mib"], ending.started / guard.MIB)}
        return cls(result, scored)


def perform(request: Request, send: Callable[[Message], None]) -> None:
    """Run one phase in this process, sending messages."""
    folder = Path(request.folder)
    before = guard.peak_bytes()

    def send_with_memory(message: Message) -> None:
        send({**message, "peak_mib": max(0, guard.peak_bytes() - before) / guard.MIB})

    if request.phase == "score":
        phases.score(folder, request.metrics, send)
    elif request.phase == "detect":
        phases.detect(folder, send)
    elif request.phase == "render":
        phases.render(folder, send)
    elif request.phase == "report":
        phases.report(folder, send)
    elif request.phase == "check":
        clauses.check(folder, send)
    else:
        phases.synthesize(folder, send_with_memory)


def warm(compiling: Callable[[], None]) -> None:
    """Import every plugin and all that they use, and load every compiled kernel, before children are forked.

    Parameters
    ----------
    compiling
        Called if kernels have to be compiled, which takes minutes, before that begins.
    """
    for name in DEFERRED:
        importlib.import_module(name)
    for kind in ("datasets", "detectors", "synthesizers", "metrics"):
        plugins.inventory(kind)
    load_kernels(compiling)


def _die_with_parent(out: int) -> None:
    """Let the kernel kill this process when the thread that started it ends; leave if its process has ended already.

    No signal handler of Python would do, because none runs while a kernel is compiled, which takes minutes.

    Parameters
    ----------
    out
        The pipe to the process that started this one.
    """
    guard.die_with_parent()
    if sys.platform.startswith("linux"):
        poll = select.poll()
        poll.register(out, 0)
        if poll.poll(0):  # nobody reads it any more
            os._exit(0)


def may_fork() -> bool:
    """Return whether forking is safe here: a system that forks, and a single thread."""
    if not sys.platform.startswith("linux") or os.environ.get("NRBENCH_FORK") == "no":
        return False
    return threading.active_count() == 1 and len(list(Path("/proc/self/task").iterdir())) == 1


def serve(requests: Iterable[str], reply: Callable[[str], None]) -> None:
    """Read one request from each line, run it in a forked child, and reply, until the input ends."""
    for line in requests:
        reply(fork_and_watch(Request.from_json(line)).to_json())


def fork_and_watch(request: Request) -> Reply:
    """Run one phase in a forked child under its limits."""
    readable, writable = os.pipe()
    base, limits = guard.held_bytes(os.getpid()), guard.Limits(request.seconds, request.mib, request.metrics)
    pid = os.fork()
    if pid == 0:
        os.close(readable)
        _child(request, writable, limits)
    os.close(writable)
    parent = os.getppid()
    watch = guard.Watch(
        pid,
        _pipe_receiver(readable),
        lambda: _has_ended(pid),
        limits,
        base,
        log=request.log,
        wanted=lambda: os.getppid() == parent,
    )
    broken = watch.watch()
    guard.sweep(pid) if broken else None
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    guard.sweep(pid)
    guard.sweep_orphans()
    os.close(readable)
    shutil.rmtree(request.temporary, ignore_errors=True)
    return Reply.of(watch.ending(broken, code))


def _has_ended(pid: int) -> bool:
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None


def _child(request: Request, writable: int, limits: guard.Limits) -> None:
    """Run the phase in the forked child, and leave without returning."""
    code = 70
    try:
        os.setsid()
        guard.die_with_parent()
        _redirect(request.log)
        os.dup2(writable, 3)
        os.closerange(4, 1 << 16)
        writable = 3
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        guard.confine(limits)
        _use_temporary(request.temporary)
        perform(request, lambda message: _send(writable, message))
        code = 0
    except BaseException as error:
        with contextlib.suppress(OSError):
            phases.send_error(error, lambda message: _send(writable, message))
            code = 0
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _use_temporary(folder: Path) -> None:
    """Make a folder, and let this process and what it starts put temporary files there."""
    folder.mkdir(mode=0o700, exist_ok=True)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)


def _redirect(log: Path) -> None:
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for target, origin in ((0, nothing), (1, handle), (2, handle)):
        os.dup2(origin, target)


def _send(writable: int, message: Message) -> None:
    data = (json.dumps(message, allow_nan=False) + "\n").encode()
    while data:
        data = data[os.write(writable, data) :]


def _pipe_receiver(readable: int) -> guard.Receive:
    """Return a receiver of messages from a pipe, one a line."""
    pending = b""

    def receive(seconds: float) -> list[Message] | None:
        nonlocal pending
        if not select.select([readable], [], [], seconds)[0]:
            return []
        data = os.read(readable, 1 << 16)
        if not data:
            return None
        *lines, pending = (pending + data).split(b"\n")
        return [message for line in lines if (message := guard.parse_message(line)) is not None]

    return receive


def main() -> None:
    """Serve the requests on standard input; with ``--once``, run a single one in this process, without forking.

    The first line of output is ``{"fork": bool}``: whether this process can fork safely. Where kernels have to be
    compiled, the line ``{"compiling": true}`` comes before it.
    """
    arguments = sys.argv[1:]
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def write(line: str) -> None:
        out.write(line + "\n")

    _die_with_parent(out.fileno())
    for file in [argument for argument in arguments if not argument.startswith("--")]:
        plugins.add_file(file)
    if "--once" in arguments:
        request = Request.from_json(sys.stdin.readline())
        try:
            _use_temporary(request.temporary)
            guard.confine(guard.Limits(request.seconds, request.mib))
            write(json.dumps({"held": guard.held_bytes(os.getpid())}))
            perform(request, lambda message: write(json.dumps(message)))
        except BaseException as error:
            phases.send_error(error, lambda message: write(json.dumps(message)))
        sys.stderr.flush()
        os._exit(0)
    guard.adopt_orphans()
    if may_fork():
        warm(lambda: write(json.dumps({"compiling": True})))
    guard.outlive_parent()  # the end of its input ends it from here on, whatever thread of the parent uses it
    write(json.dumps({"fork": may_fork()}))  # again, because a plugin may have started a thread
    serve(sys.stdin, write)
