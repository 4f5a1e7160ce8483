import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.detectors.ssdn import ssdn
from nrbench.synthesizers.representative_tile import Costs, Mask, Size, Values, continuity, resemblance


def color_noise(height: int, width: int, channels: int, seed: int = 0) -> Values:
    """Return white noise."""
    return np.random.default_rng(seed).random((height, width, channels), np.float32)


def naive_tiling(image: Values, y: int, x: int, size: Size) -> Values:
    """Repeat the tile at (y, x) over the image, in the place where it lies (section 4.2, figure 4)."""
    tile = image[y : y + size[0], x : x + size[1]]
    rows, columns = (np.arange(image.shape[0]) - y) % size[0], (np.arange(image.shape[1]) - x) % size[1]
    return tile[np.ix_(rows, columns)]


def naive_continuity(tile: Values) -> float:
    """Sum equation 5 term by term."""
    height, width = tile.shape[:2]
    wide = tile.astype(np.float64)
    total = sum(((wide[height - 1, i] - wide[0, i]) ** 2).sum() for i in range(width))
    total += sum(((wide[i, width - 1] - wide[i, 0]) ** 2).sum() for i in range(height))
    return float(total / (2 * (width + height - 1)))


@settings(max_examples=30)
@given(
    st.tuples(st.integers(5, 24), st.integers(5, 24)),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.sampled_from([1, 3]),
    st.integers(0, 99),
)
def test_every_place_costs_what_brute_force_says(shape: Size, size: Size, channels: int, seed: int) -> None:
    """Both criteria of every tile equal the paper's sums, to 1e-9, whatever the sizes."""
    image, size = color_noise(*shape, channels, seed), (min(size[0], shape[0]), min(size[1], shape[1]))
    alike, smooth = resemblance(image, size), continuity(image, size)
    assert alike.shape == smooth.shape == (shape[0] - size[0] + 1, shape[1] - size[1] + 1)
    for y, x in np.ndindex(alike.shape):
        assert alike[y, x] == pytest.approx(ssdn(naive_tiling(image, y, x, size), image), abs=1e-9)
        assert smooth[y, x] == pytest.approx(naive_continuity(image[y : y + size[0], x : x + size[1]]), abs=1e-9)


def naive_masked(image: Values, size: Size, known: Mask) -> Costs:
    """Compare the known pixels only; tiles that hold others cost infinity."""
    costs = np.full((image.shape[0] - size[0] + 1, image.shape[1] - size[1] + 1), np.inf)
    for y, x in np.ndindex(costs.shape):
        if known[y : y + size[0], x : x + size[1]].all():
            difference = (naive_tiling(image, y, x, size) - image.astype(np.float64))[known]
            costs[y, x] = (difference**2).sum() / known.sum()
    return costs


def test_unknown_pixels_neither_count_nor_serve() -> None:
    """With a disc of known pixels only, costs are brute force's over them, infinite for tiles that reach beyond."""
    y, x = np.indices((31, 27))
    known = np.hypot(y - 15, x - 13) < 13
    image = color_noise(31, 27, 3)
    costs = resemblance(image, (6, 5), known)
    np.testing.assert_allclose(costs, naive_masked(image, (6, 5), known), atol=1e-9)
    assert 0 < np.isfinite(costs).sum() < costs.size
    spoilt = np.where(known[..., np.newaxis], image, np.float32(7))
    np.testing.assert_allclose(resemblance(spoilt, (6, 5), known), costs, atol=1e-9)


def test_a_periodic_image_costs_nothing_and_any_other_something() -> None:
    """Every tile of a perfectly periodic image retells it; with one pixel changed, none does."""
    image = np.tile(color_noise(6, 7, 3), (4, 5, 1))
    np.testing.assert_allclose(resemblance(image, (6, 7)), 0, atol=1e-12)
    image[11, 17] += 0.5
    assert resemblance(image, (6, 7)).min() > 1e-4
