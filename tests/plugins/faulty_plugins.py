"""Methods, metrics, a detector and a dataset that misbehave, each in its own way."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import mmap
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, Detection, Observation, Refused, Score, Synthesis, Task, Texture
from nrbench.runs.records import Run


@dataclass(frozen=True)
class Fine:
    """The sample, repeated: what every other one here should have done."""

    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Repeat the sample."""
        height, width = task.shape
        rows, columns = np.arange(height) % task.sample.shape[0], np.arange(width) % task.sample.shape[1]
        return Synthesis(task.sample[rows][:, columns])


@dataclass(frozen=True)
class Reader:
    """The sample, brightened by the number in a file, if the number is also in a file of the working directory."""

    file: Path = Path("number.txt")
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Write a relative path, and read it and the file."""
        Path("copy.txt").write_text(self.file.read_text())
        brighter = np.maximum(task.sample, float(Path("copy.txt").read_text()))
        return Synthesis(brighter[: task.shape[0], : task.shape[1]])


def misbehave(how: str) -> None:
    """Do to the process what ``how`` says, after a line in its log; "fine" and what leaves no trace return."""
    print(f"planted {how}", flush=True)
    if how == "raise":
        raise RuntimeError("planted failure")
    if how in ("stubborn", "busy"):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(0.01 if how == "stubborn" else 0)
    if how == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "exit":
        os._exit(0)
    if how == "hog":
        hoard = []
        while True:
            hoard.append(np.ones(1 << 22, np.uint8))
            print(f"planted hog: holds {4 * len(hoard)} MiB", flush=True)
    if how == "creep":  # memory that no limit of the system counts
        for size in range(1, 1000):
            shared = mmap.mmap(-1, 1 << 20)
            shared.write(b"x" * (1 << 20))
            kept.append(shared)
            print(f"holds {size} MiB", flush=True)
            time.sleep(0.004)
    if how == "litter":
        child = subprocess.Popen(
            [sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True, stdout=subprocess.DEVNULL
        )
        print(f"child {child.pid}", flush=True)
    if how == "flood":
        for _ in range(300):
            print("flood " * 10_000)
    if how == "seed":
        np.random.seed(0)  # noqa: NPY002
        random.seed(0)
        np.seterr(all="raise")
        np.set_printoptions(precision=1)
        os.environ["OMP_NUM_THREADS"] = "9"
    if how == "folder":
        Path("left by a plugin.txt").write_text(how)
        os.chdir("/")


kept: list[mmap.mmap] = []
MISJUDGED = "misjudged"
"""The extra of an output on which the metrics below misbehave. A run that names no metrics scores by all of them."""


@dataclass(frozen=True)
class Rogue:
    """A method that does to its process what ``how`` says, and then repeats the sample."""

    how: str = "fine"
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Misbehave."""
        misbehave(self.how)
        good = Fine().synthesize(task)
        if self.how == "mutate":
            task.sample[...] = 0
        if self.how == "type":
            return Synthesis(good.image.astype(object))
        if self.how == "integers":
            return Synthesis((255 * good.image).astype(np.uint8))
        return dataclasses.replace(good, extras={MISJUDGED: np.ones(1)})


@dataclass(frozen=True)
class Probe:
    """A detector that does to its process what ``how`` says, and then finds a lattice of 16 px."""

    how: str = "fine"

    def detect(self, image: Image) -> Detection:
        """Misbehave."""
        misbehave(self.how)
        if self.how == "mutate":
            image[...] = 0
        if self.how == "nothing":
            return None  # type: ignore[return-value]
        if self.how == "nan":
            return Detection(Lattice((float("nan"), 0), (0, 16)), 1.0)
        return Detection(Lattice((16, 0), (0, 16)), 1.0)


@dataclass(frozen=True)
class Follower:
    """The sample, repeated; it wants a lattice."""

    def synthesize(self, task: Task) -> Synthesis:
        """Repeat the sample."""
        return Fine().synthesize(task)


def make_judge(how: str) -> type:
    """Return a metric that does to its process what ``how`` says for the outputs of ``rogue``, and then scores 1."""

    def score(self: Any, observation: Observation) -> Score:
        """Misbehave."""
        if MISJUDGED not in observation.extras:
            return Score({"value": 1.0})
        misbehave(how)
        if how == "mutate":
            observation.output[...] = 0
        if how == "nothing":
            return None  # type: ignore[return-value]
        return Score({"value": float("nan")} if how == "nan" else {} if how == "shape" else {"value": 1.0})

    content = {"name": f"judge-{how}", "columns": {"value": Column("Whether all is well.")}, "score": score}
    notes = {"name": ClassVar[str], "columns": ClassVar[dict[str, Column]]}
    cls = type(f"Judge{how}", (), {**content, "__annotations__": notes, "__module__": __name__, "__doc__": "A metric."})
    return dataclass(frozen=True)(cls)


