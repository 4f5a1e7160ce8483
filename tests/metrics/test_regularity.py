"""Regularity: tiles in place, slips, drift and bending."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from cases import Case, case, scored

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.integrity import Integrity
from nrbench.metrics.judgment.examination import examine
from nrbench.metrics.judgment.known_lattice import declared_drift
from nrbench.metrics.regularity import Regularity
from nrbench.synthesizers.representative_tile import RepresentativeTile

regularity = partial(scored, Regularity)


@pytest.mark.parametrize("model", [True, False])
def test_a_fresh_draw_is_preserved(own: Case, model: bool) -> None:
    """All tiles of a fresh draw are in place, to a twentieth of s, and its own lattice is the true one."""
    values = regularity(own.observe(own.fresh(), model)).values
    assert values["preserved"] is True and values["score"] == pytest.approx(1, abs=0.02)
    assert values["misplacement_p95"] < 0.06 and values["torn_share"] < 0.01
    assert values["lattice_exact"] is True and values["lattice_area_ratio"] == pytest.approx(1, abs=0.01)
    assert values["drift"] < 0.5


@pytest.mark.parametrize(
    ("kind", "size", "most"),
    [
        ("phase-step", 0.3, 0.15),
        ("slipped-course", 0.3, 0.9),
        ("dropped-row", 0.4, 0.7),
        ("doubled-row", 0.4, 0.6),
        ("off-lattice", 0.15, 0.2),
        ("off-lattice", 0.3, 0.05),
        ("warp", 0.4, 0.65),
        ("stretch", 0.04, 0.7),
        ("stretch", 0.08, 0.05),
    ],
)
def test_planted_faults_lower_the_score(own: Case, kind: str, size: float, most: float) -> None:
    """Slips, missing rows, patches off the lattice, strong warps and stretches lower the score by their share."""
    values = regularity(own.observe(own.planted(kind, size)[0])).values
    assert values["score"] <= most
    assert values["preserved"] is (values["score"] >= 0.85)


@pytest.mark.parametrize(
    ("kind", "size"), [("warp", 0.1), ("stretch", 0.01), ("two-tone", 0.3), ("over-regular", 1.0), ("blur", 1.0)]
)
def test_other_faults_leave_the_tiles_in_place(own: Case, kind: str, size: float) -> None:
    """Small drifts and warps, broken, equal and blurred tiles lose no regularity."""
    values = regularity(own.observe(own.planted(kind, size)[0])).values
    assert values["preserved"] is True and values["score"] >= 0.95


def test_the_score_falls_steadily(own: Case) -> None:
    """With the distance of a slip of half the picture the score falls from 1 to nearly 0, without a rise."""
    sizes = (0.0, 0.06, 0.12, 0.18, 0.24, 0.3)
    scores = [regularity(own.observe(own.planted("phase-step", size)[0])).values["score"] for size in sizes]
    assert scores[0] > 0.98 and scores[-1] < 0.15
    assert np.diff(scores).max() < 0.03


@pytest.mark.parametrize("name", ["weave", "hexagon"])
def test_one_displaced_tile_is_found_where_it_is(name: str) -> None:
    """One displaced tile lowers the score by its share, and the picture marks it and nothing else."""
    image, field = case(name).planted("displaced-tile", 0.35, seed=0)
    score = regularity(case(name).observe(image))
    assert 0.95 < score.values["score"] < 0.998
    y, x = np.nonzero(field.any(-1))
    center = np.array([x.mean(), y.mean()])
    y, x = np.nonzero(np.ptp(score.pictures["defects"], axis=-1) > 0.05)
    assert len(x) and np.hypot(x - center[0], y - center[1]).max() < 2 * case(name).lattice.s


def test_a_stretch_is_reported_and_forgiven_up_to_its_uncertainty() -> None:
    """A stretch of 1 % and a turn of half a degree are drift and no fault; one of 8 % is another lattice."""
    own = case("hexagon")
    stretched = regularity(own.observe(own.edited("larger, share", 0.01))).values
    turned = regularity(own.observe(own.edited("turned, degrees", 0.5))).values
    assert stretched["drift"] == pytest.approx(1, abs=0.15) and stretched["score"] >= 0.97
    assert turned["drift"] == pytest.approx(100 * np.radians(0.5), abs=0.15) and turned["score"] >= 0.97
    assert stretched["lattice_area_ratio"] == pytest.approx(1.02, abs=0.005)
    assert stretched["lattice_exact"] is True


def test_an_output_is_judged_by_the_lattice_that_it_declares() -> None:
    """A declared drift of 4 % keeps the lattice, also by a supercell; false declarations do not count."""
    own, (t1, t2) = case("hexagon"), case("hexagon").lattice.matrix
    true, shape = own.lattice, (192, 192)
    output = own.edited("larger, share", 0.04)
    made = 1.04 * t1, 1.04 * t2
    for declared, preserved in ((made, True), ((made[0] + made[1], 2 * made[1]), True), ((t1, t2), False)):
        observation = replace(own.observe(output), lattice_used=Lattice.from_basis(np.stack(declared)))
        assert regularity(observation).values["preserved"] is preserved
    drift = declared_drift(Lattice.from_basis(np.stack([made[0] - made[1], 2 * made[1]])), true, shape)
    assert drift == pytest.approx(0.04 * np.eye(2), abs=1e-9)
    for nonsense in ((made[0] / 2, made[1]), (1.5 * t1, t2), (t1[::-1], 3.1 * t2), (1.08 * t1, 1.08 * t2)):
        assert not declared_drift(Lattice.from_basis(np.stack(nonsense)), true, shape).any()
    assert not declared_drift(None, true, shape).any()


@pytest.mark.parametrize(
    "model", [Weave(warp=8.45, weft=9.9), Weave(warp=10.45, weft=11.45), Brick(17.9, 8.45), Hexagon(17.9)]
)
def test_a_perfect_wallpaper_of_rounded_periods_is_preserved(model: Model) -> None:
    """A drift of 4 to 6 % by whole pixels puts no tile out of place for who declares it, with a model or without."""
    own, method = Case.of(model, 5), RepresentativeTile(**RepresentativeTile.presets["paper"])
    made = method.synthesize(own.task())
    for by_model in (True, False):
        observation = own.observe(quantize(made.image), by_model)
        declared = regularity(replace(observation, lattice_used=made.lattice)).values
        assert declared["score"] > 0.98 and declared["worst_slip"] < 0.05 and declared["drift"] > 4
        assert regularity(observation).values["preserved"] is False


def test_a_stretched_output_is_judged_by_any_basis_of_its_declared_lattice(own: Case) -> None:
    """Fresh draws stretched by 1.045 or .96 are in place on the declared lattice, however skewed, for all perils."""
    for factor in (1.045, 0.96):
        output = own.edited("larger, share", factor - 1)
        used = Lattice.from_basis(np.array([[1, 0], [20, 1]]) @ own.lattice.matrix * factor)
        assert declared_drift(used, own.lattice, (192, 192)) == pytest.approx((factor - 1) * np.eye(2), abs=1e-6)
        observation = replace(own.observe(output), lattice_used=used)
        values = regularity(observation).values
        assert values["score"] > 0.98 and values["drift"] == pytest.approx(100 * abs(factor - 1), abs=0.3)
        assert examine(observation).misplaced == values["misplaced_share"] == 0
        assert scored(Integrity, observation).values["score"] != 0


def test_a_declared_lattice_excuses_no_fault(own: Case) -> None:
    """Slips count on the declared lattice as on the true one, and a lattice that the output lacks changes nothing."""
    slipped = own.planted("phase-step", 0.25)[0]
    plain = regularity(own.observe(slipped)).values
    for factor in (0.96, 1.045):
        used = Lattice.from_basis(own.lattice.matrix * factor)
        assert regularity(replace(own.observe(slipped), lattice_used=used)).values == plain
        drifted = replace(own.observe(own.edited("larger, share", factor - 1, image=slipped)), lattice_used=used)
        assert regularity(drifted).values["score"] < 0.4


@pytest.mark.parametrize("model", [True, False])
def test_an_output_without_the_texture_is_lost(own: Case, model: bool) -> None:
    """White noise has no lattice."""
    image = quantize(np.random.default_rng(0).random((192, 192, 3), np.float32))
    values = regularity(own.observe(image, model)).values
    assert values["preserved"] is False and values["score"] < 0.2


def test_bending_is_compared_with_the_references() -> None:
    """The bending of a fresh draw is about that of the references, a straight output has less; both are preserved."""
    model = Weave(color=0.15, noise=0.02, bend=0.8)
    own = Case.of(model, 5)
    straight = Case(Weave(color=0.15, noise=0.02, bend=0.0), own.texture).fresh()
    bent, plain = (regularity(own.observe(image)).values for image in (own.fresh(), straight))
    assert bent["misplacement_ratio"] == pytest.approx(1, abs=0.4) and bent["preserved"] is True
    assert plain["misplacement_ratio"] < 0.5 and plain["preserved"] is True
    reasons = regularity(case("hexagon").observe(case("hexagon").fresh())).reasons
    assert "does not vary" in reasons["misplacement_ratio"]


def test_a_texture_that_hides_its_lattice_is_undecided() -> None:
    """If chance puts a third of a fresh draw out of place, score and verdict are None, with that reason."""
    own = Case.of(Brick(color=1, intensity=1, noise=0.5, joint=1), 5)
    score = regularity(own.observe(own.fresh()))
    assert score.records["expected_share"] > 0.35
    assert score.values["score"] is None and score.values["preserved"] is None
    assert "out of place" in score.reasons["score"]
