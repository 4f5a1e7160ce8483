"""Claims about the references: oracle and copier return draws, a cartoon tints cells, lattice-only repeats."""

from typing import Any

import numpy as np
import pytest
from synthesis_cases import BOND, noise, synthesize, waves

from nrbench.datasets_procedural.brick import Brick
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused, Shape, Task, Texture
from nrbench.suites.cell import Recipe
from nrbench.synthesizers.cartoon import Cartoon
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
    assert Oracle.reference and Copier.reference and Cartoon.reference and LatticeOnly.reference
    assert not Oracle.uses_lattice and not Copier.uses_lattice
    assert LatticeOnly.uses_lattice and not LatticeOnly.needs_lattice


def test_a_recipe_recomposes_where_its_dataset_can() -> None:
    """A recipe gives the same recomposition again for the same k, another for another; noise has none."""
    recipe = Recipe("brick", {"color": 0.3}, 1, "wall", 0, (96, 96))
    sample = recipe.render()
    draw = recipe.recompose(sample)
    assert draw is not None
    one, same, other = (draw((100, 100), k) for k in (0, 0, 1))
    np.testing.assert_array_equal(one.image, same.image)
    assert np.abs(one.image - other.image).mean() > 0.01
    direct = Brick(color=0.3).recompose(sample, (100, 100), np.random.default_rng(0))
    assert direct.image.shape == one.image.shape
    noise = Recipe("noise", {}, 1, "noise", 0, (96, 96))
    assert noise.recompose(noise.render()) is None


def test_a_cartoon_has_the_mean_the_tints_and_the_noise_of_its_sample() -> None:
    """It varies as the sample does; its noise is nearly as smooth as the grain, or white."""
    wall = Brick(color=0.4, intensity=0.2, noise=0.06).render((192, 192), np.random.default_rng(3))
    assert wall.ideal is not None and wall.lattice is not None
    made = synthesize(Cartoon(), wall.image, (192, 192), wall.lattice)
    other = synthesize(Cartoon(), wall.image, (192, 192), wall.lattice, seed=2)
    assert made.lattice is wall.lattice and np.abs(made.image - other.image).mean() > 0.02
    departures = [image - wall.ideal for image in (wall.image, made.image)]
    assert np.abs(departures[0].mean((0, 1)) - departures[1].mean((0, 1))).max() < 0.03
    np.testing.assert_allclose(departures[1].std((0, 1)), departures[0].std((0, 1)), rtol=0.2)
    grains = [(part[:, 1:] - part[:, :-1]).mean(-1).std() for part in departures]
    assert grains[0] < grains[1] < 1.5 * grains[0]
    white = synthesize(Cartoon(grain="white"), wall.image, (192, 192), wall.lattice).image - wall.ideal
    assert (white[:, 1:] - white[:, :-1]).mean(-1).std() > 1.2 * grains[1]


def test_a_cartoon_of_a_regular_sample_is_the_sample() -> None:
    """Without tints and grain it continues the period; a sample without two whole cells is refused."""
    sample = waves((90, 120), BOND)
    made = synthesize(Cartoon(), sample, (90, 120), BOND)
    assert np.abs(made.image - sample).mean() < 0.02
    with pytest.raises(Refused, match="fewer than two cells"):
        synthesize(Cartoon(), sample[:14, :20], (90, 120), BOND)


@pytest.mark.parametrize("lattice", [Lattice((3.0, 0.0), (0.0, 2.0)), None])
def test_lattice_only_repeats_or_cuts_the_sample_and_hands_the_lattice_on(lattice: Lattice | None) -> None:
    """Pixel (x, y) is the sample's at (x mod width, y mod height), and the lattice that of the task or None."""
    sample = noise(6, 5)
    made = synthesize(LatticeOnly(), sample, (13, 4), lattice)
    np.testing.assert_array_equal(made.image, np.tile(sample, (3, 1, 1))[:13, :4])
    assert made.lattice is lattice
