"""Watch a child process: enforce its limits of wall time and memory, and kill all that it started."""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import sys
import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast

import psutil

from nrbench.runs.store import Result, is_result_part
from nrbench.work import MIB

TICK = 0.02
"""Seconds between two checks of the clock and of the memory of the child. Above half of its limit there are more."""
MEMORY_TICK = 0.1
"""Seconds between two checks of the memory of all that the child started, and of what they share."""
LONG_LOG, SHORT_LOG = 16 << 20, 1 << 20
"""Bytes of a log above which it is cut, and bytes that are kept of it."""


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


LIMITS = Limits(120.0, 4096.0)
"""The limits where no others are given."""


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

    def as_dict(self) -> dict[str, Any]:
        """Return the reply as a mapping that can be written as JSON."""
        return {**self.result, "metrics": self.scored}

    @classmethod
    def from_json(cls, line: str) -> Reply | None:
        """Read a reply from the JSON of :meth:`as_dict`; None for any other text."""
        content: Any = parse_message(line)
        if content is None or "status" not in content:
            return None
        scored = tuple(content.pop("metrics", ()))
        return cls(content, scored)

    @classmethod
    def of(cls, messages: Iterable[Message], broken: tuple[str, str] | None = None, started: int = 0) -> Reply:
        """Return the reply that follows from what a child sent.

        Parameters
        ----------
        messages
            All messages of the child.
        broken
            The status and the message of a child that was ended or died: ``timeout``, ``memory`` or ``crash``.
        started
            Most bytes that all processes which the child started held at any check.
        """
        scored = tuple(message["scored"] for message in messages if "scored" in message)
        result: Result = {"status": "ok", "message": ""}
        for message in messages:
            if "status" in message:
                result = cast("Result", message)
        if broken:
            result = {"status": broken[0], "message": broken[1]}
        elif "peak_mib" in result:
            result = {**result, "peak_mib": max(result["peak_mib"], started / MIB)}
        return cls(result, scored)


class Child(Protocol):
    """A child process that can be watched.

    Attributes
    ----------
    pid
        Its process id.
    """

    pid: int

    def receive(self, seconds: float) -> Iterable[Message] | None:
        """Wait up to a time. Return the messages that arrived, or None if the child has closed its end."""
        ...

    def has_ended(self) -> bool:
        """Return whether the process has ended.

        The end of its messages is no proof: a process that it started may hold the pipe open, and the child may close
        the pipe early.
        """
        ...


@dataclass
class Watch:
    """Watches one child until it ends or breaks a limit.

    Parameters
    ----------
    child
        The child.
    limits
        What it may use.
    base
        Bytes that the child holds (:func:`held_bytes`) before it begins; 0 for a fresh interpreter, which sends them.
    log
        The file that the child writes its messages to; it is kept short.
    messages
        The messages that have arrived and count, so that no child fills the memory of this process.
    finished
        Whether the child has said that its request is finished. It may still be running.
    spared
        Process ids of other children of the calling process, whose memory is not the child's.
    started
        Most bytes that all processes which the child started held at any check, and the memory that they share.
    """

    child: Child
    limits: Limits
    base: int
    log: Path
    spared: Collection[int] = ()
    messages: list[Message] = field(default_factory=list)
    finished: bool = False
    started: int = 0

    def __post_init__(self) -> None:
        limits, now = self.limits, time.monotonic()
        self._open, self._starting, self._undone = True, limits.start_seconds > 0, set(limits.parts)
        self._deadline = now + limits.start_seconds + limits.seconds
        self._allowed = (limits.mib + limits.start_mib) * MIB
        self._near_limit, self._next_survey, self._next_exact_check = False, now + MEMORY_TICK, 0.0
        self._files: dict[str, tuple[int, int]] = {}
        self._family: list[int] = []
        self._family_bytes = self._file_bytes = 0

    def watch(self) -> tuple[str, str] | None:
        """Wait for the child. Return None when it finishes or ends, or (status, message) when it exceeds a limit."""
        while True:
            ended = self.child.has_ended()  # asked first: its last message may arrive just before its end
            messages = self._receive(TICK / 4 if self._near_limit else TICK)
            self._keep(messages)
            if self.finished or (ended and not messages):
                return None
            now = time.monotonic()
            self._move_deadline(messages, now)
            if now > self._deadline:
                return "timeout", f"took longer than {self.limits.seconds:g} s; raise --timeout if it may"
            if self._exceeds_memory(now):
                return "memory", f"used more than {self.limits.mib:g} MiB; raise --memory if it may"

    def _keep(self, messages: list[Message]) -> None:
        """Keep the messages that count: the last result, and the parts that were not done before."""
        self.finished = any("finished" in message for message in messages)
        if any("status" in message for message in messages):
            self.messages = [message for message in self.messages if "status" not in message]
        self.messages += [each for each in messages if "status" in each or each.get("scored") in self._undone]

    def _move_deadline(self, messages: list[Message], now: float) -> None:
        """Start the clock again if a part is done, or if a fresh interpreter begins its work; that sets its base."""
        done = self._undone & {message.get("scored", "") for message in messages}
        begins = self._starting and any(isinstance(message.get("held"), int) for message in messages)
        if done or begins:
            self._undone -= done
            self._deadline = now + self.limits.seconds
        if begins:
            self._starting = False
            self.base, self._allowed = held_bytes(self.child.pid), self.limits.mib * MIB

    def _exceeds_memory(self, now: float) -> bool:
        """Return whether the child and all that it started hold too much. Costly measurements are rare."""
        held = held_bytes(self.child.pid) - self.base
        self._near_limit = held + self._family_bytes > self._allowed / 2
        if now > self._next_survey or self._near_limit:
            self._next_survey = now + MEMORY_TICK
            self._survey_family()
        if held + self._family_bytes <= self._allowed or now <= self._next_exact_check:
            return False
        self._next_exact_check = now + MEMORY_TICK
        count = 1 + len(self._family)
        known = self.base * count / (count + 1 + len(self.spared))  # the part of what the worker holds
        return proportional_bytes([self.child.pid, *self._family], self._file_bytes) - known > self._allowed

    def _survey_family(self) -> None:
        """Find what the child started and the bytes that it holds, and cut the log."""
        self._family = [each for each in descendants(os.getpid(), self.spared) if each != self.child.pid]
        self._file_bytes, mapped = shared_bytes([self.child.pid, *self._family], self._files)
        self._family_bytes = sum(map(held_bytes, self._family)) + self._file_bytes - mapped
        self.started = max(self.started, self._family_bytes)
        shorten(self.log)

    def _receive(self, seconds: float) -> list[Message]:
        if self._open:
            messages = self.child.receive(seconds)
            self._open = messages is not None
            return list(messages or ())
        time.sleep(TICK / 20)
        return []

    def reply(self, broken: tuple[str, str] | None, code: int) -> Reply:
        """Return how the child ended, from what :meth:`watch` returned and its exit code."""
        shorten(self.log)
        if code and not broken:
            broken = "crash", explain_exit(code)
        return Reply.of(self.messages, broken, self.started)


