"""Whether runs last: `python benchmarks/soak.py [PART ...]`, or `make soak` for all parts.

Each part runs `nrbench run` in processes of its own, disturbs it, resumes it, and compares outputs and scores with
those of an undisturbed run. It prints figures, and ends with exit code 1 if one is not as it must be.

- kills: SIGKILL at random instants, `--kills` times; the cells that were done must not be done again.
- cells: `--cells` trivial cells; the coordinator may hold 400 MiB; resuming and each report may take 60 s.
- disk: a disk that is full in the middle of a run (needs root, for a small file system in memory).
- runners: two runs in one directory at the same time.
- copy: a run directory of which only a part was copied, some files only in part.
- clock: a clock that jumps by up to a day at each reading, in every process.
- orphans: methods that leave processes of other sessions without an environment, and kill their worker.
"""

import contextlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from studies import read_options
from trivial_cells import write_plugin, write_suite

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.runs.records import Run

SUITE = """name = "soak"
sample = "64x64"
size = "64x64"
lattice = ["given"]
methods = ["oracle", "tiling", "scatter", "rsgf:block=16,border=4"]
metrics = ["cost", "source", "regularity"]
replicates = {replicates}
texture = [{{ name = "wall", dataset = "brick", parameters = {{ color = 0.2 }} }},
           {{ name = "web", dataset = "weave", parameters = {{ noise = 0.05 }} }}]
"""
QUIET: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
JUMPS = """import random, time
_time, _random = time.time, random.Random(0)
time.time = lambda: _time() + _random.uniform(-86400, 86400)
"""


@dataclass
class Soak:
    """The undisturbed run, the folder of the others, and what was found wrong.

    Parameters
    ----------
    place
        A folder for everything.
    jobs
        Cells at the same time.
    """

    place: Path
    jobs: int
    wrong: list[str] = field(default_factory=list)

    def command(self, out: str | Path, *words: str, suite: str = "suite.toml") -> list[str]:
        """Return the command of a run."""
        program = "import sys; from nrbench.cli.main import main; main(sys.argv[1:])"
        start = [sys.executable, "-c", program, "--plugin", str(self.place / "trivial.py"), "run"]
        jobs = ("--jobs", str(self.jobs))
        return [*start, str(self.place / suite), "--out", str(out), "--no-report", *jobs, *words]

    def start(self, *words: str | Path, **environment: str) -> subprocess.Popen[str]:
        """Start a run in the folder, its group its own."""
        return subprocess.Popen(
            self.command(*words),  # type: ignore[arg-type]
            cwd=self.place,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **environment},
            start_new_session=True,
        )

    def finish(self, *words: str | Path, **environment: str) -> tuple[int, str]:
        """Run to the end; return the exit code and the last line of standard error that is not about a cell."""
        running = self.start(*words, **environment)
        errors = running.communicate()[1]
        lines = [line for line in errors.splitlines() if not line.startswith("[")]
        return running.returncode, lines[-1] if lines else ""

    def results(self, out: str | Path) -> dict[str, int]:
        """Return when each cell that is done got its result, ns."""
        files = list((self.place / out / "cells").glob("*/result.json"))
        return {file.parent.name: file.stat().st_mtime_ns for file in files}

    def content(self, out: str | Path) -> dict[str, object]:
        """Return the output's bytes and the scores of each cell, without what is measured."""
        found = {}
        for record in Run(self.place / out).cells:
            file = record.folder / "output.png"
            values = {name: value for name, value in record.values.items() if not name.startswith("cost.")}
            found[record.key] = (record.status, file.read_bytes() if file.is_file() else b"", values)
        return found

    def compare(self, what: str, out: str | Path, other: str = "whole") -> str:
        """Return in words whether a run has the tables of an undisturbed one; note it if not."""
        try:
            same = self.content(out) == self.content(other)
        except (OSError, BadInput):
            same = False
        self.check(same, f"{what}: the tables differ")
        return "tables identical" if same else "TABLES DIFFER"

    def check(self, holds: bool, what: str) -> None:
        """Note what is wrong if a condition does not hold."""
        if not holds:
            self.wrong.append(what)