JUDGES = (
    *("raise", "stubborn", "segfault", "exit", "hog", "litter", "flood", "seed", "folder", "mutate"),
    *("nothing", "nan", "shape", "fine"),
)
globals().update({f"Judge{how}": make_judge(how) for how in JUDGES})


@dataclass(frozen=True)
class Place:
    """The sample, repeated, with a remark on the machine that did it."""

    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Repeat the sample."""
        print("placed")
        return dataclasses.replace(Fine().synthesize(task), note=os.environ.get("NRBENCH_TEST_PLACE", ""))


@dataclass(frozen=True)
class Faulty:
    """Misbehave as ``how`` says."""

    how: str = "raise"
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Misbehave."""
        good = np.full((*task.shape, task.sample.shape[2]), 0.5, np.float32)
        if self.how == "raise":
            raise RuntimeError("planted failure")
        if self.how == "full":
            raise OSError(errno.ENOSPC, "No space left on device")
        if self.how == "refuse":
            raise Refused("planted refusal")
        if self.how == "loop":
            while True:
                time.sleep(0.01)
        if self.how == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.how == "exit":
            os._exit(3)
        if self.how == "memory":
            np.ones((1 << 33,), np.uint8)
        if self.how == "hog":
            hoard = []
            while True:
                hoard.append(np.ones(1 << 22, np.uint8))
        if self.how == "nan":
            good[0, 0] = np.nan
        if self.how == "shape":
            return Synthesis(good[:-1])
        if self.how == "nothing":
            return None  # type: ignore[return-value]
        if self.how == "lie":
            source = np.ones((*task.shape, 3), np.float32)
            return Synthesis(1 - task.sample[1, 1] + np.zeros_like(good), source=source)
        return Synthesis(good)


@dataclass(frozen=True)
class Picture:
    """Draw a gray texture, or misbehave as ``how`` says."""

    how: str = "fine"

    def render(self, shape: tuple[int, int], rng: np.random.Generator) -> Texture:
        """Misbehave."""
        image = np.repeat(rng.random((*shape, 1), np.float32), 3, axis=2)
        if self.how in ("raise", "stubborn", "hog", "litter", "flood", "seed", "folder"):
            misbehave(self.how)
        if self.how == "mute":
            raise Mute
        if self.how == "loop":
            while True:
                time.sleep(0.01)
        if self.how == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.how == "exit":
            os._exit(0)
        if self.how == "group":
            os.killpg(os.getpgid(0), signal.SIGKILL)
        if self.how == "memory":
            np.ones((1 << 33,), np.uint8)
        if self.how == "kind":
            return Texture(image, kind=object())  # type: ignore[arg-type]
        if self.how == "shape":
            return Texture(image[:-1])
        return Texture(image, Lattice((16, 0), (0, 16)), family="gray")

    def again(self, texture: Texture, shape: tuple[int, int], rng: np.random.Generator) -> Texture | None:
        """Draw another one."""
        return self.render(shape, rng)


@dataclass(frozen=True)
class Sheet:
    """A report that writes one file, or misbehaves as ``how`` says."""

    how: str = "fine"
    folder: ClassVar[str] = "sheets"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Misbehave."""
        if self.how == "exit":
            os._exit(0)
        if self.how == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.how == "mute":
            raise Mute
        if self.how == "interrupt":
            raise KeyboardInterrupt
        directory.mkdir(exist_ok=True)
        (directory / "sheet.txt").write_text(str(len(run.cells)))
        return [directory / "sheet.txt"]

    def render(self, run: Run) -> str:
        """Return the text, as a report for the terminal does; this makes no dataset of the class."""
        return str(len(run.cells))


class Mute(Exception):
    """An error whose message raises an error."""

    def __str__(self) -> str:
        raise RuntimeError


@dataclass(frozen=True)
class Meddler:
    """A metric that tries to alter all that it is given, and the state of numpy."""

    columns: ClassVar = {"written": Column("How many arrays it could write into.", "", (0, 9))}

    def score(self, observation: Observation) -> Score:
        """Write everywhere."""
        truth, written = observation.truth, 0
        arrays = [observation.sample, observation.output, observation.source, *observation.extras.values()]
        arrays += [truth.image, truth.ideal, *truth.elements.values()] if truth else []
        if observation.again is not None:
            fresh = observation.again(observation.sample.shape[:2], 0)
            arrays += [fresh.image] if fresh else []
        for array in arrays:
            if array is not None and array.flags.writeable:
                array[...] = 0
                written += 1
        np.seterr(all="raise")
        np.random.seed(0)  # noqa: NPY002
        return Score({"written": float(written)})


@dataclass(frozen=True)
class Odd:
    """Return something that is of no declared type, as ``how`` says."""

    how: str = "seconds"
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Return it."""
        good = np.full((*task.shape, task.sample.shape[2]), 0.5, np.float32)
        odd = {
            "seconds": {"detection_seconds": float("nan")},
            "text": {"detection_seconds": "long"},
            "lattice": {"lattice": "32,0,0,32"},
            "pickle": {"extras": {"x": np.array([object()])}},
            "path": {"extras": {"../x": good}},
            "source": {"source": "nowhere"},
        }
        return Synthesis(good, **odd[self.how])  # type: ignore[arg-type]


