"""Methods, metrics, a detector and a dataset that misbehave, each in its own way."""

import dataclasses
import errno
import mmap
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, Detection, Observation, Refused, Score, Synthesis, Task, Texture


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
class Reader(Fine):
    """The sample, brightened by the number in a file, if the number is also in a file of the working directory."""

    file: Path = Path("number.txt")

    def synthesize(self, task: Task) -> Synthesis:
        """Write a relative path, and read it and the file."""
        Path("copy.txt").write_text(self.file.read_text())
        brighter = np.maximum(task.sample, float(Path("copy.txt").read_text()))
        return Synthesis(brighter[: task.shape[0], : task.shape[1]])


def misbehave(how: str) -> None:
    """Do to the process what ``how`` says, after a line in its log; "fine" and what leaves no trace return."""
    print(f"planted {how}", flush=True)
    if how in DEEDS:
        DEEDS[how]()


def fail(error: BaseException) -> None:
    """Raise an error."""
    raise error


def fill() -> None:
    """Fill a file in memory that is not mapped."""
    file = os.memfd_create("fill")
    for size in range(4, 2000, 4):
        os.write(file, bytes(4 << 20))
        print(f"holds {size} MiB", flush=True)


def share() -> None:
    """Reserve 40 GiB that are not touched, and share 200 MiB with three forked processes."""
    kept.append(mmap.mmap(-1, 40 << 30, flags=mmap.MAP_PRIVATE | 0x4000))  # MAP_NORESERVE
    hoard = np.ones(200 << 20, np.uint8)
    for _ in range(3):
        if os.fork() == 0:
            time.sleep(0.4)
            os._exit(int(hoard[0]))
    time.sleep(0.5)