def kills(soak: Soak, count: int, cells: int) -> None:
    """Kill runs at random instants until `count` kills have hit one, resuming each time."""
    rng, hit, redone, unfinished, runs = random.Random(0), 0, 0, [], 0
    whole = time.monotonic()
    soak.finish("timing")
    whole = time.monotonic() - whole
    strays = 0
    while hit < count:
        out = f"killed{runs}"
        runs += 1
        shutil.rmtree(soak.place / out, ignore_errors=True)
        while hit < count:
            running = soak.start(out)
            with contextlib.suppress(subprocess.TimeoutExpired):
                running.wait(rng.uniform(0, whole))
            if running.poll() is not None:
                break
            family = psutil.Process(running.pid).children(recursive=True)
            done = soak.results(out)
            running.kill()
            running.communicate()
            hit += 1
            strays += len(psutil.wait_procs(family, timeout=20)[1])
            late = soak.results(out)
            redone += sum(late.get(key) != when for key, when in done.items())
            begun = {log.parent.name for log in (soak.place / out / "cells").glob("*/log.txt")}
            unfinished.append(len(begun - set(late)))
        before = soak.results(out)
        code, _ = soak.finish(out)
        after = soak.results(out)
        redone += sum(after.get(key) != when for key, when in before.items())
        soak.check(code == 0, f"kills: the resumed run ended with exit code {code}")
        state = soak.compare("kills", out)
    soak.check(redone == 0, f"kills: {redone} finished cells were done again")
    soak.check(max(unfinished) <= soak.jobs, f"kills: {max(unfinished)} cells were begun at once")
    soak.check(strays == 0, f"kills: {strays} processes were left")
    print(
        f"kills: {hit} SIGKILLs in {runs} runs of {len(soak.content('whole'))} cells: {redone} finished cells done "
        f"again; at most {max(unfinished)} cells lost by a kill, {soak.jobs} run at a time; "
        f"{strays} processes left after 20 s; {state}"
    )


def timed(soak: Soak, command: list[str]) -> tuple[float, float, int]:
    """Run a command; return its wall seconds, the processor seconds and the most MiB of its first process."""
    start, process, cpu, peak = time.monotonic(), psutil.Popen(command, cwd=soak.place, **QUIET), 0.0, 0
    while process.poll() is None:
        with contextlib.suppress(psutil.Error):
            cpu, peak = sum(process.cpu_times()[:2]), max(peak, process.memory_info().rss >> 20)
        time.sleep(0.05)
    soak.check(process.returncode == 0, f"cells: exit code {process.returncode} of {command[5:7]}")
    return time.monotonic() - start, cpu, peak


def cells(soak: Soak, count: int, number: int) -> None:
    """Run trivial cells, resume the run and write its reports; watch the memory of the coordinator and the time."""
    write_suite(soak.place, number)
    command = soak.command("many", suite="many.toml")
    report = [*command[: command.index("run")], "report", str(soak.place / "many"), "--format"]
    verbs = {"run": command, "resume": command, "report csv": [*report, "csv"], "report html": [*report, "html"]}
    for what, words in verbs.items():
        seconds, cpu, peak = timed(soak, words)
        soak.check(peak < 400 or what.startswith("report"), f"cells: {what} took {peak} MiB")
        soak.check(seconds < 60 or what == "run", f"cells: {what} took {seconds:.0f} s")
        print(f"cells: {number} trivial cells, {what}: {seconds:.0f} s, {cpu:.0f} s of a processor, {peak} MiB")


