"""The vertex of a parabola through three samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.imaging.subpixel import find_vertex


@given(st.floats(-0.5, 0.5), st.floats(0.01, 100), st.floats(-10, 10))
def test_the_vertex_of_a_parabola_is_found(place: float, bend: float, top: float) -> None:
    """Three samples of a parabola tell where its vertex is, and how high."""
    before, middle, after = (top - bend * (x - place) ** 2 for x in (-1, 0, 1))
    offset, rise = find_vertex(before, middle, after)
    assert offset == pytest.approx(place, abs=1e-6)
    assert middle + rise == pytest.approx(top, abs=1e-6)


def test_three_samples_without_a_maximum() -> None:
    """On a slope and in a valley the offset is 0, or half a step uphill where that is wanted."""
    before, middle, after = np.array([[0.0, 1.0, 3.0], [2.0, 1.0, 3.0], [3.0, 1.0, 0.0]]).T
    assert find_vertex(before, middle, after)[0].tolist() == [0, 0, 0]
    assert find_vertex(before, middle, after, climb=True)[0].tolist() == [0.5, 0.5, -0.5]


def test_equal_samples_have_their_vertex_in_the_middle() -> None:
    """A flat line neither moves nor rises."""
    assert [float(value) for value in find_vertex(1.0, 1.0, 1.0)] == [0, 0]
