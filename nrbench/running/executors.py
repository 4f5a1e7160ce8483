"""Executors: run jobs in threads of this process, on a Dask cluster, or one after another for the debugger."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Protocol

from threadpoolctl import threadpool_limits

from nrbench.running.cluster import connect
from nrbench.running.supervisor import Job, close_all, print_notice, run_job, run_job_here
from nrbench.runs.store import Result


class Executor(Protocol):
    """Runs jobs: threads, a cluster, or this process."""

    @property
    def slots(self) -> int:
        """The number of jobs that can run at the same time, at present; 0 if :meth:`submit` runs them."""
        ...

    def submit(self, job: Job) -> Future[Result]:
        """Run a job, at once or when its turn comes. ``cancel`` of the future fails once the job is running."""
        ...

    def check(self) -> None:
        """Raise an error if the jobs that were submitted cannot end any more."""
        ...


class InProcess:
    """An executor that runs each job at once, in the caller's thread, for the debugger."""

    slots = 0

    def submit(self, job: Job) -> Future[Result]:
        """Run a job now, and return its finished future."""
        future: Future[Result] = Future()
        try:
            future.set_result(run_job_here(job))
        except Exception as error:
            future.set_exception(error)
        return future

    def check(self) -> None:
        """Raise nothing: each job has ended."""


class Threads:
    """An executor whose threads each keep a worker process.

    Parameters
    ----------
    pool
        The threads.
    slots
        Their number.
    run_job
        Runs a job in one of them.
    """

    def __init__(self, pool: ThreadPoolExecutor, slots: int, run_job: Callable[[Job], Result]) -> None:
        self._pool, self.slots, self._run_job = pool, slots, run_job

    def submit(self, job: Job) -> Future[Result]:
        """Run a job when a thread is free."""
        return self._pool.submit(self._run_job, job)

    def check(self) -> None:
        """Raise nothing: the threads are of this process."""


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
            yield cluster
    elif jobs == 0:
        limit_threads: Any = threadpool_limits
        with limit_threads(1):  # as in a worker: sums over several threads round otherwise
            yield InProcess()
    else:
        pool = ThreadPoolExecutor(jobs, thread_name_prefix="cell")
        try:
            yield Threads(pool, jobs, lambda job: run_job(job, tell))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            close_all()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            close_all()
