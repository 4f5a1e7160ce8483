"""Pixel-based synthesis without a mask: the baseline that masks are to beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from nrbench.detectors.frdft import Frdft
from nrbench.errors import checker
from nrbench.plugins.forms import Synthesis, Task

from .pixel_growing.neighborhoods import Neighborhood, layers_of
from .pixel_growing.pixel_growth import Growth, Rules, Search, scattered, sources


@dataclass(frozen=True)
class AnnPixel:
    """Pixel-based synthesis by nearest neighborhoods, without a mask (Nicoll et al. 2005, section 5, figure 7).

    Each pixel takes, in scan-line order, the one of the sample whose neighborhood of pixels synthesized before is the
    nearest: Wei and Levoy's method, with the search of :class:`~nrbench.synthesizers.fftm_pixel.FftmPixel`. Nothing
    tells it of a lattice but what the window shows, so that windows as large as the structures are needed, and errors
    add up. Beyond the output's top and sides stand random pixels of the sample.

    Parameters
    ----------
    neighborhood
        Side N in px, 2 to 10, of the window from -N//2 to N - 1 - N//2 around the pixel, of which the pixels before it
        count. (The paper: 5, 6, 8, 10.)
    search
        ``"ann"``: kd-tree, exact with ``eps`` 0. ``"exhaustive"``: every pixel of the sample. ``"k-coherence"``: for
        each pixel synthesized in the window its source, continued, and what is similar to that in the sample.
    coherence
        A neighbor's continued source is taken when its distance is at most so many times the best's: 1 or more; 0: it
        has no advantage.
    eps
        A source may be (1 + eps) times as far as the nearest: 0 or more, only for search ``ann``.
    dimensions
        Principal components that are compared; 0, or as many as there are values: all values.
    similar
        How many similar ones, 1 to 64, in search ``k-coherence``, else to be left out. None: 4.
    """

    neighborhood: int = 8
    search: Search = "ann"
    coherence: float = 2.5
    eps: float = 0.0
    dimensions: int = 16
    similar: int | None = None

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"
    paper: ClassVar[str] = Frdft.paper

    def __post_init__(self) -> None:
        _check(2 <= self.neighborhood <= 10, f"neighborhood {self.neighborhood}; choose from 2 to 10 px")
        _ = self.rules

    @property
    def rules(self) -> Rules:
        """How sources are chosen."""
        return Rules(self.search, self.coherence, self.eps, self.dimensions, self.similar)

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`AnnPixel`.

        Raises
        ------
        Refused
            When the sample does not hold a neighborhood.
        """
        neighborhood = Neighborhood.growing(self.neighborhood, masked=False)
        layers = layers_of(task.sample)
        candidates = sources(layers, neighborhood, task.rng)
        (height, width), (left, top, right, bottom) = task.shape, neighborhood.box
        start = scattered(layers, (height + top + bottom, width + left + right), task.rng)
        growth = Growth(task, start, (top, left))
        growth.grow(candidates.stock(layers, neighborhood, self.rules, 1.0), range(height), range(width))
        image, source = growth.finished()
        task.progress(1.0)
        return Synthesis(image, source=source)


_check = checker("ann-pixel")
