"""What the metrics of one observation share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nrbench.plugins.forms import Observation

WHITE = np.ones((8, 8, 1), np.float32)


def mean_of_output(observation: Observation) -> list[float]:
    """Return a new list at each call, so that two calls can be distinguished."""
    return [float(observation.output.mean())]


def test_metrics_share_what_is_computed_once() -> None:
    """The metrics of an observation get the same object, each with a random stream of its own."""
    observation = Observation(WHITE, WHITE)
    first, second = (observation.with_stream(np.random.default_rng(seed)) for seed in (1, 2))
    assert first.rng is not second.rng
    assert first.shared(mean_of_output) is second.shared(mean_of_output) is observation.shared(mean_of_output)


def test_another_output_shares_nothing() -> None:
    """A copy with another output computes its own."""
    observation = Observation(WHITE, WHITE)
    assert observation.shared(mean_of_output) == [1.0]
    assert replace(observation, output=WHITE / 2).shared(mean_of_output) == [0.5]
