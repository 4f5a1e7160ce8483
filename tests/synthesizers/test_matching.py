"""Claims about where a patch agrees with its surroundings: at whole pixels, and between pixels."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.synthesizers.gap_filling.blocks import Box
from nrbench.synthesizers.gap_filling.matching import FrameMatcher, Match, align_patch

SIZE = 9
HOLES: list[Box] = [(3, 6, 3, 6), (0, 6, 3, 9), (2, 2, 4, 4)]


def noise(shape: tuple[int, int], channels: int, seed: int = 0) -> Image:
    """Return noise of 8 bits."""
    return quantize(np.random.default_rng(seed).random((*shape, channels), np.float32))


def cut(image: Image, x: int, y: int) -> NDArray[np.float32]:
    """Return a patch as whole numbers."""
    return to_bytes(image)[y : y + SIZE, x : x + SIZE].astype(np.float32)


def counted(patch: NDArray[np.float32], hole: Box) -> NDArray[np.float64]:
    """Return the pixels of a patch outside the hole, by naive loops: (n, C)."""
    y0, y1, x0, x1 = hole
    rows = range(SIZE)
    return np.array([patch[y, x] for y in rows for x in rows if not (y0 <= y < y1 and x0 <= x < x1)], np.float64)


def naive(patch: NDArray[np.float32], template: NDArray[np.float32], hole: Box, match: Match) -> float:
    """Rate by equation 10 (negated), or equations 3 and 6, as they stand."""
    f, g = counted(patch, hole), counted(template, hole)
    if match == "color":
        return -float(((f - g) ** 2).sum())
    f, g = f - f.mean(0), g - g.mean(0)
    sigma_f, sigma_g = np.sqrt((f**2).sum(0)), np.sqrt((g**2).sum(0))
    gamma = (f * g).sum(0) / (sigma_f * sigma_g)
    return float((gamma * sigma_f * sigma_g).sum() / (sigma_f * sigma_g).sum())


@pytest.mark.parametrize("match", ["ncc", "color"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("hole", HOLES)
def test_ratings_equal_brute_force(match: Match, channels: int, hole: Box) -> None:
    """Both matches equal naive loops at every place."""
    image, other = noise((21, 17), channels), noise((21, 17), channels, seed=1)
    matcher = FrameMatcher(image, SIZE, match)
    template = cut(other, 3, 5)
    rows, columns = matcher.search_shape
    expected = [[naive(cut(image, x, y), template, hole, match) for x in range(columns)] for y in range(rows)]
    positions = np.argwhere(np.ones((rows, columns)))[:, ::-1]
    some = matcher.rate(template, hole, positions).reshape(rows, columns)
    np.testing.assert_allclose(some, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(some, matcher.rate_everywhere(template, hole))


def test_ncc_ignores_brightness_and_contrast_and_color_does_not() -> None:
    """A darker, flatter template still correlates perfectly, but differs in color."""
    image = noise((20, 20), 1)
    image = quantize(np.rint(image * 100) * 2 / 255)
    template = cut(image, 4, 6) / 2
    here = np.array([[4, 6]])
    assert FrameMatcher(image, SIZE, "ncc").rate(template, (3, 6, 3, 6), here)[0] == pytest.approx(1)
    assert FrameMatcher(image, SIZE, "color").rate(template, (3, 6, 3, 6), here)[0] < 0


def test_a_flat_border_rates_zero_by_ncc() -> None:
    """Where nothing varies there is no correlation, and no warning."""
    image = np.full((20, 20, 1), 0.4, np.float32)
    assert not FrameMatcher(image, SIZE, "ncc").rate_everywhere(cut(image, 0, 0), (3, 6, 3, 6)).any()


def test_runs_too_long_for_float32_are_summed_exactly() -> None:
    """White frames of 400 px, whose rows sum to more than 2^24, match without a rounding error."""
    image = np.ones((410, 410, 3), np.float32)
    matcher = FrameMatcher(image, 400, "color")
    template = np.full((400, 400, 3), 255, np.float32)
    assert matcher.rate(template, (10, 390, 10, 390), np.array([[3, 5]]))[0] == 0


Y, X = np.indices((48, 48)).astype(float)
FRAME = np.ones((48, 48))
FRAME[14:34, 14:34] = 0


def texture(x: np.ndarray, y: np.ndarray) -> Image:  # type: ignore[type-arg]
    """Return a texture of lines both ways, at any place."""
    waves = np.cos(2 * math.pi * x / 9.3) + np.cos(2 * math.pi * (y + 0.2 * x) / 8.1) + np.cos(0.9 * (x - y))
    return (0.5 + 0.15 * waves)[..., np.newaxis].astype(np.float32)


@pytest.mark.parametrize("off", [(0.4, -0.3), (-0.8, 0.7), (0.0, 0.05)])
def test_a_patch_is_moved_to_where_it_meets(off: tuple[float, float]) -> None:
    """A place that is off by up to a pixel is corrected to 0.02 px, by the frame alone."""
    old = texture(X + 5, Y + 7)
    place = np.add((5.0, 7.0), off)
    for _ in range(3):
        place = align_patch(lambda at: texture(X + at[0], Y + at[1]), place, old, FRAME)
    np.testing.assert_allclose(place, (5, 7), atol=0.02)


def test_equal_pictures_move_nothing() -> None:
    """Equal pictures give no displacement, not even a rounding error."""
    old = texture(X, Y)
    assert align_patch(lambda at: old, np.array([3.0, 4.0]), old, FRAME).tolist() == [3, 4]


def test_flat_pictures_move_nothing() -> None:
    """Flat pictures give no displacement, even if they differ in brightness."""
    flat = np.full((48, 48, 1), 0.3, np.float32)
    assert align_patch(lambda at: flat + 0.1, np.array([3.0, 4.0]), flat, FRAME).tolist() == [3, 4]
