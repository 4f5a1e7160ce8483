"""Textures with fresh draws, and outputs with known faults, for tests of the scores and of what methods make."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from edits import apply_edit

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Metric, Observation, Score, Shape, Task, Texture
from nrbench.streams import stream
from nrbench.synthesizers.planted import Planted

MODELS: dict[str, Model] = {
    "brick": Brick(color=0.2, noise=0.03, rotation=13.0),
    "weave": Weave(color=0.2, noise=0.03),
    "hexagon": Hexagon(color=0.3, noise=0.03, period=21.3),
}


@dataclass(frozen=True, eq=False)
class Case:
    """A texture, its sample and its fresh draws. References are cached by ``again``, which is one function a case."""

    model: Model
    texture: Texture
    streams: int | None = None
    draws: dict[tuple[Shape, int], Texture | None] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, model: Model, seed: int = 0, side: int = 128, streams: int | None = None) -> Case:
        """Return the case of a model, the seed and the side of its sample, and the seed of its fresh draws."""
        texture = model.render((side, side), np.random.default_rng(seed))
        return cls(model, replace(texture, image=quantize(texture.image)), streams)

    @property
    def lattice(self) -> Lattice:
        """The lattice of the texture."""
        assert self.texture.lattice is not None
        return self.texture.lattice

    def again(self, shape: Shape, k: int) -> Texture | None:
        """Return the k-th fresh draw, rounded to 8 bits; each is drawn once."""
        if (shape, k) not in self.draws:
            rng = stream("again", "tests", k) if self.streams is None else np.random.default_rng([self.streams, k])
            drawn = self.model.again(self.texture, shape, rng)
            self.draws[shape, k] = None if drawn is None else replace(drawn, image=quantize(drawn.image))
        return self.draws[shape, k]

    def fresh(self, side: int = 192, k: int = 0) -> Image:
        """Return the pixels of a fresh draw."""
        drawn = self.again((side, side), k)
        return drawn.image

    def edited(self, name: str, dose: float, k: int = 0, image: Image | None = None) -> Image:
        """Return a fresh draw, or another image, with one of the edits of the benchmarks."""
        picture = self.fresh(k=k) if image is None else image
        return apply_edit(name, dose, picture, self.lattice.canonical().matrix, np.random.default_rng(0))

    def task(self, side: int = 192, seed: int = 0) -> Task:
        """Return the task of a square output, with the lattice and the fresh draws."""
        return Task(self.texture.image, (side, side), self.lattice, np.random.default_rng(seed), again=self.again)

    def planted(self, kind: str, size: float, seed: int = 0, side: int = 192) -> tuple[Image, np.ndarray]:
        """Return a fresh draw with a defect, and its displacement field."""
        made = Planted(kind, size).synthesize(self.task(side, seed))
        return quantize(made.image), made.extras["displacement"]

    def observe(self, output: Image, model: bool = True) -> Observation:
        """Return the observation of an output, with or without the model."""
        truth = self.texture if model else Texture(self.texture.image, self.texture.lattice)
        again = self.again if model else None
        return Observation(self.texture.image, output, truth, again=again, rng=np.random.default_rng(0))


@cache
def case(name: str) -> Case:
    """Return the case of a model by its name."""
    return Case.of(MODELS[name], 5)


def scored(metric: type[Metric], observation: Observation) -> Score:
    """Return the score of a metric, and check that every None has its reason."""
    score = metric().score(observation)
    assert set(score.values) == set(metric.columns)
    assert all(score.reasons.get(column) for column, value in score.values.items() if value is None)
    return score


def copy_cells(task: Task) -> Image:
    """Fill each cell of the lattice with a random whole cell of the sample, without blending."""
    lattice, sample = task.lattice, task.sample
    y, x = np.indices(task.shape)
    uv = lattice.to_cell(np.stack([x, y], -1).astype(float))
    number = np.floor(uv).astype(int)
    last = np.array(sample.shape[1::-1]) - 1
    cells = np.unique(np.rint(lattice.to_cell(lattice.points(sample.shape[:2]))).astype(int), axis=0)
    corners = lattice.from_cell(cells[:, np.newaxis] + np.array([[0, 0], [0, 1], [1, 0], [1, 1]]))
    whole = cells[((corners >= 0) & (corners <= last)).all((1, 2))]
    low = number.reshape(-1, 2).min(0)
    choice = task.rng.integers(len(whole), size=number.reshape(-1, 2).max(0) - low + 1)
    source = whole[choice[number[..., 0] - low[0], number[..., 1] - low[1]]] + uv - number
    column, row = np.moveaxis(np.clip(np.rint(lattice.from_cell(source)).astype(int), 0, last), -1, 0)
    return sample[row, column]
