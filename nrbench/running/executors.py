"""Executors: run jobs in threads of this process, on a Dask cluster, or one after another for the debugger.

The machines of a cluster have the same code and share the run directory. Limits are enforced on its workers by
supervisors, as in a run without a cluster; Dask only places the jobs.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import importlib.metadata
import logging
import platform
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from nrbench import plugins
from nrbench.errors import BadInput, describe_error
from nrbench.running.options import print_notice
from nrbench.running.phases import Request
from nrbench.running.supervisor import close_all, own_supervisor, run_here, run_job
from nrbench.runs.store import CellFolder, Result

CONNECT = 10.0
"""Seconds in which a scheduler must answer at first."""
SILENCE = 30.0
"""Seconds without an answer after which a scheduler counts as lost."""
NOTICE = 10.0
"""Seconds without a worker after which a message is printed."""
PROBE = 1.0
"""Seconds between two questions to the scheduler for its workers."""
LIBRARIES = ("numpy", "scipy", "scikit-image", "numba")
"""Packages whose versions may decide the last bits of a result."""
WINGS = ("nrbench.synthesizers", "nrbench.metrics", "nrbench.datasets_procedural", "nrbench.reports")


_one_thread: Callable[[], AbstractContextManager[Any]] = partial(threadpool_limits, 1)
"""Limits libraries to one thread, as in a worker: sums over several threads round otherwise."""


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
        future.set_result(run_job(job, run_here))
    except Exception as error:
        future.set_exception(error)
    return future


def synthesize_here(job: Request) -> None:
    """Do the part of a job that needs its method, in the caller's thread; whoever runs the job then does the rest."""
    with _one_thread():
        _run_now(dataclasses.replace(job, metrics=())).result()


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
                future.set_result(run_job(job, own_supervisor(self._tell).run))
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
        with _one_thread():
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


class ClusterLost(Exception):
    """The cluster ended, or had no worker for too long. The cells that have ended are in the run directory."""


@contextmanager
def connect(address: str, worker_wait: float, tell: Callable[[str], None]) -> Iterator[Cluster]:
    """Connect to a scheduler, and yield an executor of jobs.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``.
    worker_wait
        Seconds that the cluster may be without a worker, before the run ends.
    tell
        Called with a sentence that the user should read.

    Raises
    ------
    BadInput
        When the scheduler cannot be reached, or ``distributed`` is not installed.
    """
    try:
        import distributed
    except ImportError:
        raise BadInput("--scheduler: needs distributed; install it with `pip install nrbench[distributed]`") from None
    with _quiet():
        try:
            make_client: Any = distributed.Client
            client = make_client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            why = str(error) or type(error).__name__
            raise BadInput(f"--scheduler {address}: cannot be reached ({why}); start `dask scheduler` there") from None
        try:
            yield Cluster(client, address, worker_wait, tell)
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=CONNECT)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's warnings and log lines off the terminal: what the user should read, :class:`Cluster` says."""
    roots = ("distributed", "tornado", "asyncio")
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in roots]
    levels = {name: logging.getLogger(name).level for name in names}  # Dask gives some of them levels of their own
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="distributed")
        for name in names:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            yield
        finally:
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)


class Cluster:
    """An executor of jobs on the workers of a scheduler.

    Parameters
    ----------
    client
        Dask's client.
    address
        The address of the scheduler.
    worker_wait, tell
        See :func:`connect`.
    """

    def __init__(self, client: Any, address: str, worker_wait: float, tell: Callable[[str], None]) -> None:
        self._client, self._address, self._worker_wait, self._tell = client, address, worker_wait, tell
        self._executor = client.get_executor(pure=False)
        self._told_missing = False
        self._probed = self._had_worker = time.monotonic()
        self.slots = 0
        self._probe()

    def submit(self, job: Request) -> Future[Result]:
        """Send a job to the cluster. ``cancel`` of the future fails, because a worker may have the job."""
        future: Future[Result] = Future()
        future.set_running_or_notify_cancel()
        task = self._executor.submit(run_on_worker, job, code_hash(job.plugin_files))
        task.add_done_callback(lambda task: _finish(job, task, future))
        return future

    def check(self) -> None:
        """Tell the user if the cluster has no worker.

        Raises
        ------
        ClusterLost
            When the scheduler does not answer, or there was no worker for too long.
        """
        if time.monotonic() - self._probed > PROBE:
            self._probe()
        lacking = time.monotonic() - self._had_worker if not self.slots else 0
        if lacking > self._worker_wait:
            raise ClusterLost(f"the cluster {self._address} had no worker for {self._worker_wait:g} s")
        if lacking > NOTICE and not self._told_missing:
            self._tell(f"the cluster {self._address} has no worker; waiting for one up to {self._worker_wait:g} s")
        elif not lacking and self._told_missing:
            self._tell("a worker has joined; the run goes on")
        self._told_missing = lacking > NOTICE

    def _probe(self) -> None:
        """Ask the scheduler for its workers; count the jobs that they can run at the same time."""
        try:
            self.slots = sum(self._client.sync(self._client.scheduler.ncores, callback_timeout=SILENCE).values())
        except Exception:  # whatever it is, the scheduler has not answered
            lost = f"the scheduler {self._address} has ended or cannot be reached any more"
            raise ClusterLost(lost) from None
        self._probed = time.monotonic()
        if self.slots:
            self._had_worker = self._probed


