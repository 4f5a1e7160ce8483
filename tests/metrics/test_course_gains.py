from collections.abc import Callable

import numpy as np
import pytest

from nrbench.metrics.verdict.courses import course_gain_excess, course_gains
from nrbench.metrics.verdict.tiles import measure_tiles

from .conftest import MODELS, Case
from .test_tiles import measure

Cases = Callable[[str], Case]


@pytest.mark.parametrize("name", MODELS)
def test_courses_of_a_fresh_draw_fit_here(case: Cases, name: str) -> None:
    """No course of a fresh draw has a positive mean gain, and none exceeds the limits."""
    verdict = case(name).verdict(case(name).fresh(256))
    assert course_gains(verdict.output.tiles).max() < 0
    assert verdict.course_excess.max() < 0.3


def test_a_slipped_course_is_detected_in_its_place(case: Cases) -> None:
    """Only tiles within two tiles of the course that slid exceed the limits."""
    one = case("hexagon")
    image, field = one.planted("slipped-course", 0.3, seed=2, side=256)
    verdict = one.verdict(image)
    assert verdict.preserved is False
    bad = verdict.output.tiles.centers[verdict.course_excess > 1]
    rows = np.nonzero(field.any(-1))
    assert len(bad)
    nearest = np.abs(bad[:, 1:] - rows[0]).min(1)
    assert nearest.max() < 2 * one.texture.lattice.s  # type: ignore[union-attr]


def test_short_courses_are_left_out(case: Cases) -> None:
    """An image of one tile has no course, so no tile exceeds the limits."""
    one = case("hexagon")
    periodic = measure(one).periodic
    tiny = measure_tiles(one.fresh()[:34, :34], periodic, np.zeros(2))
    whole = measure_tiles(one.fresh(), periodic, np.zeros(2))
    assert len(tiny.here) and not np.isfinite(course_gains(tiny)).any()
    assert course_gain_excess(tiny, [whole]).tolist() == [0.0] * len(tiny.here)
