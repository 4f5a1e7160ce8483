from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nrbench.lattice.comparison import lattice_error
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.verdict.reference import canonical_lattice, find_known_lattice
from nrbench.plugins.forms import Observation, Texture

from .conftest import MODELS, Case

Cases = Callable[[str], Case]


@pytest.mark.parametrize("model", [True, False])
def test_the_truth_comes_first(case: Cases, model: bool) -> None:
    """A lattice in the truth is taken, and it is said whether a model or a person knows it."""
    seen = case("brick").seen(case("brick").fresh(), model)
    found = find_known_lattice(replace(seen, lattice_used=Lattice((9, 0), (0, 9))))
    assert found.lattice is not None and seen.truth is not None and seen.truth.lattice is not None
    assert found.lattice.is_equivalent(seen.truth.lattice)
    assert found.origin == ("model" if model else "given")


@pytest.mark.parametrize("name", MODELS)
def test_without_a_truth_the_detector_is_asked(case: Cases, name: str) -> None:
    """Where nobody gives a lattice, the sample's is found, the row says by whom, and a fresh draw is preserved."""
    one = case(name)
    seen = Observation(one.texture.image, one.fresh(), Texture(one.texture.image))
    found = find_known_lattice(seen)
    assert found.origin == "dominance" and found.lattice is not None and one.texture.lattice is not None
    assert lattice_error(found.lattice, one.texture.lattice, (128, 128)).relation == "exact"
    score = Regularity().score(seen)
    assert score.records["lattice_from"] == "dominance"
    assert score.values["preserved"] is True


def test_a_sample_without_a_lattice_is_not_applicable() -> None:
    """Where the detector finds none either, every column is None and says so."""
    noise = np.random.default_rng(0).random((96, 96, 3), np.float32)
    score = Regularity().score(Observation(noise, noise, Texture(noise)))
    assert set(score.values.values()) == {None}
    assert all("dominance finds none" in reason for reason in score.reasons.values())


def test_a_stochastic_truth_is_believed(case: Cases) -> None:
    """A texture said to be stochastic has no lattice, whatever a detector would find."""
    one = case("brick")
    seen = Observation(one.texture.image, one.fresh(), Texture(one.texture.image, kind="stochastic"))
    assert find_known_lattice(seen).lattice is None
    assert find_known_lattice(seen).reason == "not applicable: no lattice in the truth"


def test_a_lattice_has_one_description() -> None:
    """Other bases and origins of the same lattice settle to the same numbers."""
    lattice = Lattice((20.0, 3.0), (-4.0, 17.0), (5.0, 2.0))
    other = Lattice((16.0, 20.0), (-20.0, -3.0), (5.0 + 3 * 20 - 8, 2.0 + 9 + 34))
    one, same = canonical_lattice(lattice), canonical_lattice(other)
    np.testing.assert_allclose(one.matrix, same.matrix, atol=1e-9)
    np.testing.assert_allclose(one.origin, same.origin, atol=1e-9)
