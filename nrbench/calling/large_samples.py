"""The part of a large sample that a method needs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from nrbench.imaging.convert import shrink
from nrbench.plugins.forms import NoLatticeFound, Synthesis, Synthesizer, Task
from nrbench.plugins.registry import NamedDetector

LARGE: Final = 1024
"""px: smaller samples are used whole."""
PERIODS: Final = 16
"""Periods along each side that are enough: they hold 256 tiles."""


def synthesize_from_part(
    synthesize: Callable[[Synthesizer, Task], Synthesis], method: Synthesizer, task: Task
) -> Synthesis:
    """Return a synthesis from the middle of a large sample, as large as the lattice and the output need.

    A method that finds a lattice gets at most :data:`LARGE` px, :data:`PERIODS` periods, or the longer side of the
    output, whichever is the most, so that its time and memory do not grow with the sample. The periods are those of the
    given lattice, or of one that the method's detector finds in the reduced sample.

    Parameters
    ----------
    synthesize
        Is called with the method and a task with the part.
    method, task
        The method and its task.
    """
    shape = task.sample.shape[:2]
    finder = getattr(method, "finder", "")
    if max(shape) <= LARGE or not finder or getattr(method, "reference", False):
        return synthesize(method, task)
    start = time.perf_counter()
    side = max(LARGE, *task.shape, math.ceil(PERIODS * _longest_period(task, finder)))
    seconds = 0.0 if task.lattice else time.perf_counter() - start
    top, left = (max(length - side, 0) // 2 for length in shape)
    part = task.sample[top : top + side, left : left + side]
    lattice = None if task.lattice is None else task.lattice.shifted((-left, -top))
    made = synthesize(method, replace(task, sample=np.ascontiguousarray(part), lattice=lattice))
    note = "; ".join(filter(None, (made.note, f"from the middle {part.shape[1]}x{part.shape[0]} px of the sample")))
    source = None if made.source is None else made.source + np.array([left, top, 0], np.float32)
    return replace(
        made,
        lattice=None if made.lattice is None else made.lattice.shifted((left, top)),
        source=source,
        detection_seconds=made.detection_seconds + seconds,
        note=note if max(shape) > side else made.note,
    )


def _longest_period(task: Task, finder: str) -> float:
    """Return the longer of the two shortest periods of the sample, px; 0 if the reduced sample shows none."""
    factor, lattice = 1, task.lattice
    if lattice is None:
        factor = math.ceil(max(task.sample.shape) / LARGE)
        try:
            lattice = NamedDetector(finder).detect(shrink(task.sample, factor)).lattice
        except NoLatticeFound:
            return 0.0
    return factor * float(np.hypot(*lattice.reduced().matrix.T).max())
