"""The verdict on textures whose geometry varies, and the tests of their displacement fields."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from nrbench.datasets_procedural.jigsaw import Jigsaw
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.datasets_procedural.overlap import Overlap
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.bending.covariance import Covariance, SampledField, Variogram
from nrbench.metrics.bending.field_tests import drop_outliers, measure_faults, smooth_field
from nrbench.metrics.quality import Quality
from nrbench.metrics.randomness import Randomness
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.verdict.bent import BentReference, compute_bent_verdict
from nrbench.metrics.verdict.examination import examine
from nrbench.plugins.forms import Observation

from .conftest import Case

BENT, STRONG = Weave(bend=0.5, color=0.2), Weave(bend=1.0, color=0.2, noise=0.03)
"""A bent texture, and one that is bent as much as models can."""
CASES = {BENT: (Case.of(BENT, 3, streams=4), 192), STRONG: (Case.of(STRONG, 6, streams=7), 224)}
"""Their samples, and the sides of their outputs in px."""


@cache
def fresh(model: Model = BENT) -> Observation:
    """Return an observation of a fresh draw."""
    own, side = CASES[model]
    return own.observe(own.fresh(side, 9))


@cache
def straight(model: Model) -> Observation:
    """Return an observation of a draw of the same texture without its displacements."""
    own, side = CASES[model]
    upright = replace(model, bend=0.0).again(own.texture, (side, side), np.random.default_rng(5))
    return own.observe(quantize(upright.image))


def sine_waves(rng: np.random.Generator, count: int = 16, spread: float = 0.12) -> SampledField:
    """Return a field of waves 5 s long, of standard deviation ``spread``, with errors of 0.02 s."""
    x, y = np.meshgrid(np.arange(count) * 0.9, np.arange(count) * 0.9)
    angles, phases = rng.uniform(0, 2 * np.pi, (2, 12, 2))
    along = x[..., np.newaxis, np.newaxis] * np.cos(angles) + y[..., np.newaxis, np.newaxis] * np.sin(angles)
    waves = np.cos(2 * np.pi * along / 5 + phases).sum(-2) * spread * np.sqrt(2 / 12)
    noisy = waves + rng.normal(0, 0.02, waves.shape)
    return SampledField(np.stack([x, y], -1), noisy, np.ones((count, count), np.bool_), np.ones((count, count)))


def crop(field: SampledField, box: tuple[slice, slice]) -> SampledField:
    """Return some rows and columns of a field."""
    return SampledField(field.places[box], field.displacement[box], field.reliable[box], field.error[box])


def test_the_covariance_of_known_waves() -> None:
    """The fitted covariance has the variance of the waves, and changes its sign at about half of their length."""
    rng = np.random.default_rng(0)
    covariance = Covariance.fit([sine_waves(rng) for _ in range(6)])
    at = covariance.between(np.zeros((1, 2)), np.array([[0.0, 0.0], [2.0, 0.0]]))[0]
    assert np.sqrt(at[0]) == pytest.approx(0.12, rel=0.2)
    assert at[1] < 0
    assert np.sqrt(covariance.noise) == pytest.approx(0.02, abs=0.02)


def test_a_step_in_a_field_is_found_and_measured() -> None:
    """A step of 0.25 s along a line has a statistic far above those of fields without a step, and its length."""
    rng = np.random.default_rng(1)
    covariance = Covariance.fit([sine_waves(rng) for _ in range(6)])
    field = sine_waves(rng)
    usual = measure_faults(field, covariance).lines
    beyond = (field.places @ (0.8, 0.6) > 8)[..., np.newaxis]
    lines = measure_faults(replace(field, displacement=field.displacement + beyond * (0.15, 0.2)), covariance).lines
    assert lines.statistic.max() > 10 * usual.statistic.max()
    assert lines.distance[lines.statistic.argmax()] == pytest.approx(0.25, abs=0.08)


def test_a_covariance_shows_short_waves_beside_strong_ones_and_missing_nodes() -> None:
    """Errors of 0.02 s are measured beside waves of 0.25 s, with a tenth of the nodes missing; none are invented."""
    rng = np.random.default_rng(4)
    fields = [sine_waves(rng, 18, 0.25) for _ in range(3)]
    fields = [replace(one, reliable=rng.random(one.reliable.shape) > 0.1) for one in fields]
    found = Covariance.fit(fields)
    short = np.geomspace(24, 1, len(found.weights)) < 2.5
    assert np.sqrt(found.variance) == pytest.approx(0.25, rel=0.25)
    assert 0.012 < np.sqrt(found.noise + found.weights[short].sum()) < 0.03


def test_nodes_of_larger_error_count_less() -> None:
    """Where the right half of a field has errors of 0.1 s, and says so, no step is found in it."""
    rng = np.random.default_rng(5)
    covariance = Covariance.fit([sine_waves(rng) for _ in range(6)])
    field = sine_waves(rng)
    errors = np.where(field.places[..., 0] > 7, 0.1, 0.0)
    worse = replace(field, displacement=field.displacement + rng.normal(0, 1, (*errors.shape, 2)) * errors[..., None])
    known = replace(worse, error=1 + errors**2 / covariance.noise)
    assert measure_faults(worse, covariance).lines.statistic.max() > 10
    assert measure_faults(known, covariance).lines.statistic.max() < 6


def test_a_rough_field_has_no_step_but_one_with_a_step_has() -> None:
    """Waves half as long and twice as high as in the references are no step if they count; a step still is one."""
    rng = np.random.default_rng(6)
    covariance = Covariance.fit([sine_waves(rng, spread=0.06) for _ in range(6)])
    field = sine_waves(rng, spread=0.06)
    rough = sine_waves(rng, 36, 0.12)
    rough = crop(replace(rough, places=rough.places / 2), np.s_[::2, ::2])
    assert measure_faults(rough, covariance).lines.statistic.max() > 20
    assert measure_faults(rough, covariance.extended_to(rough)).lines.statistic.max() < 8
    beyond = (field.places @ (0.0, 1.0) > 7)[..., np.newaxis]
    step = replace(field, displacement=field.displacement + beyond * (0.25, 0.0))
    lines = measure_faults(step, covariance.extended_to(step)).lines
    assert lines.statistic.max() > 20
    assert lines.distance[lines.statistic.argmax()] == pytest.approx(0.25, abs=0.06)


def test_waves_that_a_field_does_not_have_explain_no_step() -> None:
    """In a field of errors alone no step is made up of waves of 0.25 s that cancel one another."""
    rng = np.random.default_rng(7)
    covariance = Covariance.fit([sine_waves(rng, spread=0.25) for _ in range(6)])
    field = sine_waves(rng, spread=0.0)
    own = covariance.extended_to(field)
    assert own.variance < 0.1 * covariance.variance
    assert measure_faults(field, covariance).lines.distance.max() > 0.03
    assert measure_faults(field, own).lines.distance.max() < 0.02


def test_an_affine_part_of_a_field_is_no_fault() -> None:
    """Slopes of 4 % hardly change the statistics of lines and patches, and kriging continues them."""
    rng = np.random.default_rng(3)
    covariance = Covariance.fit([sine_waves(rng) for _ in range(6)])
    field = sine_waves(rng)
    slopes = np.array([[0.04, 0.01], [-0.02, -0.04]])
    steep = replace(field, displacement=field.displacement + field.places @ slopes)
    usual = measure_faults(field, covariance.extended_to(field))
    found = measure_faults(steep, covariance.extended_to(steep))
    assert found.lines.statistic.max() < 1.3 * usual.lines.statistic.max() + 1
    assert found.patches.statistic.max() < 1.3 * usual.patches.statistic.max() + 1
    beyond = field.places[-1, -1][np.newaxis] + 2
    change = smooth_field(steep, covariance.extended_to(steep), beyond) - smooth_field(field, covariance, beyond)
    assert change[0] == pytest.approx((beyond @ slopes)[0], abs=0.05)


def test_outliers_are_dropped_and_predicted() -> None:
    """Nodes on wrong places are dropped, and kriging predicts their displacements from the others."""
    rng = np.random.default_rng(2)
    covariance = Covariance.fit([sine_waves(rng) for _ in range(6)])
    field = sine_waves(rng)
    wrong = field.displacement.copy()
    wrong[5, 7] += 0.6
    kept = drop_outliers(replace(field, displacement=wrong), covariance)
    assert not kept.reliable[5, 7]
    assert kept.reliable.mean() > 0.9
    assert smooth_field(kept, covariance, field.places[5, 7][np.newaxis])[0] == pytest.approx(
        field.displacement[5, 7], abs=0.08
    )


def test_the_amplitude_does_not_depend_on_the_size_of_the_field() -> None:
    """The variogram of a large field and of its parts give nearly the same amplitude."""
    field = sine_waves(np.random.default_rng(3), 40)
    parts = [crop(field, np.s_[y : y + 13, x : x + 13]) for y in (0, 13, 26) for x in (0, 13, 26)]
    assert Variogram.of(parts).amplitude == pytest.approx(Variogram.of([field]).amplitude, rel=0.1)


def test_a_bent_fresh_draw_is_preserved() -> None:
    """A fresh draw is preserved with all tiles in place, and its displacements are as large as in others."""
    score = Regularity().score(fresh())
    assert score.values["preserved"] is True
    assert score.values["score"] > 0.98
    assert 0.7 < float(score.values["misplacement_ratio"] or 0) < 1.4
    assert score.pictures["defects"].shape[:2] == (192, 192)


@pytest.mark.parametrize("model", CASES)
def test_a_phase_step_in_a_bent_texture_is_lost(model: Model) -> None:
    """A phase step of 0.25 s, at most as large as the displacements of the texture, is found and measured."""
    own, side = CASES[model]
    score = Regularity().score(own.observe(own.planted("phase-step", 0.25, side=side)[0]))
    assert score.values["preserved"] is False
    assert score.records["excess"]["phase step"] > 1
    assert score.values["score"] < 0.9
    (sentence,) = (fault for fault in score.records["faults"] if fault.startswith("a phase step"))
    assert float(sentence.split()[-2]) == pytest.approx(0.25, abs=0.08)


@pytest.mark.parametrize("model", CASES)
def test_a_straightened_output_has_lost_randomness(model: Model) -> None:
    """An output without the displacements keeps its regularity; its amplitude shows that it is too regular."""
    score = Regularity().score(straight(model))
    assert score.values["preserved"] is True
    assert score.records["displacements"]["too_regular"] is True
    assert score.values["misplacement_ratio"] < 0.3
    assert Randomness().score(straight(model)).values["score"] < 0.4


def test_an_output_on_a_slightly_larger_lattice_has_no_phase_step() -> None:
    """Where all tiles are 4 % larger, as in a continued sample whose lattice departs, no step is found."""
    zoomed = ndimage.zoom(fresh().output, (1.04, 1.04, 1), order=3)[:192, :192]
    score = Regularity().score(CASES[BENT][0].observe(quantize(np.clip(zoomed, 0, 1))))
    assert score.values["preserved"] is True and score.records["excess"]["phase step"] < 1


def test_places_are_mapped_to_the_output() -> None:
    """The straightened output shows at a place what the output shows at the place that it is mapped to."""
    reference = examine(fresh()).reference
    assert isinstance(reference, BentReference)
    verdict = compute_bent_verdict(fresh().output, reference)
    places = np.array([[40.0, 50.0], [90.0, 70.0]])
    x, y = np.rint(verdict.locate_in_output(places)).astype(int).T
    straight_colors = verdict.output.image[50, 40], verdict.output.image[70, 90]
    assert np.abs(fresh().output[y, x] - straight_colors).mean() < 0.15


@pytest.mark.parametrize("model", CASES)
def test_the_chain_of_scores_speaks_on_a_bent_fresh_draw(model: Model) -> None:
    """Displacements of half a tile are followed: the draw is preserved, and all three perils have full scores."""
    score = Quality().score(fresh(model))
    assert Regularity().score(fresh(model)).values["preserved"] is True
    assert all(float(score.values[name] or 0) > 0.9 for name in ("score", "regularity", "integrity", "randomness"))


def shuffle_patches(image: Image) -> Image:
    """Return an image of random patches of 24 x 24 px of an image whose sides are multiples of 24 px."""
    rng, (height, width) = np.random.default_rng(13), image.shape[:2]
    result = np.empty_like(image)
    for y in range(0, height, 24):
        for x in range(0, width, 24):
            v, u = rng.integers(0, height - 23), rng.integers(0, width - 23)
            result[y : y + 24, x : x + 24] = image[v : v + 24, u : u + 24]
    return result


def test_rubble_is_lost_although_its_displacement_is_unknown() -> None:
    """Random patches of a texture of large bent tiles are lost: nothing of the output is left out of the verdict."""
    own = Case.of(Jigsaw(color=0.2, noise=0.03, bend=0.5), 11, streams=12)
    score = Regularity().score(own.observe(shuffle_patches(own.fresh())))
    assert score.values["preserved"] is False
    assert any(fault.startswith("the tile was not found") for fault in score.records["faults"])


def test_a_cell_larger_than_the_fresh_draws_is_undecided() -> None:
    """A bent texture whose fresh draws hold no two tiles gives a reason instead of an error."""
    own = Case.of(Overlap(color=0.2, bend=0.5), 11, streams=12)
    score = Regularity().score(own.observe(own.fresh(400)))
    assert score.values["preserved"] is None
    assert score.reasons["preserved"] == "undecided: the fresh draws are smaller than a window of 2 tiles"
