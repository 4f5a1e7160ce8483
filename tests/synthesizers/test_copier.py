import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.plugins.forms import Refused, Shape, Task, Texture
from nrbench.suites.cell import Recipe
from nrbench.synthesizers.copier import Copier

SAMPLE = np.full((20, 20, 3), 0.5, np.float32)


def test_the_output_is_the_first_recomposition() -> None:
    """The copier draws recomposition 0 at the task's shape and returns its pixels."""
    drawn = []

    def recompose(shape: Shape, k: int) -> Texture:
        drawn.append((shape, k))
        return Texture(np.full((*shape, 3), 0.25, np.float32))

    made = Copier().synthesize(Task(SAMPLE, (30, 40), None, np.random.default_rng(0), recompose=recompose))
    assert drawn == [((30, 40), 0)]
    assert made.image.shape == (30, 40, 3)
    assert (made.image == 0.25).all()


def test_without_a_model_it_refuses() -> None:
    """A texture without a model has no elements that could be copied one by one."""
    with pytest.raises(Refused, match="no model of this texture is known"):
        Copier().synthesize(Task(SAMPLE, (30, 40), None, np.random.default_rng(0)))


def test_it_is_a_reference_without_a_lattice() -> None:
    """The copier is marked, and the lattice axis does not apply to it."""
    assert Copier.reference
    assert not Copier.uses_lattice


def test_a_recipe_recomposes_where_its_dataset_can() -> None:
    """A recipe gives the same recomposition again for the same k, another for another; noise has none."""
    recipe = Recipe("brick", {"color": 0.3}, 1, "wall", 0, (96, 96))
    sample = recipe.render()
    draw = recipe.recompose(sample)
    assert draw is not None
    one, same, other = (draw((100, 100), k) for k in (0, 0, 1))
    assert one is not None and same is not None and other is not None
    np.testing.assert_array_equal(one.image, same.image)
    assert np.abs(one.image - other.image).mean() > 0.01
    direct = Brick(color=0.3).recompose(sample, (100, 100), np.random.default_rng(0))
    assert direct.image.shape == one.image.shape
    noise = Recipe("noise", {}, 1, "noise", 0, (96, 96))
    assert noise.recompose(noise.render()) is None
