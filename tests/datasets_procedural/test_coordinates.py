"""Claims about frames and cells."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.datasets_procedural.modelling.coordinates import Frame, boxes, hats, honeycomb, nearest, rows
from nrbench.lattice.geometry import Lattice


@given(st.floats(-720, 720), st.floats(-50, 50), st.floats(-50, 50))
def test_frame_and_vector_agree(rotation: float, ox: float, oy: float) -> None:
    """A pixel's model coordinates, turned back into the picture and moved to the origin, are the pixel."""
    frame = Frame((ox, oy), rotation)
    x, y = frame.grid((3, 4))
    back = frame.vector((x[2, 3], y[2, 3]))
    assert (back[0] + ox, back[1] + oy) == pytest.approx((3, 2), abs=1e-9)


def test_right_angles_are_exact() -> None:
    """A turn by 90 degrees exchanges the axes without rounding."""
    assert Frame(rotation=90.0).vector((3.0, 0.0)) == (0.0, 3.0)
    assert Frame(rotation=-90.0).vector((3.0, 0.0)) == (0.0, -3.0)


def test_nearest() -> None:
    """Points go to the nearest multiple of the period, and keep their signed distance from it."""
    index, rest = nearest(np.array([-7.0, 0, 4, 14]), 10)
    assert index.tolist() == [-1, 0, 0, 1] and rest.tolist() == [3, 0, 4, 4]


@pytest.mark.parametrize("name", ["rows", "honeycomb"])
def test_index_is_the_lattice_coordinate(name: str) -> None:
    """The cell's index times the generating vectors, plus the local coordinates, is the point; it lies in its cell."""
    x, y = np.random.default_rng(0).uniform(-90, 90, (2, 2000))
    if name == "rows":
        (i, j), (dx, dy) = rows(x, y, 20.0, 9.0, 0.5)
        lattice = Lattice((20, 0), (10, 9))
        assert np.abs(dx).max() <= 10 and np.abs(dy).max() <= 4.5
    else:
        (i, j), (dx, dy) = honeycomb(x, y, 14.0)
        lattice = Lattice((14, 0), (7, 7 * math.sqrt(3)))
        np.testing.assert_allclose(np.stack([dx, dy], -1), lattice.wrap(np.stack([x, y], -1)), atol=1e-9)
    there = lattice.from_cell(np.stack([i, j], -1)) + np.stack([dx, dy], -1)
    np.testing.assert_allclose(there, np.stack([x, y], -1), atol=1e-9)


def test_boxes() -> None:
    """A row of boxes of 10 and 4 px: which box, how far from its middle, how wide; the first one's middle is at 0."""
    which, aside, width = boxes(np.array([0.0, 4.9, 5.5, 7, 9.5, 14, -5.5]), (10.0, 4.0))
    assert which.tolist() == [0, 0, 1, 1, 2, 2, -1] and width.tolist() == [10, 10, 4, 4, 10, 10, 4]
    np.testing.assert_allclose(aside, [0, 4.9, -1.5, 0, -4.5, 0, 1.5])


def test_hats_are_a_partition() -> None:
    """The four whole points around a point have weights that add up to 1, and their mean is the point."""
    u, v = np.random.default_rng(0).uniform(-9, 9, (2, 500))
    found = hats(u, v)
    assert sum(weight for _, weight in found) == pytest.approx(np.ones(500))
    for k, part in enumerate((u, v)):
        np.testing.assert_allclose(sum(index[k] * weight for index, weight in found), part, atol=1e-12)
    for (i, j), _ in found:
        assert len(np.unique(i % 2)) == len(np.unique(j % 2)) == 1


def test_margin_and_displacement() -> None:
    """A margin adds pixels on every side; content that moved by (2, -1) comes from that much to the left and below."""
    frame = Frame((1.5, -0.5), 30.0)
    x, y = frame.grid((4, 5))
    wide = frame.grid((4, 5), margin=2)
    np.testing.assert_array_equal(wide[0][2:-2, 2:-2], x)
    moved = frame.grid((4, 5), moved=np.broadcast_to([2.0, -1.0], (4, 5, 2)))
    np.testing.assert_allclose(moved[0][:3, 2:], x[1:, :3])
    np.testing.assert_allclose(moved[1][:3, 2:], y[1:, :3])
