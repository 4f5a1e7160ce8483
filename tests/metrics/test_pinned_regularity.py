"""The verdict of `regularity` is the one from which the figures of docs/validation.md come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Shape, Task, Texture
from nrbench.synthesizers.planted import Planted

PINS: dict[tuple[type[Model], int, float], tuple[float, list[float]]] = {
    (Brick, 0, 0.0): (1.0, [0.0, 0.0, 0.04787, -0.00048937, 0.0, 0.38107, 0.25189]),
    (Brick, 0, 0.2): (0.0, [5.1389, 0.48168, 5.6036, 0.0015074, 5.1657, 2.7835, 3.2402]),
    (Brick, 1, 0.0): (1.0, [0.0, 0.0, 0.043976, -0.0074658, 0.0, 0.20222, 0.17447]),
    (Brick, 1, 0.2): (0.0, [4.4444, 0.47985, 5.578, -0.0099001, 4.8895, 2.6741, 3.3731]),
    (Weave, 0, 0.0): (1.0, [0.0, 0.0080195, 0.16438, 0.028724, 0.0, 0.33075, 0.0]),
    (Weave, 0, 0.2): (0.16022, [5.0, 0.60595, 5.4132, 0.070579, 4.8066, 3.525, 1.9945]),
    (Weave, 1, 0.0): (1.0, [0.0, 0.0, 0.19011, -0.0017148, 0.0, 0.18101, 0.0]),
    (Weave, 1, 0.2): (0.44253, [5.0, 0.60694, 5.4427, -0.041058, 5.0, 3.1313, 1.868]),
    (Hexagon, 0, 0.0): (1.0, [0.0, 0.0, 0.018576, 0.01211, 0.0, 0.1578, 0.21716]),
    (Hexagon, 0, 0.2): (0.1044, [4.8571, 0.60607, 5.4361, 0.0078612, 5.0, 1.861, 2.3083]),
    (Hexagon, 1, 0.0): (1.0, [0.0, 0.0, 0.021696, -0.020275, 0.0, 0.14559, 0.060691]),
    (Hexagon, 1, 0.2): (0.03743, [4.5714, 0.60558, 5.4307, -0.01323, 5.1337, 2.1861, 2.1096]),
}
"""Score and excesses by model, seed, and planted phase step in s; 0: a fresh draw."""


@pytest.mark.parametrize(("kind", "seed", "step"), PINS)
def test_excesses_are_pinned(kind: type[Model], seed: int, step: float) -> None:
    """Score and all excesses of fresh draws and of draws with a phase step are those of the published figures."""
    model = kind(color=0.3, intensity=0.1, noise=0.04)
    sample = _quantized(model.render((128, 128), np.random.default_rng(seed)))

    def again(shape: Shape, k: int) -> Texture:
        return _quantized(model.again(sample, shape, np.random.default_rng([seed, k])))

    output = again((192, 192), 0).image
    if step:
        task = Task(sample.image, (192, 192), sample.lattice, np.random.default_rng(7), again=again)
        output = quantize(np.clip(Planted("phase-step", step).synthesize(task).image, 0, 1))
    score = Regularity().score(Observation(sample.image, output, sample, again=again))
    expected, excesses = PINS[kind, seed, step]
    assert score.values["score"] == pytest.approx(expected, abs=1e-5)
    assert list(score.records["excess"].values()) == pytest.approx(excesses, rel=1e-3, abs=1e-4)


def _quantized(texture: Texture) -> Texture:
    return replace(texture, image=quantize(texture.image))
