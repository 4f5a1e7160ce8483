"""Claims about random numbers, grain and waves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy

from nrbench.datasets_procedural.modelling.random_fields import (
    factor_variance,
    factors,
    grain,
    hash_bits,
    smooth_inside,
    uniform,
    waves,
)


def test_hash_knows_its_index_alone() -> None:
    """A number depends on seed and index only: any part of a grid is the same part of the whole, negative or not."""
    y, x = np.arange(-20, 30)[:, np.newaxis], np.arange(-10, 50)
    whole = hash_bits(7, y, x)
    np.testing.assert_array_equal(hash_bits(7, y[5:9], x[20:33]), whole[5:9, 20:33])
    assert np.unique(whole).size == whole.size
    assert not (hash_bits(8, y, x) == whole).any() and not (hash_bits(7, x[:50], y)[:, :50] == whole[:, :50]).all()


def test_known_hash() -> None:
    """The numbers are pinned: a change here changes every texture ever rendered."""
    assert [int(word) for word in hash_bits(1, np.arange(-1, 2))] == [
        6238072747940578789,
        10451216379200822465,
        13757245211066428519,
    ]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_fields_are_smoothed_as_scipy_does(dtype: type[np.floating[Any]]) -> None:
    """Where the kernel does not overhang, the smoothed field is that of scipy, to the bit."""
    field = np.random.default_rng(0).standard_normal((90, 41)).astype(dtype)
    kernel = np.array([0.01, 0.3, 0.9, 0.3, 0.01])
    smooth = smooth_inside(field, kernel)
    assert smooth.dtype == dtype
    np.testing.assert_array_equal(smooth, scipy.ndimage.correlate1d(field, kernel, 0)[2:-2])


def test_hash_bits_are_fair() -> None:
    """Each of the 64 bits is set half of the time, and neighbors share half of their bits."""
    words = hash_bits(3, np.arange(200)[:, np.newaxis], np.arange(200))
    bits = np.unpackbits(words.view(np.uint8).reshape(200, 200, 8), axis=-1)
    assert np.abs(bits.mean((0, 1)) - 0.5).max() < 0.0125
    assert abs((bits[1:] == bits[:-1]).mean() - 0.5) < 0.002 and abs((bits[:, 1:] == bits[:, :-1]).mean() - 0.5) < 0.002


def test_uniform_moments() -> None:
    """Uniform numbers have mean 0, variance 1 and the bounds of that."""
    numbers = uniform(5, np.arange(100000))
    assert abs(numbers.mean()) < 0.015 and numbers.var() == pytest.approx(1, abs=0.01)
    assert math.sqrt(3) * 0.999 < np.abs(numbers).max() <= math.sqrt(3)


def test_factor_variance_is_that_of_factors() -> None:
    """The variance used for the regular share is the factors' own."""
    index = np.arange(50000)[:, np.newaxis]
    table = factors(2, "tile", index, 0.6, 0.4)
    assert table.var() == pytest.approx(factor_variance(0.6, 0.4), rel=0.03)
    assert table.mean() == pytest.approx(1, abs=0.005)


def test_grain_is_stationary_and_correlated() -> None:
    """Grain has mean 0, variance 1 up to the border, a near-normal shape, and the correlation of a 0.7 px Gaussian."""
    field = grain(1, (400, 400)).astype(np.float64)
    assert abs(field.mean()) < 0.02 and field.var() == pytest.approx(1, abs=0.03)
    border = np.concatenate([field[0], field[-1], field[:, 0], field[:, -1]])
    assert border.var() == pytest.approx(1, abs=0.2)
    assert (field**4).mean() == pytest.approx(3, abs=0.15)
    for lag, expected in ((1, 0.60), (2, 0.13), (5, 0.0)):
        assert (field[lag:] * field[:-lag]).mean() == pytest.approx(expected, abs=0.03)
        assert (field[:, lag:] * field[:, :-lag]).mean() == pytest.approx(expected, abs=0.03)


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
