"""Claims about how one of several places is drawn."""

import numpy as np
from scipy import stats

from nrbench.lattice.geometry import Lattice
from nrbench.synthesizers.rsgf import REMEMBERED, PlaceSampler, best_places


def grid(count: int, step: int) -> np.ndarray:
    """Return the places (x, y) of a square grid."""
    return np.stack(np.meshgrid(np.arange(count), np.arange(count)), -1).reshape(-1, 2) * step


def test_patches_that_do_not_overlap_are_used_in_turn() -> None:
    """Of nine places apart none comes back before all have been drawn, in an order that chance decides."""
    places, orders = grid(3, 10), set()
    for seed in range(5):
        sampler = PlaceSampler(np.random.default_rng(seed), 10, prefer_unused=True)
        rounds = [[tuple(sampler.draw(places)) for _ in places] for _ in range(REMEMBERED // 9)]
        assert all(len(set(drawn)) == 9 for drawn in rounds)
        orders |= {tuple(drawn) for drawn in rounds}
    assert len(orders) > 30


def test_the_first_draw_is_uniform_and_all_are_without_spreading() -> None:
    """Each place comes equally often: in first draws, and in all draws where they are not spread."""
    places = grid(3, 4)
    first = [PlaceSampler(np.random.default_rng(k), 10, prefer_unused=True).draw(places) for k in range(1800)]
    sampler = PlaceSampler(np.random.default_rng(0), 10, prefer_unused=False)
    later = [sampler.draw(places) for _ in range(1800)]
    for drawn in (first, later):
        counts = np.unique(np.array(drawn), axis=0, return_counts=True)[1]
        assert len(counts) == 9
        assert stats.chisquare(counts).pvalue > 1e-3


def test_a_place_is_shown_by_patches_that_overlap_it_in_part() -> None:
    """A patch counts whole for its own place, a quarter for one half a patch aside both ways, nothing for one apart."""
    sampler = PlaceSampler(np.random.default_rng(0), 10, prefer_unused=True)
    sampler.draw(np.array([[20, 20]]))
    np.testing.assert_allclose(sampler.overlap_counts(np.array([[20, 20], [25, 15], [30, 20]])), [1, 0.25, 0])


def test_what_was_laid_long_ago_counts_no_more() -> None:
    """After as many patches elsewhere as are remembered a place is as good as new."""
    sampler = PlaceSampler(np.random.default_rng(0), 10, prefer_unused=True)
    sampler.draw(np.array([[0, 0]]))
    for _ in range(REMEMBERED):
        sampler.draw(np.array([[50, 50]]))
    assert sampler.overlap_counts(np.array([[0, 0]])) == 0


def test_of_each_place_the_best_candidate_and_of_places_the_best_share() -> None:
    """With four places rated 4 > 3 > 2 = 2, the best share is taken, ties whole, one candidate a place."""
    lattice = Lattice((10.4, 0), (0, 9.7))
    at = np.array([3.2, 4.1])
    near = np.rint(at + np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) @ lattice.matrix).astype(np.int64)
    candidates = np.concatenate([near, near + np.array([2, 1]), near - np.array([1, 3])])
    ratings = np.array([1.0, 0, 2, 2, 4, -1, 0, 0, 0, 3, 0, 0])
    best = {share: best_places(candidates, ratings, lattice, at, share) for share in (0.0, 0.5, 0.75, 1.0)}
    first, second = tuple(near[0] + [2, 1]), tuple(near[1] - [1, 3])
    assert {tuple(place) for place in best[0.0]} == {first}
    assert {tuple(place) for place in best[0.5]} == {first, second}
    every = {first, second, tuple(near[2]), tuple(near[3])}
    assert {tuple(place) for place in best[0.75]} == {tuple(place) for place in best[1.0]} == every
