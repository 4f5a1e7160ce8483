"""Claims about patterns and their elements."""

from __future__ import annotations

import numpy as np
import pytest

from nrbench.datasets_procedural.modelling.pattern import Layer, Pattern

INDEX = np.array([[-1, -1, 2], [-1, 0, 2]])
COVERAGE = np.array([[1.0, 0.5, 0.0], [1.0, 0.25, 0.0]])
PATTERN = Pattern((0.4, 0.4, 0.4), (Layer("dot", (INDEX,), COVERAGE, (0.8, 0.2, 0.6), 0.5),))


def test_census() -> None:
    """All indices between the least and the greatest are listed, each point knows its own, unseen ones are told."""
    census = PATTERN.layers[0].census()
    assert census.index[:, 0].tolist() == [-1, 0, 1, 2]
    np.testing.assert_array_equal(census.index[census.place, 0], INDEX)
    assert census.seen(COVERAGE).tolist() == [True, True, False, False]


def test_ideal() -> None:
    """A pixel is its share of the shaded element, and ground for the rest."""
    np.testing.assert_allclose(PATTERN.ideal()[0], [(0.4, 0.1, 0.3), (0.4, 0.25, 0.35), (0.4, 0.4, 0.4)], atol=1e-6)


def test_cropped() -> None:
    """A crop of a pattern is the pattern of the crop."""
    whole = Pattern(
        np.zeros((5, 6, 3)), (Layer("dot", (np.arange(30).reshape(5, 6),), np.ones((5, 6)), (0.5, 0.5, 0.5)),)
    )
    part = whole.cropped(2)
    assert part.layers[0].index[0].tolist() == [[14, 15]] and part.ideal().shape == (1, 2, 3)
    assert whole.cropped(0).ideal().shape == (5, 6, 3)


def test_tinted() -> None:
    """A matrix turns the colors of ground and elements alike, and what leaves [0, 1] is cut off."""
    turned = PATTERN.tinted(np.array([[0.0, 0, 1], [1, 0, 0], [0, 2, 0]]))
    assert turned.layers[0].color == pytest.approx(np.array((0.6, 0.8, 0.4)))
    assert turned.ground == pytest.approx(np.array((0.4, 0.4, 0.8)))
