"""Calibration: known answers, and what a calibrated confidence comes to."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.reports.plots.calibration import calibration


def test_a_known_answer() -> None:
    """Two answers at 0.25, one right; two at 0.95, both: off by 0.25 and 0.05, 0.15 on average."""
    found = calibration(np.array([0.25, 0.25, 0.95, 0.95]), np.array([True, False, True, True]))
    assert found.error == pytest.approx(0.15) and found.n == 4
    assert [(one.low, one.high, one.right.n, one.right.value) for one in found.bins] == [
        (0.2, 0.3, 2, 0.5),
        (0.9, 1.0, 2, 1.0),
    ]


def test_the_ends_are_in_the_outer_bins() -> None:
    """Confidence 0 lies in the first tenth, 1 in the last."""
    found = calibration(np.array([0.0, 1.0]), np.array([False, True]))
    assert [one.low for one in found.bins] == [0.0, 0.9] and found.error == 0


def test_no_answers() -> None:
    """Nothing answered: no bins, no error."""
    found = calibration(np.array([]), np.array([], bool))
    assert (list(found.bins), found.error, found.n) == ([], None, 0)


def test_an_honest_confidence_has_little_error() -> None:
    """Answers that are right as often as they say: an error as small as chance allows (below 0.02 of 20000)."""
    rng = np.random.default_rng(0)
    confidence = rng.random(20000)
    assert calibration(confidence, rng.random(20000) < confidence).error < 0.02  # type: ignore[operator]


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_shares_add_up_and_the_error_is_a_share(pairs: list[tuple[float, bool]]) -> None:
    """The bins hold every answer once, in order; the error lies in [0, 1]; intervals hold their share."""
    found = calibration(np.array([c for c, _ in pairs]), np.array([right for _, right in pairs]))
    assert sum(one.right.n for one in found.bins) == found.n == len(pairs)
    assert sum(one.share for one in found.bins) == pytest.approx(1)
    assert found.error is not None and 0 <= found.error <= 1
    assert [one.low for one in found.bins] == sorted(one.low for one in found.bins)
    for one in found.bins:
        low, value, high = one.right.low, one.right.value, one.right.high
        assert low is not None and value is not None and high is not None and low <= value <= high