def shorten(log: Path) -> None:
    """Cut a log that has grown long: only its end is kept. The child goes on appending to it, and may remove it."""
    with contextlib.suppress(OSError), log.open("r+b") as file:
        if os.fstat(file.fileno()).st_size <= LONG_LOG:
            return
        file.seek(-SHORT_LOG, os.SEEK_END)
        end = file.read(SHORT_LOG)
        file.seek(0)
        file.truncate()
        file.write(b"[the beginning of this log was cut off]\n" + end)


def parse_message(line: str | bytes) -> Message | None:
    """Return the message on a line; None for any other text, as a child may write."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, dict) or not isinstance(message.get("scored", ""), str) or not is_result_part(message):
        return None
    return cast("Message", message)


def descendants(pid: int, spared: Collection[int] = ()) -> list[int]:
    """Return all processes that a process has started and that live, without some of its children and theirs."""
    children = [each for each in _children(pid) if each not in spared]
    return children + [each for child in children for each in descendants(child)]


def shared_bytes(pids: Iterable[int], files: dict[str, tuple[int, int]]) -> tuple[int, int]:
    """Return the bytes of the files in memory that processes have open, or had when this was called before (Linux).

    Such files (``memfd_create``, ``/dev/shm``) take memory whether or not a process maps them. The second number is
    what the processes together have mapped of them, which :func:`held_bytes` has counted.

    Parameters
    ----------
    pids
        The processes.
    files
        The files in ``/dev/shm`` that were open, with their devices and inodes; this call adds to it.
    """
    sizes: dict[tuple[int, int], int] = {}
    mapped = 0
    for pid in pids:
        own: dict[tuple[int, int], int] = {}
        with contextlib.suppress(OSError):
            for handle in os.listdir(f"/proc/{pid}/fd"):  # noqa: PTH208
                _measure(f"/proc/{pid}/fd/{handle}", own, files)
        sizes |= own
        mapped += min(sum(own.values()), _status_bytes(pid, "RssShmem:")) if own else 0
    for path, inode in files.items():
        with contextlib.suppress(OSError):
            found = os.lstat(path)
            if (found.st_dev, found.st_ino) == inode:
                sizes[inode] = found.st_blocks * 512
    return sum(sizes.values()), mapped


def proportional_bytes(pids: Iterable[int], files: int) -> int:
    """Return the bytes that processes hold, a page that several processes share counted by each in part.

    This takes milliseconds. Forked processes share the memory of their parent, which :func:`held_bytes` counts for each
    of them.

    Parameters
    ----------
    pids
        The processes.
    files
        Bytes of the files in memory, of which they may have mapped any part.
    """
    anonymous = mapped = 0
    for pid in pids:
        with contextlib.suppress(OSError):
            parts = {"Pss_Anon:": held_bytes(pid), "Pss_Shmem:": 0}  # where the system does not tell them
            with open(f"/proc/{pid}/smaps_rollup", encoding="ascii") as rollup:  # noqa: PTH123
                parts |= {name: int(words[0]) * 1024 for name, *words in map(str.split, rollup) if name in parts}
            anonymous, mapped = anonymous + parts["Pss_Anon:"], mapped + parts["Pss_Shmem:"]
    return anonymous + max(mapped, files)


def _measure(handle: str, sizes: dict[tuple[int, int], int], files: dict[str, tuple[int, int]]) -> None:
    """Add the size of an open file in memory to ``sizes``, and its path, if it has one, to ``files``."""
    with contextlib.suppress(OSError):
        path = os.readlink(handle)  # noqa: PTH115
        if path.startswith(("/memfd:", "/dev/shm/")):
            found = os.stat(handle)  # noqa: PTH116
            inode = found.st_dev, found.st_ino
            sizes[inode] = found.st_blocks * 512
            if found.st_nlink and path.startswith("/dev"):
                files[path] = inode


def held_bytes(pid: int) -> int:
    """Return the resident bytes of a process, on Linux without those of files; 0 if it has ended.

    A forked child has all memory of its parent from the beginning, but the pages of libraries only once it uses them.
    The difference of these bytes is therefore what the child itself has allocated.
    """
    with contextlib.suppress(OSError, psutil.Error):
        if not sys.platform.startswith("linux"):
            return int(psutil.Process(pid).memory_info().rss)
        return _status_bytes(pid, "RssAnon:", "RssShmem:")
    return 0


def _status_bytes(pid: int, *entries: str) -> int:
    with open(f"/proc/{pid}/status", encoding="ascii", errors="replace") as status:  # noqa: PTH123
        return sum(int(line.split()[1]) * 1024 for line in status if line.startswith(entries))


def kill_children(pid: int, spared: Collection[int] = ()) -> None:
    """Kill all that a process started, in any session.

    On Linux the process must be one that :func:`adopt_orphans` has prepared: what a killed child had started becomes
    its child, and is killed next.

    Parameters
    ----------
    pid
        The process. If it is the calling one, its children are reaped.
    spared
        Process ids of children that stay.
    """
    for _ in range(1000):
        children = descendants(pid, spared)
        if not children:
            return
        for each in children:
            with contextlib.suppress(psutil.Error):
                psutil.Process(each).kill()
            with contextlib.suppress(OSError):
                if pid == os.getpid():
                    os.waitpid(each, 0)
        if pid != os.getpid():
            time.sleep(0.001)  # until the process has reaped them, or ended


def _children(pid: int) -> list[int]:
    """Return the children of a process, whichever of its threads has started them."""
    with contextlib.suppress(OSError):
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(child) for thread in threads for child in (thread / "children").read_text("ascii").split()]
    with contextlib.suppress(psutil.Error):
        return [child.pid for child in psutil.Process(pid).children()]
    return []


def adopt_orphans() -> None:
    """Become the parent of orphaned descendants, so that :func:`kill_children` finds them (Linux)."""
    _prctl(36, 1)


def go_on_in_child(leash: int, folder: str) -> None:
    """Fork the calling process and go on in the child (Linux). The parent stays to kill what the child leaves behind.

    The parent waits until the child has ended, or nobody holds the other end of a pipe any more, because the run was
    killed. Then it kills all descendants, which it adopts, and ends. The child does the same if the parent is killed.

    Parameters
    ----------
    leash
        The end of the pipe that this process reads, a file descriptor.
    folder
        The temporary files of the process, which the parent removes at the end.
    """
    if not sys.platform.startswith("linux"):
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    adopt_orphans()
    ended, held = os.pipe()
    if os.fork() == 0:
        os.close(ended)
        adopt_orphans()
        signal.signal(signal.SIGTERM, _end_with_children)
        _prctl(1, signal.SIGTERM)  # sent when the parent ends
        return
    os.close(held)
    poll = select.poll()
    poll.register(ended, 0)
    poll.register(leash, 0)
    while not poll.poll():
        pass
    kill_children(os.getpid())
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def _end_with_children(*_: Any) -> None:
    kill_children(os.getpid())
    os._exit(0)


def explain_exit(code: int) -> str:
    """Return how a process died, in words, from its exit code (negative: minus the signal)."""
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"died by {signal.Signals(-code).name}"
        return f"died by signal {-code}"
    return f"exited with code {code} without a result"


def die_with_parent() -> None:
    """Let the kernel kill the calling process when the one that forked it ends (Linux)."""
    _prctl(1, signal.SIGKILL)


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


def forget_peak() -> None:
    """Give free memory back to the system, and let :func:`.peak_bytes` start anew from what is held now (Linux)."""
    import ctypes

    with contextlib.suppress(AttributeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5", "ascii")
