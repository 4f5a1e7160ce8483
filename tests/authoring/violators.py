"""Plugins that violate one clause of their form each, as ``how`` says."""

from __future__ import annotations

import os
import random
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import (
    Column,
    Detection,
    NoLatticeFound,
    Observation,
    Refused,
    Score,
    Shape,
    Synthesis,
    Task,
    Texture,
)
from nrbench.runs.records import Run

CALLS: list[int] = []
SMALL_CHANGES: dict[str, Callable[[], float]] = {
    "determinism": lambda: float(np.random.default_rng().random()) / 10,
    "state": lambda: CALLS.append(1) or (len(CALLS) % 7) / 100,
    "processes": lambda: abs(hash("a word")) % 1000 / 10000,
    "randomness": lambda: float(np.random.rand()) / 10,  # noqa: NPY002
    "python": lambda: random.random() / 10,
}
"""What depends on more than the input."""


def misbehave(how: str, array: Any) -> float:
    """Violate one of the clauses that all kinds share; return a small number that depends on the violation."""
    if how in SMALL_CHANGES:
        return SMALL_CHANGES[how]()
    if how == "seeds":
        np.random.seed(7)  # noqa: NPY002
    if how == "files":
        Path("litter.txt").write_text(tempfile.gettempdir() + str(len(list(Path.cwd().iterdir()))))
        os.utime("litter.txt", ns=(len(CALLS), CALLS.append(1) or len(CALLS)))
    if how == "environment":
        os.environ["LITTER"] = str(len(CALLS))
        CALLS.append(1)
    if how == "threads":
        threading.Thread(target=threading.Event().wait, args=(3,), daemon=True).start()
    if how == "read-only":
        array[0, 0] = 0
    if how == "crash":
        os._exit(7)
    return 0.0


def tile(sample: Image, shape: Shape) -> Image:
    """Repeat an image."""
    rows, columns = np.arange(shape[0]) % sample.shape[0], np.arange(shape[1]) % sample.shape[1]
    return np.asarray(sample[rows][:, columns])


@dataclass(frozen=True)
class BadMethod:
    """Repeat the sample.

    Parameters
    ----------
    how
        The violation.
    """

    how: str = ""
    uses_lattice: ClassVar[bool] = True

    def synthesize(self, task: Task) -> Synthesis:
        """Violate a clause."""
        shift = misbehave(self.how, task.sample)
        image = np.clip(tile(task.sample, task.shape) + np.float32(shift), 0, 1)
        y, x = np.mgrid[: task.shape[0], : task.shape[1]].astype(np.float32)
        height, width = task.sample.shape[:2]
        source = np.stack([x % width, y % height, np.ones_like(x)], -1) if not shift else None
        if self.how == "range":
            image = image + 2
        if self.how == "shape":
            image = image[1:]
        if self.how == "gray" and task.sample.shape[2] == 1:
            image = np.repeat(image, 3, 2)
        if self.how == "lie" and source is not None:
            source[..., 0] = (source[..., 0] + 5) % width
        if self.how == "lattice" and task.lattice is None and image.std() < 0.2:  # not in noise
            return Synthesis(image, lattice="16,0,0,12")  # type: ignore[arg-type]
        if self.how == "refusals" and min(task.sample.shape[:2]) < 16:
            raise IndexError("too small")
        if self.how == "mute" and min(task.sample.shape[:2]) < 16:
            raise Refused("")
        if self.how == "progress":
            task.progress(50.0)
        if self.how == "backward":
            task.progress(0.5)
            task.progress(0.2)
        if self.how == "slow" and task.sample.shape[2] == 1:
            while True:
                pass
        return Synthesis(image, task.lattice, source)


@dataclass(frozen=True)
class Tiler:
    """A method that repeats the sample."""

    def synthesize(self, task: Task) -> Synthesis:
        """Repeat the sample."""
        return Synthesis(tile(task.sample, task.shape))


@dataclass(frozen=True)
class Nameless(Tiler):
    """A method whose page leaves out its parameter."""

    how: str = ""


@dataclass(frozen=True)
class Miscited(Tiler):
    """A method whose paper is no BibTeX entry."""

    paper: ClassVar[str] = "Doe, J.: A Method, 2024"


