"""Warm workers that tests share."""

import contextlib
import queue
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from typing import Any

import pytest
from faults import registered_faults

from nrbench.running import executors, runner
from nrbench.running.executors import Executor
from nrbench.running.phases import Request
from nrbench.running.supervisor import Supervisor, run_job
from nrbench.runs.store import Result

MakeExecutor = Callable[..., AbstractContextManager[Executor]]


@pytest.fixture(scope="session")
def supervisors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Supervisor]]:
    """Start two workers, which know the plugins that misbehave, in a folder where these must leave nothing."""
    folder = tmp_path_factory.mktemp("workers")
    with ExitStack() as stack, contextlib.chdir(folder):
        started = [stack.enter_context(contextlib.closing(Supervisor())) for _ in range(2)]
        with registered_faults(), ThreadPoolExecutor(2) as threads:
            list(threads.map(Supervisor._start, started))
        yield started
    assert not list(folder.iterdir())


@pytest.fixture(scope="session")
def warm_executor(supervisors: list[Supervisor]) -> MakeExecutor:
    """Return a twin of :func:`nrbench.running.executors.executor` whose jobs run on the shared workers."""
    idle: queue.LifoQueue[Supervisor] = queue.LifoQueue()
    for one in supervisors:
        idle.put(one)

    def run_idle(job: Request) -> Result:
        supervisor = idle.get()
        try:
            return run_job(job, supervisor.run)
        finally:
            idle.put(supervisor)

    @contextmanager
    def executor(jobs: int, scheduler: str | None = None, *others: Any) -> Iterator[Executor]:
        if jobs == 0 or scheduler is not None:
            with executors.executor(jobs, scheduler, *others) as chosen:
                yield chosen
        else:
            with ThreadPoolExecutor(jobs) as pool:
                yield Executor(partial(pool.submit, run_idle), lambda: jobs)

    return executor


@pytest.fixture
def warm_workers(warm_executor: MakeExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the runs of a test use the shared workers, because a worker takes seconds to start."""
    monkeypatch.setattr(runner, "executor", warm_executor)
