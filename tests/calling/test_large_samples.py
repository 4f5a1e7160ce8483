"""The part of a large sample that a method gets."""

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


def run(method: Copying, lattice: Lattice, sample: np.ndarray = SAMPLE, known: np.ndarray | None = None) -> Synthesis:
    """Return the synthesis of 40 x 50 px."""
    task = Task(sample, (40, 50), lattice, np.random.default_rng(0), known=known)
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


def test_of_a_large_sample_the_best_known_part_is_used() -> None:
    """Where a mask leaves out the middle, the method gets the window that holds most of what counts."""
    known, method = np.zeros((1500, 1500), bool), Copying()
    known[:, 1300:] = known[1300:] = known[:200] = True
    made = run(method, Lattice((30, 0), (0, 20)), np.resize(SAMPLE, (1500, 1500, 1)), known)
    seen = method.seen[0].known
    assert seen is not None and seen.shape == (1024, 1024) and seen.sum() == 1024 * 200 + 200 * 824
    assert made.lattice is not None and made.lattice.is_equivalent(Lattice((30, 0), (0, 20)), 0.01)
    assert made.note == "from the best known 1024x1024 px of the sample"


def test_what_lies_beyond_all_known_pixels_is_cropped() -> None:
    """A method gets the box of the pixels that count, at its place of the lattice."""
    known, method = np.zeros((1100, 1500), bool), Copying()
    known[300:400, 700:900] = True
    made = run(method, Lattice((30, 0), (0, 20)), known=known)
    assert method.seen[0].sample.shape == (100, 200, 1) and made.source is not None
    x, y = made.source[..., :2].astype(int).transpose(2, 0, 1)
    np.testing.assert_array_equal(SAMPLE[y, x], made.image)
    assert (x.min(), y.min()) == (700, 300)
