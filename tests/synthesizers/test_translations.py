import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nrbench.synthesizers.patchwork.translations import Features, Layer, Translations, draw_translation


def pixels(rng: np.random.Generator, shape: tuple[int, int], channels: int) -> Features:
    """Return whole numbers, as large as colors of a mask of weight 5."""
    return rng.integers(0, 1275, (*shape, channels)).astype(np.int32)


def by_hand(sample: tuple[Features, ...], window: list[Layer]) -> NDArray[np.float64]:
    """Return the definition, place by place."""
    height, width = window[0].values.shape[:2]
    rows, columns = sample[0].shape[0] - height + 1, sample[0].shape[1] - width + 1
    costs = np.zeros((rows, columns))
    for y, x in np.ndindex(rows, columns):
        for part, layer in zip(sample, window, strict=True):
            known = np.ones((height, width), bool) if layer.known is None else layer.known
            apart = part[y : y + height, x : x + width].astype(np.int64) - layer.values
            costs[y, x] += (apart[known] ** 2).sum()
    return costs


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.integers(1, 23), st.integers(1, 23)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.lists(st.tuples(st.integers(1, 3), st.booleans()), min_size=1, max_size=2),
    st.integers(0, 99),
)
def test_ratings_are_the_sums_of_squared_differences_to_the_last_bit(
    shape: tuple[int, int], part: tuple[float, float], layers: list[tuple[int, bool]], seed: int
) -> None:
    """Whatever sample, window, layers and known pixels: the Fourier way gives what place by place gives, exactly."""
    rng = np.random.default_rng(seed)
    size = 1 + int(part[0] * (shape[0] - 1)), 1 + int(part[1] * (shape[1] - 1))
    sample = tuple(pixels(rng, shape, channels) for channels, _ in layers)
    window = [
        Layer(pixels(rng, size, channels), None if everywhere else rng.random(size) < 0.5)
        for channels, everywhere in layers
    ]
    np.testing.assert_array_equal(Translations(sample).rate(window), by_hand(sample, window))


def test_what_does_not_count_may_hold_anything() -> None:
    """Pixels that a layer does not know do not change a rating."""
    rng = np.random.default_rng(0)
    sample, known = pixels(rng, (20, 20), 3), rng.random((7, 9)) < 0.5
    window = pixels(rng, (7, 9), 3)
    other = np.where(known[..., np.newaxis], window, 999).astype(np.int32)
    rate = Translations((sample,)).rate
    np.testing.assert_array_equal(rate([Layer(window, known)]), rate([Layer(other, known)]))


def test_as_many_layers_are_asked_as_the_sample_has() -> None:
    """A window that lacks a layer is no window of this sample."""
    sample = np.zeros((9, 9, 1), np.int32)
    with pytest.raises(ValueError, match="zip"):
        Translations((sample, sample)).rate([Layer(sample)])


def test_places_are_drawn_by_their_costs() -> None:
    """The share of a place's draws is its exp(-cost / scale) over that of all."""
    costs, rng = np.array([[0.0, 1.0], [2.0, 700.0]]), np.random.default_rng(0)
    found = [draw_translation(costs + 5, 2.0, rng) for _ in range(4000)]
    expected = np.exp(-costs / 2) / np.exp(-costs / 2).sum()
    for y, x in np.ndindex(2, 2):
        assert found.count((x, y)) / 4000 == pytest.approx(expected[y, x], abs=0.03)


def test_without_randomness_one_of_the_best_is_drawn() -> None:
    """At scale 0 every best place is draw_translation, and no other, be costs as large as they like."""
    costs, rng = np.array([[1e12, 3e9, 3e9], [3e9, 3e9 + 1, 1e15]]), np.random.default_rng(0)
    assert {draw_translation(costs, 0.0, rng) for _ in range(100)} == {(1, 0), (2, 0), (0, 1)}
