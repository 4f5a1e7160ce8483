"""Claims about distances and coverage."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.datasets_procedural.modelling.coordinates import Field
from nrbench.datasets_procedural.modelling.shapes import box, capsule, coverage, disc, hexagon, lozenge, stripe, turned


def test_box_distances() -> None:
    """A box of 10 x 6 px: known distances at its centre, sides and corners, sharp and rounded."""
    x, y = np.array([0.0, 5, 8, 8, 0]), np.array([0.0, 0, 0, 7, 3])
    np.testing.assert_allclose(box(x, y, 10, 6), (-3, 0, 3, 5, 0))
    np.testing.assert_allclose(box(x, y, 10, 6, radius=1), (-3, 0, 3, np.hypot(4, 5) - 1, 0))


def test_hexagon_distances() -> None:
    """A hexagon 10 px from flat to flat: known distances at its centre, flats and corner."""
    corner = 10 / np.sqrt(3)
    x = np.array([0.0, 5, 7, 0, 0, 5 * np.cos(np.pi / 3)])
    y = np.array([0.0, 0, 0, corner, corner + 2, 5 * np.sin(np.pi / 3)])
    np.testing.assert_allclose(hexagon(x, y, 10), (-5, 0, 2, 0, 2, 0), atol=1e-12)


def test_stripe_distances() -> None:
    """A stripe 4 px wide: 2 px deep, its edge at 2."""
    np.testing.assert_allclose(stripe(np.array([0.0, -2, 5]), 4), (-2, 0, 3))


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


def test_round_shapes() -> None:
    """A disc 6 px across, and a capsule 10 px long and 4 broad: known distances."""
    np.testing.assert_allclose(disc(np.array([0.0, 3, 4]), np.array([0.0, 0, 3]), 6), (-3, 0, 2))
    np.testing.assert_allclose(capsule(np.array([0.0, 5, 3, 7]), np.array([0.0, 0, 2, 0]), 10, 4), (-2, 0, 0, 2))


def test_lozenge() -> None:
    """A lozenge 8 px wide and 6 high: its sides pass through its tips, its middle is 2.4 px from each."""
    np.testing.assert_allclose(
        lozenge(np.array([0.0, 4, 0, 2]), np.array([0.0, 0, 3, 1.5]), 8, 6), (-2.4, 0, 0, 0), atol=1e-12
    )


def test_turned() -> None:
    """A point on the y axis lies on the x axis of axes turned by 90 degrees."""
    np.testing.assert_allclose(turned(np.array(0.0), np.array(2.0), 90.0), (2, 0), atol=1e-12)
