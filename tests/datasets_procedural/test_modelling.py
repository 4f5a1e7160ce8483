"""Claims about shapes, threads, colors, grain and waves. Frozen samples and the claims about models hold the rest."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from nrbench.datasets_procedural.modelling.pattern import (
    Field,
    bevel,
    box,
    capsule,
    coverage,
    disc,
    hexagon,
    hue_rotation,
    interlace,
    lozenge,
    stripe,
)
from nrbench.datasets_procedural.modelling.random_fields import (
    factor_variance,
    grain,
    ink_shares,
    palette,
    waves,
)
from nrbench.datasets_procedural.weave import Weave

CORNER = 10 / math.sqrt(3)
DISTANCES: list[tuple[Callable[[Field, Field], Field], list[tuple[float, float]], list[float]]] = [
    (lambda x, y: box(x, y, 10, 6), [(0, 0), (5, 0), (8, 0), (8, 7), (0, 3)], [-3, 0, 3, 5, 0]),
    (lambda x, y: box(x, y, 10, 6, radius=1), [(0, 0), (5, 0), (8, 7)], [-3, 0, math.hypot(4, 5) - 1]),
    (
        lambda x, y: hexagon(x, y, 10),
        [(0, 0), (5, 0), (7, 0), (0, CORNER), (0, CORNER + 2), (2.5, 2.5 * math.sqrt(3))],
        [-5, 0, 2, 0, 2, 0],
    ),
    (lambda x, y: stripe(x, 4), [(0, 0), (-2, 9), (5, 0)], [-2, 0, 3]),
    (lambda x, y: disc(x, y, 6), [(0, 0), (3, 0), (4, 3)], [-3, 0, 2]),
    (lambda x, y: capsule(x, y, 10, 4), [(0, 0), (5, 0), (3, 2), (7, 0)], [-2, 0, 0, 2]),
    (lambda x, y: lozenge(x, y, 8, 6), [(0, 0), (4, 0), (0, 3), (2, 1.5)], [-2.4, 0, 0, 0]),
]


@pytest.mark.parametrize(("shape", "points", "distances"), DISTANCES)
def test_known_distances(
    shape: Callable[[Field, Field], Field], points: list[tuple[float, float]], distances: list[float]
) -> None:
    """Shapes have known distances at their centers, sides, corners and tips, negative inside."""
    np.testing.assert_allclose(shape(*np.array(points, np.float64).T), distances, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0])
@pytest.mark.parametrize("shape", ["box", "hexagon"])
def test_coverage_is_the_area_covered(shape: str, angle: float) -> None:
    """At any angle the share of each pixel agrees with one counted over 256 points in it."""

    def distance(x: Field, y: Field) -> Field:
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        along, across = x * cos + y * sin, y * cos - x * sin
        return box(along, across, 15.3, 9.1) if shape == "box" else hexagon(along, across, 13.7)

    y, x = np.indices((30, 30)) - 14.6
    fine = (np.indices((480, 480)) + 0.5) / 16 - 0.5 - 14.6
    counted = (distance(fine[1], fine[0]) < 0).reshape(30, 16, 30, 16).mean((1, 3))
    error = coverage(distance(x, y)) - counted
    assert np.abs(error).max() < 0.25 and np.sqrt((error**2).mean()) < 0.02 and abs(error.sum()) < 0.01 * counted.sum()


def test_bevel_is_lit_from_the_upper_left() -> None:
    """On its edge an element is lighter towards the upper left and darker opposite; its middle keeps its color."""
    x, y = np.array([-1.0, 1, 1, 0]), np.array([-1.0, 1, -1, 0])
    assert bevel(np.array([0.0, 0, 0, -99]), x, y, 0.2, 2.0) == pytest.approx((1.2, 0.8, 1.0, 1.0))


def test_hue_turns() -> None:
    """Three turns by 120 degrees are none, one takes red to green, gray and the mean of the channels stay."""
    turn = hue_rotation(120.0)
    np.testing.assert_allclose(turn @ (1, 0, 0), (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(turn @ turn @ turn, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(hue_rotation(33.0) @ (0.4, 0.4, 0.4), 0.4)
    assert (hue_rotation(33.0) @ (0.1, 0.2, 0.6)).mean() == pytest.approx(0.3)


DRAFT = np.array([[True, True, False], [False, True, True]])


def test_the_draft_is_followed() -> None:
    """At each crossing the thread is seen that the draft puts above, whole, and the other not at all."""
    y, x = np.mgrid[0:4, 0:6] * 10.0
    warp, weft = interlace(x, y, (10.0, 10.0), 2.0, DRAFT)
    expected = np.tile(DRAFT, (2, 2))
    np.testing.assert_array_equal(warp.coverage, expected)
    np.testing.assert_array_equal(weft.coverage, ~expected)
    np.testing.assert_array_equal(warp.index, np.tile(np.arange(6), (4, 1)))


def test_drafts_of_weaves() -> None:
    """In a twill each thread floats over two; a basket weave moves pairs; a herringbone turns back."""
    grid = np.mgrid[0:8, 0:8] * 10.0
    above = {}
    for draft in ("plain", "twill", "basket", "herringbone"):
        cloth = Weave(warp=10, weft=10, gap=2, draft=draft)
        above[draft] = cloth.pattern(grid[1], grid[0]).layers[0].coverage > 0.5
    assert (above["plain"] != np.roll(above["plain"], 1, 0)).all()
    for draft in ("twill", "basket", "herringbone"):
        assert (above[draft] == np.roll(above[draft], 2, 0)).mean() == 0 and above[draft].mean() == 0.5
    assert (above["twill"] == np.roll(np.roll(above["twill"], 1, 0), -1, 1)).all()
    assert (above["basket"][::2] == above["basket"][1::2]).all()
    assert (above["herringbone"][:, 1:4] == above["herringbone"][:, 7:4:-1]).all()


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_inks_have_the_moments_of_continuous_colors(count: int) -> None:
    """By their shares, inks have mean 1 and the variance of the factors in each channel; no two inks are alike."""
    shares = ink_shares(count)
    inks = palette("tile", count, 0.4, 0.2)
    assert shares.sum() == pytest.approx(1) and (np.diff(shares) < 0).all()
    np.testing.assert_allclose(shares @ inks, 1)
    np.testing.assert_allclose(shares @ (inks - 1) ** 2, factor_variance(0.4, 0.2))
    distances = np.linalg.norm(inks[:, np.newaxis] - inks, axis=-1)[np.triu_indices(count, 1)]
    assert distances.min() > 0.25
    np.testing.assert_array_equal(palette("tile", count, 0.0, 0.0), 1)


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


def test_lengths() -> None:
    """Waves are about as long as stated: a field of 30 px waves crosses zero some 2 times in 30 px along a line."""
    rows = np.concatenate([waves(seed, (2, 600), 30.0)[0] for seed in range(40)])
    crossings = (np.diff(np.sign(rows)) != 0).mean()
    assert 30 * crossings == pytest.approx(2 / np.sqrt(2), rel=0.25)
