"""Executors: run jobs in threads of this process, on a Dask cluster, or one after another for the debugger."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from nrbench.errors import BadInput
from nrbench.running.supervisor import Job, close_all, run_job, run_job_here
from nrbench.runs.store import Result

T = TypeVar("T")
RunJob = Callable[[Job], Result]


class InProcess(Executor):
    """An executor that runs each call at once, in the caller's thread, for the debugger."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Run ``fn`` now, and return its finished future."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def executor(jobs: int, scheduler: str | None = None) -> Iterator[tuple[Executor, RunJob]]:
    """Yield an executor, and the function that runs a job on it.

    Parameters
    ----------
    jobs
        Cells at the same time; 0 runs them in this process, without limits, for the debugger.
    scheduler
        Address of a Dask scheduler (``tcp://...``). Its workers run the cells; they must see the run directory under
        the same path.

    Raises
    ------
    BadInput
        When the cluster cannot be reached, or ``distributed`` is not installed.
    """
    if scheduler is not None:
        with _cluster(scheduler) as cluster:
            yield cluster, run_job
    elif jobs == 0:
        limit_threads: Any = threadpool_limits
        with limit_threads(1):  # as in a worker: sums over several threads round otherwise
            yield InProcess(), run_job_here
    else:
        pool = ThreadPoolExecutor(jobs, thread_name_prefix="cell")
        try:
            yield pool, run_job
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            close_all()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            close_all()


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise BadInput("--scheduler: needs distributed; install it with `pip install nrbench[distributed]`") from None
    try:
        connect: Any = Client
        client = connect(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(f"--scheduler {address}: cannot be reached ({error}); start `dask scheduler` there") from None
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()
