"""Progress on standard error."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from nrbench.errors import strip_control

PATIENCE = 2.0
"""Delay before the first message of progress, s."""
PAUSE = 5.0
"""Least seconds between two lines where standard error is no terminal."""
LINES = 20
"""Most lines of one long piece of work where standard error is no terminal, without those of failures."""
SHARE = 0.01
"""Least fraction done from which the time left is estimated; the first steps are often slow."""


@contextmanager
def live_progress(estimate: bool = True, patience: bool = False) -> Iterator[Callable[..., None]]:
    """Show progress on standard error: a live bar on a terminal, elsewhere a line at each twentieth of the work.

    Parameters
    ----------
    estimate
        Whether the bar estimates the time left, from the pace so far.
    patience
        Whether nothing is shown in the first :data:`PATIENCE` seconds where standard error is no terminal.

    Yields
    ------
    Callable
        Shows the number of items done, of all, and the last one; the fourth argument tells whether it failed, which
        always has a line.
    """
    if not sys.stderr.isatty():
        start = time.monotonic()

        def print_line(done: int, total: int, what: str, failed: bool = False) -> None:
            reached = failed or done * LINES // total > (done - 1) * LINES // total
            if reached and (not patience or time.monotonic() - start > PATIENCE):
                with contextlib.suppress(OSError):  # nobody can read it, and the work goes on
                    print(f"[{done}/{total}] {strip_control(what)}", file=sys.stderr, flush=True)

        yield print_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    remaining = [TimeRemainingColumn()] if estimate else []
    columns = (BarColumn(), MofNCompleteColumn(), *remaining, TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def update(done: int, total: int, what: str, failed: bool = False) -> None:
            if failed:
                bar.console.print(what, markup=False, highlight=False)
            bar.update(task, completed=done, total=total, description=what)

        yield update


@contextmanager
def waiting(what: str) -> Iterator[Callable[[float], None]]:
    """Tell on standard error how far one long step is, from :data:`PATIENCE` seconds on; nothing for a shorter one.

    The time that is left is estimated from the fraction that is done. Where no fraction is known, the time that has
    passed is shown. The compilation of kernels is shown as such, and its time is not counted.

    Parameters
    ----------
    what
        What goes on, in a few words.

    Yields
    ------
    Callable
        Takes the fraction that is done, in [0, 1].
    """
    from nrbench.jit import COMPILATION, COMPILING

    start, ended, fraction = time.monotonic(), threading.Event(), 0.0
    before, COMPILATION.told = COMPILATION.seconds, True

    def advance(done: float) -> None:
        nonlocal fraction
        fraction = min(1.0, max(fraction, float(done)))

    def tick() -> None:
        terminal, said = sys.stderr.isatty(), ""
        begin, end, pause = ("\r\x1b[2K", "", 0.5) if terminal else ("", "\n", PAUSE)
        if ended.wait(PATIENCE):
            return
        while True:
            compiled = COMPILATION.seconds - before
            passed = time.monotonic() - start - compiled
            state = f"{what}: {passed:.0f} s"
            if COMPILATION.since is not None:
                state = f"{COMPILING}: {compiled:.0f} s" if terminal else COMPILING
            elif fraction >= SHARE:
                left = max(1, round(passed / fraction * (1 - fraction)))
                state = f"{what}: {100 * fraction:.0f} %, about {left} s left"
            if state != said:
                print(f"{begin}{state}", end=end, file=sys.stderr, flush=True)
            said = state
            if ended.wait(pause):
                break
        print(begin, end="", file=sys.stderr, flush=True)  # removes the last line from a terminal

    ticker = threading.Thread(target=tick, daemon=True)
    ticker.start()
    try:
        yield advance
    finally:
        ended.set()
        ticker.join()
