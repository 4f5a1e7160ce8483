"""A suite of many cells that cost next to nothing, for benchmarks of what a run adds to its methods and metrics."""

from pathlib import Path

PLUGIN = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.plugins.forms import Synthesis, Task


@dataclass(frozen=True)
class Trivial:
    """The sample's first pixels, repeated."""

    number: int = 0
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        """Repeat them."""
        return Synthesis(np.resize(np.roll(task.sample, self.number, axis=1), (*task.shape, task.sample.shape[2])))
'''
TEXTURES = 10
"""Textures of the suite; each one has a tenth of the cells."""
MOST_METHODS = 200
"""Largest number of methods of the suite; more cells are replicates. The tables compare each method with each other."""


def write_plugin(folder: Path) -> Path:
    """Write the file of the method ``trivial``; return its path."""
    path = folder / "trivial.py"
    path.write_text(PLUGIN)
    return path


def write_suite(folder: Path, count: int, parameter: str = "trivial:number") -> Path:
    """Write a suite of about ``count`` cells of 64 x 64 px, scored by their cost alone.

    Its methods differ in one parameter, whose values are whole numbers.
    """
    replicates = max(1, round(count / TEXTURES / MOST_METHODS))
    methods = ", ".join(f'"{parameter}={k}"' for k in range(max(1, count // TEXTURES // replicates)))
    rows = (f'{{ name = "wall{k}", dataset = "brick", parameters = {{ color = 0.{k} }} }}' for k in range(TEXTURES))
    head = 'name = "many"\nsample = "64x64"\nsize = "64x64"\nmetrics = ["cost"]\n'
    head += f"replicates = {replicates}\n"
    path = folder / "many.toml"
    path.write_text(f"{head}methods = [{methods}]\ntexture = [{', '.join(rows)}]\n")
    return path
