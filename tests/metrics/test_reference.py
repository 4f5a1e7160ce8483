"""The known lattice, and what an output is compared with."""

from dataclasses import replace

import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.verdict.examination import examine
from nrbench.metrics.verdict.limits import SURE_SHARE
from nrbench.metrics.verdict.reference import (
    DRAWS,
    Reference,
    canonical_lattice,
    find_known_lattice,
    fold_reference,
    reference_from_sample,
)
from nrbench.metrics.verdict.verdict import compute_verdict
from nrbench.plugins.forms import Observation, Texture
from nrbench.running.phases import score_observation

from .conftest import MODELS, case


def reference_of(observation: Observation) -> Reference:
    """Return the reference of an observation."""
    reference = examine(observation).reference
    assert isinstance(reference, Reference)
    return reference


@pytest.mark.parametrize("name", MODELS)
def test_the_reference_of_a_model_is_its_ideal_image(name: str) -> None:
    """With the model, the periodic image is the ideal one, and no reference image equals an output."""
    reference = reference_of(case(name).observe(case(name).fresh()))
    assert reference.source == "model"
    np.testing.assert_array_equal(reference.periodic.image((70, 60)), case(name).again((70, 60), 0).ideal)  # type: ignore[union-attr]
    assert len(reference.images) == DRAWS
    first = case(name).fresh(160)
    assert not any(np.array_equal(each.image[:160, :160], first) for each in reference.images)
    assert reference.regular_share == case(name).model.regular_share


@pytest.mark.parametrize("name", MODELS)
def test_the_reference_of_a_sample_comes_near_the_ideal_image(name: str) -> None:
    """Without the model the mean tile resembles the ideal image, and the regular share is near that of the model."""
    reference = reference_of(case(name).observe(case(name).fresh(), model=False))
    assert reference.source == "sample"
    folded, ideal = reference.periodic.image((90, 90)), case(name).again((90, 90), 0).ideal  # type: ignore[union-attr]
    assert np.corrcoef(folded.ravel(), ideal.ravel())[0, 1] > 0.93
    assert reference.regular_share == pytest.approx(case(name).model.regular_share, abs=0.2)


def test_varying_pixels_weigh_less() -> None:
    """Joints, which are equal in all tiles, have larger weights than faces, which are not."""
    reference = reference_of(case("hexagon").observe(case("hexagon").fresh()))
    ideal, weights = reference.periodic.image((80, 80)).mean(-1), reference.periodic.weights((80, 80))
    joints = ideal >= np.quantile(ideal, 0.95)
    assert weights[joints].mean() > 2 * weights[~joints].mean()
    assert weights.mean() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("error", [-0.012, 0.012])
def test_a_lattice_that_is_a_little_off_is_fitted_to_the_sample(error: float) -> None:
    """An error of the vectors of 1.2 % is reduced to 0.3 % before the sample is folded."""
    true = case("brick").lattice
    true = true.reduced()
    off = Lattice(*((x * (1 + error), y * (1 + error)) for x, y in (true.t1, true.t2)))
    fitted = fold_reference(case("brick").fresh(256), off).lattice
    assert np.abs(fitted.matrix - true.matrix).max() < 0.003 * true.s


@pytest.mark.parametrize("name", ["regularity", "integrity", "randomness", "deformation", "geometry_appearance"])
def test_a_truth_without_a_lattice_is_not_applicable(name: str) -> None:
    """Without a lattice in the truth every column is None, with that reason."""
    observation = case("brick").observe(case("brick").fresh())
    score = score_observation(replace(observation, truth=Texture(observation.sample)), name)
    assert set(score.values.values()) == {None}
    assert set(score.reasons.values()) == {"not applicable: no lattice in the truth"}


def test_without_a_truth_there_is_no_reference() -> None:
    """An output of unknown origin has no reference."""
    observation = replace(case("brick").observe(case("brick").fresh()), truth=None)
    assert examine(observation).reference == "not applicable: no lattice in the truth"


@pytest.mark.parametrize("model", ["brick", "bent"])
@pytest.mark.parametrize("largest", [0, 400])
def test_without_fresh_draws_nothing_is_scored(model: str, largest: int) -> None:
    """A dataset that gives no fresh draw, or none as large as the output, leaves columns None with that reason."""
    wall = Brick(color=0.2, bend=0.3 if model == "bent" else 0.0)
    drawn = wall.render((128, 128), np.random.default_rng(0))
    output = wall.render((480, 480), np.random.default_rng(1)).image

    def again(shape: tuple[int, int], k: int) -> Texture | None:
        return wall.again(drawn, shape, np.random.default_rng(k)) if max(shape) <= largest else None

    observation = Observation(quantize(drawn.image), quantize(output), drawn, drawn.lattice, again=again)
    small = ("regularity", "quality") if not largest else ()  # these use draws that are smaller than the output
    for name in ("integrity", "randomness", *small):
        score = score_observation(observation, name)
        assert set(score.values.values()) == {None}, name
        assert all("no fresh draw" in reason for reason in score.reasons.values()), (name, score.reasons)


