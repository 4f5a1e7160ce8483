"""G and A of textures with known departures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from nrbench.datasets_procedural.weave import Weave
from nrbench.metrics.geometry_appearance import GeometryAppearance
from nrbench.plugins.forms import Metric, Texture

from .conftest import Case
from .test_deformation import make_observation

Cases = Callable[[str], Case]
PLAIN = Weave(color=0.0, intensity=0.0, noise=0.0)


def test_a_perfect_texture_has_neither() -> None:
    """Identical tiles on a regular lattice have a G under 0.01 s and an A under the error of resampling."""
    values = GeometryAppearance().score(make_observation(PLAIN)).values
    assert isinstance(GeometryAppearance(), Metric) and set(values) == set(GeometryAppearance.columns)
    assert values["g"] is not None and values["a"] is not None
    assert values["g"] < 0.01 and values["a"] < 0.02


def test_appearance_measures_noise() -> None:
    """A is the standard deviation of grain, less what bilinear resampling removes, and G stays small."""
    values = GeometryAppearance().score(make_observation(replace(PLAIN, noise=0.08))).values
    assert values["a"] is not None and values["g"] is not None
    assert 0.05 < values["a"] < 0.08
    assert values["g"] < 0.02


def test_each_score_responds_to_its_own_departure() -> None:
    """Color changes A and hardly G; a warp changes G and hardly A."""
    g, a = [], []
    for departure in ({}, {"color": 0.2}, {"color": 0.4}, {"bend": 0.2}, {"bend": 0.4}):
        values = GeometryAppearance().score(make_observation(Weave(noise=0.02, **{"color": 0.1, **departure}))).values
        g.append(values["g"])
        a.append(values["a"])
    assert a[0] < a[1] < a[2] and a[2] > 2 * a[0]
    assert g[0] < g[3] < g[4] and g[4] > 5 * g[0]
    assert max(g[1:3]) < 0.03 and max(a[3:]) < 1.3 * a[0]


def test_one_tile_repeated_lacks_appearance(case: Cases) -> None:
    """The A ratio of one tile repeated is far below 1, that of a fresh draw near 1."""
    one = case("hexagon")
    drawn = one.again((192, 192), 0)
    assert drawn is not None and drawn.ideal is not None
    fresh, paper = (GeometryAppearance().score(one.observe(image)).values for image in (drawn.image, drawn.ideal))
    assert fresh["a_ratio"] == pytest.approx(1, abs=0.25)
    assert paper["a_ratio"] is not None and paper["a_ratio"] < 0.3


def test_no_lattice_is_not_applicable(case: Cases) -> None:
    """Without a lattice every column is None, with that reason."""
    one = case("brick").observe(case("brick").fresh())
    score = GeometryAppearance().score(replace(one, truth=Texture(one.sample)))
    assert set(score.values.values()) == {None}
    assert set(score.reasons.values()) == {"not applicable: no lattice in the truth"}
