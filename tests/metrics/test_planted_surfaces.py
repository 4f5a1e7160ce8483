"""Claims about planted wrong surfaces, new colors and torn elements: each lowers the peril that it stands for."""

from functools import cache

import pytest
from cases import Case

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.cans import Cans
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.metrics.quality import Quality

MODELS: dict[str, Model] = {
    "clay": Brick(color=0.2, material="clay"),
    "cloth": Weave(color=0.2, material="cloth", rotation=20),
    "flat": Brick(color=0.2, noise=0.03),
    "inks": Hexagon(period=26.2, joint=2.4, inks=3, color=0.45, noise=0.01),
    "cans": Cans(period=26.3, color=0.0, intensity=0.04, noise=0.02),
}


case = cache(lambda name: Case.of(MODELS[name], 3))


def judged(name: str, kind: str, size: float) -> dict[str, float]:
    """Return quality and perils of a fresh draw with a defect."""
    own = case(name)
    return Quality().score(own.observe(own.planted(kind, size, 1)[0])).values


@pytest.mark.parametrize("name", ["clay", "cloth"])
def test_a_wrong_surface_costs_appearance_on_a_material(name: str) -> None:
    """The more detail is replaced by grain of equal power, the less appearance is left; the lattice stays."""
    scores = [judged(name, "wrong-surface", size)["appearance"] for size in (0.0, 0.5, 1.0)]
    assert scores[0] >= 0.95 and scores == sorted(scores, reverse=True) and scores[2] <= 0.3
    assert judged(name, "wrong-surface", 1.0)["regularity"] >= 0.95


def test_a_wrong_surface_is_none_where_the_detail_is_grain() -> None:
    """On a flat model, grain in place of grain costs nothing."""
    assert judged("flat", "wrong-surface", 1.0)["score"] >= 0.85


@pytest.mark.parametrize("name", ["inks", "flat", "clay"])
def test_new_colors_cost_appearance(name: str) -> None:
    """Some elements of a color that no element has cost appearance: the fresh draw itself does not."""
    fresh, few = (judged(name, "new-color", size)["appearance"] for size in (0.0, 0.1))
    assert fresh >= 0.95 and few <= 0.3


def test_torn_cans_are_seen() -> None:
    """Where elements are alike, torn ones cost quality by their share."""
    scores = [judged("cans", "torn", size)["score"] for size in (0.0, 0.1, 0.3)]
    assert scores[0] >= 0.85 and scores == sorted(scores, reverse=True) and scores[2] <= 0.4
