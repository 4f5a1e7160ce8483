"""Self-similarity, from regular to stochastic textures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import spearmanr

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.noise import Noise
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.self_similarity import REACH, SelfSimilarity, regularity
from nrbench.plugins.forms import Metric, Observation
from nrbench.suites.suite import load_suite

FULL = {"color": 0.6, "intensity": 0.3, "noise": 0.08, "jitter": 0.8, "bend": 1.0}


def picture(model: Model | Noise, side: int = 128, seed: int = 0) -> Image:
    """Return a draw."""
    return quantize(model.render((side, side), np.random.default_rng(seed)).image)


def regular(image: Image) -> float:
    """Return the score of one image."""
    return regularity(image, int(REACH * min(image.shape[:2]))).score


@pytest.mark.parametrize("model", [Hexagon, Weave, Brick])
def test_perfect_regularity_is_near_one(model: type[Model]) -> None:
    """A texture without any departure scores above 0.9."""
    assert regular(picture(model(color=0, intensity=0, noise=0))) > 0.9


@pytest.mark.parametrize("spectrum", ["white", "pink", "brown", "blobs"])
def test_noise_is_near_zero(spectrum: str) -> None:
    """Noise of any spectrum, even blots of one size, scores below 0.1."""
    scores = [regular(picture(Noise(spectrum=spectrum, scale=13), seed=seed)) for seed in range(3)]
    assert max(scores) < 0.1


@pytest.mark.parametrize("side", [128, 192])
def test_the_spectrum_is_in_order(side: int) -> None:
    """The score falls from regular to stochastic textures, also on single images."""
    knob = [0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8]
    models = [Hexagon(period=26.2, joint=2.4, **{name: k * full for name, full in FULL.items()}) for k in knob]
    scores = np.array([[regular(picture(model, side, seed)) for model in models] for seed in range(3)])
    assert spearmanr(knob, scores.mean(0))[0] == pytest.approx(-1)
    assert min(-spearmanr(knob, row)[0] for row in scores) >= 0.95


@settings(max_examples=15)
@given(st.floats(-90, 90), st.floats(14, 32))
def test_rotation_and_period_do_not_count(rotation: float, period: float) -> None:
    """Hexagons of any period and rotation score alike, if two periods are in reach."""
    model = Hexagon(period=period, joint=period / 10, rotation=rotation, color=0.2, noise=0.02)
    assert 0.68 < regular(picture(model)) < 0.92


@settings(max_examples=15)
@given(st.floats(0.2, 0.6), st.floats(0, 0.4))
def test_brightness_and_contrast_do_not_count(contrast: float, brightness: float) -> None:
    """An affine change of all values leaves the score."""
    image = picture(Hexagon(color=0.2, noise=0.02))
    assert regular(np.asarray(contrast * image + brightness, np.float32)) == pytest.approx(regular(image), abs=1e-3)


def test_the_period_is_found() -> None:
    """Length and direction of the step that repeats are those of a lattice vector."""
    found = regularity(picture(Hexagon(period=22.3, rotation=20.0, color=0.1)), 76)
    assert found.period / 22.3 == pytest.approx(1, abs=0.03) or found.period / 22.3 == pytest.approx(3**0.5, abs=0.03)
    assert min(abs((found.direction - 20) % 30), 30 - abs((found.direction - 20) % 30)) < 2


def test_sample_and_output_are_compared() -> None:
    """The difference of the scores is reported; a noisy output is less regular than its sample."""
    sample, output = picture(Hexagon(color=0.1)), picture(Noise(), 200)
    values = SelfSimilarity().score(Observation(sample, output)).values
    assert isinstance(SelfSimilarity(), Metric) and set(values) == set(SelfSimilarity.columns)
    assert values["difference"] == values["score"] - values["sample_score"] < -0.5


@pytest.mark.parametrize(("output", "why"), [(np.full((64, 64, 3), 0.5), "flat"), (np.zeros((12, 64, 3)), "lags of")])
def test_missing_scores_have_reasons(output: Image, why: str) -> None:
    """A flat image and one of few pixels have no score, with a reason."""
    score = SelfSimilarity().score(Observation(picture(Weave()), output.astype(np.float32)))
    assert score.values["score"] is None and why in score.reasons["score"]
    assert score.values["difference"] is None and score.reasons["difference"]


def test_the_suite_has_the_tested_models() -> None:
    """The suite named spectrum has the models of these tests."""
    rows = {row.name: row for row in load_suite("spectrum").texture}
    for knob in (5, 20, 80):
        parameters = rows[f"knob-{knob:03}"].parameters
        assert all(parameters[name] == pytest.approx(knob / 100 * full, rel=0.01) for name, full in FULL.items())
