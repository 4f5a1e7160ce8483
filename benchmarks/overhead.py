"""What a cell costs beyond its method: `python benchmarks/overhead.py [--cells 2000]` prints it in ms and in u.

A real run of trivial cells, one at a time: a warm worker forks one child that repeats the pixels of a 64 x 64 sample,
and another child reads the cell's folder for the `cost` metric. The time that the methods themselves take is
subtracted. The start of the worker is not included; the writing of all files and the work of the coordinator are. The
second line is the processor time of all processes, which depends less on what else the machine does. The third one is
the part of it that encodes and decodes the small pictures, measured apart, in this process. The last one is the memory
of the coordinator, which must not grow with the cells.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import psutil
from trivial_cells import write_plugin, write_suite
from unit import cpu_unit, machine_unit

from nrbench import plugins
from nrbench.api import run
from nrbench.imaging.files import read_image, write_image
from nrbench.running.pace import Step
from nrbench.running.runner import Options

BLOCKS = 20
"""The cells are timed in so many blocks. The first one, with the start of the worker, is left out."""


def processor_seconds(process: psutil.Process) -> dict[str, float]:
    """Return the processor seconds so far of the coordinator, and of the worker with the children that have ended.

    The scorer is counted with the worker.
    """
    used = process.cpu_times()
    others = 0.0
    for child in process.children(recursive=True):
        with contextlib.suppress(psutil.Error):
            others += sum(child.cpu_times()[:4])
    return {"coordinator": used.user + used.system, "worker and its children": others}


def picture_seconds(folder: Path) -> float:
    """Return the processor seconds of the pictures of one cell: sample and output are written, and read three times."""
    sample, copy = folder / "sample.png", folder.parent / "copy.png"
    image = read_image(sample)
    tasks = (lambda: write_image(copy, image), lambda: read_image(sample))
    taken = []
    for task in tasks:
        start = time.process_time()
        for _ in range(200):
            task()
        taken.append((time.process_time() - start) / 200)
    return 2 * taken[0] + 3 * taken[1]


def main() -> None:
    """Print the overhead of a cell and the memory of the coordinator."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=2000, help="at least 200; rounded down to a multiple of 200")
    count = max(200, parser.parse_args().cells // 200 * 200)
    block, process = count // BLOCKS, psutil.Process()
    marks: list[tuple[float, float]] = []
    processors: list[dict[str, float]] = []

    def follow(step: Step) -> None:
        if step.done % block == 0:
            marks.append((time.perf_counter(), process.memory_info().rss / 2**20))
            processors.append(processor_seconds(process))

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        plugins.add_file(write_plugin(folder))
        done = run(write_suite(folder, count), out=folder / "run", options=Options(jobs=1), progress=follow)
        cells = done.cells
        pictures = picture_seconds(cells[0].folder)
    if len(cells) != count or any(cell.status != "ok" for cell in cells):
        raise SystemExit("overhead: a trivial cell failed")
    method = statistics.fmean(float(cell.result["seconds"]) for cell in cells)
    blocks = [(end[0] - start[0]) / block - method for start, end in pairwise(marks)]
    unit, median = machine_unit(), statistics.median(blocks)
    print(
        f"overhead of a cell, warm, over {count} trivial cells: {1000 * median:.1f} ms = {median / unit:.2f} u "
        f"(blocks of {block} cells from {1000 * min(blocks):.1f} to {1000 * max(blocks):.1f} ms; "
        f"u = {1000 * unit:.2f} ms)"
    )
    used = {name: (processors[-1][name] - first) / (count - block) for name, first in processors[0].items()}
    parts = ", ".join(f"{name} {1000 * seconds:.1f} ms" for name, seconds in used.items())
    total = sum(used.values()) - method
    print(f"processor time of a cell: {1000 * total:.1f} ms = {total / cpu_unit():.2f} u ({parts})")
    print(f"of it encoding and decoding of pictures: {1000 * pictures:.1f} ms")
    print(
        f"memory of the coordinator: {marks[0][1]:.0f} MiB after {block} cells, {marks[-1][1]:.0f} MiB after {count} "
        f"({1024 * (marks[-1][1] - marks[0][1]) / (count - block):.2f} KiB a cell)"
    )


if __name__ == "__main__":
    main()
