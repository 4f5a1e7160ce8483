"""Watch a child process: enforce its limits of wall time and memory, and kill all that it started."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import psutil

from nrbench.runs.store import Result

TICK = 0.02
"""Seconds between two checks of the clock."""
MEMORY_TICK = 0.1
"""Seconds between two checks of the memory of the child and its own children."""
MIB = 1 << 20
LONG_LOG, SHORT_LOG = 16 << 20, 1 << 20
"""Bytes of a log above which it is cut, and bytes that are kept of it."""
_TYPES: Mapping[str, Any] = {**dict.fromkeys(("status", "message", "scored"), str), "peak_mib": int | float}
"""Types of some entries of a message, if they are there. A child may write anything else."""
MARK = "NRBENCH_RUN"
"""Environment variable that holds a mark of the process that started a worker; all that a worker starts inherits it."""


class Message(Result, total=False):
    """What a child sends, one JSON object a line: the result of its phase, or a metric that is done.

    Attributes
    ----------
    scored
        The metric.
    held
        Bytes that a fresh interpreter holds (:func:`held_bytes`) when its work begins.
    finished
        Sent by a forked child when a request is finished. The end of its process then tells nothing more.
    """

    scored: str
    held: int
    finished: bool


Receive = Callable[[float], Iterable[Message] | None]
"""Waits up to a number of seconds. Returns the messages that arrived, or None if the child has closed its end."""


@dataclass(frozen=True)
class Limits:
    """What a child may use.

    Parameters
    ----------
    seconds
        Wall seconds of each part of the work.
    mib
        MiB above the idle worker.
    parts
        The parts of the work, each done when a message ``{"scored": part}`` arrives, which starts the clock again.
    start_seconds, start_mib
        What a fresh interpreter may use in addition until it sends the message ``{"held": bytes}``: its start and its
        imports. Then the clock starts again, and the memory is counted above those bytes.
    """

    seconds: float
    mib: float
    parts: tuple[str, ...] = ()
    start_seconds: float = 0.0
    start_mib: float = 0.0


@dataclass(frozen=True)
class Ending:
    """How a child ended.

    Parameters
    ----------
    messages
        All messages of the child.
    status
        ``ended``, ``timeout``, ``memory``, ``crash`` or ``abandoned`` (its result is no longer wanted).
    message
        One sentence, empty for ``ended``.
    started
        Most bytes that all processes which the child started held at any check.
    """

    messages: list[Message]
    status: str = "ended"
    message: str = ""
    started: int = 0


class Watch:
    """Watches one child until it ends or breaks a limit.

    Parameters
    ----------
    pid
        Process id of the child, leader of its own process group where there are such groups.
    receive
        Receives its messages.
    ended
        Returns whether the process has ended. The end of its messages is no proof: a process that it started may hold
        the pipe open, and the child may close the pipe early.
    limits
        What it may use.
    base
        Bytes that the idle worker holds (:func:`held_bytes`) that it was forked from; 0 for a fresh interpreter.
    log
        The file that the child writes its messages to; it is kept short.
    wanted
        Returns whether the result is still wanted: false once the run has ended.

    Attributes
    ----------
    messages
        The messages that have arrived.
    finished
        Whether the child has said that its request is finished. It may still be running.
    """

    def __init__(
        self,
        pid: int,
        receive: Receive,
        ended: Callable[[], bool],
        limits: Limits,
        base: int = 0,
        log: Path | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self.pid, self.receive, self.ended, self.log = pid, receive, ended, log
        self.limits, self.base, self.wanted = limits, base, wanted
        self.messages: list[Message] = []
        self.finished = False
        self.started = 0
        self._open = True

    def watch(self) -> tuple[str, str] | None:
        """Wait until the child has finished its request or ends (None), or breaks a limit (status and message)."""
        limits, left, most = self.limits, set(self.limits.parts), self.limits.mib + self.limits.start_mib
        deadline = time.monotonic() + limits.start_seconds + limits.seconds
        starting = limits.start_seconds > 0
        memory_check = time.monotonic() + MEMORY_TICK
        while True:
            messages = self._receive()
            self.messages += [message for message in messages if "finished" not in message]
            self.finished = any("finished" in message for message in messages)
            if self.finished or (not messages and self.ended()):
                return None
            now = time.monotonic()
            done = left & {message.get("scored", "") for message in messages}
            if done:
                left -= done
                deadline = now + limits.seconds
            if starting and any(isinstance(message.get("held"), int) for message in messages):
                starting, deadline = False, now + limits.seconds
                self.base, most = held_bytes(self.pid), limits.mib
            if now > deadline:
                return "timeout", f"took longer than {limits.seconds:g} s; raise --timeout if it may"
            if not self.wanted():
                return "abandoned", "the run ended"
            if now > memory_check:
                memory_check = now + MEMORY_TICK
                own, started = held_by_family(self.pid)
                self.started = max(self.started, started)
                if own + started - self.base > most * MIB:
                    return "memory", f"used more than {limits.mib:g} MiB; raise --memory if it may"
                shorten(self.log)

    def _receive(self) -> list[Message]:
        if self._open:
            messages = self.receive(TICK)
            self._open = messages is not None
            return list(messages or ())
        time.sleep(TICK / 20)
        return []

    def ending(self, broken: tuple[str, str] | None, code: int) -> Ending:
        """Return how the child ended, from what :meth:`watch` returned and its exit code."""
        shorten(self.log)
        if broken:
            return Ending(self.messages, *broken)
        if code != 0:
            return Ending(self.messages, "crash", explain_exit(code))
        return Ending(self.messages, started=self.started)


def shorten(log: Path | None) -> None:
    """Cut a log that has grown long: only its end is kept. The child goes on appending to it, and may remove it."""
    with contextlib.suppress(OSError):
        if log is None or not log.is_file() or log.stat().st_size <= LONG_LOG:
            return
        with log.open("rb") as file:
            file.seek(-SHORT_LOG, os.SEEK_END)
            end = file.read(SHORT_LOG)
        os.truncate(log, 0)
        with log.open("ab") as file:
            file.write(b"[the beginning of this log was cut off]\n" + end)


def parse_message(line: str | bytes) -> Message | None:
    """Return the message on a line; None for any other text, as a child may write."""
    try:
        message = json.loads(line)
    except ValueError:
        return None
    if not isinstance(message, dict):
        return None
    if not all(isinstance(message[name], kind) for name, kind in _TYPES.items() if name in message):
        return None
    return cast("Message", message)


def held_by_family(pid: int) -> tuple[int, int]:
    """Return the bytes that a process holds, and those that all its descendants hold; 0 for one that has ended."""
    with contextlib.suppress(psutil.Error):
        return held_bytes(pid), sum(held_bytes(one.pid) for one in psutil.Process(pid).children(recursive=True))
    return 0, 0


def held_bytes(pid: int) -> int:
    """Return the resident bytes of a process, on Linux without those of files; 0 if it has ended.

    A forked child has all memory of its parent from the beginning, but the pages of libraries only once it uses them.
    The difference of these bytes is therefore what the child itself has allocated.
    """
    with contextlib.suppress(OSError, psutil.Error):
        if not sys.platform.startswith("linux"):
            return int(psutil.Process(pid).memory_info().rss)
        with open(f"/proc/{pid}/status", encoding="ascii", errors="replace") as status:  # noqa: PTH123
            kept = [line.split() for line in status if line.startswith(("RssAnon:", "RssShmem:"))]
        return sum(int(words[1]) * 1024 for words in kept)
    return 0


def sweep(pid: int) -> None:
    """Kill a process, its group and its descendants."""
    with contextlib.suppress(psutil.Error):
        for one in psutil.Process(pid).children(recursive=True):
            with contextlib.suppress(psutil.Error):
                one.kill()
    if sys.platform != "win32":
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
    with contextlib.suppress(psutil.Error):
        psutil.Process(pid).kill()


def sweep_marked(mark: str) -> None:
    """Kill every process whose environment carries a mark, whatever its parent and session (Linux)."""
    if not sys.platform.startswith("linux"):
        return
    wanted = f"{MARK}={mark}".encode()
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if folder.name != str(os.getpid()) and wanted in (folder / "environ").read_bytes().split(b"\0"):
                os.kill(int(folder.name), signal.SIGKILL)


def adopt_orphans() -> None:
    """Become the parent of orphaned descendants, so that :func:`sweep_orphans` finds them (Linux)."""
    _prctl(36, 1)


def sweep_orphans(spared: Collection[int] = ()) -> None:
    """Kill and reap the children of the calling process: those that a finished job left running, in any session.

    Parameters
    ----------
    spared
        Process ids of children that stay.
    """
    for _ in range(1000):
        children = [pid for pid in _children() if pid not in spared]
        if not children:
            return
        for pid in children:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        for pid in children:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, 0)


def _children() -> list[int]:
    pid = os.getpid()
    try:
        with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as children:  # noqa: PTH123
            return [int(child) for child in children.read().split()]
    except OSError:
        return [child.pid for child in psutil.Process().children()]


def explain_exit(code: int) -> str:
    """Return how a process died, in words, from its exit code (negative: minus the signal)."""
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"died by {signal.Signals(-code).name}"
        return f"died by signal {-code}"
    return f"exited with code {code} without a result"


def confine(limits: Limits) -> None:
    """Let the calling process, and what it starts, allocate no more than its limit above what it holds now.

    A huge allocation then fails at once, inside the process; :class:`Watch` finds slow growth. On a system without
    such a limit, :class:`Watch` is the only check.
    """
    if not sys.platform.startswith("linux"):
        return
    import resource

    held = _data_bytes()
    bound = held + int(limits.mib * MIB)
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (bound if hard < 0 else min(bound, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _data_bytes() -> int:
    with open("/proc/self/status", encoding="ascii") as status:  # noqa: PTH123
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmData:"))


def die_with_parent() -> None:
    """Let the kernel kill the calling process when the thread that started it ends (Linux)."""
    _prctl(1, signal.SIGKILL)


def outlive_parent() -> None:
    """Undo :func:`die_with_parent`."""
    _prctl(1, 0)


_MADV_COLLAPSE = 25
"""Advice of madvise(2), from linux/mman.h: collapse a range of memory into huge pages now."""


def collapse_pages() -> None:
    """Put the memory of the calling process into huge pages (Linux from 6.1): a fork then takes half the time.

    Older kernels refuse the request, which changes nothing.
    """
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    madvise, huge = ctypes.CDLL(None).madvise, 1 << 21
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:  # noqa: PTH123
        mapped = [line.split() for line in maps.readlines()]
    for addresses, access, _, _, inode, *_ in mapped:
        if access != "rw-p" or inode != "0":  # not private memory, or that of a file
            continue
        begin, end = (int(address, 16) for address in addresses.split("-"))
        first, last = -(-begin // huge) * huge, end // huge * huge
        if last > first:
            madvise(ctypes.c_void_p(first), ctypes.c_size_t(last - first), _MADV_COLLAPSE)


def _prctl(option: int, value: int) -> None:
    if sys.platform.startswith("linux"):
        import ctypes

        ctypes.CDLL(None, use_errno=True).prctl(option, value)


def peak_bytes() -> int:
    """Return the highest resident size of this process so far, bytes."""
    if sys.platform == "win32":
        return int(psutil.Process().memory_info().peak_wset)
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def cpu_seconds() -> float:
    """Return the processor seconds so far of this process, all threads, and of the programs that it has waited for."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system
