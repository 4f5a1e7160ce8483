"""Claims about many draws: their mean is the ideal image, next to nothing is clipped, the regular share is right."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.modelling.pattern import Frame
from nrbench.datasets_procedural.modelling.recomposition import Draw

from .conftest import MODELS, NONE, render, truth


def _deviations(model: type[Model], **strengths: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return how far the mean of 300 draws is off the ideal, in standard errors, and which values were clipped."""
    made = model(**{**NONE, "rotation": 11.0, "noise": 0.02, **strengths})
    first = render(made, side=32)
    seeds = np.random.default_rng(1).integers(2**63, size=300)
    pattern = made.colored_pattern(*Frame(truth(first)[0].origin, made.rotation).grid((32, 32)))
    draws = np.stack([np.clip(made.departures.paint(pattern, int(seed), Draw(int(seed)))[0], 0, 1) for seed in seeds])
    np.testing.assert_array_equal(draws[0], made.again(first, (32, 32), np.random.default_rng(1)).image)
    error = draws.std(0, ddof=1, dtype=np.float64) / math.sqrt(300)
    return (draws.mean(0, dtype=np.float64) - truth(first)[1]) / error, (draws <= 0) | (draws >= 1)


@pytest.mark.parametrize("departure", ["color", "intensity"])
@pytest.mark.parametrize("model", MODELS)
def test_mean_is_the_ideal(model: type[Model], departure: str) -> None:
    """At a strength of 0.6, under noise, the mean of 300 draws is the ideal image within four standard errors.

    By chance 0.008 % of the values are farther off (Student, 299 degrees of freedom): 0.05 % of 32 x 32 px are one.
    """
    z, _ = _deviations(model, **{departure: 0.6})
    assert (np.abs(z) > 4).mean() <= 0.0005


@pytest.mark.parametrize("model", MODELS)
def test_mean_of_noise_is_the_ideal(model: type[Model]) -> None:
    """In-tile noise too weak to be clipped leaves the mean of 300 draws alone, and its errors are normal."""
    z, clipped = _deviations(model)
    assert not clipped.any() and (np.abs(z) > 4).mean() <= 0.0005
    assert abs(z.mean()) < 0.3 and 0.85 < z.std() < 1.15


@pytest.mark.parametrize("departure", ["color", "intensity"])
@pytest.mark.parametrize("model", MODELS)
def test_clipping_is_rare(model: type[Model], departure: str) -> None:
    """At a strength of 0.6, under noise, less than 0.1 % of the pixels are clipped in any channel."""
    made = model(**{**NONE, "noise": 0.04, departure: 0.6})
    images = np.stack([render(made, seed, 64).image for seed in range(30)])
    assert ((images <= 0) | (images >= 1)).any(-1).mean() < 0.001


@pytest.mark.parametrize("model", MODELS)
def test_regular_share(model: type[Model]) -> None:
    """The share given is the one measured over draws and phases, whatever the rotation."""
    made = model(color=0.3, intensity=0.2, noise=0.06, rotation=20.0)
    textures = [render(made, seed, 200) for seed in range(8)]
    regular = np.mean([truth(texture)[1].var((0, 1)).mean() for texture in textures])
    departures = np.mean([((texture.image - truth(texture)[1]) ** 2).mean() for texture in textures])
    assert textures[0].regular_share == pytest.approx(regular / (regular + departures), abs=0.03)
    assert {texture.regular_share for texture in textures} == {made.regular_share}
    assert model(**NONE).regular_share == 1.0
