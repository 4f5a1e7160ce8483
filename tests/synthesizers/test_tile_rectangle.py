import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.rectangular_tiles.tile_rectangle import pixel_grid, rectangle_frame

SHAPE = (128, 150, 3)


@settings(max_examples=60, deadline=None)
@given(st.floats(8, 40), st.floats(0, math.pi), st.floats(0.7, 1.4), st.floats(1.05, 2.1), st.sampled_from([0.02, 0.1]))
def test_periods_are_lattice_vectors_at_nearly_a_right_angle(
    length: float, turn: float, ratio: float, angle: float, tolerance: float
) -> None:
    """Whatever the lattice: it is refused, or the tile's sides are its vectors, nearly at right angles."""
    other = ratio * length
    lattice = Lattice(
        (length * math.cos(turn), length * math.sin(turn)),
        (other * math.cos(turn + angle), other * math.sin(turn + angle)),
    )
    try:
        frame = rectangle_frame(lattice, SHAPE, tolerance, scale_down=True)
    except Refused as refusal:
        assert "less than two periods" in refusal.reason or "larger than the sample" in refusal.reason
        return
    assert np.abs(lattice.wrap(frame.periods)).max() < 1e-6 * length
    assert abs(np.linalg.det(frame.periods)) == pytest.approx(frame.cells * lattice.area)
    lengths = np.hypot(*frame.periods.T)
    skew = abs(frame.periods[0] @ frame.periods[1]) / lengths.max()
    assert skew <= 2.1 * tolerance * lattice.s + 1e-6
    assert frame.size == (int(lengths[1] + 0.05), int(lengths[0] + 0.05))
    assert abs(frame.periods[0, 0]) >= abs(frame.periods[0, 1]) - 2 * tolerance * lattice.s - 1e-6
    assert (np.abs(frame.periods).sum(0) <= (150.05, 128.05)).all()


def test_the_scaled_image_covers_the_sample_and_no_more() -> None:
    """Its pixels lie on the sample up to its last row and column; turned, the corners of its box lie outside."""
    upright = rectangle_frame(Lattice((21.37, 0), (0, 18.81)), SHAPE, 0.1, scale_down=True)
    at = upright.to_sample(pixel_grid(upright.shape))
    assert upright.first == (0, 0) and upright.holds(pixel_grid(upright.shape), SHAPE).all()
    assert (np.array([149, 127]) - at[-1, -1] < upright.steps.max()).all()
    turned = rectangle_frame(Lattice((20, 6), (-6, 20)), SHAPE, 0.1, scale_down=True)
    inside = turned.holds(pixel_grid(turned.shape), SHAPE)
    assert inside.sum() == pytest.approx(149 * 127 / abs(np.linalg.det(turned.steps)), rel=0.01) and not inside.all()


def test_a_period_just_under_a_whole_number_is_that_number() -> None:
    """29.97 px are 30, not 29; 29.9 px are 29: what is measured no better does not shrink a tile by a pixel."""
    for period, pixels in ((29.97, 30), (29.9, 29), (30.0, 30), (30.9, 30)):
        assert rectangle_frame(Lattice((period, 0), (0, 20)), SHAPE, 0.1, scale_down=True).size == (20, pixels)


def test_without_scale_down_steps_are_pixels_long() -> None:
    """The tile keeps the sample's scale, turned or not."""
    for lattice in (Lattice((21.37, 0), (0, 18.81)), Lattice((20.2, 6.1), (-6.1, 20.2))):
        assert rectangle_frame(lattice, SHAPE, 0.1, scale_down=False).scale == pytest.approx((1, 1))
    assert rectangle_frame(Lattice((21.37, 0), (0, 18.81)), SHAPE, 0.1, scale_down=False).plain


def test_patterns_finer_than_two_pixels_are_refused() -> None:
    """A tile of a pixel's width shows nothing."""
    with pytest.raises(Refused, match="less than 2 px"):
        rectangle_frame(Lattice((1.5, 0), (0, 20)), SHAPE, 0.1, scale_down=True)
