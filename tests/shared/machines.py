"""A Dask cluster on this machine, for tests: a real scheduler and real workers."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Machines:
    """A scheduler and its workers, each a process of its own.

    Parameters
    ----------
    folder
        Where they work.
    """

    folder: Path
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def address(self) -> str:
        """The address of the scheduler."""
        return (self.folder / "address").read_text().strip()

    def start_scheduler(self) -> None:
        """Start it, and wait for its address."""
        program = (
            "import asyncio, pathlib\nfrom distributed import Scheduler\n"
            "async def main():\n"
            "    async with Scheduler(host='127.0.0.1', port=0, dashboard=False) as scheduler:\n"
            "        pathlib.Path('part').write_text(scheduler.address)\n"
            "        pathlib.Path('part').rename('address')\n"
            "        await scheduler.finished()\n"
            "asyncio.run(main())\n"
        )
        self._start("scheduler", "-c", program)
        while not (self.folder / "address").exists():
            assert self.processes["scheduler"].poll() is None
            time.sleep(0.05)

    def start_worker(self, name: str) -> None:
        """Start a worker of one thread."""
        words = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder / name))
        self._start(name, "-m", "distributed.cli.dask_worker", self.address, *words)

    def wait_for_workers(self, number: int) -> None:
        """Wait until the scheduler knows so many workers, however long they take to start."""
        from distributed import Client  # of an optional package

        with Client(self.address) as client:
            client.wait_for_workers(number)

    def _start(self, name: str, *words: str) -> None:
        log = (self.folder / f"{name}.log").open("wb")
        environment = {**os.environ, "NRBENCH_TEST_PLACE": name}
        command = [sys.executable, *words]
        self.processes[name] = subprocess.Popen(command, cwd=self.folder, stdout=log, stderr=log, env=environment)

    def kill(self, name: str) -> None:
        """Kill a process by a signal that it cannot catch, as a machine that fails."""
        self.processes[name].kill()
        self.processes.pop(name).wait()


@contextmanager
def machines(folder: Path, *workers: str) -> Iterator[Machines]:
    """Start a scheduler and workers, and end them."""
    made = Machines(folder)
    with ExitStack() as stack:
        stack.callback(lambda: [made.kill(name) for name in list(made.processes)])
        made.start_scheduler()
        for name in workers:
            made.start_worker(name)
        yield made
