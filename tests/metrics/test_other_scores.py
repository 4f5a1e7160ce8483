"""Cost, lattice recovery and the use of the sample; every metric fulfils every clause of its form."""

import dataclasses
import math

import numpy as np
import pytest
from conformance import violations

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.vertices import lay_vertices
from nrbench.metrics.cost import Cost
from nrbench.metrics.lattice_recovery import LatticeRecovery
from nrbench.metrics.source import SourceUse
from nrbench.plugins.forms import FoundLattice, Metric, Observation, Score, SourceMap, Texture

SMALL, WIDE = np.zeros((64, 64, 3), np.float32), np.zeros((100, 200, 3), np.float32)
MEASURED = {"cpu_seconds": 0.4, "detection_seconds": 0.1, "prepare_seconds": 3.0, "peak_mib": 12.0}


def test_what_was_measured_is_reported() -> None:
    """Seconds and memory are reported as measured, the speed in output pixels per second."""
    score = Cost().score(Observation(SMALL, WIDE, seconds=0.5, cost=MEASURED))
    assert score.values == {"seconds": 0.5, **MEASURED, "px_per_second": pytest.approx(40000), "reliable": True}
    assert not score.reasons and isinstance(Cost(), Metric)


def test_a_neighbor_makes_times_unreliable() -> None:
    """Times measured beside another cell are reported as not reliable."""
    score = Cost().score(Observation(SMALL, WIDE, seconds=0.5, cost={**MEASURED, "side_by_side": 1}))
    assert score.values["reliable"] is False and score.values["seconds"] == 0.5


def test_what_was_not_measured_has_a_reason() -> None:
    """Without measurements every column is None, with a reason; a cost of 0 is a measurement."""
    score = Cost().score(Observation(SMALL, WIDE))
    assert set(score.values) == set(Cost.columns) == set(score.reasons)
    assert set(score.values.values()) == {None}
    assert Cost().score(Observation(SMALL, WIDE, cost={"peak_mib": 0.0})).values["peak_mib"] == 0


def test_no_time_at_all_is_no_speed() -> None:
    """If the synthesis took 0 s the speed is None, with a reason."""
    score = Cost().score(Observation(SMALL, WIDE, seconds=0.0))
    assert score.values["seconds"] == 0
    assert score.values["px_per_second"] is None and "clock" in score.reasons["px_per_second"]


TRUTH = Lattice((20.0, 0.0), (10.0, 12.0))
VERTICES = ("vertex_recall", "vertex_precision", "vertex_error")
SAMPLE, OUTPUT = np.zeros((64, 64, 3), np.float32), np.zeros((200, 300, 3), np.float32)


def observed(used: Lattice | None, truth: Lattice | None = TRUTH) -> Observation:
    """Return an observation of a method that used a lattice."""
    return Observation(SAMPLE, OUTPUT, Texture(SAMPLE, truth, kind="I"), lattice_used=used)


def test_the_true_lattice_is_exact() -> None:
    """The true lattice in another basis is exact: index 1, no error."""
    score = LatticeRecovery().score(observed(Lattice((10.0, 12.0), (-10.0, 12.0))))
    assert score.values["exact"] is True and score.values["index"] == 1
    assert score.values["vector_error"] == pytest.approx(0) and score.values["drift"] == pytest.approx(0, abs=1e-9)
    assert score.records == {"class": "exact"} and set(score.reasons) == {"found", "confidence", *VERTICES}


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
    assert score.values["exact"] is False and score.values["vector_error"] > 1


@pytest.mark.parametrize(("used", "truth", "reason"), [(TRUTH, None, "truth"), (None, TRUTH, "method")])
def test_without_a_lattice_nothing_is_scored(used: Lattice | None, truth: Lattice | None, reason: str) -> None:
    """Without a lattice every column is None, and the reason says whether truth or method has none."""
    score = LatticeRecovery().score(observed(used, truth))
    assert set(score.values) == set(LatticeRecovery.columns) == set(score.reasons)
    compared = [text for name, text in score.reasons.items() if name not in ("found", "confidence", *VERTICES)]
    assert set(score.values.values()) == {None} and all(reason in text for text in compared)


def test_a_detectors_lattice_comes_with_its_confidence() -> None:
    """The answer of the detector stands beside the comparison."""
    observation = dataclasses.replace(observed(TRUTH), detected=FoundLattice(TRUTH, 0.1, confidence=0.75))
    score = LatticeRecovery().score(observation)
    assert (score.values["found"], score.values["confidence"], score.values["exact"]) == (True, 0.75, True)
    assert not score.reasons and [score.values[name] for name in VERTICES] == [1, 1, pytest.approx(0, abs=1e-6)]


