"""Claims about the brick wall."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.errors import BadInput


def test_known_places() -> None:
    """A brick's middle is clay, and the joints half a brick and half a row away are mortar."""
    wall = Brick(width=30, height=12, joint=2, phase=(0, 0), color=0, intensity=0, noise=0)
    image = wall.render((24, 60), np.random.default_rng(0)).image
    assert image[0, 0, 0] == pytest.approx(0.55, abs=0.01) and image[0, 0, 2] == pytest.approx(0.32, abs=0.01)
    for y, x in ((0, 15), (6, 0), (6, 22), (12, 0)):
        np.testing.assert_allclose(image[y, x], (0.75, 0.72, 0.67), atol=1e-6)


def test_each_brick_has_one_factor() -> None:
    """Inside a brick the picture is the ideal one times the brick's factor, and the mortar never varies."""
    wall = Brick(width=30, height=12, joint=2, phase=(0, 0), color=0.4, intensity=0, noise=0)
    texture = wall.render((12, 90), np.random.default_rng(0))
    assert texture.ideal is not None
    ratio = texture.image / texture.ideal
    index, factor = (texture.elements[f"brick.{part}"] for part in ("index", "factor"))
    for brick, column in (((0, 0), slice(0, 13)), ((1, 0), slice(18, 43)), ((2, 0), slice(48, 73))):
        expected = factor[(index == brick).all(1)]
        np.testing.assert_allclose(
            ratio[0:4, column].reshape(-1, 3), np.broadcast_to(expected, (4 * ratio[0, column].shape[0], 3)), rtol=1e-5
        )
    np.testing.assert_allclose(ratio[6], 1, atol=1e-6)


@pytest.mark.parametrize("parameters", [{"joint": 0.5}, {"width": 3.0}, {"height": float("nan")}, {"width": 1e6}])
def test_bad_sizes(parameters: dict[str, Any]) -> None:
    """A joint under one px, and a brick that the joints swallow, are refused with the least size."""
    with pytest.raises(BadInput, match="give at least"):
        Brick(**parameters)
