"""Tile sets, and the statistics of them, on tiles of known departures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.residual_tiles.dependence import sum_variance
from nrbench.metrics.residual_tiles.distance import compare_sets, measure_distances
from nrbench.metrics.residual_tiles.repetition import SIZES, Share, Twins, find_pairs, find_twins
from nrbench.metrics.residual_tiles.tiles import TileSet

SQUARE = Lattice((16, 0), (0, 16))
FLAT = np.ones((16, 16), np.float32)


def tiles(rows: int, columns: int, seed: int = 0, strength: float = 0.1) -> TileSet:
    """Return tiles of random colors with a little grain, in rows and columns."""
    rng = np.random.default_rng(seed)
    numbers = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
    values = strength * rng.standard_normal((len(numbers), 1, 1, 3)) + 0.02 * rng.standard_normal(
        (len(numbers), 16, 16, 3)
    )
    return with_tiles(TileSet(numbers, numbers * 16.0 + 8, FLAT[np.newaxis], SQUARE), (0.5 + values).astype(np.float32))


def with_tiles(places: TileSet, values: Values) -> TileSet:
    """Return other tiles in the same places."""
    return TileSet(places.numbers, places.centers, values, places.lattice)


def repeated(period: int, seed: int = 0) -> TileSet:
    """Return 12 x 12 tiles, of which those ``period`` apart along rows and columns are equal."""
    places, few = tiles(12, 12, seed), tiles(period, period, seed + 1)
    number = places.numbers % period
    return with_tiles(places, few.tiles[number[:, 1] * period + number[:, 0]])


def chosen(sources: NDArray[np.intp], seed: int = 0) -> TileSet:
    """Return 12 x 12 tiles, each one of some few, as numbered."""
    places, few = tiles(12, 12, seed), tiles(1, int(sources.max()) + 1, seed + 1)
    return with_tiles(places, few.tiles[sources])


def test_tiles_are_cut_where_the_lattice_says() -> None:
    """In an image of its own coordinates the mean of each tile is its lattice point."""
    y, x = np.indices((70, 90))
    found = TileSet.on(np.stack([x, y], -1).astype(np.float32), Lattice((15.5, 2), (-1, 12.3), (3, 4)), (12, 16))
    assert len(found) > 15
    np.testing.assert_allclose(found.tiles.mean((1, 2)), found.centers, atol=0.02)


def test_departures_keep_the_energy_that_the_mean_takes() -> None:
    """Over many small sets the mean square of departures is that of the distribution."""
    energy = [
        float((with_tiles(tiles(1, 3), noise).departures ** 2).mean())
        for noise in np.random.default_rng(0).standard_normal((300, 3, 16, 16, 3)).astype(np.float32)
    ]
    assert np.mean(energy) == pytest.approx(1, abs=0.01)


def test_blocks_cover_the_image() -> None:
    """Every tile lies in a block, no block exceeds the extent, and equal extents give one block."""
    found = tiles(9, 12)
    blocks = list(found.blocks((144, 192), (80, 100)))
    assert len(blocks) == 4
    assert {tuple(number) for block in blocks for number in block.numbers} == {tuple(n) for n in found.numbers}
    assert all((np.ptp(block.centers, 0) <= (99, 79)).all() for block in blocks)
    assert [len(block) for block in found.blocks((144, 192), (144, 192))] == [len(found)]


def test_pair_distances_are_mean_squared_differences() -> None:
    """At each size the distances equal weighted mean squared differences that are summed directly."""
    found, weights = tiles(2, 4), np.linspace(1, 2, 256).reshape(16, 16).astype(np.float32)
    halves, whole, wide = (pairs.distances for pairs in find_pairs(found, weights))
    i, j = np.triu_indices(8, 1)
    squares = ((found.tiles[i] - found.tiles[j]) ** 2).mean(-1)
    np.testing.assert_allclose(whole, (squares * weights).sum((1, 2)) / weights.sum(), rtol=1e-3, atol=1e-6)
    corner = weights[:8, :8]
    np.testing.assert_allclose(halves[: len(i)], (squares[:, :8, :8] * corner).sum((1, 2)) / corner.sum(), rtol=1e-3)
    assert len(wide) == 1
    first, last = found.tiles[[0, 1, 4, 5]], found.tiles[[2, 3, 6, 7]]
    expected = (((first - last) ** 2).mean(-1) * weights).sum((1, 2)).mean() / weights.sum()
    assert wide[0] == pytest.approx(expected, rel=1e-3)


def test_pairs_are_counted_by_their_lags() -> None:
    """Near and returning pairs, counted pair by pair, are those of every size; wide pairs share no tile."""
    found = repeated(3).take(np.flatnonzero(np.random.default_rng(0).random(144) < 0.9))
    halves, whole, wide = find_pairs(found, FLAT)
    blocks = found.neighbors()
    for pairs, parts, members in (
        (halves, 4, np.arange(len(found))[:, np.newaxis]),
        (whole, 1, np.arange(len(found))[:, np.newaxis]),
        (wide, 1, blocks),
    ):
        every: dict[tuple[int, ...], list[bool]] = {}
        near, at = pairs.distances.reshape(parts, -1) <= 1e-3, 0
        for i in range(len(members)):
            for j in range(i + 1, len(members)):
                if set(members[i]) & set(members[j]):
                    continue
                lag = found.numbers[members[j, 0]] - found.numbers[members[i, 0]]
                lag = max(tuple(map(int, lag)), tuple(map(int, -lag)))
                for part in range(parts):
                    every.setdefault((part, *lag), []).append(bool(near[part, at]))
                at += 1
        assert at == near.shape[1]
        returning = [max(2 * sum(flags) - len(flags), 0) for flags in every.values() if len(flags) >= 6]
        assert pairs.count(1e-3).tolist() == [near.size, near.sum(), sum(returning)]
        assert sum(returning) > 0


def test_without_neighbors_there_are_no_wide_pairs() -> None:
    """Of a single row of tiles, and of a single tile, no pairs are counted where there are none."""
    assert find_pairs(tiles(1, 8), FLAT)[2].count(1.0).tolist() == [0, 0, 0]
    assert [pairs.count(1.0).tolist() for pairs in find_pairs(tiles(1, 1), FLAT)] == [[0, 0, 0]] * 3


@pytest.mark.parametrize("period", [3, 4, 6])
def test_a_supercell_repeats_at_every_size(period: int) -> None:
    """With a period of p x p tiles, N / p^2 - 1 of a tile's N - 1 pairs are twins, all at few lags."""
    fresh = tuple(tiles(12, 12, seed) for seed in (10, 11))
    found = find_twins(repeated(period), fresh, FLAT, [float(period**2)] * 3, 1.0)
    assert [one.size for one in found] == list(SIZES)
    expected = period**2 * math.sqrt((144 / period**2 - 1) / 143)
    assert [one.score for one in found[:2]] == pytest.approx([expected] * 2, rel=0.15)
    assert 0.7 * expected < found[2].score < 1.8 * expected


