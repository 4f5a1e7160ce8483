"""A plugin of each kind that violates the clause of its form that ``how`` names."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from nrbench import (
    Column,
    Detection,
    Lattice,
    NoLatticeFound,
    Observation,
    Refused,
    Run,
    Score,
    Shape,
    Synthesis,
    Task,
    Texture,
)

CALLS: list[int] = []


@dataclass(frozen=True)
class BadMethod:
    """Repeat the sample.

    Parameters
    ----------
    how
        The violation.
    """

    how: str = ""

    def synthesize(self, task: Task) -> Synthesis:
        """Violate a clause."""
        (height, width), how = task.sample.shape[:2], self.how
        y, x = np.indices(task.shape)
        image = np.clip(task.sample[y % height, x % width] + np.float32(self.shift(task)), 0, 1)
        source = np.stack([(x + 5 * (how == "source map")) % width, y % height, 1 + 0 * x], -1).astype(np.float32)
        if how == "gray":
            image = image[..., [0, -1, -1]]
        if how == "own lattice" and task.lattice is None and image.std() < 0.2:  # not in noise
            return Synthesis(image, lattice="16,0,0,12")
        if how == "refusals" and min(height, width) < 16:
            raise IndexError("too small")
        if how == "progress":
            task.progress(0.5)
            task.progress(0.2)
        shown = image[1:] if how == "output" else image
        return Synthesis(shown, task.lattice, source if how in ("", "source map") else None)

    def shift(self, task: Task) -> float:
        """Return a brightness that depends on more than the task, or do what a method may not."""
        CALLS.append(1)
        match self.how:
            case "determinism":
                return (len(CALLS) % 7) / 100
            case "processes":
                return abs(hash("a word")) % 1000 / 10000
            case "randomness":
                return float(np.random.rand()) / 10  # noqa: NPY002
            case "read only":
                task.sample[0, 0] = 0
            case "crash":
                os._exit(7)
            case "hang":
                while task.sample.shape[2] == 1:
                    pass
            case "refused":
                raise Refused("")
        return 0.0


@dataclass(frozen=True)
class Nameless(BadMethod):
    """A method whose page leaves out its parameter."""


@dataclass(frozen=True)
class Miscited(BadMethod):
    """A method whose paper is no BibTeX entry.

    Parameters
    ----------
    how
        The violation.
    """

    paper: ClassVar[str] = "Doe, J.: A Method, 2024"


@dataclass(frozen=True)
class Forgetful(BadMethod):
    """A method whose parameter JSON cannot hold.

    Parameters
    ----------
    how, share
        The violation, and a number.
    """

    share: float = float("nan")


@dataclass(frozen=True)
class BadDetector:
    """Find the same lattice everywhere.

    Parameters
    ----------
    how
        The violation.
    """

    how: str = ""

    def detect(self, image: np.ndarray) -> Detection:
        """Violate a clause."""
        if self.how == "odd images" and min(image.shape[:2]) < 16:
            raise ZeroDivisionError("too small")
        if self.how != "no guess" and np.ptp(image) == 0:
            raise NoLatticeFound("one color")
        confidence = 2.0 if self.how == "detection" else 0.5
        return Detection(Lattice((16, 0), (0, 12)), confidence + 0 * image[0, 0, 1 if self.how == "gray" else 0])


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
        if self.how == "little known" and observation.again is None:
            raise AttributeError("no model")
        mean = float(observation.output[..., 2 if self.how == "gray" else 0].mean())
        return Score({"mean": 20 * mean if self.how == "score" else mean})


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
        y, x = np.indices(shape)
        height = 9.5 if self.how == "truth" else 12
        ideal = (0.5 + 0.2 * np.sin(2 * np.pi * x / 16) * np.cos(2 * np.pi * y / height))[..., np.newaxis]
        pixels = np.clip(ideal + rng.normal(0, 0.01, (*shape, 3)), 0, 1).astype(np.float32)
        flat, lattice = np.repeat(ideal, 3, 2).astype(np.float32), Lattice((16, 0), (0, 12))
        return Texture(pixels[1:] if self.how == "texture" else pixels, lattice, (lattice,), kind="0", ideal=flat)

    def again(self, texture: Texture, shape: Shape, rng: np.random.Generator) -> Texture | None:
        """Violate a clause."""
        if self.how == "read only":
            texture.image[0] = 0
        drawn = self.render(shape, rng)
        return Texture(drawn.image, Lattice((16, 0), (0, 13))) if self.how == "fresh draws" else drawn


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
        target = directory / "list.html"
        statuses = [str(record.status) for record in run.cells]
        if self.how == "no results" and "ok" not in statuses:
            raise ZeroDivisionError("no results")
        target.write_text(str(statuses), "utf-8")
        return [directory / "nothing.html"] if self.how == "files" else [target]

    def render(self, run: Run) -> str:
        """Return text."""
        return None if self.how == "terminal" else "text"
