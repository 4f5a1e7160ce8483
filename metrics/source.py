"""Source: the length of unbroken copies, and how evenly they use the sample."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.plugins.forms import Column, Observation, Score, SourceMap

_SLACK = 0.25
"""Tolerance, px, of the step between the sources of neighbors in a copy: positions may be real-valued."""


@dataclass(frozen=True)
class SourceUse:
    """Statistics of a source map, which gives for each output pixel the sample pixel that it was copied from.

    They are for display. The map is checked against the pixels, but only methods that copy give one, so no headline
    score depends on it. A random choice among all equivalent places uses the sample evenly; one tile repeated uses a
    small part of it.
    """

    version: ClassVar[str] = "2"
    columns: ClassVar[Mapping[str, Column]] = {
        "mean_copy_length": Column(
            "Mean length, along rows and columns, over which neighbors in the output are neighbors in the sample.",
            "px",
            (1.0, math.inf),
        ),
        "used": Column("Share of the sample's pixels that were copied at least once.", better="higher"),
        "entropy": Column(
            "Entropy of the distribution of copied sample pixels over that of a uniform distribution.", better="higher"
        ),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        source = observation.source
        if source is None:
            return Score.missing(self.columns, "not applicable: the method gives no source map")
        if not _known(source).any():
            return Score.missing(self.columns, "not applicable: the source map names no pixel")
        counts = _count_uses(source, observation.sample.shape[:2])
        entropy = _entropy(counts) if min(int(counts.sum()), counts.size) > 1 else None
        values = {"mean_copy_length": _mean_copy_length(source), "used": float((counts > 0).mean()), "entropy": entropy}
        reasons = {"entropy": "not applicable: the use of a single pixel has no entropy"} if entropy is None else {}
        return Score(values, reasons, records={"mapped": float(_known(source).mean())})


def _known(source: SourceMap) -> NDArray[np.bool_]:
    """Return which pixels have a source, ``(H, W)``."""
    parts = [np.isfinite(source[..., k]) for k in range(source.shape[-1])]  # numpy is slow along a short last axis
    return np.asarray(np.logical_and.reduce(parts))


def _mean_copy_length(source: SourceMap) -> float:
    """Return the mean length of unbroken runs, those along rows and those along columns together."""
    count, starts = int(_known(source).sum()), 0
    for lines, step in ((source, (0, 1)), (source.swapaxes(0, 1), (1, 0))):
        known = _known(lines)
        along, across = (np.abs(np.diff(lines[..., k], axis=0) - lines.dtype.type(step[k])) <= _SLACK for k in (0, 1))
        starts += count - int((known[1:] & known[:-1] & along & across).sum())
    return 2 * count / starts


def _count_uses(source: SourceMap, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number of output pixels that each sample pixel was copied to, ``(H, W)``."""
    known = source[_known(source)]
    places = np.rint(known[:, 1::-1]).astype(np.intp).T
    index = np.ravel_multi_index(tuple(places), shape, mode="clip")
    return np.asarray(np.bincount(index, minlength=math.prod(shape)).reshape(shape))


def _entropy(counts: NDArray[np.int64]) -> float:
    """Return the entropy of use over the largest possible for so many pixels, in [0, 1]."""
    total = int(counts.sum())
    share = counts[counts > 0] / total
    return float(np.clip(-(share * np.log(share)).sum() / math.log(min(total, counts.size)), 0, 1))