def test_vertices_of_a_detector() -> None:
    """Followed vertices count, not the lattice; those that a person set are the truth; a detector without any has 0."""
    at_hand = lay_vertices(TRUTH, (64, 64))
    photograph = Texture(SAMPLE, vertices=at_hand)
    followed = FoundLattice(Lattice((9.0, 0.0), (0.0, 7.0)), vertices=at_hand)
    none, laid = FoundLattice(None, reason="flat"), FoundLattice(Lattice((20.0, 0.0), (0.0, 24.0)))
    for detected, recall in ((followed, 1), (laid, 0.5), (none, 0)):
        score = LatticeRecovery().score(Observation(SAMPLE, OUTPUT, photograph, detected=detected))
        assert score.values["vertex_recall"] == pytest.approx(recall, abs=0.1)
    assert score.reasons["vertex_precision"] == "no vertices can be compared"
    unknown = LatticeRecovery().score(Observation(SAMPLE, OUTPUT, Texture(SAMPLE, TRUTH), detected=followed))
    assert unknown.reasons["vertex_recall"] == "no vertices can be compared"


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


PLAIN = np.zeros((32, 48, 3), np.float32)


def use(source: SourceMap | None) -> Score:
    """Return the score of a source map, and check that every None has its reason."""
    output = PLAIN if source is None else np.zeros((*source.shape[:2], 3), np.float32)
    score = SourceUse().score(Observation(PLAIN, output, source=source))
    assert set(score.values) == set(SourceUse.columns)
    assert all(score.reasons.get(column) for column, value in score.values.items() if value is None)
    return score


def copy_map(height: int, width: int) -> SourceMap:
    """Return the map of a copy of the sample's upper left part."""
    y, x = np.indices((height, width), np.float32)
    return np.stack([x, y, np.ones_like(x)], -1)


def blocks(side: int, count: int, seed: int = 0) -> SourceMap:
    """Return the map of ``count`` x ``count`` square patches from random places."""
    rng = np.random.default_rng(seed)
    source = np.tile(copy_map(side, side), (count, count, 1))
    for row, column in np.ndindex(count, count):
        part = source[row * side : (row + 1) * side, column * side : (column + 1) * side]
        part[..., :2] += rng.integers((48 - side + 1, 32 - side + 1))
    return source


def test_a_plain_copy_is_one_run() -> None:
    """In a copy of the sample the runs are as long as its sides, and all of it is used evenly."""
    values = use(copy_map(32, 48)).values
    assert values["mean_copy_length"] == pytest.approx(2 * 32 * 48 / (32 + 48))
    assert values["used"] == 1
    assert values["entropy"] == pytest.approx(1)


@pytest.mark.parametrize("side", [4, 8, 16])
def test_runs_are_as_long_as_the_patches(side: int) -> None:
    """Patches of n px give runs of about n px, also at real-valued places."""
    source = blocks(side, 8)
    assert use(source).values["mean_copy_length"] == pytest.approx(side, rel=0.1)
    source[..., :2] += np.float32(0.3)
    assert use(source).values["mean_copy_length"] == pytest.approx(side, rel=0.1)


def test_single_pixels_from_anywhere_have_runs_of_one() -> None:
    """Pixels in random order have runs of 1 px, and use the sample almost evenly."""
    rng = np.random.default_rng(0)
    source = np.stack([rng.integers(48, size=(99, 99)), rng.integers(32, size=(99, 99)), np.ones((99, 99))], -1)
    values = use(source.astype(np.float32)).values
    assert values["mean_copy_length"] == pytest.approx(1, abs=0.01)
    assert values["used"] > 0.99
    assert values["entropy"] > 0.98


def test_one_patch_repeated_uses_little() -> None:
    """A patch of 8 x 8 px that is repeated uses 64 pixels, and has their entropy."""
    values = use(np.tile(blocks(8, 1), (8, 8, 1))).values
    assert values["used"] == pytest.approx(64 / PLAIN[..., 0].size)
    assert values["entropy"] == pytest.approx(np.log(64) / np.log(PLAIN[..., 0].size))


def test_missing_scores_have_reasons() -> None:
    """Without a map, with an empty one, and for a single pixel the scores are None, with a reason."""
    assert set(use(None).reasons.values()) == {"not applicable: the method gives no source map"}
    empty = np.full((9, 9, 3), np.nan, np.float32)
    assert set(use(empty).reasons.values()) == {"not applicable: the source map names no pixel"}
    assert set(use(np.ones((1, 1, 3), np.float32)).reasons) == {"entropy"}


def test_pixels_without_a_source_break_runs() -> None:
    """Pixels of unknown source divide a copy, and do not count as used."""
    source = copy_map(16, 21)
    source[:, 10] = np.nan
    score = use(source)
    assert score.values["mean_copy_length"] == pytest.approx(2 * 320 / (2 * 16 + 20))
    assert score.records["mapped"] == pytest.approx(20 / 21)


SLOW = dict.fromkeys(("quality", "integrity", "randomness", "regularity"), ("randomness",))


@pytest.mark.parametrize("name", [plugin.name for plugin in plugins.inventory("metrics") if plugin.built_in])
def test_a_metric_conforms(name: str) -> None:
    """The metric fails no clause."""
    assert violations("metrics", name, {}, SLOW.get(name, ())) == []
