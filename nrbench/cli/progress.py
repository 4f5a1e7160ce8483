"""Progress on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def live_progress(estimate: bool = True) -> Iterator[Callable[[int, int, str], None]]:
    """Show progress on standard error: a live bar on a terminal, plain lines elsewhere.

    Parameters
    ----------
    estimate
        Whether the bar estimates the time left, from the pace so far.

    Yields
    ------
    Callable
        Shows the number of items done, of all, and the last one.
    """
    if not sys.stderr.isatty():
        yield lambda done, total, what: print(f"[{done}/{total}] {what}", file=sys.stderr, flush=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    time = [TimeRemainingColumn()] if estimate else []
    columns = (BarColumn(), MofNCompleteColumn(), *time, TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda done, total, what: bar.update(task, completed=done, total=total, description=what)