def _finish(job: Request, task: Future[Result], future: Future[Result]) -> None:
    """Hand the outcome of a task on. A job whose workers died has the status ``crash``.

    Any other error ends the run: a full disk, or workers that cannot run nrbench.
    """
    try:
        future.set_result(task.result())
    except CancelledError:  # the scheduler is lost, as Cluster.check says
        return
    except (BadInput, OSError) as error:
        future.set_exception(error)
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            future.set_result(_record_loss(job))
        else:
            why = f"--scheduler: the workers cannot run nrbench ({describe_error(error)}); install the same there"
            future.set_exception(BadInput(why))


def _record_loss(job: Request) -> Result:
    """Record that a job has no result, or that scores of its output are missing."""
    where, why = CellFolder(Path(job.folder)), "each worker of the cluster that ran it died"
    known = where.result()
    if known is None or known["status"] != "ok":
        return where.write_result({"status": "crash", "message": why, "phase": "synthesize"})
    for metric in where.missing_scores(job.metrics):
        where.write_failed_score(metric, f"failed: crash: {why}")
    return known


@cache
def code_hash(files: tuple[str, ...]) -> str:
    """Return a hash of all code that decides a result, as it was when the hash was first computed.

    It covers the sources of nrbench, and the versions of the packages with plugins, of Python and of :data:`LIBRARIES`.

    Parameters
    ----------
    files
        Files of plugins, which the hash covers, too.
    """
    digest = hashlib.blake2b(platform.python_version().encode(), digest_size=8)
    sources = {file: Path(file) for file in files}
    for package in ("nrbench", *WINGS):
        folder = Path(importlib.import_module(package).__path__[0])
        sources |= {f"{package.replace('.', '/')}/{file.relative_to(folder)}": file for file in folder.rglob("*.py")}
    for name, file in sorted(sources.items()):
        digest.update(name.encode() + b"\0" + file.read_bytes())
    points = [point for kind in plugins.FORMS for point in importlib.metadata.entry_points(group=f"nrbench.{kind}")]
    for name in sorted({*LIBRARIES, *(point.dist.name for point in points if point.dist)}):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            digest.update(f"{name} {importlib.metadata.version(name)}".encode())
    return digest.hexdigest()


def run_on_worker(job: Request, code: str) -> Result:
    """Run a job on a worker of a cluster.

    Parameters
    ----------
    job
        The job.
    code
        The :func:`code_hash` of the machine that sent the job.

    Raises
    ------
    BadInput
        When the worker has other code, or does not see the folder of the cell.
    """
    from distributed import get_worker

    worker: Any = get_worker()
    where = f"--scheduler: the worker {worker.address}"
    if code_hash(job.plugin_files) != code:
        raise BadInput(f"{where} has other code than this machine; install the same there, and restart the workers")
    if not CellFolder(Path(job.folder)).cell_file.is_file():
        raise BadInput(f"{where} does not see {job.folder}; pass an --out that all machines share under the same path")
    with _ends_when_unwanted(worker):
        for file in job.plugin_files:
            plugins.add_file(file)
        for kind, name in job.imports:
            plugins.find(kind, name)
        return run_job(job, own_supervisor().run)


@contextmanager
def _ends_when_unwanted(worker: Any) -> Iterator[None]:
    """End this thread's supervisor when the client or the scheduler has taken back the task that is running.

    Dask cannot stop a task that runs; without this it would run on for a coordinator that has ended.
    """
    key, supervisor, done = worker.get_current_task(), own_supervisor(), threading.Event()

    def watch() -> None:
        while not done.wait(0.5):
            task = worker.state.tasks.get(key)
            if task is None or task.state not in ("executing", "long-running"):
                supervisor.end()
                return

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        done.set()