def loop(pause: float) -> None:
    """Ignore the signal to end, and loop for ever."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    while True:
        time.sleep(pause)


def hog() -> None:
    """Allocate memory for ever."""
    hoard = []
    while True:
        hoard.append(np.ones(1 << 22, np.uint8))
        print(f"planted hog: holds {4 * len(hoard)} MiB", flush=True)


def creep() -> None:
    """Fill memory that no limit of the system counts."""
    for size in range(1, 1000):
        shared = mmap.mmap(-1, 1 << 20)
        shared.write(b"x" * (1 << 20))
        kept.append(shared)
        print(f"holds {size} MiB", flush=True)
        time.sleep(0.004)


def litter() -> None:
    """Leave a process of another session behind."""
    child = subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True, stdout=subprocess.DEVNULL
    )
    print(f"child {child.pid}", flush=True)


def hide() -> None:
    """Leave a process of another session behind that has no environment, and whose parent has ended; and loop."""
    program = "import os, time\nif os.fork():\n    os._exit(0)\nprint('child', os.getpid(), flush=True)\n"
    subprocess.Popen([sys.executable, "-c", program + "time.sleep(600)"], start_new_session=True, env={}).wait()
    loop(0.01)


def flood() -> None:
    """Print much."""
    for _ in range(300):
        print("flood " * 10_000)


def change_settings() -> None:
    """Change settings of the process."""
    np.random.seed(0)  # noqa: NPY002
    random.seed(0)
    np.seterr(all="raise")
    np.set_printoptions(precision=1)
    os.environ["OMP_NUM_THREADS"] = "9"


def leave_folder() -> None:
    """Write into the working directory, and leave it."""
    Path("left by a plugin.txt").write_text("folder")
    os.chdir("/")


DEEDS: dict[str, Callable[[], object]] = {
    "raise": lambda: fail(RuntimeError("planted failure")),
    "refuse": lambda: fail(Refused("planted refusal")),
    "full": lambda: fail(OSError(errno.ENOSPC, "No space left on device")),
    "stubborn": lambda: loop(0.01),
    "busy": lambda: loop(0),
    "segfault": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "group": lambda: os.killpg(os.getpgid(0), signal.SIGKILL),
    "exit": lambda: os._exit(0),
    "leave": lambda: os._exit(3),
    "memory": lambda: np.ones((1 << 33,), np.uint8),
    "hog": hog,
    "creep": creep,
    "fill": fill,
    "share": share,
    "litter": litter,
    "hide": hide,
    "flood": flood,
    "seed": change_settings,
    "folder": leave_folder,
}
"""What is done to a process."""
kept: list[mmap.mmap] = []
MISJUDGED = "misjudged"
"""The extra of an output on which the metrics below misbehave. A run that names no metrics scores by all of them."""


@dataclass(frozen=True)
class Faulty(Fine):
    """A method that does to its process what ``how`` says, or returns something odd; else it repeats the sample."""

    how: str = "raise"

    def synthesize(self, task: Task) -> Synthesis:
        """Misbehave."""
        misbehave(self.how)
        good = super().synthesize(task)
        image = np.array(good.image)
        if self.how == "mutate":
            task.sample[...] = 0
        if self.how == "nan":
            image[0, 0] = np.nan
        if self.how == "shape":
            image = image[:-1]
        if self.how == "type":
            image = image.astype(object)
        if self.how == "nothing":
            return None
        if self.how == "lie":
            return Synthesis(1 - task.sample[1, 1] + 0 * image, source=np.ones((*task.shape, 3), np.float32))
        return Synthesis(image, extras={MISJUDGED: np.ones(1)})


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
            return None
        if self.how == "nan":
            return Detection(Lattice((float("nan"), 0), (0, 16)), 1.0)
        return Detection(Lattice((16, 0), (0, 16)), 1.0)


@dataclass(frozen=True)
class Follower(Fine):
    """The sample, repeated; it wants a lattice."""

    uses_lattice: ClassVar[bool] = True


def make_judge(how: str) -> type:
    """Return a metric that does to its process what ``how`` says for the outputs of ``faulty``, and then scores 1."""

    def score(self: Any, observation: Observation) -> Score:
        """Misbehave."""
        if MISJUDGED not in observation.extras:
            return Score({"value": 1.0})
        misbehave(how)
        if how == "mutate":
            observation.output[...] = 0
        if how == "nothing":
            return None
        odd: dict[str, Any] = {"nan": {"value": float("nan")}, "shape": {}, "words": {"value": "good"}}
        return Score(odd.get(how, {"value": 1.0}))

    content = {"name": f"judge-{how}", "columns": {"value": Column("Whether all is well.")}, "score": score}
    notes = {"name": ClassVar[str], "columns": ClassVar[dict[str, Column]]}
    cls = type(f"Judge{how}", (), {**content, "__annotations__": notes, "__module__": __name__, "__doc__": "A metric."})
    return dataclass(frozen=True)(cls)


JUDGES = (
    *("raise", "stubborn", "segfault", "exit", "hog", "litter", "flood", "seed", "folder", "mutate"),
    *("nothing", "nan", "shape", "words", "fine"),
)
globals().update({f"Judge{how}": make_judge(how) for how in JUDGES})


@dataclass(frozen=True)
class Place(Fine):
    """The sample, repeated, with a remark on the machine that did it."""

    def synthesize(self, task: Task) -> Synthesis:
        """Repeat the sample."""
        print("placed")
        return dataclasses.replace(super().synthesize(task), note=os.environ.get("NRBENCH_TEST_PLACE", ""))


@dataclass(frozen=True)
class Picture:
    """Draw a gray texture, or misbehave as ``how`` says."""

    how: str = "fine"

    def render(self, shape: tuple[int, int], rng: np.random.Generator) -> Texture:
        """Misbehave."""
        image = np.repeat(rng.random((*shape, 1), np.float32), 3, axis=2)
        misbehave(self.how)
        if self.how == "kind":
            return Texture(image, kind=object())
        if self.how == "shape":
            return Texture(image[:-1])
        return Texture(image, Lattice((16, 0), (0, 16)), family="gray")

    def again(self, texture: Texture, shape: tuple[int, int], rng: np.random.Generator) -> Texture | None:
        """Draw another one."""
        return self.render(shape, rng)


@dataclass(frozen=True)
class Sleeper(Fine):
    """Start a process and sleep until a file exists; then end the process and answer well."""

    until: str = "awake"

    def synthesize(self, task: Task) -> Synthesis:
        """Sleep, then repeat the sample."""
        with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
            print("asleep", flush=True)
            while not Path(self.until).exists():
                time.sleep(0.05)
            process.kill()
        return super().synthesize(task)


@dataclass(frozen=True)
class Learner(Fine):
    """The sample, brightened by what was learned of it; it takes a while to learn, and to synthesize."""

    seconds: float = 0.2
    marks: Path = Path("marks")

    def prepare(self, task: Task) -> None:
        """Write a number into the folder that lasts."""
        with self.marks.open("a") as marks:
            marks.write(f"{task.shape}\n")
        time.sleep(self.seconds)
        (task.cache / "number").write_text(str(task.rng.random()))

    def synthesize(self, task: Task) -> Synthesis:
        """Brighten the sample."""
        number = (task.cache / "number").read_text()
        time.sleep(self.seconds / 2)
        return dataclasses.replace(super().synthesize(task), note=number)


@dataclass(frozen=True)
class Blind:
    """A detector that raises."""

    name: ClassVar[str] = "blind"

    def detect(self, image: Image) -> Detection:
        """Fail."""
        raise KeyError("gone")
