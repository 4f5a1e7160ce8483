import numpy as np
import pytest

from nrbench.metrics.cost import Cost
from nrbench.plugins.forms import Metric, Observation

SAMPLE, OUTPUT = np.zeros((64, 64, 3), np.float32), np.zeros((100, 200, 3), np.float32)
MEASURED = {"cpu_seconds": 0.4, "detection_seconds": 0.1, "peak_mib": 12.0}


def test_what_was_measured_is_reported() -> None:
    """Seconds and memory are reported as measured, the speed in output pixels per second."""
    score = Cost().score(Observation(SAMPLE, OUTPUT, seconds=0.5, cost=MEASURED))
    assert score.values == {"seconds": 0.5, **MEASURED, "px_per_second": pytest.approx(40000), "reliable": True}
    assert not score.reasons and isinstance(Cost(), Metric)


def test_a_neighbor_makes_times_unreliable() -> None:
    """Times measured beside another cell are reported as not reliable."""
    score = Cost().score(Observation(SAMPLE, OUTPUT, seconds=0.5, cost={**MEASURED, "side_by_side": 1}))
    assert score.values["reliable"] is False and score.values["seconds"] == 0.5


def test_what_was_not_measured_has_a_reason() -> None:
    """Without measurements every column is None, with a reason; a cost of 0 is a measurement."""
    score = Cost().score(Observation(SAMPLE, OUTPUT))
    assert set(score.values) == set(Cost.columns) == set(score.reasons)
    assert set(score.values.values()) == {None}
    assert Cost().score(Observation(SAMPLE, OUTPUT, cost={"peak_mib": 0.0})).values["peak_mib"] == 0


def test_no_time_at_all_is_no_speed() -> None:
    """If the synthesis took 0 s the speed is None, with a reason."""
    score = Cost().score(Observation(SAMPLE, OUTPUT, seconds=0.0))
    assert score.values["seconds"] == 0
    assert score.values["px_per_second"] is None and "clock" in score.reasons["px_per_second"]
