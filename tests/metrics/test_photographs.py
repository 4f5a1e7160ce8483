"""Claims about the verdict without a model: samples with little regularity, and uneven samples."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import nrbench
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.verdict.reference import Reference, compare_mean_tiles, reference_from_sample
from nrbench.plugins.forms import Observation, Score, Texture

FAINT = Hexagon(period=21.3, joint=2.5, noise=0.3, color=0.6)
UNEVEN = Brick(width=21, height=13, joint=2, jitter=0.8, noise=0.02)
SIDE = 150


@cache
def sample_of(model: Model) -> Texture:
    """Return a sample of a model."""
    return model.render((128, 128), np.random.default_rng(0))


def fresh(model: Model, side: int = SIDE, seed: int = 1) -> Image:
    """Return a fresh draw."""
    drawn = model.again(sample_of(model), (side, side), np.random.default_rng(seed))
    assert drawn is not None
    return quantize(drawn.image)


def lattice_of(model: Model) -> Lattice:
    """Return the lattice of a model."""
    lattice = sample_of(model).lattice
    assert lattice is not None
    return lattice


def baseline(model: Model, method: str) -> Image:
    """Return the output of a baseline."""
    texture = sample_of(model)
    output = nrbench.synthesize(method, quantize(texture.image), (SIDE, SIDE), lattice=texture.lattice, seed=0)
    return quantize(output.image)


def score(model: Model, output: Image) -> Score:
    """Return the scores of an output that is compared with the sample alone."""
    image, lattice = quantize(sample_of(model).image), lattice_of(model)
    return Regularity().score(Observation(image, output, Texture(image, lattice, (lattice,))))


def test_fresh_draws_of_a_faint_texture_are_preserved() -> None:
    """At a regular share below 0.35 a fresh draw is preserved, and the resolution is at most 0.3 s."""
    result = score(FAINT, fresh(FAINT))
    assert 0.05 < result.records["regular_share"] < 0.35
    assert result.values["preserved"] is True
    assert result.records["resolution"] <= 0.3
    assert result.records["tile_fit"] > 0.7


@pytest.mark.parametrize("method", ["scatter", "random-phase"])
def test_gross_outputs_of_a_faint_texture_are_lost(method: str) -> None:
    """Content off the lattice and a different pattern are lost at a low regular share."""
    result = score(FAINT, baseline(FAINT, method))
    assert result.values["preserved"] is False
    assert result.records["tile_fit"] < 0.5


def test_a_phase_step_in_a_faint_texture_is_lost() -> None:
    """Half of an output that is displaced by 0.3 s is seen at a low regular share."""
    output, step = fresh(FAINT, 170), round(0.3 * lattice_of(FAINT).s)
    stepped = np.concatenate([output[:150, :75], output[step : 150 + step, 75:150]], 1)
    assert score(FAINT, stepped).values["preserved"] is False


def test_an_output_is_compared_with_an_uneven_sample() -> None:
    """Bricks that are displaced in the sample may be displaced in the output; scattered patches are lost."""
    image, lattice = quantize(sample_of(UNEVEN).image), lattice_of(UNEVEN)
    assert reference_from_sample(image, lattice).scatter > 0.05
    assert score(UNEVEN, fresh(UNEVEN)).values["preserved"] is not False
    assert score(UNEVEN, baseline(UNEVEN, "scatter")).values["preserved"] is False


def test_larger_windows_are_used_where_small_ones_lock_onto_wrong_places() -> None:
    """The width of the windows grows as the pattern gets fainter, if the output has room for them."""
    lattice = lattice_of(FAINT)

    def reference(noise: float, output: tuple[int, int]) -> Reference:
        shape = np.random.default_rng(3).standard_normal((128, 128, 3))
        image = quantize(np.clip(0.5 + 0.2 * (sample_of(FAINT).image - 0.5) + noise * shape, 0, 1).astype(np.float32))
        return reference_from_sample(image, lattice, output=output)

    assert reference(0.01, (300, 300)).periodic.window_tiles == 2
    assert reference(0.25, (300, 300)).periodic.window_tiles > 2
    assert reference(0.25, (90, 90)).periodic.window_tiles == 2


def test_the_fit_of_the_mean_tile_is_one_for_the_same_texture() -> None:
    """The fit of the mean tile is about 1 for a fresh draw, also of few tiles, and small for a different phase."""
    reference = reference_from_sample(quantize(sample_of(FAINT).image), lattice_of(FAINT))
    for side in (64, 150):
        image = reference.prepare_image(fresh(FAINT, side))
        assert compare_mean_tiles(image, reference.periodic, reference.regular_share) == pytest.approx(1, abs=0.25)
    scattered = reference.prepare_image(baseline(FAINT, "scatter"))
    assert compare_mean_tiles(scattered, reference.periodic, reference.regular_share) < 0.4
