"""Neighborhood vectors as points of few dimensions, in whole numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kdtree import Points

Vectors = NDArray[np.uint8]
"""``uint8 (n, D)``: pixel values, channel by channel."""

FARTHEST = 30000.0
"""Greatest distance of two points: differences fit 16 bits, squared distances 31."""
FINEST = 16
"""Most units of a gray level: finer ones change nothing that 8 bits can show."""
BLOCK = 1 << 15
"""Vectors that are computed with at a time: memory does not grow with the sample by more than its vectors."""
LANES = 16
"""Dimensions are filled up with zeros to a multiple of this, for vector instructions."""


@dataclass(frozen=True, eq=False)
class Projection:
    """A linear mapping of pixel values to points: ``(matrix @ values + shift) >> bits``.

    It is made in floating point, once, and rounded; from there on all is whole numbers, so that no order of summation
    and no machine changes which neighborhoods are alike. (What machines' libraries make differently in the last bits of
    an eigenvector is lost in the rounding, but for the rare coefficient that lies on its brink.)

    Parameters
    ----------
    matrix
        ``int16 (d, D)``.
    shift
        ``int32 (d,)``: takes the mean of the vectors to 0.
    bits
        Binary digits of the matrix behind the point.
    units
        Of a point's coordinates in a gray level.
    """

    matrix: NDArray[np.int16]
    shift: NDArray[np.int32]
    bits: int
    units: int

    @classmethod
    def of(cls, vectors: Vectors, weights: NDArray[np.float64], dimensions: int) -> Projection:
        """Return the projection on the vectors' principal components.

        Parameters
        ----------
        vectors
            At least one.
        weights
            ``(D,)``: what a squared difference counts, at least 0.
        dimensions
            How many components; 0, or as many as there are values: all values as they are, weighted.
        """
        width = vectors.shape[1]
        whole = dimensions == 0 or dimensions >= width
        rows = np.eye(width) if whole else _components(vectors, np.sqrt(weights), dimensions)
        weighted = rows * np.sqrt(weights)
        units = _units(float(np.sqrt(weights.sum())) * 255)
        bits = int(np.floor(np.log2(32767 / max(float(np.abs(weighted).max()) * units, 1e-9))))
        bits = min(bits, 15)
        matrix = np.zeros((_filled(len(rows)), _filled(width)), np.int16)
        matrix[: len(rows), :width] = np.rint(weighted * units * 2.0**bits)
        total = matrix[:, :width].astype(np.int64) @ vectors.sum(0, dtype=np.int64)
        return cls(matrix, (-(total // len(vectors))).astype(np.int32), bits, units)

    def points(self, vectors: Vectors) -> Points:
        """Return the points of some vectors, ``int16 (n, d)``, exactly as compiled loops project them."""
        matrix = self.matrix[:, : vectors.shape[1]].astype(np.float64)
        found = np.empty((len(vectors), len(matrix)), np.int16)
        for start in range(0, len(vectors), BLOCK):
            products = (vectors[start : start + BLOCK].astype(np.float64) @ matrix.T).astype(np.int64)
            found[start : start + BLOCK] = (products + self.shift) >> self.bits
        return found


def _components(vectors: Vectors, scales: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the strongest principal components of the vectors, each value scaled, ``(count, D)``, orthonormal.

    The second moments are sums of whole numbers, exact in float64.
    """
    mean = vectors.sum(0, dtype=np.int64) / len(vectors)
    moments = np.zeros((vectors.shape[1], vectors.shape[1]))
    for start in range(0, len(vectors), BLOCK):
        values = vectors[start : start + BLOCK].astype(np.float64)
        moments += values.T @ values
    covariance = moments / len(vectors) - np.outer(mean, mean)
    _, rows = np.linalg.eigh(covariance * np.outer(scales, scales))
    strongest = rows.T[::-1][:count]
    peaks = np.take_along_axis(strongest, np.abs(strongest).argmax(1)[:, np.newaxis], 1)
    return np.asarray(strongest * np.where(peaks < 0, -1, 1))


def _units(norm: float) -> int:
    """Return the finest power of two at which a vector of this norm stays within reach."""
    units = FINEST
    while units > 1 and norm * units > FARTHEST:
        units //= 2
    return units


def _filled(count: int) -> int:
    return -(-count // LANES) * LANES
