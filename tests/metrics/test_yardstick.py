from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nrbench.lattice.geometry import Lattice
from nrbench.metrics.yardstick import DRAWS, sample_yardstick, yardstick
from nrbench.texture import Texture

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
