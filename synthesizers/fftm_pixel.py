"""Pixel-based synthesis guided by a fractional Fourier texture mask."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

from nrbench.detectors.frdft import Frdft
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Synthesis, Task
from nrbench.spectra.harmonics import Channels, Harmonic, Signal

from .masks.clusters import Clusters
from .masks.fftm_mask import Analysis, TextureMask
from .masks.mask_period import tileable_mask
from .pixel_growing.neighborhoods import Neighborhood, layers_of
from .pixel_growing.pixel_growth import Candidates, Growth, Rules, Search, Stock, sources

Match = Literal["full", "cluster"]

CLUSTERS = 64
"""Of which each takes some hundred pixels of a sample of 128 x 128."""


@dataclass(frozen=True)
class FftmPixel:
    """Fractional Fourier texture masks, pixel-based (Nicoll et al. 2005, sections 4.1 and 4.3).

    The regular part of the sample, its mask, is drawn at the output's size. The output is then synthesized pixel by
    pixel in scan-line order: each takes the pixel of the sample whose neighborhood is nearest. What is synthesized
    already (N_upper) is compared in the texture, the pixel itself and what follows (N_lower) in the mask, by the sum of
    squared differences d_TT + c d_MM (equations 8 and 9): one vector, so that one tree finds it. The weight c is the
    mask's wherever it stands; section 4.2 prints d_MM + c d_TT, which contradicts what 4.1 says of small and large c.

    Where the paper's best results owe their quality to a search library that happens to favor neighbors of the sample
    (its figure 5), ``coherence`` says so openly: among sources that fit about as well the one is taken that continues a
    neighbor's. Beyond the output's top and sides the mask stands for the texture. Equally good sources are chosen by a
    random order, drawn once.

    Distances are whole numbers: principal components are rounded to fractions of a gray level, and so are the mask's
    colors, so that the nearest neighborhood is the same on every machine. Linear in the pixels of the output; each
    costs the logarithm of the sample's (ann), all of them (exhaustive), or a constant (k-coherence).

    With a lattice given, the mask's waves are looked for from there; with none the lattice is found, too.

    Parameters
    ----------
    neighborhood
        Side N in px, 2 to 6, of the window from -N//2 to N - 1 - N//2 around the pixel. (The paper: 2 for simple
        structures, 3, 6 for knitted wool.)
    weight
        c, 0 to 100: what squared differences in the mask count against those in the texture. (The paper: about 1; below
        0.1 the mask has no effect, above 5 it is too strong.) Only for match ``full``.
    match
        ``"full"``: as above. ``"cluster"``: pixels are sorted by the mask around them (k-means over the whole window);
        those of the sample in the output pixel's cluster are candidates, compared by d_TT alone.
    search
        ``"ann"``: kd-tree, exact with ``eps`` 0. ``"exhaustive"``: every candidate. ``"k-coherence"``: for each pixel
        synthesized in the window its source, continued, and what is similar to that in the sample (Tong et al. 2002).
    coherence
        A neighbor's continued source is taken when its distance is at most so many times the best's: 1 or more; 0: it
        has no advantage.
    eps
        A source may be (1 + eps) times as far as the nearest: 0 or more, only for search ``ann``. A neighbor's
        continued source may be farther by both factors.
    dimensions
        Principal components that are compared; 0, or as many as there are values: all values.
    similar
        How many similar ones, 1 to 64, in search ``k-coherence``, else to be left out. None: 4.
    clusters
        How many, 2 to 4096, in match ``cluster``, else to be left out. None: 64.
    tileable
        Whether the output can be repeated without a seam: the mask is fitted to its size, neighborhoods go on at the
        opposite side, and a second pass replaces the pixels within N px of the border. Then all around them is
        synthesized, and compared in the texture. (The paper replaces those alone whose opposite neighborhoods were not
        there: lines too thin to mediate between both sides.) The size asked for must be a period of the mask, up to a
        tenth of s; another is refused with the nearest ones that are.
    threshold
        Least amplitude of a wave of the mask, units of 1/255; 0: automatic.
    harmonics
        ``"tied"`` to whole combinations of common fundamentals, or ``"free"`` (the paper's), which cannot tile.
    signal
        How waves are searched: ``"real"``, or ``"analytic"`` (the paper's).
    channels
        Whether a wave has one frequency in all channels, ``"joint"``, or every channel is analyzed by itself,
        ``"each"`` (the paper's).
    """

    neighborhood: int = 3
    weight: float = 1.0
    match: Match = "full"
    search: Search = "ann"
    coherence: float = 2.5
    eps: float = 0.0
    dimensions: int = 16
    similar: int | None = None
    clusters: int | None = None
    tileable: bool = False
    threshold: float = 0.0
    harmonics: Harmonic = "tied"
    signal: Signal = "real"
    channels: Channels = "joint"

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    version: ClassVar[str] = "1"
    paper: ClassVar[str] = Frdft.paper

    def __post_init__(self) -> None:
        _check(2 <= self.neighborhood <= 6, f"neighborhood {self.neighborhood}; choose from 2 to 6 px")
        _check(0 <= self.weight <= 100, f"weight {self.weight}; choose from 0 to 100")
        _check(
            self.match == "full" or self.weight == 1.0,
            f"weight {self.weight} with match 'cluster', which compares no mask; choose match 'full', or leave it out",
        )
        _check(
            self.match == "cluster" or self.clusters is None,
            f"clusters {self.clusters} with match 'full'; choose match 'cluster', or leave them out",
        )
        _check(self.clusters is None or 2 <= self.clusters <= 4096, f"clusters {self.clusters}; choose from 2 to 4096")
        _check(
            not (self.tileable and self.harmonics == "free"),
            "tileable with harmonics 'free', which have no common period; choose harmonics 'tied'",
        )
        _ = self.rules, self.analysis

    @property
    def rules(self) -> Rules:
        """How sources are chosen."""
        return Rules(self.search, self.coherence, self.eps, self.dimensions, self.similar)

    @property
    def analysis(self) -> Analysis:
        """How the mask is made."""
        return Analysis(self.threshold, self.harmonics, self.signal, self.channels)

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`FftmPixel`.

        Raises
        ------
        Refused
            When the sample has no regular part, when it does not hold a neighborhood, and when a tileable output is
            asked for at a size that is no period of the mask.
        """
        start = time.perf_counter()
        mask = self.analysis.of(task.sample, task.lattice)
        return self.guided(task, mask, 0.0 if task.lattice else time.perf_counter() - start)

    def guided(self, task: Task, mask: TextureMask, seconds: float = 0.0) -> Synthesis:
        """Return the synthesis by a mask, which took so many seconds to find; the mask is among its extras."""
        guide = _Guide(self, task, mask)
        guide.grow()
        image, source = guide.growth.finished()
        task.progress(1.0)
        return Synthesis(image, mask.lattice, source, {"mask": guide.picture}, seconds)


_check = checker("fftm-pixel")


class _Guide:
    """One synthesis: the sample and the output, each with its mask."""

    def __init__(self, method: FftmPixel, task: Task, mask: TextureMask) -> None:
        self.method, self.task = method, task
        size = method.neighborhood
        self.window = Neighborhood.of_mask(size // 2 * 2 + 1 if method.tileable else size)
        self.layers = layers_of(task.sample, mask.picture(task.sample.shape[:2]))
        self.drawn = self._drawn(tileable_mask(mask, task.shape) if method.tileable else mask)
        left, top, _, _ = self.window.box
        self.growth = Growth(task, layers_of(self.drawn, self.drawn), (top, left), method.tileable)
        self.candidates = sources(self.layers, self.window, task.rng)
        if method.match == "cluster":
            groups = self.clusters.labels
            self.candidates = Candidates(self.candidates.pixels, self.candidates.ranks, groups)

    def _drawn(self, mask: TextureMask) -> Image:
        """Return the mask of the output and of the border that its neighborhoods reach into."""
        (height, width), (left, top, right, bottom) = self.task.shape, self.window.box
        return mask.picture((height + top + bottom, width + left + right), (-left, -top))

    @property
    def picture(self) -> Image:
        """The mask of the output."""
        (height, width), (left, top, _, _) = self.task.shape, self.window.box
        return self.drawn[top : top + height, left : left + width]

    @cached_property
    def clusters(self) -> Clusters:
        """The sample's pixels sorted by what the mask shows around them."""
        window, count = Neighborhood.of_mask(self.method.neighborhood), self.method.clusters or CLUSTERS
        return Clusters.of(self.layers, window, self.candidates.pixels, count, self.task.rng)

    def grow(self) -> None:
        """Synthesize all pixels; of tileable outputs those near the border once more."""
        size, masked = self.method.neighborhood, self.method.match == "full"
        height, width = self.task.shape
        groups = None if masked else self.clusters.of_output(self.growth.layers, self.task.shape, self.growth.corner)
        self.growth.grow(self._stock(Neighborhood.growing(size, masked)), range(height), range(width), groups)
        if self.method.tileable:
            stock = self._stock(Neighborhood.closing(size, masked))
            for rows in _border(height, size):
                self.growth.grow(stock, rows, range(width), groups)
            for columns in _border(width, size):
                self.growth.grow(stock, range(height), columns, groups)

    def _stock(self, neighborhood: Neighborhood) -> Stock:
        return self.candidates.stock(self.layers, neighborhood, self.method.rules, self.method.weight)


def _border(length: int, reach: int) -> tuple[range, range]:
    """Return the last and the first places of a side, in the order in which they follow each other round it."""
    return range(max(length - reach, 0), length), range(min(reach, length))
