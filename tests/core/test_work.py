"""Results that several methods use are found once, and count for each."""

import time

import numpy as np

from nrbench.work import MOST_KEPT, REUSED, cpu_seconds, keep_results, reuse, work_clock


def ramp(length: int) -> list[np.ndarray]:
    """Return a ramp after some work."""
    time.sleep(0.05)
    return [np.arange(length), np.zeros(200_000).cumsum()]


def test_a_reused_result_is_the_first_one_and_counts_again() -> None:
    """In blocks a result is found once; its arrays are read-only, and the clocks advance by its cost at each use."""
    REUSED.kept.clear()
    with keep_results():
        first = reuse(("ramp", np.arange(3.0), None), ramp, 4)
    with keep_results():
        wall, cpu, real = work_clock(), cpu_seconds(), time.perf_counter()
        second = reuse(("ramp", np.arange(3.0), None), ramp, 4)
        assert time.perf_counter() - real < work_clock() - wall >= 0.05
        assert cpu_seconds() > cpu
        assert second is first and not first[0].flags.writeable
        others = [reuse(("ramp", key, None), ramp, 4) for key in (np.arange(3), np.zeros((3, 1)), 3.0)]
        assert all(other is not first for other in others)
    assert reuse(("ramp", np.arange(3.0), None), ramp, 4) is not first, "outside of a block nothing is kept or used"


def test_few_results_are_kept() -> None:
    """The latest are kept, so that memory does not grow with the number of samples."""
    with keep_results():
        for number in range(MOST_KEPT + 3):
            reuse(("few", number), list, (number,))
    assert len(REUSED.kept) == MOST_KEPT
