from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.verdict.reference import canonical_lattice, find_known_lattice
from nrbench.plugins.forms import Observation, Texture

from .conftest import MODELS, Case

Cases = Callable[[str], Case]


@pytest.mark.parametrize("model", [True, False])
def test_the_truth_comes_first(case: Cases, model: bool) -> None:
    """A lattice in the truth is taken, and it is said whether a model or a person knows it."""
    observation = case("brick").observe(case("brick").fresh(), model)
    known = find_known_lattice(replace(observation, lattice_used=Lattice((9, 0), (0, 9))))
    assert known.lattice is not None and observation.truth is not None and observation.truth.lattice is not None
    assert known.lattice.is_equivalent(observation.truth.lattice)
    assert known.origin == ("model" if model else "given")


@pytest.mark.parametrize("name", MODELS)
def test_without_a_truth_the_detector_finds_the_lattice(case: Cases, name: str) -> None:
    """Without a given lattice the detector finds it, a record names the detector, and a fresh draw is preserved."""
    one = case(name)
    observation = Observation(one.texture.image, one.fresh(), Texture(one.texture.image))
    known = find_known_lattice(observation)
    assert known.origin == "dominance" and known.lattice is not None and one.texture.lattice is not None
    assert lattice_error(known.lattice, one.texture.lattice, (128, 128)).relation == "exact"
    score = Regularity().score(observation)
    assert score.records["lattice_from"] == "dominance"
    assert score.values["preserved"] is True


def test_a_sample_without_a_lattice_is_not_applicable() -> None:
    """If the detector finds no lattice, every column is None, with that reason."""
    noise = np.random.default_rng(0).random((96, 96, 3), np.float32)
    score = Regularity().score(Observation(noise, noise, Texture(noise)))
    assert set(score.values.values()) == {None}
    assert all("dominance finds none" in reason for reason in score.reasons.values())


def test_a_stochastic_truth_has_no_lattice(case: Cases) -> None:
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
