"""Pixel-based synthesis without a mask: the baseline for the methods that follow one (method ``ann-pixel``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nrbench.detectors.frdft import Frdft
from nrbench.errors import require_ranges
from nrbench.plugins.forms import Synthesis, Task

from .gap_filling.holes import leaves_out
from .pixel_growing.pixel_growth import (
    SEARCH_OF_THE_PAPER,
    Growth,
    Neighborhood,
    NeighborhoodIndex,
    SearchParameters,
    list_candidates,
    scatter_pixels,
    stack_layers,
)


@leaves_out
@dataclass(frozen=True)
class AnnPixel(SearchParameters):
    """Pixel-based synthesis by nearest neighborhoods, without a mask (Nicoll et al. 2005, section 5, figure 7).

    This is the method of Wei and Levoy, with the search of :class:`~nrbench.synthesizers.fftm_pixel.FftmPixel`. The
    output is synthesized in scan-line order. Each pixel is copied from the pixel of the sample that has the most
    similar neighborhood; only pixels that are synthesized already are compared. The method knows the lattice only as
    far as a window shows it. It therefore needs windows as large as the structures, and position errors add up. Above
    the output and at its sides, neighborhoods contain random pixels of the sample.

    ``preset=paper`` has the side of the middle one of the five examples of figure 7, 16 principal components, and the
    coherence of ``fftm-pixel`` in place of the paper's search library.

    Parameters
    ----------
    neighborhood
        Side N of the window in px, 2 to 10. The window reaches from -N//2 to N - 1 - N//2 around the pixel; the pixels
        before it in scan-line order are compared. (The paper uses 5, 6, 8 and 10.)

    References
    ----------
    .. [1] Alexander Nicoll, Jan Meseth, Gero Müller, Reinhard Klein. "Fractional Fourier Texture Masks: Guiding
           Near-Regular Texture Synthesis." Computer Graphics Forum 24(3), 2005.
    """

    neighborhood: int = 8

    wraps: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "pixels without a lattice"
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "1"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {"neighborhood": 8, **SEARCH_OF_THE_PAPER}}
    paper: ClassVar[str] = Frdft.paper

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ranges(self, neighborhood=(2, 10))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`AnnPixel`.

        Raises
        ------
        Refused
            If the sample is smaller than a neighborhood.
        """
        neighborhood = Neighborhood.first_pass(self.neighborhood, masked=False)
        around = Neighborhood.second_pass(self.neighborhood, masked=False) if task.tileable else neighborhood
        layers = stack_layers(task.sample)
        candidates = list_candidates(layers, around, task.rng)
        (height, width), (left, top, right, bottom) = task.shape, around.box
        if task.tileable:
            start = scatter_pixels(layers, task.shape, task.rng)
            start = np.ascontiguousarray(np.pad(start, ((0, 0), (top, bottom), (left, right), (0, 0)), "wrap"))
        else:
            start = scatter_pixels(layers, (height + top + bottom, width + left + right), task.rng)
        growth = Growth(task, start, (top, left), task.tileable)
        growth.grow(NeighborhoodIndex(layers, candidates, neighborhood, self), range(height), range(width))
        if task.tileable:
            growth.grow_edges(NeighborhoodIndex(layers, candidates, around, self), self.neighborhood)
        image, source = growth.result()
        task.progress(1.0)
        return Synthesis(image, source=source)
