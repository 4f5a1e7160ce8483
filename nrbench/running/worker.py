"""The worker process: it imports the plugins of a run, loads their kernels, and then forks children that run phases.

The worker computes nothing itself and has a single thread, so that forking is safe. Where it is not, each child is a
fresh interpreter. Each phase that runs third-party code has a child of its own. Two forked children serve many cells:
one synthesizes by the methods of nrbench, and the other, the scorer, scores by its metrics.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import importlib
import json
import os
import queue
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NoReturn, cast

from nrbench import plugins
from nrbench.jit import load_kernels
from nrbench.plugins.parameters import leave_user_folder, prepare_conversion
from nrbench.running import guard
from nrbench.running.guard import Message, Reply
from nrbench.running.phases import PREPARED, KeptSurvey, Request, Send, perform, send_error
from nrbench.suites.cell import Cell, Recipe, reader_of
from nrbench.work import MIB

ROOM_BETWEEN = 256.0
"""MiB beyond those of the worker that a child may hold between two cells. Above it, a new child takes its place."""
PATIENCE = 0.02
"""Seconds that a worker waits for the next request before it ends the child of the last one."""
LATE = 5.0
"""Seconds that the last messages of an ended interpreter may take to arrive, because a thread reads them."""
GRACE = 10.0
"""Seconds that a fresh interpreter may take to start."""
LONGEST = 16 << 20
"""Bytes of the longest message; what is longer is no message."""
MESSAGES = 3
"""The file descriptor to which a child writes its messages."""
DEFERRED = (
    *("scipy.cluster.vq", "scipy.fft", "scipy.interpolate", "scipy.linalg", "scipy.ndimage", "scipy.optimize"),
    *("scipy.signal", "scipy.sparse", "scipy.spatial.distance", "scipy.special", "scipy.stats", "skimage.color"),
    "skimage.morphology",
    *("PIL.BmpImagePlugin", "PIL.GifImagePlugin", "PIL.JpegImagePlugin", "PIL.PpmImagePlugin"),
    *("encodings.ascii", "pydantic.type_adapter"),
)
"""Modules that libraries import on first use. A worker imports them before it forks, not each of its children."""


def warm(compiling: Callable[[], None], imports: Iterable[Sequence[str]] = ()) -> None:
    """Import plugins and all that they use, and load every compiled kernel, before children are forked.

    These are the datasets, detectors and metrics of nrbench, and the given plugins. Kernels of methods that no cell
    needs take seconds to compile.

    Parameters
    ----------
    compiling
        Called if kernels have to be compiled, which takes minutes, before that begins.
    imports
        Kind and name of plugins. If no synthesizer is among them, all those of nrbench are imported. A child imports
        any other plugin when it needs it.
    """
    for name in DEFERRED:
        importlib.import_module(name)
    wanted = {plugins.find(kind, name) for kind, name in imports}
    for kind in ("datasets", "detectors", "metrics", "synthesizers"):
        if kind != "synthesizers" or all(plugin.kind != kind for plugin in wanted):
            wanted.update(plugin for plugin in plugins.inventory(kind) if plugin.built_in)
    for plugin in wanted:
        prepare_conversion(plugin.cls)
    for read in (Cell, Recipe, KeptSurvey):
        reader_of(read)
    load_kernels(compiling)
    gc.collect()
    gc.freeze()  # a collection in a child would write into all objects of the worker, and so copy their memory
    guard.collapse_pages()


def may_fork() -> bool:
    """Return whether forking is safe here: a system that forks, and a single thread."""
    if not sys.platform.startswith("linux") or os.environ.get("NRBENCH_FORK") == "no":
        return False
    return len(list(Path("/proc/self/task").iterdir())) == 1  # also threads that Python does not know


class ForkedChild:
    """A child of this process that runs the requests which arrive in its standard input, a pipe.

    Parameters
    ----------
    many
        Whether it runs many requests; otherwise it ends after one.
    """

    def __init__(self, many: bool) -> None:
        (self._messages, theirs), (requests, self._requests) = os.pipe(), os.pipe()
        try:
            self.pid = os.fork()
            if self.pid == 0:
                _serve(requests, theirs, many)
        except OSError:
            os.close(self._messages)
            os.close(self._requests)
            raise
        finally:
            os.close(theirs)
            os.close(requests)
        self._pending = b""

    def send(self, request: Request) -> None:
        """Send a request."""
        with contextlib.suppress(OSError):  # it has just died
            _write_line(self._requests, request.to_json())

    def receive(self, seconds: float) -> list[Message] | None:
        """Wait for messages, see :class:`~nrbench.running.guard.Child`."""
        if not select.select([self._messages], [], [], seconds)[0]:
            return []
        data = os.read(self._messages, 1 << 16)
        *lines, pending = (self._pending + data).split(b"\n")
        self._pending = pending if len(pending) < LONGEST else b""
        return [message for line in lines if (message := guard.parse_message(line))] if data else None

    def has_ended(self) -> bool:
        """Return whether the process has ended."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None

    def end(self, kill: bool) -> int:
        """Wait for the end of the process, killed or not; return its exit code (negative: minus the signal)."""
        if kill:
            os.kill(self.pid, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        os.close(self._messages)
        os.close(self._requests)
        return code


class FreshChild:
    """A new interpreter that runs a single request.

    Parameters
    ----------
    log
        The file that it writes its messages to.
    folder
        Its working directory at the start, from which relative paths to modules start.
    """

    def __init__(self, log: Path, folder: str) -> None:
        with log.open("ab") as opened:
            self._process = start_worker({"once": True}, stderr=opened, cwd=folder)
        self.pid = self._process.pid
        self._lines, _ = read_lines(self._process)

    def send(self, request: Request) -> None:
        """Send the request."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write(request.to_json() + "\n")
            self._process.stdin.close()

    def receive(self, seconds: float) -> list[Message] | None:
        """Wait for a message, see :class:`~nrbench.running.guard.Child`."""
        end = time.monotonic() + (LATE if self.has_ended() else seconds)
        while (left := end - time.monotonic()) > 0:
            try:
                line = self._lines.get(timeout=left)
            except queue.Empty:
                break
            if line is None:
                return None
            if message := guard.parse_message(line):
                return [message]
        return []

    def has_ended(self) -> bool:
        """Return whether the process has ended."""
        return self._process.poll() is not None

    def end(self, kill: bool) -> int:
        """Wait for the end of the process, killed with its group or not; return its exit code."""
        if kill:
            self._process.kill()
        code = self._process.wait()
        if sys.platform != "win32":
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, signal.SIGKILL)
        return code


def start_worker(content: Mapping[str, Any], **options: Any) -> subprocess.Popen[str]:
    """Start an interpreter that calls :func:`run_worker`.

    Parameters
    ----------
    content
        Its argument.
    options
        More options of :class:`subprocess.Popen`.
    """
    program = "from nrbench.running.worker import run_worker; run_worker()"
    command = [sys.executable, "-c", program, json.dumps(content)]
    options = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "start_new_session": True, **options}
    started: subprocess.Popen[str] = subprocess.Popen(command, **options)
    return started


def read_lines(process: subprocess.Popen[str]) -> tuple[queue.Queue[str | None], threading.Thread]:
    """Read the output of a process in a thread; return the queue of its lines (None at the end) and the thread."""
    lines: queue.Queue[str | None] = queue.Queue()

    def read(output: IO[str]) -> None:
        with contextlib.suppress(ValueError, OSError):
            while line := output.readline(LONGEST):
                lines.put(line)
            output.close()
        lines.put(None)

    thread = threading.Thread(target=read, args=(process.stdout,), daemon=True)
    thread.start()
    return lines, thread


class ChildServer:
    """Runs requests in children, one at a time, under their limits.

    A child that runs third-party code ends with its request. The methods and metrics of nrbench keep no state and start
    nothing, so one child synthesizes many cells and one scores them: a fork takes longer than many a cell, and what is
    found of a sample is found once. Between two cells, the first gives free memory back and starts to measure its peak
    anew. Each is replaced when it breaks a limit, dies, or has come to hold more than :data:`ROOM_BETWEEN`.

    A fork takes milliseconds, and so does the end of a process. Neither delays a reply: the child of the next request
    is forked after a reply (:attr:`next_child`), and the last child ends while the scorer works, or before the next
    child begins.

    Parameters
    ----------
    forks
        Whether children are forked.
    home
        The working directory at the start of children that are fresh interpreters.
    folder
        An empty folder, in which the working directories of children are made.
    """

    def __init__(self, forks: bool, home: str, folder: str) -> None:
        self._forks, self._home, self._folder = forks, home, folder
        self.next_child: ForkedChild | None = None
        self._shared: dict[str, ForkedChild] = {}
        self._last: ForkedChild | FreshChild | None = None
        self._work = ""

    def run(self, request: Request) -> Reply:
        """Run one request; return how it ended."""
        shared = self._forks and request.built_in
        scores = shared and request.phase == "score_cell"
        if not scores:
            self.recover()
            self._work = self._work or tempfile.mkdtemp(dir=self._folder)
        request = dataclasses.replace(request, temporary=self._folder if scores else self._work)
        child = self._take_child(request, shared)
        limits = guard.Limits(request.seconds, request.mib, request.metrics or (PREPARED,))
        if not self._forks:
            limits = dataclasses.replace(limits, start_seconds=GRACE, start_mib=512)
        base = guard.held_bytes(child.pid) if self._forks else 0
        child.send(request)
        if scores:
            self.recover({child.pid})
        others = self._waiting_children()
        watch = guard.Watch(child, limits, base, request.log, others)
        broken = watch.watch()
        if watch.finished and shared:
            self._shared[request.phase] = cast("ForkedChild", child)
        elif watch.finished:
            self._last = child
        code = 0 if watch.finished else child.end(kill=broken is not None)
        if not scores:
            self._empty_work()  # the disk of the run may be full of it
        return watch.reply(broken, code)

    def _take_child(self, request: Request, shared: bool) -> ForkedChild | FreshChild:
        """Return a child that waits for a request."""
        if not self._forks:
            return FreshChild(request.log, self._home)
        if shared:
            waiting = self._shared.pop(request.phase, None)
        else:
            waiting, self.next_child = self.next_child, None
        if waiting is not None and waiting.has_ended():  # something has killed it
            waiting.end(kill=False)
            waiting = None
        return waiting or ForkedChild(many=shared)

    def _waiting_children(self) -> set[int]:
        """Return the process ids of the children that wait for a request."""
        return {child.pid for child in (*self._shared.values(), self.next_child) if child is not None}

    def recover(self, spared: Collection[int] = ()) -> None:
        """End the child of the last request, kill all that it started, and remove its files.

        Parameters
        ----------
        spared
            Process ids of other children that stay.
        """
        last, self._last = self._last, None
        if last is not None:
            last.end(kill=True)
        room = guard.held_bytes(os.getpid()) + ROOM_BETWEEN * MIB
        for phase, child in list(self._shared.items()):
            if guard.held_bytes(child.pid) > room:
                self._shared.pop(phase).end(kill=True)
        guard.kill_children(os.getpid(), self._waiting_children().union(spared))
        self._empty_work()

    def _empty_work(self) -> None:
        """Remove what a request left in its working directory. An empty one is used again, which saves time."""
        if self._work and any(Path(self._work).iterdir()):
            shutil.rmtree(self._work, ignore_errors=True)
            self._work = ""


def _serve(requests: int, messages: int, many: bool) -> NoReturn:
    """Run the requests that arrive, one a line, in the calling process, a forked child; say when each is finished.

    Parameters
    ----------
    requests, messages
        The file descriptors from which requests are read, and to which messages are written.
    many
        Whether it runs many requests.
    """
    code = 70
    try:
        os.setsid()
        guard.die_with_parent()
        os.dup2(requests, 0)  # first, because its number may be that of the messages
        os.dup2(messages, MESSAGES)
        os.closerange(MESSAGES + 1, 1 << 16)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        with os.fdopen(os.dup(0), encoding="utf-8") as lines:
            while line := lines.readline():
                request = Request.from_json(line)
                try:
                    _redirect(request.log)
                    request.set_up_process()
                    with warnings.catch_warnings():  # so that a warning is in the log of each cell that it is about
                        perform(request, _send)
                except BaseException as error:
                    send_error(error, _send)
                _redirect(None)
                with contextlib.suppress(OSError):  # a plugin may have closed the pipe; the end of the process will do
                    _send({"finished": True})
                if not many:
                    break
                if request.phase == "synthesize_cell":  # its costs are measured
                    guard.forget_peak()
        code = 0
    finally:
        os._exit(code)


def _redirect(log: Path | None) -> None:
    """Let what this process prints go to a file, or nowhere."""
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    nothing = os.open(os.devnull, os.O_RDWR)
    handle = os.dup(nothing) if log is None else os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for target, origin in ((0, nothing), (1, handle), (2, handle)):
        os.dup2(origin, target)
    os.close(handle)
    os.close(nothing)


def _send(message: Message) -> None:
    _write_line(MESSAGES, json.dumps(message, allow_nan=False))


def _write_line(writable: int, line: str) -> None:
    data = f"{line}\n".encode()
    while data:
        data = data[os.write(writable, data) :]


def run_worker() -> None:
    """Serve the requests on standard input, or run a single one in this process.

    The argument of the process is a mapping in JSON:

    - ``once``: whether a single request is run in this process.
    - ``warm``: whether it imports plugins and loads kernels before it forks.
    - ``files``, ``imports``: the plugins that it imports then: files, and kind and name of others.
    - ``folder``: an empty folder for temporary files.

    The first line of output is ``{"ready": true}``, with ``"threads": true`` if an import started a thread: then this
    process cannot fork. Where kernels have to be compiled, the line ``{"compiling": true}`` comes before it.
    """
    options: Mapping[str, Any] = json.loads(sys.argv[1])
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def write(content: Mapping[str, Any]) -> None:
        out.write(json.dumps(content) + "\n")

    if options["once"]:
        _run_fresh(cast("Send", write))
    guard.go_on_in_child(sys.stdin.fileno(), options["folder"])
    home, forks = os.getcwd(), may_fork()  # noqa: PTH109
    if forks and options["warm"]:
        leave_user_folder(Path(home), Path(options["folder"], "imports"))
        for file in options["files"]:
            plugins.add_file(file)
        warm(lambda: write({"compiling": True}), options["imports"])
    threads = forks and not may_fork()
    server = ChildServer(forks and not threads, home, options["folder"])
    write({"ready": True, "threads": threads})
    lines = iter(sys.stdin)
    while True:
        if forks and not threads and server.next_child is None:
            with contextlib.suppress(OSError):  # what the last request left running may take all that a fork needs
                server.next_child = ForkedChild(many=False)
        if not forks or threads or not select.select([sys.stdin], [], [], PATIENCE)[0]:
            server.recover()
        line = next(lines, None)
        if line is None:
            return
        write(server.run(Request.from_json(line)).as_dict())


def _run_fresh(send: Send) -> NoReturn:
    """Run the request on standard input in this process, and leave."""
    request = Request.from_json(sys.stdin.readline())
    try:
        request.set_up_process()
        send(cast("Message", {"held": guard.held_bytes(os.getpid())}))
        perform(request, send)
    except BaseException as error:
        send_error(error, send)
    sys.stderr.flush()
    os._exit(0)
