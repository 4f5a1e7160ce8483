"""Claims about the references: oracle and copier return draws of the model, lattice-only repeats the sample."""

from typing import Any

import numpy as np
import pytest
from synthesis_cases import noise, synthesize

from nrbench.datasets_procedural.brick import Brick
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Shape, Task, Texture
from nrbench.suites.cell import Recipe
from nrbench.synthesizers.copier import Copier
from nrbench.synthesizers.lattice_only import LatticeOnly
from nrbench.synthesizers.oracle import Oracle


def task(**draws: Any) -> Task:
    """Return a task whose model draws what the functions return."""
    return Task(noise(20, 20), (30, 40), None, np.random.default_rng(0), **draws)


@pytest.mark.parametrize(("method", "source"), [(Oracle(), "again"), (Copier(), "recompose")])
def test_the_output_is_draw_0_at_the_shape_of_the_task(method: Any, source: str) -> None:
    """The oracle returns the pixels of the first fresh draw, the copier those of the first recomposition."""
    drawn = []

    def draw(shape: Shape, k: int) -> Texture:
        drawn.append((shape, k))
        return Texture(np.full((*shape, 3), 0.25, np.float32))

    made = method.synthesize(task(**{source: draw}))
    assert drawn == [((30, 40), 0)] and made.image.shape == (30, 40, 3) and (made.image == 0.25).all()


def test_without_a_draw_it_refuses() -> None:
    """The refusal says whether there is no model, or no room in a photograph for a region of the output's size."""
    with pytest.raises(Refused, match="no fresh draws"):
        Oracle().synthesize(task())
    with pytest.raises(Refused, match="no room for a region of 40x30 px"):
        Oracle().synthesize(task(again=lambda shape, k: None))
    with pytest.raises(Refused, match="no model of this texture is known"):
        Copier().synthesize(task())


def test_references_are_marked() -> None:
    """They are never ranked; lattice-only takes a lattice but needs none, and none of them refuses for lack of one."""
    assert Oracle.reference and Copier.reference and LatticeOnly.reference
    assert not Oracle.uses_lattice and not Copier.uses_lattice
    assert LatticeOnly.uses_lattice and not LatticeOnly.needs_lattice


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


@pytest.mark.parametrize("lattice", [Lattice((3.0, 0.0), (0.0, 2.0)), None])
def test_lattice_only_repeats_or_cuts_the_sample_and_hands_the_lattice_on(lattice: Lattice | None) -> None:
    """Pixel (x, y) is the sample's at (x mod width, y mod height), and the lattice that of the task or None."""
    sample = noise(6, 5)
    made = synthesize(LatticeOnly(), sample, (13, 4), lattice)
    np.testing.assert_array_equal(made.image, np.tile(sample, (3, 1, 1))[:13, :4])
    assert made.lattice is lattice