@dataclass(frozen=True)
class Escaper:
    """Leave a process of its own session behind, and a forged message in every open file."""

    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Start it, write rubbish, and answer well."""
        child = os.fork()
        if child == 0:
            os.setsid()
            time.sleep(600)
            os._exit(0)
        print(f"child {child}", flush=True)
        for handle in range(3, 64):
            with contextlib.suppress(OSError):
                os.write(handle, b"[1]\n{\n")
        return Synthesis(np.full((*task.shape, task.sample.shape[2]), 0.25, np.float32))


@dataclass(frozen=True)
class Tenant:
    """The sample, repeated, with a note on what its process finds; it may leave things behind, as ``leaves`` says."""

    leaves: bool = False
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Look around, leave things, and repeat the sample."""
        import resource

        place, limit = Path(tempfile.gettempdir()), resource.getrlimit(resource.RLIMIT_DATA)[0]
        seen = {
            "pid": os.getpid(),
            "leads": os.getsid(0) == os.getpgid(0) == os.getpid(),
            "place": str(place),
            "folder": str(Path.cwd()),
            "found": sorted(str(path.relative_to(place)) for path in place.rglob("*")),
            "open": sorted(str(file.readlink()) for file in Path("/proc/self/fd").iterdir() if file.is_file()),
            "environment": dict(os.environ),
            "random": int(np.random.get_state()[1][0]),  # type: ignore[index]  # noqa: NPY002
            "limited": 0 < limit < 1 << 34,
        }
        if self.leaves:
            for folder in (place, Path.cwd()):
                (folder / "left").touch()
            Path.cwd().chmod(0o500)
        return dataclasses.replace(Fine().synthesize(task), note=json.dumps(seen))


@dataclass(frozen=True)
class Boaster:
    """Claim that the request is finished, and loop for ever."""

    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Write its process id, claim and loop."""
        print(f"child {os.getpid()}", flush=True)
        os.write(3, b'{"finished": true}\n')
        while True:
            time.sleep(0.01)


@dataclass(frozen=True)
class Spawner:
    """Start a process that would outlive the cell, and loop for ever."""

    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Fork a process that sleeps, and loop."""
        child = os.fork()
        if child == 0:
            time.sleep(600)
            os._exit(0)
        print(f"child {child}", flush=True)
        while True:
            time.sleep(0.01)


@dataclass(frozen=True)
class Hermit:
    """Start a process of another session, without an environment, whose parent has ended; and loop for ever."""

    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Write the id of the process, and loop."""
        program = "import os, time\nif os.fork():\n    os._exit(0)\nprint('child', os.getpid(), flush=True)\n"
        command = [sys.executable, "-c", program + "time.sleep(600)"]
        subprocess.Popen(command, start_new_session=True, env={}).wait()
        while True:
            time.sleep(0.01)


@dataclass(frozen=True)
class Sleeper:
    """Start a process and sleep until a file exists; then end the process and answer well."""

    until: str = "awake"
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Sleep, then repeat the sample."""
        with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
            print("asleep", flush=True)
            while not Path(self.until).exists():
                time.sleep(0.05)
            process.kill()
        return Fine().synthesize(task)


@dataclass(frozen=True)
class Deadly:
    """A metric that kills its process when the output is gray, and raises when it is NaN-free but tiny."""

    columns: ClassVar = {"value": Column("Never there.")}

    def score(self, observation: Observation) -> Score:
        """Die on a gray output; else answer."""
        if float(np.ptp(observation.output)) == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return Score({"value": 1.0})


@dataclass(frozen=True)
class Wordy:
    """A metric that answers with words when the output is gray."""

    columns: ClassVar = {"value": Column("Never there.")}

    def score(self, observation: Observation) -> Score:
        """Answer."""
        return Score({"value": "good" if float(np.ptp(observation.output)) == 0 else 1.0})  # type: ignore[dict-item]


@dataclass(frozen=True)
class Blind:
    """A detector that raises."""

    name: ClassVar[str] = "blind"

    def detect(self, image: Image) -> Detection:
        """Fail."""
        raise KeyError("gone")
