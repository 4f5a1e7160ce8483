"""Cluster-ID match: pixels of sample and output sorted by what the mask shows around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans, vq

from nrbench.plugins.forms import Shape

from ..pixel_growing.neighborhoods import Integers, Layers, Neighborhood

BAND = 32
"""Rows of the output that are sorted at a time."""
SETTLED = 0.1
"""Gray levels: the clustering stops when the mean distance to the centers falls by less."""


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of mask neighborhoods (Nicoll et al. 2005, section 4.1, cluster ID match).

    Parameters
    ----------
    neighborhood
        N_full, in the mask.
    centers
        ``float64 (k, D)``: whole gray levels, so that distances are exact.
    labels
        ``(n,)``: the cluster of each of the sample's pixels; no cluster is empty.
    """

    neighborhood: Neighborhood
    centers: NDArray[np.float64]
    labels: Integers

    @classmethod
    def of(
        cls, layers: Layers, neighborhood: Neighborhood, pixels: Integers, count: int, rng: np.random.Generator
    ) -> Clusters:
        """Cluster the neighborhoods of some pixels by k-means, from ``count`` of them drawn at random (or all)."""
        vectors = neighborhood.vectors(layers, pixels).astype(np.float64)
        distinct = np.unique(vectors, axis=0)
        guess = distinct[np.sort(rng.permutation(len(distinct))[:count])]
        centers = np.unique(np.rint(kmeans(vectors, guess, thresh=SETTLED)[0]), axis=0)
        used, labels = np.unique(vq(vectors, centers)[0], return_inverse=True)
        return cls(neighborhood, centers[used], labels.astype(np.int64))

    def of_output(self, layers: Layers, shape: Shape, corner: tuple[int, int]) -> Integers:
        """Return the cluster of each pixel of an output of ``shape`` whose layers have a border, ``(H, W)``."""
        height, width = shape
        columns = np.arange(width) + corner[1]
        found = np.empty(shape, np.int64)
        for start in range(0, height, BAND):
            rows = np.arange(start, min(start + BAND, height)) + corner[0]
            pixels = (rows[:, np.newaxis] * layers.shape[2] + columns).ravel()
            vectors = self.neighborhood.vectors(layers, pixels).astype(np.float64)
            found[start : start + BAND] = vq(vectors, self.centers)[0].reshape(len(rows), width)
        return found
