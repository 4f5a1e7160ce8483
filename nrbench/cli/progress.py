"""Progress on standard error."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE = 2.0
"""Delay before the first message of progress, s."""
PAUSE = 5.0
"""Least seconds between two lines where standard error is no terminal."""


@contextmanager
def live_progress(estimate: bool = True, patience: bool = False) -> Iterator[Callable[[int, int, str], None]]:
    """Show progress on standard error: a live bar on a terminal, plain lines elsewhere.

    Parameters
    ----------
    estimate
        Whether the bar estimates the time left, from the pace so far.
    patience
        Whether nothing is shown in the first :data:`PATIENCE` seconds where standard error is no terminal.

    Yields
    ------
    Callable
        Shows the number of items done, of all, and the last one.
    """
    if not sys.stderr.isatty():
        start = time.monotonic()

        def print_line(done: int, total: int, what: str) -> None:
            if not patience or time.monotonic() - start > PATIENCE:
                print(f"[{done}/{total}] {what}", file=sys.stderr, flush=True)

        yield print_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    remaining = [TimeRemainingColumn()] if estimate else []
    columns = (BarColumn(), MofNCompleteColumn(), *remaining, TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda done, total, what: bar.update(task, completed=done, total=total, description=what)


@contextmanager
def waiting(what: str) -> Iterator[Callable[[float], None]]:
    """Tell on standard error how far one long step is, from :data:`PATIENCE` seconds on; nothing for a shorter one.

    The time that is left is estimated from the fraction that is done. Where no fraction is known, the time that has
    passed is shown.

    Parameters
    ----------
    what
        What goes on, in a few words.

    Yields
    ------
    Callable
        Takes the fraction that is done, in [0, 1].
    """
    clock = _Clock(what)
    ticker = threading.Thread(target=clock.tick, daemon=True)
    ticker.start()
    try:
        yield clock.set
    finally:
        clock.ended.set()
        ticker.join()


class _Clock:
    """Writes lines of progress; a line replaces the one before on a terminal."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.start = time.monotonic()
        self.fraction = 0.0
        self.ended = threading.Event()

    def set(self, fraction: float) -> None:
        """Note the fraction that is done."""
        self.fraction = min(1.0, max(self.fraction, float(fraction)))

    def tick(self) -> None:
        """Write a line now and then until the step ends; on a terminal, remove the last one."""
        begin, end, pause = ("\r\x1b[2K", "", 0.5) if sys.stderr.isatty() else ("", "\n", PAUSE)
        if self.ended.wait(PATIENCE):
            return
        while True:
            print(f"{begin}{self.line(time.monotonic() - self.start)}", end=end, file=sys.stderr, flush=True)
            if self.ended.wait(pause):
                break
        print(begin, end="", file=sys.stderr, flush=True)

    def line(self, passed: float) -> str:
        """Return what is shown after some seconds."""
        if not self.fraction:
            return f"{self.what}: {passed:.0f} s"
        left = passed / self.fraction * (1 - self.fraction)
        return f"{self.what}: {100 * self.fraction:.0f} %, about {max(1, round(left))} s left"
