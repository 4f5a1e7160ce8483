import numpy as np
import pytest

from nrbench.imaging.convert import quantize
from nrbench.metrics.quality import LOST, Quality
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Score, Synthesizer, Task
from nrbench.synthesizers.random_phase import RandomPhase
from nrbench.synthesizers.scatter import Scatter
from nrbench.synthesizers.shuffle import Shuffle
from nrbench.synthesizers.supertile import Supertile
from nrbench.synthesizers.tiling import Tiling

from .conftest import MODELS, Case, case, copy_cells

PERILS = ("regularity", "integrity", "randomness")


def quality(observation: Observation) -> Score:
    """Return the score, and check that it is the smallest of the known perils."""
    score = Quality().score(observation)
    known = [score.values[name] for name in PERILS if score.values[name] is not None]
    assert score.values["score"] == min(known)
    assert score.values["score"] == score.values[score.records["worst"]]
    return score


def synthesis_task(case: Case, seed: int = 0) -> Task:
    """Return the task of a case, with its lattice."""
    return Task(case.texture.image, (208, 208), case.lattice, np.random.default_rng(seed), again=case.again)


@pytest.mark.parametrize("name", MODELS)
def test_fresh_draws_have_full_quality(name: str) -> None:
    """The mean quality of fresh draws is at least 0.95, in each peril."""
    scores = [quality(case(name).observe(case(name).fresh(208, k))).values for k in range(3)]
    for column in ("score", *PERILS):
        assert np.mean([one[column] for one in scores]) >= 0.95


@pytest.mark.parametrize("baseline", [Tiling(), Supertile(), Shuffle(), Scatter(), RandomPhase()])
@pytest.mark.parametrize("name", MODELS)
def test_baselines_have_little_quality(baseline: Synthesizer, name: str) -> None:
    """Each baseline avoids some perils and falls into another, so its quality is at most 0.25."""
    image = baseline.synthesize(synthesis_task(case(name))).image
    assert quality(case(name).observe(quantize(image))).values["score"] <= 0.25


@pytest.mark.parametrize("name", MODELS)
def test_hard_edged_copies_of_cells_have_little_quality(name: str) -> None:
    """Random cells with hard edges keep lattice and variation, but hardly any element is whole."""
    scores = quality(case(name).observe(copy_cells(synthesis_task(case(name))))).values
    assert scores["regularity"] > 0.9
    assert scores["score"] <= 0.2


def test_a_lost_lattice_counts_a_quarter() -> None:
    """After a phase step half of the tiles are in place; the regularity is a quarter of their share."""
    observation = case("brick").observe(case("brick").planted("phase-step", 0.3)[0])
    share = Regularity().score(observation).values["score"]
    assert quality(observation).values["regularity"] == LOST * share
    assert quality(observation).values["randomness"] is None


def test_no_quality_without_a_verdict() -> None:
    """If regularity is undecided all columns are None, with its reason."""
    observation = case("hexagon").observe(case("hexagon").fresh(60))
    score = Quality().score(observation)
    assert set(score.values.values()) == {None}
    assert all(reason.startswith("undecided") for reason in score.reasons.values())
