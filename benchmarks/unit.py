"""The machine unit u, in which every benchmark prints its figures."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from scipy import fft


def median_seconds(call: Callable[[], object], repeats: int = 7) -> float:
    """Return the median wall seconds of a call, after one that warms up."""
    call()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def machine_unit() -> float:
    """Return u: the median seconds of a forward and inverse `rfft2` of a 1024 x 1024 float32 array, one thread."""
    image = np.random.default_rng(0).random((1024, 1024), np.float32)
    return median_seconds(lambda: fft.irfft2(fft.rfft2(image), image.shape), 15)


def cpu_unit() -> float:
    """Return u in CPU seconds: the least of five."""
    image = np.random.default_rng(0).random((1024, 1024), np.float32)
    taken = []
    for _ in range(5):
        start = time.process_time()
        fft.irfft2(fft.rfft2(image), image.shape)
        taken.append(time.process_time() - start)
    return min(taken)


def median_units(call: Callable[[], object], repeats: int = 7) -> float:
    """Return the median CPU time of a call, after one that warms up, each over that of a unit taken right before it."""
    image = np.random.default_rng(0).random((1024, 1024), np.float32)
    call()
    ratios = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(3):
            fft.irfft2(fft.rfft2(image), image.shape)
        middle = time.process_time()
        call()
        ratios.append((time.process_time() - middle) / (middle - start) * 3)
    return statistics.median(ratios)