def test_weaker_departures_are_no_copies() -> None:
    """Tiles of half the energy are no twins, but tiles that hardly differ at all are."""
    fresh = tuple(tiles(12, 12, seed) for seed in (10, 11))
    weak = tiles(12, 12, 5)
    half, nothing = (
        with_tiles(weak, (0.5 + share * (weak.tiles - 0.5)).astype(np.float32)) for share in (0.5**0.5, 0.05)
    )
    assert all(abs(one.score) < 0.1 for one in find_twins(half, fresh, FLAT, [20.0] * 3, 0.5))
    assert all(one.score > 15 for one in find_twins(nothing, fresh, FLAT, [20.0] * 3, 0.0025))


def test_the_best_copier_scores_one() -> None:
    """The score is 1 if one pair in M is a twin beyond chance, 0 by chance alone, and M if all pairs are."""
    for share, expected in ((0.02 + 0.98 / 50, 1), (0.02, 0), (1.0, 50)):
        found = Twins(1.0, Share(share, share), Share(0.02, 0.02), 50.0)
        assert found.score == pytest.approx(expected)


def test_strewn_twins_do_not_count_by_lag() -> None:
    """If each of M sources is chosen at random one pair in M is a twin, and at no lag most pairs are."""
    found = [chosen(np.random.default_rng(seed).integers(9, size=144)) for seed in range(12)]
    shares = [Share.of([find_pairs(one, FLAT)[1]], 1e-6) for one in found]
    assert np.mean([share.all for share in shares]) == pytest.approx(1 / 9, rel=0.1)
    assert max(share.by_lag for share in shares) < 1 / 9


