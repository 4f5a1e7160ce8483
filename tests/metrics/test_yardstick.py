from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.verdict.limits import SURE_SHARE
from nrbench.metrics.verdict.measurements import look_at_references
from nrbench.metrics.verdict.reference import DRAWS, best_yardstick, sample_yardstick, yardstick
from nrbench.metrics.verdict.verdict import compare
from nrbench.plugins.forms import Texture

from .conftest import MODELS, Case

Cases = Callable[[str], Case]


@pytest.mark.parametrize("name", MODELS)
def test_the_models_yardstick_is_its_ideal_image(case: Cases, name: str) -> None:
    """With the model, the periodic image is the ideal one, and the references are draws that no output is."""
    measure = yardstick(case(name).seen(case(name).fresh()))
    assert measure is not None
    assert measure.source == "model"
    np.testing.assert_array_equal(measure.periodic.image((70, 60)), case(name).again((70, 60), 0).ideal)  # type: ignore[union-attr]
    assert len(measure.references) == DRAWS
    first = case(name).fresh(160)
    assert not any(np.array_equal(reference.image[:160, :160], first) for reference in measure.references)
    assert measure.regular_share == case(name).model.regular_share


@pytest.mark.parametrize("name", MODELS)
def test_the_samples_yardstick_comes_near_the_ideal_image(case: Cases, name: str) -> None:
    """Without the model the mean tile resembles the ideal image, and the regular share is of the right size."""
    measure = yardstick(case(name).seen(case(name).fresh(), model=False))
    assert measure is not None
    assert measure.source == "sample"
    folded, ideal = measure.periodic.image((90, 90)), case(name).again((90, 90), 0).ideal  # type: ignore[union-attr]
    assert np.corrcoef(folded.ravel(), ideal.ravel())[0, 1] > 0.93
    assert measure.regular_share == pytest.approx(case(name).model.regular_share, abs=0.2)


def test_varying_pixels_weigh_less(case: Cases) -> None:
    """Joints, which are alike in all tiles, weigh more than faces, which are not."""
    measure = yardstick(case("hexagon").seen(case("hexagon").fresh()))
    assert measure is not None
    ideal, weights = measure.periodic.image((80, 80)).mean(-1), measure.periodic.weights((80, 80))
    joints = ideal >= np.quantile(ideal, 0.95)
    assert weights[joints].mean() > 2 * weights[~joints].mean()
    assert weights.mean() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("error", [-0.012, 0.012])
def test_a_lattice_that_is_a_little_off_is_fitted_to_the_sample(case: Cases, error: float) -> None:
    """Vectors off by 1.2 % are mended to 0.3 % before the sample is folded."""
    true = case("brick").texture.lattice
    assert true is not None
    true = true.reduced()
    off = Lattice(*((x * (1 + error), y * (1 + error)) for x, y in (true.t1, true.t2)))
    fitted = sample_yardstick(case("brick").fresh(256), off).lattice
    assert np.abs(fitted.matrix - true.matrix).max() < 0.003 * true.s


def test_a_truth_without_a_lattice_has_no_yardstick(case: Cases) -> None:
    """No lattice in the truth, or no truth: nothing to measure against."""
    seen = case("brick").seen(case("brick").fresh())
    assert yardstick(replace(seen, truth=Texture(seen.sample))) is None
    assert yardstick(replace(seen, truth=None)) is None


def test_each_part_of_a_sample_is_judged_by_the_rest(case: Cases) -> None:
    """A sample with a stain in one half: only the other half's template shows it."""
    sample = np.array(case("brick").texture.image)
    sample[:, :64] *= 0.5
    assert case("brick").texture.lattice is not None
    first, last = sample_yardstick(sample, case("brick").texture.lattice.reduced()).references
    assert first.image.mean() < 0.7 * first.periodic.image((60, 60)).mean()
    assert last.periodic.image((60, 60)).mean() < 0.7 * last.image.mean()


@pytest.mark.parametrize("name", MODELS)
def test_a_samples_regular_share_is_on_the_scale_of_its_models(case: Cases, name: str) -> None:
    """What folding smooths away, and what a mean of few tiles keeps of the departures, is made up for."""
    image, lattice = case(name).fresh(256), case(name).texture.lattice
    assert lattice is not None
    share = sample_yardstick(image, lattice).regular_share
    assert share == pytest.approx(case(name).model.regular_share, abs=0.06)
    periodic = case(name).again((256, 256), 0).ideal  # type: ignore[union-attr]
    assert sample_yardstick(quantize(periodic), lattice).regular_share > 0.97


def test_colors_that_swamp_the_joints_are_looked_through() -> None:
    """Of bricks in colors of their own the detail is judged: a fresh draw is preserved, one of twice the size lost."""
    model = Brick(width=18, height=18, joint=2, bond="stack", color=0.9, intensity=0.3, noise=0.03)
    texture = model.render((128, 128), np.random.default_rng(0))
    sample, lattice = quantize(texture.image), texture.lattice
    fresh = model.again(texture, (256, 256), np.random.default_rng(1))
    assert lattice is not None
    assert fresh is not None
    measure = best_yardstick(sample, lattice)
    assert measure.detail
    assert sample_yardstick(sample, lattice).regular_share < SURE_SHARE < measure.regular_share
    looks = look_at_references(measure)
    assert compare(quantize(fresh.image), measure, looks).preserved is True
    enlarged = compare(np.repeat(np.repeat(sample, 2, 0), 2, 1), measure, looks)
    assert enlarged.faults == ("many tiles fit better elsewhere",)