@dataclass(frozen=True)
class Forgetful(Tiler):
    """A method whose parameter cannot be given as text: ``none`` is read as None.

    Parameters
    ----------
    names
        Names.
    """

    names: str | None = "none"


@dataclass(frozen=True)
class BadDetector:
    """Find the same lattice everywhere.

    Parameters
    ----------
    how
        The violation.
    """

    how: str = ""

    def detect(self, image: Image) -> Detection:
        """Violate a clause."""
        constant = np.ptp(image) == 0
        confidence = 0.5
        if self.how == "gray":
            confidence += float(image[0, 0, 1] * 0)
        if self.how == "odd images" and min(image.shape[:2]) < 16:
            raise ZeroDivisionError("too small")
        if self.how != "no guess" and constant:
            raise NoLatticeFound("one color")
        if self.how == "text":
            return Detection("16,0,0,12", confidence)  # type: ignore[arg-type]
        return Detection(Lattice((16, 0), (0, 12)), 2.0 if self.how == "confidence" else confidence)


@dataclass(frozen=True)
class BadMetric:
    """The mean of the output.

    Parameters
    ----------
    how
        The violation.
    """

    how: str = ""
    columns: ClassVar = {"mean": Column("Mean.")}

    def score(self, observation: Observation) -> Score:
        """Violate a clause."""
        mean = float(observation.output.mean())
        if self.how == "float":
            return mean  # type: ignore[return-value]
        if self.how == "little known" and observation.again is None:
            raise AttributeError("no model")
        if self.how == "gray":
            mean += float(observation.output[0, 0, 2] * 0)
        if self.how == "reason":
            return Score({"mean": None})
        if self.how == "json":
            return Score({"mean": mean}, records={"x": {1, 2}})
        return Score({"mean": 20 * mean if self.how == "range" else mean})


@dataclass(frozen=True)
class BadDataset:
    """Stripes.

    Parameters
    ----------
    how
        The violation.
    """

    how: str = ""

    def render(self, shape: Shape, rng: np.random.Generator) -> Texture:
        """Violate a clause."""
        if self.how == "shapes" and min(shape) < 16:
            raise ValueError("too small")
        y, x = np.mgrid[: shape[0], : shape[1]]
        height = 12 if self.how != "truth" else 9.5
        ideal = 0.5 + 0.2 * np.sin(2 * np.pi * x / 16) * np.cos(2 * np.pi * y / height)
        image = ideal[..., np.newaxis] + rng.normal(0, 0.01, (*shape, 3))
        lattice = Lattice((16, 0), (0, 12))
        pixels = np.asarray(np.clip(image, 0, 1), np.float32)
        flat = np.asarray(np.repeat(ideal[..., np.newaxis], 3, 2), np.float32)
        return Texture(pixels[1:] if self.how == "shape" else pixels, lattice, (lattice,), kind="0", ideal=flat)

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture | None:
        """Violate a clause."""
        if self.how == "read-only":
            texture.image[0] = 0
        drawn = self.render(shape, rng)
        if self.how == "fresh draws":
            return Texture(drawn.image, Lattice((16, 0), (0, 13)))
        return Texture(drawn.image[1:], drawn.lattice) if self.how == "size" else drawn

    def __getattr__(self, name: str) -> Callable[..., Texture]:
        """Have a method ``recompose`` in one case only."""
        if name == "recompose" and self.how == "recomposition":
            return lambda texture, shape, rng: self.render((8, 8), rng)
        raise AttributeError(name)


@dataclass(frozen=True)
class BadReport:
    """A list of the cells.

    Parameters
    ----------
    how
        The violation.
    width
        Characters.
    """

    how: str = ""
    width: int = 80
    terminal: ClassVar[bool] = True

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Violate a clause."""
        target = (run.root if self.how == "inside" else directory) / "list.html"
        statuses = [str(record.status) for record in run.cells]
        if self.how == "no results" and "ok" not in statuses:
            raise ZeroDivisionError("no results")
        names = " ".join(record.texture for record in run.cells)
        target.write_text(names if self.how == "markup" else str(statuses), "utf-8")
        if self.how == "missing":
            return [directory / "nothing.html"]
        return [] if self.how == "none" else [target]

    def render(self, run: Run) -> str:
        """Return text."""
        return None if self.how == "terminal" else "text"  # type: ignore[return-value]
