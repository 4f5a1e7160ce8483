"""Claims about materials: mean 0, the stated regular share, the same lattice, stationary fields, copies of elements."""

from typing import Any

import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.materials import MATERIALS
from nrbench.datasets_procedural.weave import Weave
from nrbench.errors import BadInput

MODELS = (Brick, Weave, Hexagon)


def draws(model: Any, count: int, side: int = 96) -> tuple[Any, np.ndarray]:
    """Return a texture of a model, and fresh draws of it, ``(n, H, W, 3)``."""
    texture = model.render((side, side), np.random.default_rng(0))
    images = [model.again(texture, (side, side), np.random.default_rng(k + 1)).image for k in range(count)]
    return texture, np.stack(images).astype(np.float64)


@pytest.mark.parametrize("material", MATERIALS)
def test_the_ideal_image_and_the_regular_share_hold(material: str) -> None:
    """Over fresh draws the mean is the ideal image, and the regular share is the one stated."""
    for model in MODELS:
        texture, images = draws(model(color=0.2, noise=0.02, rotation=20.0, material=material), 40)
        departures = images - texture.ideal
        assert np.abs(departures.mean((0, 1, 2))).max() < 0.01
        variance = images.var(0, ddof=1).mean()
        regular = images.mean(0).var((0, 1)).mean() - variance / len(images)
        assert texture.regular_share == pytest.approx(regular / (regular + variance), abs=0.03)


@pytest.mark.parametrize("material", MATERIALS)
def test_a_material_changes_neither_lattice_nor_ideal(material: str) -> None:
    """Lattice and ideal image are those of the plain model of the same seed, the pixels are not."""
    plain, made = (Brick(material=name).render((64, 64), np.random.default_rng(5)) for name in ("plain", material))
    assert made.lattice == plain.lattice and np.array_equal(made.ideal, plain.ideal)
    assert np.abs(made.image - plain.image).mean() > 0.01 and made.regular_share < plain.regular_share


@pytest.mark.parametrize("material", MATERIALS)
def test_windows_of_a_draw_agree(material: str) -> None:
    """A larger picture of the same seed begins with the smaller one."""
    model = Hexagon(material=material)
    texture = model.render((40, 50), np.random.default_rng(2))
    large = model.again(texture, (60, 80), np.random.default_rng(7)).image
    small = model.again(texture, (40, 50), np.random.default_rng(7)).image
    np.testing.assert_allclose(large[:40, :50], small, atol=1e-5)


@pytest.mark.parametrize("material", MATERIALS)
def test_a_material_is_as_strong_everywhere(material: str) -> None:
    """What it adds varies over draws as much in each quarter of the picture."""
    model = Brick(color=0, intensity=0, noise=0, material=material)
    texture, images = draws(model, 60)
    spread = (images - texture.ideal).var(0).mean(-1)
    quarters = [spread[48 * j : 48 * j + 48, 48 * i : 48 * i + 48].mean() for j in range(2) for i in range(2)]
    assert max(quarters) < 1.25 * min(quarters)


@pytest.mark.parametrize("material", ["clay", "wood"])
def test_a_recomposition_copies_the_material(material: str) -> None:
    """Without tints, the elements of a recomposition look like the sample's: they depart as strongly from the ideal."""
    model = Hexagon(color=0, intensity=0, noise=0, material=material)
    texture = model.render((128, 128), np.random.default_rng(1))
    made = model.recompose(texture, (128, 128), np.random.default_rng(3))
    strengths = [(each.image - each.ideal).std() for each in (texture, made)]
    assert strengths[1] == pytest.approx(strengths[0], rel=0.2)


def test_an_unknown_material_is_named() -> None:
    """The error lists the materials."""
    with pytest.raises(BadInput, match="plain, clay, stone, wood, cloth"):
        Brick(material="gold")
