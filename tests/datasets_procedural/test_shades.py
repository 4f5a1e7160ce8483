"""Claims about shades and colors."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.datasets_procedural.modelling.shades import bevel, hue_turn, mix, rim, round_profile


def test_rim_and_profile() -> None:
    """A rim is darkest at the edge; a round thread is lightest in the middle, and never under its depth."""
    assert rim(np.array([0.0, -50]), 0.2, 1.5) == pytest.approx((0.8, 1.0))
    assert round_profile(np.array([0.0, 3, 5, 9]), 10, 0.4) == pytest.approx((1.0, 0.92, 0.6, 0.6))


def test_bevel_is_lit_from_the_upper_left() -> None:
    """On its edge an element is lighter towards the upper left and darker opposite; its middle keeps its color."""
    x, y = np.array([-1.0, 1, 1, 0]), np.array([-1.0, 1, -1, 0])
    assert bevel(np.array([0.0, 0, 0, -99]), x, y, 0.2, 2.0) == pytest.approx((1.2, 0.8, 1.0, 1.0))


def test_mix() -> None:
    """A quarter of white over black is a dark gray."""
    np.testing.assert_allclose(mix(np.array([[0.25]]), (0.0, 0, 0), (1.0, 1, 1)), [[[0.25] * 3]])


def test_hue_turns() -> None:
    """Three turns by 120 degrees are none, one takes red to green, gray and the mean of the channels stay."""
    turn = hue_turn(120.0)
    np.testing.assert_allclose(turn @ (1, 0, 0), (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(turn @ turn @ turn, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(hue_turn(33.0) @ (0.4, 0.4, 0.4), 0.4)
    assert (hue_turn(33.0) @ (0.1, 0.2, 0.6)).mean() == pytest.approx(0.3)
