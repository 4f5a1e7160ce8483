"""Lattices worth a closer look: pairs of an autocorrelation's peaks at whose multiples it is high."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nrbench.detectors.agreement.evidence import Evidence, reduced
from nrbench.detectors.agreement.evidence_kernels import rate_pairs
from nrbench.detectors.autocorrelation.peaks import UNIT, dilated, find_peaks, quantized, subpixel
from nrbench.detectors.autocorrelation.refinement import fit_multiples
from nrbench.lattice.geometry import Points

FURTHEST = 0.55
"""Candidates lie within this share of the image's sides: beyond, no multiple would confirm them."""
RATED = 0.6
"""Multiples within this share of the sides are rated."""
SHORTEST = 2.6
"""px; shorter vectors are within one period of any sampled pattern."""


class Proposals(NamedTuple):
    """The fitted lattices, best first, as ``(2, 2)`` bases; and the vectors ``(n, 2)`` that were paired."""

    bases: list[Points]
    vectors: Points


def proposals(evidence: Evidence, peaks: int, count: int) -> Proposals:
    """Return the lattices of the best pairs of peaks, each once.

    A pair is rated by the share of the variance that it foretells (:meth:`Evidence.foretold`), with the correlation
    read at whole pixels, the highest within one: good enough to tell which are worth fitting.

    Parameters
    ----------
    evidence
        The image's likeness to itself.
    peaks
        How many peaks, the most prominent, are paired.
    count
        How many pairs are fitted.
    """
    vectors = candidates(evidence, peaks)
    if len(vectors) < 2:
        return Proposals([], vectors)
    rated = rate_pairs(quantized(dilated(evidence.gamma, 1)), vectors, float(UNIT), RATED)
    pairs, repeated = rated[:, :4].reshape(-1, 2, 2), rated[:, 4]
    tiles = evidence.shape[0] * evidence.shape[1] / np.abs(np.linalg.det(pairs))
    foretold = repeated - (1 - repeated) / (tiles - 1)
    bases: dict[bytes, Points] = {}
    seen: set[bytes] = set()
    for number in np.argsort(-foretold, kind="stable"):
        if foretold[number] <= 0 or len(bases) == count:
            break
        basis = reduced(pairs[number])
        if _key(basis, 1.0) not in seen:
            seen.add(_key(basis, 1.0))
            fitted = evidence.fit(basis)
            bases.setdefault(_key(fitted, 0.5), fitted)
    return Proposals(list(bases.values()), vectors)


def candidates(evidence: Evidence, count: int) -> Points:
    """Return the most prominent peaks, fitted to their own multiples, ``(n, 2)`` px in ascending length."""
    gamma, (height, width) = evidence.gamma, evidence.shape
    reach = min(int(FURTHEST * width), width - 4), min(int(FURTHEST * height), height - 4)
    if min(reach) < 1:
        return np.zeros((0, 2))
    peaks = find_peaks(gamma, reach)
    order = np.argsort(-peaks.prominences, kind="stable")[:count]
    vectors = fit_multiples(gamma, subpixel(gamma, peaks.lags[order]), reach)
    lengths = np.hypot(*vectors.T)
    order = np.argsort(lengths, kind="stable")
    return np.ascontiguousarray(vectors[order[lengths[order] >= SHORTEST]])


def _key(basis: Points, grain: float) -> bytes:
    return np.rint(basis / grain).astype(np.int64).tobytes()
