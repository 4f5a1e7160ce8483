import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.synthesizers.pixel_growing.neighbor_search import KdTree, Projection


def draw_points(count: int, axes: int, spread: int, seed: int) -> NDArray[np.int16]:
    """Return points whose coordinates take few values where the spread is small: many ties."""
    return np.random.default_rng(seed).integers(-spread, spread + 1, (count, axes)).astype(np.int16)


def distances(points: NDArray[np.int16], queries: NDArray[np.int16]) -> NDArray[np.int64]:
    """Return all squared distances, (q, n)."""
    apart = queries[:, np.newaxis].astype(np.int64) - points
    return np.asarray((apart**2).sum(-1))


SETS = st.tuples(st.integers(1, 120), st.integers(1, 20), st.sampled_from([0, 1, 3, 50, 5000]), st.integers(0, 999))


@settings(max_examples=150)
@given(SETS, st.integers(1, 5), st.integers(1, 9), st.integers(1, 4))
def test_the_nearest_are_those_of_brute_force(
    drawing: tuple[int, int, int, int], k: int, leaf: int, number: int
) -> None:
    """With eps 0 the k nearest of a group are found, ties by rank, whatever the leaves; -1 where there are fewer."""
    count, axes, spread, seed = drawing
    points, queries = draw_points(count, axes, spread, seed), draw_points(20, axes, spread, seed + 1)
    rng = np.random.default_rng(seed)
    ranks, groups = rng.permutation(count), np.sort(np.arange(count) % number)
    among = rng.integers(groups.max() + 1, size=20)
    numbers, apart = KdTree.build(points, ranks, groups, leaf).nearest(queries, k, groups=among)
    for query, row in enumerate(distances(points, queries)):
        mine = np.flatnonzero(groups == among[query])
        due = mine[np.lexsort([ranks[mine], row[mine]])][:k]
        np.testing.assert_array_equal(numbers[query, : len(due)], due)
        np.testing.assert_array_equal(apart[query, : len(due)], row[due])
        assert (numbers[query, len(due) :] == -1).all()


@settings(max_examples=100)
@given(SETS, st.sampled_from([0.1, 0.5, 1.0, 3.0]))
def test_with_eps_none_is_farther_than_it_may_be(drawing: tuple[int, int, int, int], eps: float) -> None:
    """What is found is at most (1 + eps) times as far as the nearest."""
    count, axes, spread, seed = drawing
    points, queries = draw_points(count, axes, spread, seed), draw_points(30, axes, spread, seed + 1)
    _, apart = KdTree.build(points, leaf=2).nearest(queries, eps=eps)
    assert (apart[:, 0] <= distances(points, queries).min(1) * (1 + eps) ** 2).all()


def test_eps_saves_work_at_the_cost_of_some_distance() -> None:
    """On scattered points a large eps finds farther ones now and then: it does something."""
    points, queries = draw_points(4000, 8, 3000, 0), draw_points(500, 8, 3000, 1)
    tree = KdTree.build(points)
    exact, loose = tree.nearest(queries)[1], tree.nearest(queries, eps=2.0)[1]
    assert (loose >= exact).all()
    assert 0.02 < (loose > exact).mean() < 0.98


@pytest.mark.parametrize("coordinate", [-16000, 0, 16000])
def test_points_that_are_all_alike_are_one_leaf_and_the_first_rank_wins(coordinate: int) -> None:
    """Ten thousand copies of a point neither stop the build nor hide which is preferred."""
    points = np.full((10_000, 3), coordinate, np.int16)
    ranks = np.random.default_rng(0).permutation(10_000)
    numbers, apart = KdTree.build(points, ranks).nearest(points[:5], 2)
    np.testing.assert_array_equal(numbers, [np.argsort(ranks)[:2]] * 5)
    assert (apart == 0).all()


def test_the_farthest_points_do_not_overflow() -> None:
    """Distances up to 2^31 - 1, the largest number of 32 bits, are right."""
    points = np.array([[-16000, 0, 0, 0], [16000, 0, 0, 0]], np.int16)
    numbers, apart = KdTree.build(points).nearest(np.array([[16000, 32000, 0, 0]], np.int16), 2)
    assert numbers.tolist() == [[1, 0]]
    assert apart.tolist() == [[32000**2, 2 * 32000**2]]


def draw_vectors(count: int, width: int, seed: int) -> NDArray[np.uint8]:
    """Return vectors of few dimensions in truth, with some noise."""
    rng = np.random.default_rng(seed)
    mixed = rng.random((count, 3)) @ rng.random((3, width)) * 60 + rng.normal(60, 4, (count, width))
    return np.clip(mixed, 0, 255).astype(np.uint8)


def distances_in_gray_levels(points: NDArray[np.int16], units: int) -> NDArray[np.float64]:
    """Return all distances in gray levels."""
    difference = points[:, np.newaxis].astype(np.float64) - points
    return np.asarray(np.sqrt((difference**2).sum(-1)) / units)


@settings(max_examples=40)
@given(st.integers(1, 40), st.integers(1, 60), st.sampled_from([0, 999]), st.floats(0, 6), st.integers(0, 99))
def test_all_values_keep_weighted_distances(count: int, width: int, dimensions: int, weight: float, seed: int) -> None:
    """Without components, distances are those of the weighted values, up to the rounding of each coordinate."""
    vectors = draw_vectors(count, width, seed)
    weights = np.where(np.arange(width) % 2, weight, 1.0)
    projection = Projection.fit(vectors, weights, dimensions)
    difference = vectors[:, np.newaxis].astype(np.float64) - vectors
    due = np.sqrt((difference**2 * weights).sum(-1))
    np.testing.assert_allclose(
        distances_in_gray_levels(projection.points(vectors), projection.units),
        due,
        atol=1.5 * np.sqrt(width) / projection.units,
    )


def test_components_keep_what_varies() -> None:
    """Of vectors of three dimensions and noise, four components keep distances to the noise."""
    vectors = draw_vectors(200, 50, 0)
    projection = Projection.fit(vectors, np.ones(50), 4)
    assert not projection.matrix[4:].any()
    difference = vectors[:, np.newaxis].astype(np.float64) - vectors
    due = np.sqrt((difference**2).sum(-1))
    found = distances_in_gray_levels(projection.points(vectors), projection.units)
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
    projection = Projection.fit(vectors, weights, dimensions)
    exact = (
        vectors.astype(np.int64) @ projection.matrix[:, :108].T.astype(np.int64) + projection.shift >> projection.bits
    )
    np.testing.assert_array_equal(projection.points(vectors), exact)
    assert np.sqrt(((exact[:, np.newaxis] - exact) ** 2).sum(-1)).max() < 32767


def test_constant_vectors_are_one_point() -> None:
    """Nothing that varies: no division by nothing, all at one place."""
    projection = Projection.fit(np.full((20, 27), 77, np.uint8), np.ones(27), 16)
    assert len(np.unique(projection.points(np.full((20, 27), 77, np.uint8)), axis=0)) == 1
