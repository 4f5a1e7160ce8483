"""The warm worker: imports done, kernels loaded, nothing computed, one thread; it forks one child a phase."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import psutil

from nrbench import plugins
from nrbench.jit import load_kernels
from nrbench.running import guard

Request = dict[str, Any]
"""``phase`` (synthesize, score or detect), ``folder``, ``metrics``, ``seconds``, ``mib``."""
Reply = dict[str, Any]
"""``status``, ``message``, and the child's last message's own entries; ``scored``: the metrics that are done."""


def perform(request: Request, send: Callable[[dict[str, Any]], None]) -> None:
    """Do one phase in this very process, sending messages as it goes."""
    from nrbench.running import phases, scoring

    folder = Path(request["folder"])
    before = guard.peak_bytes()

    def send_with_memory(message: dict[str, Any]) -> None:
        send({**message, "peak_mib": max(0, guard.peak_bytes() - before) / guard.MIB})

    if request["phase"] == "score":
        scoring.score(folder, request["metrics"], send)
    elif request["phase"] == "detect":
        phases.detect(folder, send)
    else:
        phases.synthesize(folder, send_with_memory)


def summarize(ending: guard.Ending) -> Reply:
    """Return what a child's ending means for the one who asked."""
    scored = [message["scored"] for message in ending.messages if "scored" in message]
    last: dict[str, Any] = next((m for m in reversed(ending.messages) if "status" in m), {})
    if ending.status == "ended" and not last:
        return {"status": "ok", "message": "", "scored": scored}
    if ending.status != "ended":
        return {"status": ending.status, "message": ending.message, "scored": scored}
    peak = {"peak_mib": max(last["peak_mib"], ending.started / guard.MIB)} if "peak_mib" in last else {}
    return {**last, **peak, "scored": scored}


def warm() -> None:
    """Import every plugin and compiled kernel, so that a forked child finds them ready."""
    from nrbench.running import phases, scoring

    assert phases and scoring
    for kind in ("datasets", "detectors", "synthesizers", "metrics"):
        plugins.inventory(kind)
    load_kernels()


def may_fork() -> bool:
    """Return whether forking is safe here: a system that forks, and a single thread."""
    if not sys.platform.startswith("linux") or os.environ.get("NRBENCH_FORK") == "no":
        return False
    return threading.active_count() == 1 and len(list(Path("/proc/self/task").iterdir())) == 1


def serve(requests: Iterable[str], reply: Callable[[Reply], None]) -> None:
    """Answer one request a line, each in a forked child, until the input ends."""
    for line in requests:
        reply(fork_and_watch(json.loads(line)))


def fork_and_watch(request: Request) -> Reply:
    """Run one phase in a forked child under its limits."""
    readable, writable = os.pipe()
    base, limits = psutil.Process().memory_info().rss, guard.Limits(request["seconds"], request["mib"])
    pid = os.fork()
    if pid == 0:
        os.close(readable)
        _child(request, writable, limits)
    os.close(writable)
    parent = os.getppid()
    watch = guard.Watch(
        pid, _pipe_receiver(readable), lambda: _has_ended(pid), limits, base, lambda: os.getppid() == parent
    )
    broken = watch.broken()
    guard.sweep(pid) if broken else None
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    guard.sweep(pid)
    guard.sweep_orphans()
    os.close(readable)
    return summarize(_ending(watch, broken, code))


def _has_ended(pid: int) -> bool:
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None


def _ending(watch: guard.Watch, broken: tuple[str, str] | None, code: int) -> guard.Ending:
    if broken:
        return guard.Ending(watch.messages, *broken)
    if code != 0:
        return guard.Ending(watch.messages, "crash", guard.explain_exit(code))
    return guard.Ending(watch.messages, started=watch.started)


def _child(request: Request, writable: int, limits: guard.Limits) -> None:
    """Run the phase in the forked child, and leave without returning."""
    code = 70
    try:
        os.setsid()
        guard.die_with_parent()
        _redirect(Path(request["folder"]) / "log.txt")
        os.dup2(writable, 3)
        os.closerange(4, 1 << 16)
        writable = 3
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        guard.confine(limits)
        perform(request, lambda message: _send(writable, message))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _redirect(log: Path) -> None:
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for target, origin in ((0, nothing), (1, handle), (2, handle)):
        os.dup2(origin, target)


def _send(writable: int, message: dict[str, Any]) -> None:
    data = (json.dumps(message, allow_nan=False) + "\n").encode()
    while data:
        data = data[os.write(writable, data) :]


def _pipe_receiver(readable: int) -> guard.Receive:
    """Return a receiver of JSON lines from a pipe; None once every writer has closed it."""
    pending = b""

    def receive(seconds: float) -> list[dict[str, Any]] | None:
        nonlocal pending
        if not select.select([readable], [], [], seconds)[0]:
            return []
        data = os.read(readable, 1 << 16)
        if not data:
            return None
        *lines, pending = (pending + data).split(b"\n")
        return [message for line in lines if (message := guard.parsed(line)) is not None]

    return receive


def main() -> None:
    """Serve standard input; with ``--once`` do a single request right here, without forking.

    The first line out is ``{"fork": bool}``: whether this process can fork safely.
    """
    arguments = sys.argv[1:]
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def reply(message: dict[str, Any]) -> None:
        out.write(json.dumps(message) + "\n")

    for file in [argument for argument in arguments if not argument.startswith("--")]:
        plugins.add_file(file)
    if "--once" in arguments:
        guard.die_with_parent()
        request = json.loads(sys.stdin.readline())
        guard.confine(guard.Limits(request["seconds"], request["mib"]))
        perform(request, reply)
        sys.stderr.flush()
        os._exit(0)
    guard.adopt_orphans()
    warm()
    reply({"fork": may_fork()})
    serve(sys.stdin, reply)
