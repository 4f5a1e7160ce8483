"""Claims about the hexagonal tiles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.errors import BadInput


def test_lattice_is_hexagonal() -> None:
    """The two vectors are equally long, 60 degrees apart."""
    lattice = Hexagon(period=20.5, rotation=8.0).render((32, 32), np.random.default_rng(0)).lattice
    assert lattice is not None
    assert lattice.area == pytest.approx(20.5**2 * math.sqrt(3) / 2)
    assert lattice.s == pytest.approx(20.5)


def test_sixfold() -> None:
    """A turn by 60 degrees changes nothing."""
    images = [
        Hexagon(phase=(0, 0), rotation=angle, color=0, intensity=0, noise=0)
        .render((64, 64), np.random.default_rng(0))
        .image
        for angle in (10.0, 70.0)
    ]
    np.testing.assert_allclose(images[0], images[1], atol=1e-5)


def test_each_tile_has_one_factor() -> None:
    """Away from the grout the picture is the ideal one times one factor a tile, another for each neighbor."""
    tiles = Hexagon(period=20, joint=2, phase=(0, 0), color=0.4, intensity=0, noise=0)
    texture = tiles.render((20, 70), np.random.default_rng(0))
    assert texture.ideal is not None
    ratio = texture.image / texture.ideal
    inside = [ratio[0:5, 0:8], ratio[0:5, 13:28], ratio[0:5, 33:48], ratio[14:20, 4:17]]
    for tile in inside:
        assert np.ptp(tile.reshape(-1, 3), axis=0).max() < 1e-5
    assert len({tuple(tile[0, 2].round(4)) for tile in inside}) == 4


@pytest.mark.parametrize("parameters", [{"joint": 0.9}, {"period": 4.0}, {"period": float("inf")}])
def test_bad_sizes(parameters: dict[str, Any]) -> None:
    """Grout under one px, and a tile that it swallows, are refused with the least size."""
    with pytest.raises(BadInput, match="give at least"):
        Hexagon(**parameters)
