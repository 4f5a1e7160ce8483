"""Executors: run jobs in threads of this process, on a Dask cluster, or one after another for the debugger."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from nrbench.running.cluster import connect
from nrbench.running.options import print_notice
from nrbench.running.phases import Request
from nrbench.running.supervisor import InProcessRunner, close_all, own_supervisor, run_job
from nrbench.runs.store import Result


@dataclass(frozen=True)
class Executor:
    """Runs jobs: threads, a cluster, or this process.

    Parameters
    ----------
    submit
        Runs a job, at once or when its turn comes. ``cancel`` of the future fails once the job is running.
    count_slots
        Returns the number of jobs that can run at the same time, at present; 0 if ``submit`` runs them.
    check
        Raises an error if the jobs that were submitted cannot end any more.
    """

    submit: Callable[[Request], Future[Result]]
    count_slots: Callable[[], int]
    check: Callable[[], None] = lambda: None


def _run_now(job: Request) -> Future[Result]:
    """Run a job in the caller's thread, for the debugger; return its finished future."""
    future: Future[Result] = Future()
    try:
        future.set_result(run_job(job, InProcessRunner()))
    except Exception as error:
        future.set_exception(error)
    return future


class _GroupedThreads:
    """Threads that run jobs, each if possible of the group of its last one, or else of a group that no other has.

    Parameters
    ----------
    count
        The number of threads.
    tell
        Called with a sentence that the user should read.
    """

    def __init__(self, count: int, tell: Callable[[str], None]) -> None:
        self.pool = ThreadPoolExecutor(count, thread_name_prefix="cell")
        self._tell = tell
        self._lock = threading.Lock()
        self._waiting: list[tuple[Request, Future[Result]]] = []
        self._groups: dict[int, str] = {}

    def submit(self, job: Request) -> Future[Result]:
        """Run a job when its turn comes; return its future."""
        future: Future[Result] = Future()
        with self._lock:
            self._waiting.append((job, future))
        self.pool.submit(self._run_next)
        return future

    def _run_next(self) -> None:
        thread = threading.get_ident()
        with self._lock:
            own = self._groups.get(thread)
            others = {group for other, group in self._groups.items() if other != thread}
            job, future = min(self._waiting, key=lambda each: (each[0].group != own, each[0].group in others))
            self._waiting.remove((job, future))
            self._groups[thread] = job.group
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(run_job(job, own_supervisor(self._tell)))
            except BaseException as error:
                future.set_exception(error)


@contextmanager
def executor(
    jobs: int,
    scheduler: str | None = None,
    worker_wait: float = 600.0,
    tell: Callable[[str], None] = print_notice,
) -> Iterator[Executor]:
    """Yield an executor.

    Parameters
    ----------
    jobs
        Cells at the same time; 0 runs them in this process, without limits, for the debugger.
    scheduler
        Address of a Dask scheduler (``tcp://...``), whose workers run the cells.
    worker_wait
        Seconds that a cluster may be without a worker.
    tell
        Called with a sentence that the user should read.

    Raises
    ------
    BadInput
        When the cluster cannot be reached, or ``distributed`` is not installed.
    """
    if scheduler is not None:
        with connect(scheduler, worker_wait, tell) as cluster:
            yield Executor(cluster.submit, lambda: cluster.slots, cluster.check)
    elif jobs == 0:
        limit_threads: Any = threadpool_limits
        with limit_threads(1):  # as in a worker: sums over several threads round otherwise
            yield Executor(_run_now, lambda: 0)
    else:
        threads = _GroupedThreads(jobs, tell)
        try:
            yield Executor(threads.submit, lambda: jobs)
        except BaseException:
            threads.pool.shutdown(wait=False, cancel_futures=True)
            close_all()
            raise
        finally:
            threads.pool.shutdown(cancel_futures=True)
            close_all()
