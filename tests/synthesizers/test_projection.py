import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.synthesizers.pixel_growing.neighbor_search import Projection


def drawn(count: int, width: int, seed: int) -> NDArray[np.uint8]:
    """Return vectors of few dimensions in truth, with some noise."""
    rng = np.random.default_rng(seed)
    mixed = rng.random((count, 3)) @ rng.random((3, width)) * 60 + rng.normal(60, 4, (count, width))
    return np.clip(mixed, 0, 255).astype(np.uint8)


def apart(points: NDArray[np.int16], units: int) -> NDArray[np.float64]:
    """Return all distances in gray levels."""
    difference = points[:, np.newaxis].astype(np.float64) - points
    return np.asarray(np.sqrt((difference**2).sum(-1)) / units)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.integers(1, 60), st.sampled_from([0, 999]), st.floats(0, 6), st.integers(0, 99))
def test_all_values_keep_weighted_distances(count: int, width: int, dimensions: int, weight: float, seed: int) -> None:
    """Without components, distances are those of the weighted values, up to the rounding of each coordinate."""
    vectors = drawn(count, width, seed)
    weights = np.where(np.arange(width) % 2, weight, 1.0)
    made = Projection.fit(vectors, weights, dimensions)
    difference = vectors[:, np.newaxis].astype(np.float64) - vectors
    due = np.sqrt((difference**2 * weights).sum(-1))
    np.testing.assert_allclose(apart(made.points(vectors), made.units), due, atol=1.5 * np.sqrt(width) / made.units)


def test_components_keep_what_varies() -> None:
    """Of vectors of three dimensions and noise, four components keep distances to the noise."""
    vectors = drawn(200, 50, 0)
    made = Projection.fit(vectors, np.ones(50), 4)
    assert not made.matrix[4:].any()
    difference = vectors[:, np.newaxis].astype(np.float64) - vectors
    due = np.sqrt((difference**2).sum(-1))
    found = apart(made.points(vectors), made.units)
    assert (found <= due + 1).all()
    far = due > 150
    assert far.any()
    np.testing.assert_allclose(found[far], due[far], rtol=0.1)


@pytest.mark.parametrize("weight", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("dimensions", [0, 1, 16])
def test_extremes_fit_sixteen_bits(weight: float, dimensions: int) -> None:
    """Black and white neighborhoods of 300 values differ by less than 32 767 units, however the mask counts."""
    vectors = np.zeros((10, 108), np.uint8)
    vectors[5:] = 255
    vectors[3, ::2] = 255
    weights = np.where(np.arange(108) % 2, weight, 1.0)
    made = Projection.fit(vectors, weights, dimensions)
    exact = vectors.astype(np.int64) @ made.matrix[:, :108].T.astype(np.int64) + made.shift >> made.bits
    np.testing.assert_array_equal(made.points(vectors), exact)
    assert np.sqrt(((exact[:, np.newaxis] - exact) ** 2).sum(-1)).max() < 32767


def test_constant_vectors_are_one_point() -> None:
    """Nothing that varies: no division by nothing, all at one place."""
    made = Projection.fit(np.full((20, 27), 77, np.uint8), np.ones(27), 16)
    assert len(np.unique(made.points(np.full((20, 27), 77, np.uint8)), axis=0)) == 1
