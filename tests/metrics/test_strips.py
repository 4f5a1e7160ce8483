from collections.abc import Callable

import numpy as np
import pytest

from nrbench.metrics import limits
from nrbench.metrics.judgement import judge
from nrbench.metrics.scatter import scatter_suspicion
from nrbench.metrics.strips import strip_suspicion, strips

from .conftest import MODELS, Case
from .test_tiles import measure

Cases = Callable[[str], Case]


@pytest.mark.parametrize("name", MODELS)
def test_no_course_of_a_fresh_draw_has_slid(case: Cases, name: str) -> None:
    """No course of a fresh draw fits elsewhere as well as in its place, and none is suspected."""
    judgement = judge(case(name).seen(case(name).fresh(256)))
    assert judgement is not None
    seen = judgement.output.strips
    assert max(gain.max() for gain in seen.gain) < limits.STRIP_GAIN
    own = [look.strips for look in judgement.references]
    assert strip_suspicion(seen, own, judgement.output.tiles, 0.9).max() < 0.8


@pytest.mark.parametrize("name", MODELS)
def test_a_course_that_slid_by_little_is_seen(case: Cases, name: str) -> None:
    """A course that slid by 0.15 s, within most of its windows' tolerance, is called lost."""
    image, _ = case(name).planted("slipped-course", 0.15, seed=2, side=256)
    judgement = judge(case(name).seen(image))
    assert judgement is not None and judgement.preserved is False
    assert "a course of tiles has slid" in judgement.faults


@pytest.mark.parametrize("name", MODELS)
def test_bent_content_is_seen(case: Cases, name: str) -> None:
    """A warp of 0.15 s at most scatters windows more than fresh draws do; a fresh draw does not."""
    one = case(name)
    bent = judge(one.seen(one.planted("warp", 0.15, seed=2, side=256)[0]))
    assert bent is not None and "the content is bent" in bent.faults
    right = judge(one.seen(one.fresh(256, 1)))
    assert right is not None
    references = [look.placement for look in right.references]
    assert scatter_suspicion(right.output.placement, references) < 0.6


def test_courses_follow_the_lattice_origin(case: Cases) -> None:
    """Moving the origin by a lattice vector renumbers the courses and changes no gain."""
    one = case("brick")
    periodic, image = measure(one).periodic, one.fresh(128)
    lattice = periodic.lattice
    away = lattice.from_cell((2.0, -1.0)) - lattice.from_cell((0.0, 0.0))
    here, there = strips(image, lattice, periodic), strips(image, lattice.shifted((away[0], away[1])), periodic)
    for first, second in zip(here.gain, there.gain, strict=True):
        seen = np.isfinite(first)
        assert len(first) == len(second) and np.allclose(first[seen], second[np.isfinite(second)], atol=0.02)
