"""How a plan is run: the options of :func:`nrbench.run` and of the command line. No option changes a result."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from nrbench.flags import Address, Jobs, Mebibytes, OtherRun, Seconds, Switch


def print_notice(text: str) -> None:
    """Print a sentence that the user should read on standard error."""
    print(f"nrbench: {text}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Options:
    """How to run a plan. No option changes a result.

    Parameters
    ----------
    jobs
        Number of cells that run at the same time; 0 runs them in this process.  [default: number of cores]

        In this process there are no limits, so that a debugger stops where an error is.
    scheduler
        Run the cells on a Dask cluster.
    timeout
        Limit of the wall time of one synthesis, detection or metric, seconds.
    memory
        Limit of the memory of one synthesis, detection or metric, in addition to that of an idle worker.
    retry_failed
        Run failed cells again.
    reuse
        Copy the results of equal cells from another run.
    worker_wait
        End the run if the Dask cluster has no worker for so many seconds.
    argv
        The command line; ``run.json`` records it.
    tell
        Called with a sentence that the user should read: that kernels are compiled, that a cluster has no worker.
    stop
        Once this event is set no further cell is started; those that are running end, then the run is interrupted.

    Examples
    --------
    >>> from nrbench import Options
    >>> Options(jobs=2, timeout=60.0).memory
    4096.0
    """

    jobs: Jobs = field(default_factory=lambda: os.cpu_count() or 1)
    scheduler: Address = None
    timeout: Seconds = 120.0
    memory: Mebibytes = 4096.0
    retry_failed: Switch = False
    reuse: OtherRun = None
    worker_wait: Seconds = 600.0
    argv: Sequence[str] = ()
    tell: Callable[[str], None] = print_notice
    stop: threading.Event = field(default_factory=threading.Event)
