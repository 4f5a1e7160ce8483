from dataclasses import replace

import numpy as np

from nrbench.plugins.forms import Observation


def test_a_changed_observation_shares_nothing() -> None:
    """What metrics share is computed once an observation, and again for a copy with another output."""
    white, black = np.ones((8, 8, 1), np.float32), np.zeros((8, 8, 1), np.float32)
    calls: list[float] = []

    def mean(observation: Observation) -> float:
        calls.append(float(observation.output.mean()))
        return calls[-1]

    first = Observation(white, white)
    assert [first.shared(mean), first.shared(mean), replace(first, output=black).shared(mean)] == [1, 1, 0]
    assert calls == [1, 0]