def disk(soak: Soak, count: int, number: int) -> None:
    """Run on a disk that is full in the middle, give it room, and resume."""
    mount = soak.place / "small"
    mount.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(mount)]
    made = subprocess.run(command, capture_output=True, check=False)
    if made.returncode != 0:
        print("disk: skipped; a small file system needs root")
        return
    try:
        used = sum(file.stat().st_size for file in (soak.place / "whole").rglob("*") if file.is_file())
        (mount / "ballast").write_bytes(bytes((16 << 20) - used // 2))
        code, line = soak.finish(mount / "run")
        done = len(soak.results(mount / "run"))
        soak.check(code == 2, f"disk: exit code {code}: {line}")
        soak.check(0 < done < len(soak.content("whole")), f"disk: it was full after {done} cells")
        (mount / "ballast").unlink()
        subprocess.run(["mount", "-o", "remount,size=256m", str(mount)], check=True)
        again, last = soak.finish(mount / "run")
        soak.check(again == 0, f"disk: the resumed run ended with exit code {again}: {last}")
        state = soak.compare("disk", mount / "run")
        print(f"disk: full after {done} cells: exit code {code}, {line!r}; with room again: {state}")
    finally:
        subprocess.run(["umount", str(mount)], check=False)


def runners(soak: Soak, count: int, number: int) -> None:
    """Start two runs in one directory."""
    pair = [soak.start("shared"), soak.start("shared")]
    errors = [one.communicate()[1].splitlines()[-1] for one in pair]
    codes = sorted(one.returncode for one in pair)
    refused = next(line for one, line in zip(pair, errors, strict=True) if one.returncode == codes[-1])
    soak.check(codes == [0, 2], f"runners: exit codes {codes}")
    print(f"runners: exit codes {codes}, {refused!r}; {soak.compare('runners', 'shared')}")


def copy(soak: Soak, count: int, number: int) -> None:
    """Copy a part of a run directory, cut some files, and resume in the copy."""
    rng, whole = random.Random(1), soak.place / "whole"
    files = [file for file in sorted(whole.rglob("*")) if file.is_file()]
    cut = 0
    for file in files:
        there = soak.place / "copy" / file.relative_to(whole)
        there.parent.mkdir(parents=True, exist_ok=True)
        if rng.random() < 0.5 or file.name == "run.json":
            shutil.copy(file, there)
            if rng.random() < 0.1:
                cut += 1
                os.truncate(there, rng.randrange(max(1, there.stat().st_size)))
    (soak.place / "copy" / "cells").mkdir(exist_ok=True)
    code, line = soak.finish("copy", "--retry-failed")
    soak.check(code == 0, f"copy: exit code {code}: {line}")
    print(f"copy: half of {len(files)} files, {cut} of them cut: exit code {code}, {soak.compare('copy', 'copy')}")


def clock(soak: Soak, count: int, number: int) -> None:
    """Run with a clock that jumps."""
    folder = soak.place / "jumps"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(JUMPS)
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    start = time.monotonic()
    code, line = soak.finish("jumping", "--timeout", "30", PYTHONPATH=path)
    soak.check(code == 0, f"clock: exit code {code}: {line}")
    print(f"clock: exit code {code} in {time.monotonic() - start:.0f} s, {soak.compare('clock', 'jumping')}")


LEAVER = """import os, subprocess, sys, time
from dataclasses import dataclass
from typing import ClassVar
PLACE = {place!r}
PROGRAM = "import os, sys, time\\nif os.fork(): os._exit(0)\\nos.setsid()\\nos.closerange(0, 3)\\n"
PROGRAM += "open(sys.argv[1], 'a').write(f'{{os.getpid()}} ')\\ntime.sleep(600)"
@dataclass(frozen=True)
class Leaver:
    "A page."
    number: int = 0
    uses_lattice: ClassVar = False
    def synthesize(self, task):
        for _ in range(3):
            subprocess.Popen([sys.executable, "-S", "-c", PROGRAM, PLACE], env={{}}, start_new_session=True).wait()
        time.sleep(0.3)
        os.kill(os.getppid(), 9)
        time.sleep(60)
"""


def orphans(soak: Soak, count: int, number: int) -> None:
    """Run methods that leave processes and kill their worker, in forked children and in fresh interpreters."""
    place, marks = soak.place / "orphans.py", soak.place / "pids"
    place.write_text(LEAVER.format(place=str(marks)))
    methods = [word for each in range(10) for word in ("-m", f"leaver:number={each}")]
    for forks in ("yes", "no"):
        words = ("--plugin", str(place), "-t", "wall", "--replicates", "1", *methods)
        code, _ = soak.finish(f"orphans-{forks}", *words, NRBENCH_FORK=forks)
        pids = [int(word) for word in marks.read_text().split()]
        time.sleep(1)
        left = [pid for pid in pids if psutil.pid_exists(pid)]
        soak.check(code == 1 and not left and len(pids) == 30, f"orphans: exit code {code}, {left} of {len(pids)} live")
        print(f"orphans, forks: {forks}: {len(left)} of {len(pids)} processes live after their worker was killed")
        marks.unlink()


PARTS: dict[str, Callable[[Soak, int, int], None]] = {
    each.__name__: each for each in (kills, cells, disk, runners, copy, clock, orphans)
}


@contextlib.contextmanager
def soaking(jobs: int, replicates: int) -> Iterator[Soak]:
    """Make the folder, the plugin, the suite and the undisturbed run; remove them afterwards."""
    with tempfile.TemporaryDirectory(prefix="soak-", ignore_cleanup_errors=True) as place:
        soak = Soak(Path(place), jobs)
        (soak.place / "suite.toml").write_text(SUITE.format(replicates=replicates))
        plugins.add_file(write_plugin(soak.place))
        code, line = soak.finish("whole")
        if code != 0:
            raise SystemExit(f"the undisturbed run ended with exit code {code}: {line}")
        yield soak


def main() -> int:
    """Run the parts that the arguments name, or all."""
    more = {"parts": [], "kills": 50, "cells": 20_000, "replicates": 6, "jobs": 2}
    options = read_options(__doc__, ["parts"], {"parts": [*PARTS, []]}, **more)
    with soaking(options.jobs, options.replicates) as soak:
        for name in options.parts or PARTS:
            PARTS[name](soak, options.kills, options.cells)
            sys.stdout.flush()
    for line in soak.wrong:
        print(f"WRONG {line}")
    return int(bool(soak.wrong))


if __name__ == "__main__":
    sys.exit(main())
