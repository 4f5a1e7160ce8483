"""The worker process: it imports every plugin, loads every kernel, and then forks the children that run phases.

The worker computes nothing itself and has a single thread, so that forking is safe. Each phase has a child of its own.
The exception is scoring by the metrics of nrbench: one child, the scorer, scores many cells. After each reply the
worker forks the child of the next phase, the spare, which waits for its request.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import gc
import importlib
import json
import os
import select
import signal
import stat
import sys
import tempfile
import threading
import uuid
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import IO, Any, cast

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.jit import load_kernels
from nrbench.plugins.parameters import prepare_conversion
from nrbench.running import guard, phases
from nrbench.running.guard import Message
from nrbench.runs.store import CellFolder, Result
from nrbench.storage import leave_user_folder, read_json, remove_folder, working_folder

PATIENCE = 0.02
"""Seconds that a worker waits for the next request before it tidies up after the last one."""
SCORER_ROOM = 256.0
"""MiB that the scorer may hold between two cells, beyond what the worker holds. Above it, a new one takes its place."""
MESSAGES = 3
"""The file descriptor to which a child writes its messages."""
DEFERRED = (
    *("scipy.cluster.vq", "scipy.fft", "scipy.interpolate", "scipy.linalg", "scipy.ndimage", "scipy.optimize"),
    *("scipy.signal", "scipy.sparse", "scipy.spatial.distance", "scipy.special", "scipy.stats", "skimage.color"),
    *("PIL.BmpImagePlugin", "PIL.GifImagePlugin", "PIL.JpegImagePlugin", "PIL.PpmImagePlugin"),
    *("encodings.ascii", "pydantic.type_adapter"),
)
"""Modules that libraries import on first use. A worker imports them before it forks, not each of its children."""


@dataclass(frozen=True)
class Request:
    """One phase of one cell, to be run under limits.

    Parameters
    ----------
    phase
        What to do: the name of a function of :mod:`nrbench.running.phases`, or the whole path of another function.
    folder
        The cell's folder.
    seconds, mib
        Limits, see :class:`~nrbench.running.guard.Limits`.
    metrics
        The metrics of the phase ``score``.
    user_folder
        The folder in which the user started nrbench: relative paths in parameters start from there.
    temporary
        The folder of the phase's temporary files; the supervisor that runs the request fills it in. It does not lie in
        the cell's folder: the path of a socket has 107 bytes at most, and that of a run may be longer.
    """

    phase: str
    folder: str
    seconds: float
    mib: float
    metrics: tuple[str, ...] = ()
    user_folder: str = dataclasses.field(default_factory=working_folder)
    temporary: str = ""

    @property
    def log(self) -> Path:
        """The file of what the phase prints."""
        return Path(self.folder) / "log.txt"

    def settle(self) -> None:
        """Give the calling process the temporary files and the working directory of the phase."""
        temporary = Path(self.temporary)
        temporary.mkdir(mode=0o700, parents=True, exist_ok=True)  # a system may have cleaned its temporary files
        os.environ["TMPDIR"] = tempfile.tempdir = self.temporary
        leave_user_folder(Path(self.user_folder), temporary / "work")

    def tidy(self) -> None:
        """Remove what the phase left among its temporary files.

        Folders in which it left nothing are kept for the next phase, because some disks take milliseconds to remove
        one. All others get another name first, so that the next phase finds nothing of what cannot be removed.
        """
        if not self.left_nothing():
            temporary = Path(self.temporary)
            aside = temporary.with_name(uuid.uuid4().hex)
            with contextlib.suppress(OSError):
                temporary.rename(aside)
            remove_folder(aside)

    def left_nothing(self) -> bool:
        """Return whether the folder of temporary files is as :meth:`settle` made it."""
        temporary, work = Path(self.temporary), Path(self.temporary, "work")
        try:
            modes = [path.lstat().st_mode & ~stat.S_ISGID for path in (temporary, work)]  # that bit is inherited
            folders = all(mode == stat.S_IFDIR | 0o700 for mode in modes)
            return folders and os.listdir(temporary) == [work.name] and not os.listdir(work)  # noqa: PTH208
        except OSError:
            return False

    def to_json(self) -> str:
        """Return the request as one line of JSON."""
        return json.dumps(vars(self))

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
    before = guard.peak_bytes()

    def send_with_memory(message: Message) -> None:
        peak = {"peak_mib": max(0, guard.peak_bytes() - before) / guard.MIB} if request.phase == "synthesize" else {}
        send(cast("Message", {**message, **peak}))

    module, _, name = request.phase.rpartition(".")
    phase = getattr(importlib.import_module(module or phases.__name__), name)
    phase(Path(request.folder), send_with_memory, *request.metrics)


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
        for plugin in plugins.inventory(kind):
            if plugin.cls is not None:
                prepare_conversion(plugin.cls)
    load_kernels(compiling)
    gc.collect()
    gc.freeze()  # a collection in a child would write into all objects of the worker, and so copy their memory
    guard.collapse_pages()


def _import_plugins(request: Request) -> None:
    """Import the plugins that a request names, so that its limits do not count that, as in a forked child."""
    content: Any = read_json(CellFolder(Path(request.folder)).cell_file) or {}
    recipe = content.get("recipe")
    named = [("datasets", recipe.get("dataset") if isinstance(recipe, dict) else None)]
    if request.phase == "score":
        named += [("metrics", metric) for metric in request.metrics]
    else:
        named += [("synthesizers", content.get("method")), ("detectors", content.get("detector"))]
    for kind, name in named:
        if isinstance(name, str):
            with contextlib.suppress(BadInput):  # its phase says why it does not load
                plugins.find(kind, name)


def _add_files(files: Iterable[str]) -> None:
    for file in files:
        plugins.add_file(file)


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


def serve(requests: IO[str], reply: Callable[[str], None]) -> None:
    """Read one request from each line, run it in a forked child, and reply, until the input ends."""
    server = ForkServer()
    try:
        for line in requests:
            reply(server.run(Request.from_json(line)).to_json())
            server.prepare()
            if not select.select([requests], [], [], PATIENCE)[0]:
                server.tidy()
    finally:  # also where nobody reads the reply any more
        server.tidy()


@dataclass(frozen=True)
class Child:
    """A forked child.

    Parameters
    ----------
    pid
        Its process id.
    messages
        The end of a pipe at which the child's messages arrive, a file descriptor.
    requests
        The end of a pipe to which its requests are written, a file descriptor.
    """

    pid: int
    messages: int
    requests: int

    def has_ended(self) -> bool:
        """Return whether the process has ended."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None

    def end(self, kill: bool) -> int:
        """Wait for the end of the process, killed or not; return its exit code (negative: minus the signal).

        What it has started is left to :func:`~nrbench.running.guard.sweep_orphans`.
        """
        if kill:
            os.kill(self.pid, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        os.close(self.messages)
        os.close(self.requests)
        return code


class ForkServer:
    """Runs requests in forked children, one at a time, under their limits.

    A child that runs code of others, or whose costs are measured, ends with its request. The metrics of nrbench keep
    no state and start nothing, so one child, the scorer, scores many cells: a fork takes longer than many a score. It
    is replaced when it breaks a limit, dies, or has come to hold more than :data:`SCORER_ROOM`.

    A fork takes milliseconds, and so does the end of a process. Neither delays a reply. The child of the next request,
    the spare, is forked after a reply. It is like one that is forked later, because the server does not change. A child
    says when its request is finished, and the server waits for its end while the scorer works, or before the next one.
    Only temporary files that it left are removed before the reply.
    """

    def __init__(self) -> None:
        self._scorer: Child | None = None
        self._spare: Child | None = None
        self._finished: tuple[Child, Request] | None = None

    def run(self, request: Request) -> Reply:
        """Run one request; return how it ended."""
        return self._score(request) if _is_own(request) else self._run_alone(request)

    def prepare(self) -> None:
        """Fork the child of the next request, if there is none yet."""
        with contextlib.suppress(OSError):  # what the last request left running may take all that a fork needs
            self._spare = self._spare or _fork(_run_one)

    def tidy(self) -> None:
        """End the child whose request is finished, kill what it left running, and remove its temporary files."""
        finished, self._finished = self._finished, None
        if finished is not None:
            child, request = finished
            child.end(kill=True)
            self._remove_rests(request)

    def _remove_rests(self, request: Request) -> None:
        guard.sweep_orphans({child.pid for child in (self._scorer, self._spare) if child is not None})
        request.tidy()

    def _run_alone(self, request: Request) -> Reply:
        self.tidy()
        child = self._take_spare()
        _send_request(child, request)
        watch = _watch(child, request, guard.held_bytes(os.getpid()))
        broken = watch.watch()
        if watch.finished:
            self._finished = child, request
            if not request.left_nothing():  # the disk of the run may be full of it, and its removal may take long
                self.tidy()
            return Reply.of(watch.ending(None, 0))
        reply = Reply.of(watch.ending(broken, child.end(kill=broken is not None)))
        self._remove_rests(request)
        return reply

    def _take_spare(self) -> Child:
        """Return the spare, or a new child if there is none or something has killed it."""
        spare, self._spare = self._spare, None
        if spare is not None and spare.has_ended():
            spare.end(kill=False)
            spare = None
        return spare or _fork(_run_one)

    def _score(self, request: Request) -> Reply:
        child = self._scorer
        if child is None or child.has_ended():
            self._end_scorer()
            self.tidy()  # what the last request left running may take all that a fork needs
            child = self._scorer = _fork(_run_many)
        base = guard.held_bytes(child.pid)
        _send_request(child, request)
        self.tidy()
        watch = _watch(child, request, base)
        broken = watch.watch()
        if watch.finished:
            if guard.held_bytes(child.pid) > guard.held_bytes(os.getpid()) + SCORER_ROOM * guard.MIB:
                self._end_scorer()
            return Reply.of(watch.ending(None, 0))
        self._scorer = None
        reply = Reply.of(watch.ending(broken, child.end(kill=broken is not None)))
        self._remove_rests(request)
        return reply

    def _end_scorer(self) -> None:
        child, self._scorer = self._scorer, None
        if child is not None:
            child.end(kill=True)


def _is_own(request: Request) -> bool:
    """Return whether a request scores a cell, and all metrics as well as the dataset of its texture belong to nrbench.

    Such a request runs no code of others, and its costs are not measured. The dataset counts because scoring draws the
    texture again. A plugin may have changed the file of the cell, so its content is checked.
    """
    if request.phase != "score" or not set(request.metrics) <= _own_names("metrics"):
        return False
    try:
        recipe: Any = (read_json(CellFolder(Path(request.folder)).cell_file) or {}).get("recipe")
    except OSError:  # it cannot be read
        return False
    name = recipe.get("dataset") if isinstance(recipe, dict) else None
    return isinstance(name, str) and name in _own_names("datasets")


@cache  # a search among all plugins for each request would touch, and so copy, much memory that children share
def _own_names(kind: str) -> set[str]:
    return {plugin.name for plugin in plugins.inventory(kind) if plugin.own and plugin.cls is not None}


def _watch(child: Child, request: Request, base: int) -> guard.Watch:
    limits, parent = guard.Limits(request.seconds, request.mib, request.metrics), os.getppid()
    receive, log = _receiver(child.messages), request.log
    return guard.Watch(child.pid, receive, child.has_ended, limits, base, log, lambda: os.getppid() == parent)


def _send_request(child: Child, request: Request) -> None:
    with contextlib.suppress(OSError):  # it has just died
        _write_line(child.requests, request.to_json())


def _fork(run: Callable[[], None]) -> Child:
    """Fork a child that calls a function and leaves. Its standard input is the pipe of requests."""
    (messages, theirs), (requests_end, requests) = os.pipe(), os.pipe()
    parent = os.getpid()
    try:
        pid = os.fork()
    except OSError:
        for end in (messages, theirs, requests_end, requests):
            os.close(end)
        raise
    if pid == 0:
        code = 70
        try:
            os.setsid()
            guard.die_with_parent()
            if os.getppid() != parent:  # it has ended already
                os._exit(code)
            os.dup2(requests_end, 0)  # first, because its number may be that of the messages
            os.dup2(theirs, MESSAGES)
            os.closerange(MESSAGES + 1, 1 << 16)
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            run()
            code = 0
        finally:
            os._exit(code)
    os.close(theirs)
    os.close(requests_end)
    return Child(pid, messages, requests)


def _run_one() -> None:
    """Run the request that arrives, a line, in the calling process; say when it is finished."""
    with os.fdopen(os.dup(0), encoding="utf-8") as lines:
        line = lines.readline()
    if line:  # otherwise the worker has ended
        request = Request.from_json(line)
        _run_request(request, request.settle)
        with contextlib.suppress(OSError):  # a plugin may have closed the pipe; the end of the process will do
            _send({"finished": True})


def _run_many() -> None:
    """Score by the requests that arrive, one a line, in the calling process; say when each one is finished.

    The metrics of nrbench write no files of their own. They work in the root directory, because the folder of a cell on
    a network disk cannot be removed while somebody is in it.
    """
    with os.fdopen(os.dup(0), encoding="utf-8") as lines:
        for line in lines:
            request = Request.from_json(line)
            with warnings.catch_warnings():  # so that a warning is in the log of each cell that it is about
                _run_request(request, partial(leave_user_folder, Path(request.user_folder), Path("/")))
            _redirect(Path(os.devnull))
            _send({"finished": True})


def _run_request(request: Request, settle: Callable[[], None]) -> None:
    """Run one request in the calling process, which is a child; raise nothing that could be sent as a message."""
    try:
        _redirect(request.log)
        guard.confine(guard.Limits(request.seconds, request.mib))
        settle()
        perform(request, _send)
    except BaseException as error:
        phases.send_error(error, _send)
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()


def _redirect(log: Path) -> None:
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
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


def _receiver(readable: int) -> guard.Receive:
    """Return a receiver of a child's messages, one a line."""
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

    The other arguments are files of plugins. They are imported in the working directory of the request, or in the one
    that ``--folder`` names.

    The first line of output is ``{"fork": bool}``: whether this process can fork safely. Where kernels have to be
    compiled, the line ``{"compiling": true}`` comes before it.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--once", action="store_true")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("files", nargs="*")
    options = parser.parse_args()
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def write(line: str) -> None:
        out.write(line + "\n")

    _die_with_parent(out.fileno())
    if options.once:
        request = Request.from_json(sys.stdin.readline())
        try:
            request.settle()
            _add_files(options.files)
            _import_plugins(request)
            guard.confine(guard.Limits(request.seconds, request.mib))
            write(json.dumps({"held": guard.held_bytes(os.getpid())}))
            perform(request, lambda message: write(json.dumps(message)))
        except BaseException as error:
            phases.send_error(error, lambda message: write(json.dumps(message)))
        sys.stderr.flush()
        os._exit(0)
    leave_user_folder(Path(working_folder()), options.folder)
    _add_files(options.files)
    guard.adopt_orphans()
    if may_fork():
        warm(lambda: write(json.dumps({"compiling": True})))
    guard.outlive_parent()  # the end of its input ends it from here on, whatever thread of the parent uses it
    write(json.dumps({"fork": may_fork()}))  # again, because a plugin may have started a thread
    serve(sys.stdin, write)
