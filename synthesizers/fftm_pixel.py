"""Pixel-based synthesis guided by a fractional Fourier texture mask (method ``fftm-pixel``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.detectors.frdft import Frdft
from nrbench.errors import require, require_ranges
from nrbench.plugins.forms import Shape, Synthesis, Task

from .gap_filling.holes import leaves_out
from .masks.texture_mask import MASK_OF_THE_PAPER, MaskParameters, TextureMask
from .pixel_growing.neighbor_search import Integers
from .pixel_growing.pixel_growth import (
    SEARCH_OF_THE_PAPER,
    Growth,
    Layers,
    Neighborhood,
    NeighborhoodIndex,
    SearchParameters,
    list_candidates,
    stack_layers,
)

Match = Literal["full", "cluster"]

CLUSTERS = 64
"""Number of clusters. In a sample of 128 x 128 px, each cluster holds a few hundred pixels."""
CLUSTER_BAND = 32
"""Number of output rows that are sorted into clusters at a time."""
CLUSTER_CHANGE = 0.1
"""Gray levels. The clustering stops when the mean distance to the centers decreases by less than this."""


@leaves_out
@dataclass(frozen=True)
class FftmPixel(MaskParameters, SearchParameters):
    """Fractional Fourier texture masks, pixel-based (Nicoll et al. 2005, sections 4.1 and 4.3).

    The mask is the regular part of the sample, a sum of waves, and is drawn at the output's size
    (:class:`~nrbench.synthesizers.masks.texture_mask.MaskParameters`). Its frequencies are found by
    :mod:`nrbench.spectra.harmonics`. The output is then synthesized pixel by pixel in scan-line order. Each
    pixel is copied from the pixel of the sample that has the most similar neighborhood. The distance of two
    neighborhoods is d_TT + c d_MM (equations 8 and 9), two L2 norms. With ``distance=squares`` both are squared, and
    the sum is one Euclidean distance; fewer elements then stay whole. d_TT compares the texture at the pixels that are
    synthesized already (N_upper). d_MM compares the mask at the current pixel and at the later ones (N_lower). The
    weight c always belongs to the mask; section 4.2 prints d_MM + c d_TT, which contradicts what section 4.1 says about
    small and large c.

    The paper's best results rely on a search library that happens to favor neighboring pixels of the sample (its figure
    5). Here the parameter ``coherence`` has this effect: among sources of similar distance, the method prefers the one
    that continues the source of a neighbor. Above the output and at its sides, the mask replaces the texture. Ties
    between sources are broken by a random order, which is drawn once. ``preset=paper`` has the paper's mask: free waves
    of the analytic signal in each channel, above an amplitude of 2/255 (table 1 tries 0.5, 1, 2 and 5; the paper does
    not say which it uses), and its neighborhood of 3 x 3 px, weight 1 and 16 principal components (section 5).

    Distances are integers: principal components and the mask's colors are rounded to fractions of a gray level, so that
    the nearest neighborhood is the same on every machine. The time is linear in the number of output pixels. The time
    per pixel is logarithmic in the number of sample pixels (ann), linear (exhaustive), or constant (k-coherence).

    If a lattice is given, the search for the mask's waves starts from it; otherwise the method also finds the lattice.
    For a tileable output, a second pass replaces the pixels within N px of the border. Neighborhoods then continue at
    the opposite side, so that all pixels around are known and are compared in the texture. (The paper replaces only the
    pixels whose neighborhoods were incomplete. These lines are too thin for a transition between both sides.)

    Parameters
    ----------
    neighborhood
        Side N of the window in px, 2 to 6. The window reaches from -N//2 to N - 1 - N//2 around the pixel. (The paper
        uses 2 and 3 for simple structures, and 6 for knitted wool.)
    weight
        c, 0 to 100: the weight of d_MM, the difference in the mask; that in the texture has weight 1. (The paper uses
        about 1. Below 0.1 the mask has no effect; above 5 it is too strong.) Only for match ``full``.
    match
        ``"full"``: as above. ``"cluster"``: pixels are sorted into 64 clusters by the mask in the whole window around
        them (k-means). The candidates for an output pixel are the sample's pixels of the same cluster; only d_TT
        compares them.
    distance
        What d_TT and d_MM are: ``"norms"`` (the paper), whose principal components do not mix texture and mask, or
        ``"squares"`` of these. Only for match ``full``.

    References
    ----------
    .. [1] Alexander Nicoll, Jan Meseth, Gero Müller, Reinhard Klein. "Fractional Fourier Texture Masks: Guiding
           Near-Regular Texture Synthesis." Computer Graphics Forum 24(3), 2005.
    """

    neighborhood: int = 3
    weight: float = 2.0
    match: Match = "full"
    distance: Literal["squares", "norms"] = "norms"

    version: ClassVar[str] = "2"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "neighborhood": 3,
            "weight": 1.0,
            "match": "full",
            "distance": "norms",
            **MASK_OF_THE_PAPER,
            **SEARCH_OF_THE_PAPER,
        }
    }
    paper: ClassVar[str] = Frdft.paper

    def __post_init__(self) -> None:
        MaskParameters.__post_init__(self)
        SearchParameters.__post_init__(self)
        require_ranges(self, neighborhood=(2, 6), weight=(0, 100))
        unused = self.match == "cluster" and self.weight != FftmPixel.weight
        require(not unused, f"weight {self.weight} has no effect with match 'cluster'; choose match 'full'")

    def synthesize_with_mask(self, task: Task, mask: TextureMask) -> Synthesis:
        """Return the synthesis guided by a given mask of the sample. Exceptions are those of :meth:`synthesize`."""
        (height, width), size = task.shape, self.neighborhood
        window = Neighborhood.of_mask(size // 2 * 2 + 1 if self.tileable else size)
        left, top, right, bottom = window.box
        layers = stack_layers(task.sample, mask.draw(task.sample.shape[:2]))
        fitted = self.fit_to_output(mask, task.shape)
        bordered = fitted.draw((height + top + bottom, width + left + right), (-left, -top))
        growth = Growth(task, stack_layers(bordered, bordered), (top, left), self.tileable)
        candidates, groups = list_candidates(layers, window, task.rng), None
        if self.match == "cluster":
            clusters = Clusters.fit(layers, Neighborhood.of_mask(size), candidates.pixels, task.rng)
            candidates = replace(candidates, groups=clusters.labels)
            groups = clusters.label_output(growth.layers, task.shape, growth.corner)
        masked = self.match == "full"
        norms = masked and self.distance == "norms"
        index = partial(NeighborhoodIndex, layers, candidates, rules=self, weight=self.weight, norms=norms)
        growth.grow(index(Neighborhood.first_pass(size, masked)), range(height), range(width), groups)
        if self.tileable:
            growth.grow_edges(index(Neighborhood.second_pass(size, masked)), size, groups)
        image, source = growth.result()
        task.progress(1.0)
        return Synthesis(image, mask.lattice, source, {"mask": bordered[top : top + height, left : left + width]})


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of mask neighborhoods (Nicoll et al. 2005, section 4.1, cluster ID match).

    Parameters
    ----------
    neighborhood
        N_full, in the mask.
    centers
        ``float64 (k, D)``: integer gray levels, so that distances are exact.
    labels
        ``(n,)``: the cluster of each of the sample's pixels; no cluster is empty.
    """

    neighborhood: Neighborhood
    centers: NDArray[np.float64]
    labels: Integers

    @classmethod
    def fit(cls, layers: Layers, neighborhood: Neighborhood, pixels: Integers, rng: np.random.Generator) -> Clusters:
        """Cluster the neighborhoods of some pixels by k-means, starting from :data:`CLUSTERS` random ones (or all)."""
        vectors = neighborhood.vectors(layers, pixels).astype(np.float64)
        distinct = np.unique(vectors, axis=0)
        guess = distinct[np.sort(rng.permutation(len(distinct))[:CLUSTERS])]
        centers = np.unique(np.rint(scipy.cluster.vq.kmeans(vectors, guess, thresh=CLUSTER_CHANGE)[0]), axis=0)
        used, labels = np.unique(scipy.cluster.vq.vq(vectors, centers)[0], return_inverse=True)
        return cls(neighborhood, centers[used], labels.astype(np.int64))

    def label_output(self, layers: Layers, shape: Shape, corner: tuple[int, int]) -> Integers:
        """Return the cluster of each output pixel, ``(H, W)``.

        Parameters
        ----------
        layers
            The output's layers, with their border.
        shape
            (height, width) of the output.
        corner
            Rows and columns of the border at the top and at the left.
        """
        columns = np.arange(shape[1]) + corner[1]
        labels = np.empty(shape, np.int64)
        for start in range(0, shape[0], CLUSTER_BAND):
            rows = np.arange(start, min(start + CLUSTER_BAND, shape[0])) + corner[0]
            pixels = (rows[:, np.newaxis] * layers.shape[2] + columns).ravel()
            vectors = self.neighborhood.vectors(layers, pixels).astype(np.float64)
            numbers, _ = scipy.cluster.vq.vq(vectors, self.centers)
            labels[start : start + len(rows)] = numbers.reshape(len(rows), -1)
        return labels
