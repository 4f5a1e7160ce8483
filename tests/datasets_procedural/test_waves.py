"""Claims about smooth random fields."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.datasets_procedural.modelling.waves import waves


def test_moments_over_draws() -> None:
    """At every pixel, over seeds, the mean is 0 and the variance 1, for one wave as for many."""
    for count in (1, 12):
        fields = np.stack([waves(seed, (12, 9), 30.0, count) for seed in range(600)])
        assert np.abs(fields.mean(0)).max() < 0.2 and np.abs(fields.var(0) - 1).max() < 0.25
        assert np.abs(fields).max() <= np.sqrt(2 * count)


def test_lengths() -> None:
    """Waves are about as long as stated: a field of 30 px waves crosses zero some 2 times in 30 px along a line."""
    rows = np.concatenate([waves(seed, (2, 600), 30.0)[0] for seed in range(40)])
    crossings = (np.diff(np.sign(rows)) != 0).mean()
    assert 30 * crossings == pytest.approx(2 / np.sqrt(2), rel=0.25)


def test_any_window_is_the_same_field() -> None:
    """A smaller shape is the larger one's corner, to the bit; another seed is another field."""
    np.testing.assert_array_equal(waves(3, (20, 30), 17.0), waves(3, (64, 48), 17.0)[:20, :30])
    assert np.abs(waves(3, (20, 30), 17.0) - waves(4, (20, 30), 17.0)).max() > 0.5
