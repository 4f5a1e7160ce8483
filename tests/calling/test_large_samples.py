"""The part of a large sample that a method gets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from nrbench.calling.method_calls import synthesize_from_part
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Synthesis, Task

SAMPLE = np.random.default_rng(0).random((1100, 1500, 1), np.float32)


@dataclass
class Copying:
    """Copies the first pixels of the sample that it gets, and keeps the task."""

    finder: str = "consensus"
    seen: list[Task] = field(default_factory=list)

    def synthesize(self, task: Task) -> Synthesis:
        """Return the upper left corner of the sample, with its source map."""
        self.seen.append(task)
        height, width = task.shape
        y, x = np.indices(task.shape, np.float32)
        return Synthesis(task.sample[:height, :width], task.lattice, np.stack([x, y, np.ones_like(x)], -1))


def run(method: Copying, lattice: Lattice, sample: np.ndarray = SAMPLE) -> Synthesis:
    """Return the synthesis of 40 x 50 px."""
    task = Task(sample, (40, 50), lattice, np.random.default_rng(0))
    return synthesize_from_part(lambda plugin, given: plugin.synthesize(given), method, task)


def test_a_large_sample_is_cropped_to_its_middle() -> None:
    """The method gets 1024 px a side; lattice and source map of the result are those of the whole sample."""
    lattice, method = Lattice((30, 0), (0, 20), (400, 300)), Copying()
    made = run(method, lattice)
    assert method.seen[0].sample.shape == (1024, 1024, 1)
    assert made.lattice == lattice and made.source is not None
    x, y = made.source[..., :2].astype(int).transpose(2, 0, 1)
    np.testing.assert_array_equal(SAMPLE[y, x], made.image)
    assert made.note == "from the middle 1024x1024 px of the sample"


@pytest.mark.parametrize(
    ("method", "lattice", "sample", "shape"),
    [
        (Copying(), Lattice((80, 0), (0, 20)), SAMPLE, (1100, 1280)),
        (Copying(), Lattice((100, 0), (0, 20)), SAMPLE, (1100, 1500)),
        (Copying(), Lattice((30, 0), (0, 20)), SAMPLE[:1024, :1024], (1024, 1024)),
        (Copying(finder=""), Lattice((30, 0), (0, 20)), SAMPLE, (1100, 1500)),
    ],
    ids=["long period", "longer period", "small sample", "method without a detector"],
)
def test_what_is_needed_stays(method: Copying, lattice: Lattice, sample: np.ndarray, shape: tuple[int, int]) -> None:
    """Sixteen periods stay, samples up to 1024 px stay whole, and so do those of methods that find no lattice."""
    run(method, lattice, sample)
    assert method.seen[0].sample.shape[:2] == shape
