"""Where copied pixels came from: how long unbroken pieces are, and how evenly the sample is used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.plugins.forms import Column, Observation, Score, SourceMap

_SLACK = 0.25
"""A run goes on where the source moves by one pixel, give or take this: positions may be real-valued."""


@dataclass(frozen=True)
class SourceUse:
    """What a method's source map tells of how it copies.

    For display: the map has been checked against the pixels, but only methods that copy give one, so no headline rests
    on it. A random choice among all equal places uses the sample evenly; one tile repeated uses little of it.
    """

    version: ClassVar[str] = "1"
    columns: ClassVar[Mapping[str, Column]] = {
        "run": Column(
            "Mean length, along rows and columns, over which neighbors in the output were neighbors in the sample.",
            "px",
            (1.0, math.inf),
        ),
        "used": Column("Share of the sample's pixels that were copied at least once.", better="higher"),
        "entropy": Column("Entropy of the use of the sample's pixels over that of uniform use.", better="higher"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        source = observation.source
        if source is None:
            return Score.missing(self.columns, "not applicable: the method gives no source map")
        if not np.isfinite(source).all(-1).any():
            return Score.missing(self.columns, "not applicable: the source map names no pixel")
        counts = _uses(source, observation.sample.shape[:2])
        values = {"run": _run(source), "used": float((counts > 0).mean()), "entropy": _entropy(counts)}
        reasons = (
            {"entropy": "not applicable: use of a single pixel has no entropy"} if values["entropy"] is None else {}
        )
        return Score(values, reasons, records={"mapped": float(np.isfinite(source).all(-1).mean())})


def _run(source: SourceMap) -> float:
    """Return the mean length of unbroken runs: those along rows and along columns taken together."""
    known = np.isfinite(source).all(-1)
    starts = 0
    for axis in (0, 1):
        step = np.diff(source[..., :2], axis=axis) - (np.arange(2) != axis)
        first, second = (np.take(known, part, axis) for part in _sides(known.shape[axis]))
        goes_on = first & second & (np.abs(np.where(np.isfinite(step), step, np.inf)).max(-1) <= _SLACK)
        starts += int(known.sum() - goes_on.sum())
    return 2 * float(known.sum()) / starts


def _sides(length: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.arange(length - 1), np.arange(1, length)


def _uses(source: SourceMap, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return how many pixels of the output came from each of the sample, ``(H, W)``."""
    known = source[np.isfinite(source).all(-1)]
    x, y = np.rint(known[:, :2]).astype(np.intp).T
    x, y = np.clip(x, 0, shape[1] - 1), np.clip(y, 0, shape[0] - 1)
    return np.asarray(np.bincount(y * shape[1] + x, minlength=shape[0] * shape[1]).reshape(shape))


def _entropy(counts: NDArray[np.int64]) -> float | None:
    """Return the entropy of use over the largest that so many pixels can have: in [0, 1]; None for one pixel."""
    total = int(counts.sum())
    most = math.log(min(total, counts.size))
    share = counts[counts > 0] / total
    return float(np.clip(-(share * np.log(share)).sum() / most, 0, 1)) if most > 0 else None