def test_each_part_of_a_sample_is_compared_with_the_rest() -> None:
    """If one half of the sample is darker, the template of the other half is darker, and not its own."""
    sample = np.array(case("brick").texture.image)
    sample[:, :64] *= 0.5
    first, last = fold_reference(sample, case("brick").lattice.reduced()).images
    assert first.image.mean() < 0.7 * first.periodic.image((60, 60)).mean()
    assert last.periodic.image((60, 60)).mean() < 0.7 * last.image.mean()


@pytest.mark.parametrize("name", MODELS)
def test_a_samples_regular_share_is_on_the_scale_of_its_models(name: str) -> None:
    """The regular share is corrected for the smoothing by folding and for the departures in a mean of few tiles."""
    image, lattice = case(name).fresh(256), case(name).lattice
    share = fold_reference(image, lattice).regular_share
    assert share == pytest.approx(case(name).model.regular_share, abs=0.06)
    periodic = case(name).again((256, 256), 0).ideal  # type: ignore[union-attr]
    assert fold_reference(quantize(periodic), lattice).regular_share > 0.97


def test_detail_is_compared_where_colors_hide_the_joints() -> None:
    """For bricks in different colors the detail is compared. A fresh draw is preserved, an enlarged sample is lost."""
    model = Brick(width=18, height=18, joint=2, bond="stack", color=0.9, intensity=0.3, noise=0.03)
    texture = model.render((128, 128), np.random.default_rng(0))
    sample, lattice = quantize(texture.image), texture.lattice
    fresh = model.again(texture, (256, 256), np.random.default_rng(1))
    assert lattice is not None
    assert fresh is not None
    reference = reference_from_sample(sample, lattice)
    assert reference.detail
    assert fold_reference(sample, lattice).regular_share < SURE_SHARE < reference.regular_share
    assert compute_verdict(quantize(fresh.image), reference).preserved is True
    enlarged = compute_verdict(np.repeat(np.repeat(sample, 2, 0), 2, 1), reference)
    assert enlarged.faults == ("many tiles fit better elsewhere",)


@pytest.mark.parametrize("model", [True, False])
def test_the_truth_comes_first(model: bool) -> None:
    """A lattice in the truth is taken; its origin names whether a model or a person knows it."""
    observation = case("brick").observe(case("brick").fresh(), model)
    known = find_known_lattice(replace(observation, lattice_used=Lattice((9, 0), (0, 9))))
    assert known.lattice is not None and observation.truth is not None and observation.truth.lattice is not None
    assert known.lattice.is_equivalent(observation.truth.lattice)
    assert known.origin == ("model" if model else "given")


@pytest.mark.parametrize("name", MODELS)
def test_without_a_truth_the_detector_finds_the_lattice(name: str) -> None:
    """Without a given lattice the detector finds it, a record names the detector, and a fresh draw is preserved."""
    one = case(name)
    observation = Observation(one.texture.image, one.fresh(), Texture(one.texture.image))
    known = find_known_lattice(observation)
    assert known.origin == "dominance" and known.lattice is not None and one.lattice is not None
    assert lattice_error(known.lattice, one.lattice, (128, 128)).relation == "exact"
    score = Regularity().score(observation)
    assert score.records["lattice_from"] == "dominance"
    assert score.values["preserved"] is True


def test_a_sample_without_a_lattice_is_not_applicable() -> None:
    """If the detector finds no lattice, every column is None, with that reason."""
    noise = np.random.default_rng(0).random((96, 96, 3), np.float32)
    score = Regularity().score(Observation(noise, noise, Texture(noise)))
    assert set(score.values.values()) == {None}
    assert all("dominance finds none" in reason for reason in score.reasons.values())


def test_a_stochastic_truth_has_no_lattice() -> None:
    """A texture whose truth is stochastic has no lattice, even if a detector finds one."""
    one = case("brick")
    observation = Observation(one.texture.image, one.fresh(), Texture(one.texture.image, kind="stochastic"))
    assert find_known_lattice(observation).lattice is None
    assert find_known_lattice(observation).reason == "not applicable: no lattice in the truth"


def test_a_lattice_has_one_description() -> None:
    """Other bases and origins of the same lattice have the same canonical form."""
    lattice = Lattice((20.0, 3.0), (-4.0, 17.0), (5.0, 2.0))
    other = Lattice((16.0, 20.0), (-20.0, -3.0), (5.0 + 3 * 20 - 8, 2.0 + 9 + 34))
    one, same = canonical_lattice(lattice), canonical_lattice(other)
    np.testing.assert_allclose(one.matrix, same.matrix, atol=1e-9)
    np.testing.assert_allclose(one.origin, same.origin, atol=1e-9)
