"""What a cell costs beyond its method and metrics: `python benchmarks/overhead.py` prints it in ms and in u.

A warm worker forks one child that runs the cheapest method on a 64 x 64 texture and one that reads its folder for the
`cost` metric; what the method itself takes is subtracted. Encoding and decoding of the small pictures is included.
"""

from __future__ import annotations

import shutil
import statistics
import tempfile
import time
from pathlib import Path

from unit import machine_unit

from nrbench.api import run
from nrbench.running.runner import Options
from nrbench.running.supervisor import Job, Supervisor, perform_job
from nrbench.runs.store import CellFolder
from nrbench.suites.suite import Suite, TextureRow

REPEATS = 41


def main() -> None:
    """Print the median overhead of a cell."""
    wall = TextureRow(name="wall", dataset="brick")
    suite = Suite(name="overhead", sample=(64, 64), size=(64, 64), methods=("scatter",), texture=(wall,))
    with tempfile.TemporaryDirectory() as place, Supervisor() as supervisor:
        first = run(suite, out=Path(place) / "run", options=Options(jobs=0)).cells[0]
        where = CellFolder(first.folder)
        job = Job("cell", str(where.path), seconds=20, mib=1024, metrics=("cost",))
        taken = [_once(where, job, supervisor) for _ in range(REPEATS)][3:]
    unit = machine_unit()
    median = statistics.median(taken)
    print(f"overhead of a cell, warm: {1000 * median:.1f} ms = {median / unit:.2f} u (u = {1000 * unit:.2f} ms)")


def _once(where: CellFolder, job: Job, supervisor: Supervisor) -> float:
    where.result_file.unlink()
    shutil.rmtree(where.scores)
    start = time.perf_counter()
    result = perform_job(job, supervisor)
    return time.perf_counter() - start - float(result["seconds"])


if __name__ == "__main__":
    main()