def test_lags_are_the_same_both_ways() -> None:
    """The order of the tiles does not change the shares."""
    one = repeated(4)
    turned = one.take(np.random.default_rng(0).permutation(len(one)))
    assert Share.of([find_pairs(turned, FLAT)[1]], 1e-6) == Share.of([find_pairs(one, FLAT)[1]], 1e-6)


def distances(own: TileSet, fresh: tuple[TileSet, ...]) -> dict[str, float]:
    """Return the distances, with a wave across the tiles as mean tile."""
    wave = np.broadcast_to(np.sin(np.arange(16) * np.pi / 8)[:, np.newaxis, np.newaxis], (16, 16, 3))
    measured = measure_distances(own, fresh, FLAT, np.asarray(wave, np.float32))
    return {name: one.value for name, one in measured.items()}


def test_the_distance_of_one_distribution_is_zero() -> None:
    """A further draw has a distance of 0; half the strength is farther; equally strong grain is far in every group."""
    fresh = tuple(tiles(9, 9, seed) for seed in range(10, 16))
    further = [distances(tiles(9, 9, seed), fresh) for seed in range(6)]
    spread = {name: float(np.std([one[name] for one in further])) for name in ("parts", "detail")}
    for name in spread:
        assert abs(np.mean([one[name] for one in further])) < 3 * spread[name] + 1e-3
    assert distances(tiles(9, 9, 0, 0.05), fresh)["parts"] > 5 * spread["parts"]
    rng = np.random.default_rng(0)
    grain = with_tiles(fresh[0], (0.1 * rng.standard_normal((81, 16, 16, 3))).astype(np.float32))
    assert (grain.departures**2).mean() == pytest.approx((fresh[0].departures ** 2).mean(), rel=0.2)
    for name, value in distances(grain, fresh).items():
        assert value > 20 * spread[name], name
    assert distances(grain, fresh)["detail"] > 0.9


def test_distances_follow_a_shift_as_stated() -> None:
    """If one of many standard normal features moves by one, two or four deviations, see the docstring."""
    rng = np.random.default_rng(0)
    fresh = [rng.standard_normal((600, 1)).astype(np.float32) for _ in range(3)]
    for shift, expected in ((1, 0.2), (2, 0.45), (4, 0.7)):
        own = rng.standard_normal((600, 1)).astype(np.float32) + np.float32(shift)
        assert compare_sets([own, *fresh]).value == pytest.approx(expected, abs=0.03)
        assert compare_sets([own, *fresh]).excess == pytest.approx(expected, abs=0.03)


def test_chance_alone_is_no_distance() -> None:
    """Of 200 further draws at most two have an excess, whether tiles are independent or all rows of tiles are equal."""
    rng = np.random.default_rng(0)
    for equal in (1, 10):
        beyond = 0
        for _ in range(200):
            sets = [rng.standard_normal((60 // equal, 4)).repeat(equal, 0).astype(np.float32) for _ in range(5)]
            beyond += compare_sets(sets).excess > 0.05
        assert beyond <= 2


def test_the_order_of_tiles_does_not_matter() -> None:
    """The order of the tiles does not change the distances."""
    fresh, own = tuple(tiles(9, 9, seed) for seed in (10, 11)), tiles(9, 9, 1)
    mixed = own.take(np.random.default_rng(0).permutation(len(own)))
    for name, value in distances(own, fresh).items():
        assert distances(mixed, fresh)[name] == pytest.approx(value, abs=1e-6)


def test_the_variance_of_a_sum_counts_threads() -> None:
    """The estimate is 1 to 1.6 times the variance of the sum over draws, for independent tiles, rows and diagonals."""
    rng = np.random.default_rng(0)
    u, v = (part.ravel() for part in np.meshgrid(np.arange(12), np.arange(12)))
    numbers = np.stack([u, v], 1)
    for line in (None, v, u + v):
        draws = rng.standard_normal((300, 144))
        if line is not None:
            draws = 0.6 * draws + 0.8 * rng.standard_normal((300, 24))[:, line]
        estimate = np.mean([sum_variance(numbers, one) for one in draws])
        assert 0.9 < estimate / np.var(draws.sum(1)) < 1.7
