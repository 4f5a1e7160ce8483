"""Phase coherence: the lattice of an output, by matches of its places with those of the sample alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cases import Case, case

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.squares import Squares
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.judgment.known_lattice import canonical_lattice
from nrbench.metrics.perception.visible import perceive, perceive_sample
from nrbench.metrics.quality import Quality
from nrbench.metrics.registration.coherence import MatchedPicture, match_sample
from nrbench.metrics.registration.lattice_net import sample_planes
from nrbench.metrics.registration.lattice_nodes import find_lengths
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Score

MODELS: dict[str, tuple[Model, int]] = {
    "wall": (Brick(width=34, height=17, joint=2, color=0.3, noise=0.05), 160),
    "tiles": (Squares(period=73.0, color=0.3, noise=0.1), 256),
}


@cache
def photograph(name: str) -> Case:
    """Return a texture that is judged by its sample alone."""
    model, side = MODELS[name]
    return Case.of(model, 3, side)


def judge(own: Case, output: Image) -> Score:
    """Return the regularity of an output, judged by the sample alone."""
    return Regularity().score(own.observe(output, model=False))


def slip(image: Image, share: float, own: Case) -> Image:
    """Return a picture whose lower half is moved by a share of s."""
    lower = image.copy()
    half = len(image) // 2
    lower[half:] = np.roll(image[half:], round(share * own.lattice.s), axis=1)
    return lower


def follow(own: Case, output: Image) -> MatchedPicture:
    """Return an output followed by matches."""
    followed = match_sample(perceive_sample(own.texture.image), canonical_lattice(own.lattice)).follow(perceive(output))
    assert followed is not None
    return followed


@pytest.mark.parametrize("name", MODELS)
def test_a_fresh_draw_is_preserved_and_a_slipped_one_is_lost(name: str) -> None:
    """By the sample alone a fresh draw is preserved, half of it moved by .3 s is not, also at 3.5 cells a side."""
    own = photograph(name)
    fresh = own.fresh(256)
    assert judge(own, fresh).values["preserved"] is True
    score = judge(own, slip(fresh, 0.3, own))
    assert score.values["preserved"] is False and score.values["score"] < 0.4
    assert set(score.records["misplaced_shares"]) >= {"coherence"} and score.pictures.keys() == {"defects"}


@pytest.mark.parametrize("name", MODELS)
def test_displacements_are_those_of_the_picture(name: str) -> None:
    """The two halves of a slipped picture lie as far apart as they were moved, to .05 s."""
    own = photograph(name)
    followed = follow(own, slip(own.fresh(256), 0.3, own))
    middle, s = followed.centers[..., 1], own.lattice.s
    upper, lower = (followed.valid & (side > 0.75 * s) for side in (128 - middle, middle - 128))
    turns = [np.exp(2j * np.pi * followed.displacement[part]).mean(0) for part in (lower, upper)]
    apart = np.angle(turns[0] / turns[1]) / (2 * np.pi)
    assert find_lengths(apart, followed.net.vectors) == pytest.approx(0.3 * s, abs=0.05 * s)


def test_four_cells_are_enough_and_three_are_not() -> None:
    """A sample of 2 x 2 cells is judged, the quality too; one of 2 x 1.4 cells is undecided."""
    own = photograph("tiles")
    small = Case(own.model, replace(own.texture, image=np.ascontiguousarray(own.texture.image[:146, :146])))
    score = Quality().score(small.observe(own.fresh(256), model=False))
    assert score.values["regularity"] is not None and score.values["complete"] is False
    tiny = np.ascontiguousarray(own.texture.image[:146, :100])
    assert match_sample(perceive_sample(tiny), canonical_lattice(own.lattice)).picture is None


def test_smooth_bending_and_unseen_edits_keep_the_lattice() -> None:
    """A bend of .1 s, grain of 4 levels, and a change of light leave a wall preserved."""
    own = photograph("wall")
    fresh = own.fresh(256)
    y, x = np.mgrid[:256, :256].astype(float)
    bent = sample_planes(fresh, np.stack([x + 0.1 * own.lattice.s * np.sin(y / 40), y], -1))
    grain = fresh + np.random.default_rng(0).normal(0, 4 / 255, fresh.shape)
    for output in (bent, grain, fresh * 0.9):
        image = quantize(np.clip(np.asarray(output, np.float32), 0, 1))
        assert judge(own, image).values["preserved"] is True


def test_a_sample_without_the_lattice_is_undecided() -> None:
    """Places of white noise match at no phase: nothing can be told."""
    noise = quantize(np.random.default_rng(1).random((160, 160, 3), np.float32))
    assert match_sample(perceive_sample(noise), Lattice((30.0, 0.0), (0.0, 30.0))).picture is None


def test_with_a_model_registration_decides_alone() -> None:
    """Fresh draws of a model show more than one sample does: matches are not used."""
    own = case("brick")
    score = Regularity().score(own.observe(own.fresh()))
    assert score.records["decided_by"] == "registration" and score.records["misplaced_shares"].keys() == {
        "registration"
    }
