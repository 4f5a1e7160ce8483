import numpy as np
import pytest

from nrbench.plugins.forms import Refused, Shape, Task, Texture
from nrbench.synthesizers.oracle import Oracle

SAMPLE = np.full((20, 20, 3), 0.5, np.float32)


def test_the_answer_is_the_first_fresh_draw_at_the_outputs_size() -> None:
    """The oracle returns the pixels of draw 0 at the task's shape."""
    calls = []

    def again(shape: Shape, k: int) -> Texture:
        calls.append((shape, k))
        return Texture(np.full((*shape, 3), 0.25, np.float32))

    made = Oracle().synthesize(Task(SAMPLE, (30, 40), None, np.random.default_rng(0), again=again))
    assert calls == [((30, 40), 0)]
    assert made.image.shape == (30, 40, 3)
    assert (made.image == 0.25).all()


def test_without_a_model_it_refuses() -> None:
    """A texture of which nothing more is known has no oracle."""
    with pytest.raises(Refused, match="no fresh draws"):
        Oracle().synthesize(Task(SAMPLE, (30, 40), None, np.random.default_rng(0)))


def test_without_room_it_refuses() -> None:
    """A photograph without a free region of the output's size is refused; the message names the size."""
    task = Task(SAMPLE, (30, 40), None, np.random.default_rng(0), again=lambda shape, k: None)
    with pytest.raises(Refused, match="no room for a region of 40x30 px"):
        Oracle().synthesize(task)


def test_it_is_a_reference_without_a_lattice() -> None:
    """The oracle is marked, and the lattice axis does not apply to it."""
    assert Oracle.reference
    assert not Oracle.uses_lattice
