import dataclasses
import math

import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.lattice_recovery import LatticeRecovery
from nrbench.plugins.forms import FoundLattice, Metric, Observation, Texture

TRUTH = Lattice((20.0, 0.0), (10.0, 12.0))
SAMPLE, OUTPUT = np.zeros((64, 64, 3), np.float32), np.zeros((200, 300, 3), np.float32)


def observed(used: Lattice | None, truth: Lattice | None = TRUTH) -> Observation:
    """Return an observation of a method that used a lattice."""
    return Observation(SAMPLE, OUTPUT, Texture(SAMPLE, truth), lattice_used=used)


def test_the_true_lattice_is_exact() -> None:
    """The true lattice in another basis is exact: index 1, no error."""
    score = LatticeRecovery().score(observed(Lattice((10.0, 12.0), (-10.0, 12.0))))
    assert score.values["exact"] is True and score.values["index"] == 1
    assert score.values["vector_error"] == pytest.approx(0) and score.values["drift"] == pytest.approx(0, abs=1e-9)
    assert score.records == {"class": "exact"} and set(score.reasons) == {"found", "confidence"}


def test_a_supercell_has_its_index() -> None:
    """A lattice of twice the cell is not exact: index and area ratio are 2."""
    score = LatticeRecovery().score(observed(Lattice((20.0, 0.0), (0.0, 24.0))))
    assert score.values["exact"] is False and score.values["index"] == 2
    assert score.values["area_ratio"] == pytest.approx(2) and score.records["class"] == "supercell 2"


def test_drift_is_over_the_output() -> None:
    """Drift is measured across the output: an error of 1 % is 3 px over its 300 px."""
    score = LatticeRecovery().score(observed(Lattice((20.2, 0.0), (10.1, 12.0))))
    assert score.values["drift"] == pytest.approx(3.0)


def test_a_wrong_lattice_has_no_index() -> None:
    """A wrong lattice has no index, with a reason, but it has an error."""
    score = LatticeRecovery().score(observed(Lattice((23.0, 3.0), (-5.0, 15.0))))
    assert score.values["index"] is None and "wrong" in score.reasons["index"]
    assert score.values["exact"] is False and score.values["vector_error"] > 1  # type: ignore[operator]


@pytest.mark.parametrize(("used", "truth", "reason"), [(TRUTH, None, "truth"), (None, TRUTH, "method")])
def test_without_a_lattice_nothing_is_scored(used: Lattice | None, truth: Lattice | None, reason: str) -> None:
    """Without a lattice every column is None, and the reason says whether truth or method has none."""
    score = LatticeRecovery().score(observed(used, truth))
    assert set(score.values) == set(LatticeRecovery.columns) == set(score.reasons)
    compared = [text for name, text in score.reasons.items() if name not in ("found", "confidence")]
    assert set(score.values.values()) == {None} and all(reason in text for text in compared)


def test_a_detectors_lattice_comes_with_its_confidence() -> None:
    """The answer of the detector stands beside the comparison."""
    observation = dataclasses.replace(observed(TRUTH), detected=FoundLattice(TRUTH, 0.1, confidence=0.75))
    score = LatticeRecovery().score(observation)
    assert (score.values["found"], score.values["confidence"], score.values["exact"]) == (True, 0.75, True)
    assert not score.reasons


def test_no_lattice_is_an_answer() -> None:
    """A detector that finds no lattice is not exact if there is one, and has no value if there is none."""
    none = FoundLattice(None, 0.1, "no better than chance")
    missed = LatticeRecovery().score(dataclasses.replace(observed(None), detected=none))
    assert (missed.values["found"], missed.values["exact"], missed.values["vector_error"]) == (False, False, None)
    assert "no better than chance" in missed.reasons["confidence"]
    right = LatticeRecovery().score(dataclasses.replace(observed(None, truth=None), detected=none))
    assert (right.values["found"], right.values["exact"]) == (False, None)


def test_without_a_truth_nothing_is_scored() -> None:
    """An output of unknown origin has no true lattice."""
    score = LatticeRecovery().score(Observation(SAMPLE, OUTPUT, lattice_used=TRUTH))
    assert set(score.values.values()) == {None}


def test_it_is_a_metric() -> None:
    """Lattice recovery has the form of a metric, and refuses a tolerance that is not a number."""
    assert isinstance(LatticeRecovery(), Metric)
    with pytest.raises(BadInput, match="above 0"):
        LatticeRecovery(tolerance=math.nan)
