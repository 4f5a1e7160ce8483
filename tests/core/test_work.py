"""Results that several methods use are found once, and count for each."""

import time

import numpy as np
import pytest

from nrbench.work import MOST_KEPT, REUSED, cpu_seconds, keep_results, make_once, work_clock


def ramp(length: int) -> list[np.ndarray]:
    """Return a ramp after some work."""
    time.sleep(0.05)
    return [np.arange(length), np.zeros(200_000).cumsum()]


def test_a_reused_result_is_the_first_one_and_counts_again() -> None:
    """In blocks a result is found once; its arrays are read-only, and the clocks advance by its cost at each use."""
    REUSED.kept.clear()
    with keep_results():
        first = make_once(("ramp", np.arange(3.0), None), ramp, 4)
    with keep_results():
        wall, cpu, real = work_clock(), cpu_seconds(), time.perf_counter()
        second = make_once(("ramp", np.arange(3.0), None), ramp, 4)
        assert time.perf_counter() - real < work_clock() - wall >= 0.05
        assert cpu_seconds() > cpu
        assert second is first and not first[0].flags.writeable
        others = [make_once(("ramp", key, None), ramp, 4) for key in (np.arange(3), np.zeros((3, 1)), 3.0)]
        assert all(other is not first for other in others)
    assert make_once(("ramp", np.arange(3.0), None), ramp, 4) is not first, "outside of a block nothing is kept or used"


def test_few_results_are_kept() -> None:
    """The latest are kept, so that memory does not grow with the number of samples."""
    with keep_results():
        for number in range(MOST_KEPT + 3):
            make_once(("few", number), list, (number,))
    assert len(REUSED.kept) == MOST_KEPT


def test_peaks_and_nested_results_count_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A peak counts from the beginning of the block, whatever was done before in it; a part adds no cost."""
    peaks = iter([100 << 20, 300 << 20, 320 << 20, 320 << 20, 320 << 20])
    monkeypatch.setattr("nrbench.work.peak_bytes", lambda: next(peaks))
    with keep_results():
        make_once(("first",), ramp, 2)
        make_once(("whole",), lambda: make_once(("part",), ramp, 3))
    spent = [cost for _, cost in list(REUSED.kept.values())[-3:]]
    assert [each.peak_mib for each in spent] == [200, 220, 220]
    with keep_results():
        wall = work_clock()
        make_once(("whole",), ramp, 3)
        assert 0.05 <= work_clock() - wall < spent[2].seconds + spent[1].seconds
        assert REUSED.peak_mib == 220
