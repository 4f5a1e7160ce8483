"""Run jobs on a Dask cluster: send them, watch that the cluster lives, and bring home what its workers made.

A worker that sees the run directory under the same path writes into it. Every other one works in a folder of its own
and sends the files of the finished cell back. Limits are enforced on the worker by a supervisor, as in a run without a
cluster; Dask only places the jobs.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import importlib.metadata
import logging
import platform
import secrets
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypedDict

from nrbench import plugins
from nrbench.errors import BadInput, describe_error
from nrbench.running.supervisor import Closed, Job, own_supervisor, run_job
from nrbench.runs.store import CellFolder, Result
from nrbench.storage import read_json, write_bytes
from nrbench.suites.cell import RESULTS_VERSION

CONNECT = 10.0
"""Seconds in which a scheduler must answer at first."""
SILENCE = 30.0
"""Seconds without an answer after which a scheduler counts as lost."""
NOTICE = 10.0
"""Seconds without a worker after which a message is printed."""
PROBE = 1.0
"""Seconds between two questions to the scheduler for its workers."""
TOKEN = ".cluster-"
"""Start of the name of the file by which a worker knows the run directory."""
LIBRARIES = ("numpy", "scipy", "scikit-image", "numba")
"""Packages whose versions may decide the last bits of a result."""
WINGS = ("synthesizers", "metrics", "datasets_procedural", "reports")


class ClusterLost(Exception):
    """The cluster ended, or had no worker for too long. The cells that have ended are in the run directory."""


class Parcel(TypedDict):
    """What a worker receives.

    Attributes
    ----------
    job
        The fields of the :class:`~nrbench.running.supervisor.Job`.
    versions, libraries
        What the worker must have, and what it should have, see :func:`versions_of`.
    token, secret
        The path and the content of the token file.
    files
        The files of the cell's folder, by their paths in it.
    sources
        The text of each plugin file, by its path.
    """

    job: dict[str, Any]
    versions: dict[str, str]
    libraries: dict[str, str]
    token: str
    secret: str
    files: dict[str, bytes]
    sources: dict[str, bytes]


class Answer(TypedDict, total=False):
    """What a worker sends back.

    Attributes
    ----------
    worker
        Its address.
    unfit
        Why it cannot run the job; it has run nothing then.
    differs
        The libraries of which it has other versions.
    result
        How the job ended; missing if the job is no longer wanted.
    files
        The files that the job wrote; empty if they are in the run directory.
    """

    worker: str
    unfit: str
    differs: str
    result: Result
    files: dict[str, bytes]


@contextmanager
def connect(address: str, root: Path, worker_wait: float, tell: Callable[[str], None]) -> Iterator[Cluster]:
    """Connect to a scheduler, and yield an executor of jobs in a run directory.

    Parameters
    ----------
    address
        ``tcp://HOST:PORT``.
    root
        The run directory.
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
    token, secret = root.resolve() / f"{TOKEN}{secrets.token_hex(8)}", secrets.token_hex(16)
    with _quiet():
        try:
            make_client: Any = distributed.Client
            client = make_client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            why = str(error) or type(error).__name__
            raise BadInput(f"--scheduler {address}: cannot be reached ({why}); start `dask scheduler` there") from None
        cluster = Cluster(client, address, (token, secret), worker_wait, tell)
        try:
            for stale in root.glob(f"{TOKEN}*"):  # of a run that was killed
                stale.unlink(missing_ok=True)
            token.write_text(secret, "ascii")
            yield cluster
        finally:
            cluster.end()
            with contextlib.suppress(Exception):
                client.close(timeout=CONNECT)
            token.unlink(missing_ok=True)


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
    token
        The path of the token file, and its content.
    worker_wait, tell
        See :func:`connect`.
    """

    def __init__(
        self, client: Any, address: str, token: tuple[Path, str], worker_wait: float, tell: Callable[[str], None]
    ) -> None:
        self._client, self._address, self._token = client, address, token
        self._worker_wait, self._tell = worker_wait, tell
        self._threads: Mapping[str, int] = {}
        self._answered = self._had_worker = time.monotonic()
        self._told_missing = False
        self._told_libraries: set[str] = set()
        self._ended = threading.Event()
        self._probe()
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def slots(self) -> int:
        """The number of jobs that the workers of the cluster can run at the same time, at present."""
        return sum(self._threads.values())

    def submit(self, job: Job) -> Future[Result]:
        """Send a job to the cluster."""
        future = _ClusterFuture(self._client)
        future.task = self._client.submit(
            run_parcel, self._pack(job), pure=False, key=f"nrbench-{secrets.token_hex(12)}"
        )
        future.task.add_done_callback(lambda task: self._finish(job, future, task))
        return future

    def check(self) -> None:
        """Tell the user if the cluster has no worker.

        Raises
        ------
        ClusterLost
            When the scheduler does not answer, or there was no worker for too long.
        """
        now = time.monotonic()
        if self._client.status != "running" or now - self._answered > SILENCE:
            raise ClusterLost(f"the scheduler {self._address} has ended or cannot be reached any more")
        lacking = now - self._had_worker
        if lacking > self._worker_wait:
            raise ClusterLost(f"the cluster {self._address} had no worker for {self._worker_wait:g} s")
        if lacking > NOTICE and not self._told_missing:
            self._told_missing = True
            self._tell(f"the cluster {self._address} has no worker; waiting for one up to {self._worker_wait:g} s")
        elif not lacking and self._told_missing:
            self._told_missing = False
            self._tell("a worker has joined; the run goes on")

    def end(self) -> None:
        """Stop to watch the cluster."""
        self._ended.set()

    def _watch(self) -> None:
        while not self._ended.wait(PROBE):
            self._probe()

    def _probe(self) -> None:
        """Ask the scheduler for its workers."""
        with contextlib.suppress(Exception):  # whatever it is, the scheduler has not answered
            self._threads = self._client.sync(self._client.scheduler.ncores, callback_timeout=SILENCE)
            self._answered = time.monotonic()
        if self._threads:
            self._had_worker = self._answered

    def _pack(self, job: Job) -> Parcel:
        return {
            "job": dataclasses.asdict(job),
            "versions": versions_of(job),
            "libraries": _libraries(),
            "token": str(self._token[0]),
            "secret": self._token[1],
            "files": read_files(CellFolder(Path(job.folder))),
            "sources": {file: Path(file).read_bytes() for file in job.plugins},
        }

    def _finish(self, job: Job, future: Future[Result], task: Any) -> None:
        """Write what a worker sent back, and finish the future. A task that was lost or canceled finishes nothing."""
        if task.status in ("cancelled", "lost") or not future.set_running_or_notify_cancel():
            return
        try:
            if task.status == "error":
                future.set_result(_result_of_failure(job, task.exception()))
            else:
                future.set_result(self._unpack(job, task.result()))
        except BaseException as error:  # the thread that waits for the future gets it
            future.set_exception(error)
        finally:
            task.release()

    def _unpack(self, job: Job, answer: Answer) -> Result:
        if answer.get("unfit"):
            raise BadInput(f"--scheduler {self._address}: the worker {answer['worker']} {answer['unfit']}")
        differs = answer.get("differs", "")
        if differs and differs not in self._told_libraries:
            self._told_libraries.add(differs)
            self._tell(f"the worker {answer['worker']} has {differs}; the last bits of its results may differ")
        if "result" not in answer:
            return _record_loss(job, f"the worker {answer['worker']} gave it up")
        write_files(CellFolder(Path(job.folder)), answer["files"])
        return answer["result"]


class _ClusterFuture(Future[Result]):
    """The future of a job on a cluster. Only a job that no worker has can be canceled."""

    task: Any

    def __init__(self, client: Any) -> None:
        super().__init__()
        self._client = client

    def cancel(self) -> bool:
        """Take the job back, unless a worker has it."""
        try:
            placed = {key for keys in self._client.processing().values() for key in keys}
        except Exception:  # the scheduler is lost, as Cluster.check says
            return False
        if self.task.key in placed or not super().cancel():
            return False
        self.task.cancel()
        return True


def _result_of_failure(job: Job, error: BaseException) -> Result:
    """Return and record the result of a job whose workers died, or raise what ends the run.

    Raises
    ------
    BadInput
        When the workers cannot run nrbench at all.
    OSError
        When a disk is full or broken.
    """
    if isinstance(error, OSError):
        raise error
    if type(error).__name__ != "KilledWorker":
        raise BadInput(f"--scheduler: the workers cannot run nrbench ({describe_error(error)}); install the same there")
    return _record_loss(job, "each worker of the cluster that ran it died")


def _record_loss(job: Job, why: str) -> Result:
    """Record that a job has no result, or that scores of its output are missing."""
    where = CellFolder(Path(job.folder))
    known = where.result()
    if known is None or known["status"] != "ok":
        return where.write_result({"status": "crash", "message": why, "phase": "synthesize"})
    for metric in where.missing_scores(job.metrics):
        where.write_failed_score(metric, f"failed: crash: {why}")
    return known


def versions_of(job: Job) -> dict[str, str]:
    """Return what a worker must have: nrbench, its code, and the plugins that the job names, each with its version."""
    content: Any = read_json(CellFolder(Path(job.folder)).cell_file) or {}
    named = [("metrics", metric) for metric in job.metrics]
    if job.kind == "detect":
        named.append(("detectors", content["detector"]))
    else:
        named += [("synthesizers", content["method"]), ("datasets", content["recipe"]["dataset"])]
    core = {
        "nrbench": f"{importlib.metadata.version('nrbench')}, results version {RESULTS_VERSION}, code {code_hash()}"
    }
    return core | {f"{kind} {name}": _version(kind, name) for kind, name in named}


def _version(kind: str, name: str) -> str:
    try:
        return plugins.find(kind, name).version
    except BadInput as error:
        return str(error)


@cache
def code_hash() -> str:
    """Return a hash of the source files of nrbench and of its plugin folders."""
    core = Path(__file__).parents[1]
    files = {file.relative_to(core).as_posix(): file for file in core.rglob("*.py")}
    for wing in WINGS:
        folder = Path(importlib.import_module(f"nrbench.{wing}").__path__[0])
        files |= {f"{wing}/{file.relative_to(folder).as_posix()}": file for file in folder.rglob("*.py")}
    digest = hashlib.blake2b(digest_size=6)
    for name, file in sorted(files.items()):
        digest.update(name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


@cache
def _libraries() -> dict[str, str]:
    found = {"Python": platform.python_version(), "processor": platform.machine()}
    for name in LIBRARIES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def read_files(where: CellFolder) -> dict[str, bytes]:
    """Return the files that belong to a cell, by their paths in its folder. Links are not followed."""
    single = (where.cell_file, where.sample, where.again, where.output, where.source, where.log, where.result_file)
    files = [*single, *where.extras.glob("*"), *where.scores.glob("*")]
    whole = [file for file in files if file.is_file() and not file.is_symlink() and not file.name.startswith(".")]
    return {file.relative_to(where.path).as_posix(): file.read_bytes() for file in whole}


def write_files(where: CellFolder, files: Mapping[str, bytes]) -> None:
    """Write files into a cell's folder, the result last, because a cell with a result is never run again.

    Raises
    ------
    BadInput
        When a path leads out of the folder.
    """
    result = where.result_file.name
    for name in sorted(files, key=lambda name: (name == result, name)):
        path, content = where.path / name, files[name]
        if path.resolve().parent not in (where.path.resolve(), where.extras.resolve(), where.scores.resolve()):
            raise BadInput(f"--scheduler: a worker sent the file {name!r}, which lies outside its cell")
        write_bytes(path, content)


def run_parcel(parcel: Parcel) -> Answer:
    """Run a job on a worker of a cluster, in the run directory if the worker sees it, else in a folder of its own."""
    from distributed import get_worker

    worker: Any = get_worker()
    place = Path(worker.local_directory)
    answer = Answer(worker=str(worker.address), differs=_differences(parcel["libraries"], _libraries()))
    job = Job(**{**parcel["job"], "metrics": tuple(parcel["job"]["metrics"])})
    with contextlib.ExitStack() as stack:
        if not _sees(Path(parcel["token"]), parcel["secret"]):
            folder = stack.enter_context(tempfile.TemporaryDirectory(dir=place, ignore_cleanup_errors=True))
            job = dataclasses.replace(job, folder=str(Path(folder, Path(job.folder).name)))
            write_files(CellFolder(Path(job.folder)), parcel["files"])
        unfit = _unfit(job, parcel, place)
        if unfit:
            return {**answer, "unfit": unfit}
        try:
            with _ends_when_unwanted(worker):
                answer["result"] = run_job(job)
        except Closed:
            return answer
        except OSError as error:
            raise OSError(error.errno, f"worker {worker.address}: {error.strerror}", error.filename) from None
        home = Path(job.folder) == Path(parcel["job"]["folder"])
        made = {} if home else read_files(CellFolder(Path(job.folder)))
    return {**answer, "files": {name: text for name, text in made.items() if parcel["files"].get(name) != text}}


def _sees(token: Path, secret: str) -> bool:
    """Return whether this machine has the token file of the coordinator, and may write beside it."""
    try:
        if token.read_text("ascii") != secret:
            return False
        with tempfile.TemporaryFile(dir=token.parent):
            return True
    except (OSError, ValueError):
        return False


def _unfit(job: Job, parcel: Parcel, place: Path) -> str:
    """Load the plugin files of a job; return in words what this worker lacks to run it, or an empty string."""
    try:
        for path, text in parcel["sources"].items():
            _load_plugins(Path(path), text, place)
    except BadInput as error:
        return f"cannot load a plugin: {error}; restart the workers"
    differs = _differences(parcel["versions"], versions_of(job))
    return f"has {differs}; install the same on all machines, and restart the workers" if differs else ""


def _load_plugins(path: Path, text: bytes, place: Path) -> None:
    """Register a plugin file, or a copy of it where this machine does not have the same file."""
    digest = hashlib.blake2b(text, digest_size=8).hexdigest()
    with _loading:
        if digest in _loaded:
            return
        file = path
        if not _holds(path, text):
            file = place / f"plugin-{digest}" / path.name
            write_bytes(file, text)
        plugins.add_file(file)
        _loaded.add(digest)


def _holds(path: Path, text: bytes) -> bool:
    try:
        return path.read_bytes() == text
    except OSError:
        return False


_loading = threading.Lock()
_loaded: set[str] = set()
"""Hashes of the plugin files that this worker has loaded."""


def _differences(wanted: Mapping[str, str], found: Mapping[str, str]) -> str:
    """Return in words what is found in another version than wanted."""
    return ", ".join(
        f"{name} {found.get(name, 'missing')} instead of {version}"
        for name, version in wanted.items()
        if found.get(name) != version
    )


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
