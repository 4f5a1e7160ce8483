"""The machine unit w, in which every benchmark prints its figures."""

import statistics
import time
from collections.abc import Callable

import numpy as np
from scipy import fft

_IMAGE = np.random.default_rng(0).random((1024, 1024), np.float32)
np.empty(16 << 20, np.uint8)  # freed at once; malloc keeps the pages of smaller arrays from now on, so w is one number


def _seconds(call: Callable[[], object], times: int = 1) -> float:
    """Return the CPU seconds of a call, the mean of some times."""
    start = time.process_time()
    for _ in range(times):
        call()
    return (time.process_time() - start) / times


def _transform() -> object:
    return fft.irfft2(fft.rfft2(_IMAGE), _IMAGE.shape)


def cpu_unit() -> float:
    """Return w: CPU seconds of a forward and inverse `rfft2` of 1024 x 1024 float32, the least of five."""
    return min(_seconds(_transform) for _ in range(5))


def median_units(call: Callable[[], object], repeats: int = 7) -> float:
    """Return the median CPU time of a call, after one that warms up, each over that of a unit taken right before it."""
    call()
    ratios = []
    for _ in range(repeats):
        unit = _seconds(_transform, 3)
        ratios.append(_seconds(call) / unit)
    return statistics.median(ratios)
