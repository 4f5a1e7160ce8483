"""New elements that vary as the sample's do: their colors are drawn anew, their detail is copied."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.errors import require_ranges
from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Tile, Values, fold
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Geometry, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .canvas.canvas import FURTHER
from .gap_filling.holes import leaves_out
from .lattice_places.equal_places import CellTorus, pixel_grid, require_two_periods
from .resampling.element_classes import find_object
from .resampling.element_colors import ElementColors
from .resampling.element_copies import ElementCopies
from .resampling.element_map import FEWEST, map_grid, segment
from .resampling.element_outlines import ElementOutlines
from .resampling.novelty import NoveltyTest
from .tile_set import TileSet

MOST_VARIATION: Final = 4.0
"""Largest parameter ``variation``."""
_EXPLAINED = 0.05
"""Least share of the residual's variance that the colors of elements explain; with less, elements are whole cells."""
_BY_CHANCE = 5.0
"""Pixels of noise whose variance one more color, and its gains, explain by chance."""
_TONES = 0.6
"""Least share of the variance of the coarse residual that the colors of elements explain, for colors to be drawn."""
_COARSE = 1 / 14
"""Standard deviation, in s, of the Gaussian that separates the coarse part of a residual from its detail."""
_NO_COPY = 0.999
"""Weight of the only source of a pixel, whose color is another one."""
_ROWS = 256
"""Rows of the output that are composed at once."""


@leaves_out
@dataclass(frozen=True)
class Resample:
    """Draws new elements: bricks, threads and tiles with new colors, whose detail is copied from the sample's.

    Methods that copy repeat what the sample happens to show. This one estimates how elements vary, and draws others:

    1. The mean tile is subtracted. What is left, the residual, is color and detail.
    2. The cell is cut into elements: regions whose color varies together from cell to cell, or whose border does not
       stand out. Threads that run through several cells are recognized by the likelihood of their colors.
    3. The residual of a place is the color of its element, times the gain of this place of the cell, and a rest. Colors
       and gains are fitted by least squares. A joint that has the same color everywhere has a gain near 0.
    4. The outline of each instance is found: which pixels show it, and which the ground or a neighbor (expectation and
       maximization). A joint that wanders is found where it lies, if its color differs from the elements'.
    5. New colors are a Gaussian random field with the sample's correlations between elements, as far as they exceed
       chance, moved to the sample's distribution of colors, smoothed. Few elements are smoothed more.
    6. The rest of each new element is that of an instance that the sample shows whole, copied with what surrounds it.
       Instances of similar color are more likely, and those whose surroundings fit their neighbors (Gibbs sampling).
       The new colors are laid inside the outlines of the copied instances. Copies are joined along
       the lines on which they differ least.

    The output is the mean tile, plus the new colors times the gain, plus the copied rests. The source map says where
    those come from. Other maps of the sample are copied from there, and change with the new colors as far as the colors
    of the sample's elements predict them, by linear regression; the rest is that of the copied element. The extras hold
    pictures of the model in the sample: ``template``, the mean tile; ``elements``, one color an element;
    ``attributes``, the estimated colors of the elements.

    In an output that repeats, threads run around the edges. Where they are turned against the edges, most meet others,
    and few colors are left; the note tells how many.

    A print has a few inks: colors that form classes are drawn as classes, which go together with their neighbors' as in
    the sample, and each element is a whole instance of the sample, color and detail. What it shows of its neighbors
    takes their new colors. Parts whose classes decide each other are one element.

    Where tones vary inside elements nearly as much as between them, elements are whole instances as well. The method
    also checks what it draws. Where colors are farther from those of the sample than these are from each other at equal
    places, elements are whole instances; where these are strange, too, the output is that of ``tile-set``. The note
    says so.

    If the colors of elements explain less than a twentieth of the residual more than chance, elements are whole cells.
    An element that the sample shows whole fewer than three times joins its neighbor. Where it has none, the output is
    that of ``tile-set``, which has no extras. The note says so. Without a lattice the sample is refused. Another output
    of the same sample in the same process reuses the model.

    Parameters
    ----------
    variation
        Factor of all departures from the mean tile, 0 to 4. 1: as the sample; 0: tiling with the mean tile; 2: twice as
        strong.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``;
        ``"waves"``: bent if the sample waves, straight if it is in perspective, round or distorted by a lens.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself.
    """

    variation: float = 1.0
    geometry: Geometry = "waves"

    finder: ClassVar[str] = "consensus"
    wraps: ClassVar[bool] = True
    maps: ClassVar[str] = "source"
    version: ClassVar[str] = "10"
    family: ClassVar[str] = "elements drawn anew"

    def __post_init__(self) -> None:
        require_ranges(self, variation=(0, MOST_VARIATION))

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`Resample`.

        Raises
        ------
        Refused
            If no lattice is found, or the sample does not show two periods.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there are no elements to vary")
        require_two_periods(lattice, task.sample.shape)
        model = VariationModel.of(task.sample, lattice)
        if model.copied:
            tiles = TileSet().synthesize(replace(task, lattice=lattice))
            return replace(tiles, detection_seconds=seconds, note=f"copied by tile-set: {model.copied}")
        image, source = model.draw(task, self.variation)
        note = "; ".join(filter(None, (*model.notes, model.describe_threads(task))))
        return Synthesis(
            image,
            lattice,
            source[:, :, 0],
            model.pictures(),
            seconds,
            note,
            blended=source[:, :, 1:],
            tints=model.tints(),
        )


@dataclass(frozen=True, eq=False)
class VariationModel:
    """The model of a texture: sample = mean tile + colors of elements + detail.

    Parameters
    ----------
    mean
        The mean tile.
    colors
        The colors of elements.
    detail
        The rest; the sample itself if elements are whole instances, with color and detail.
    notes
        How elements are drawn, if not in new colors, and why.
    copied
        Why the sample should be copied instead; empty if it need not be.
    """

    mean: Tile
    colors: ElementColors
    detail: ElementCopies
    notes: tuple[str, ...]
    copied: str = ""

    @classmethod
    def of(cls, sample: Image, lattice: Lattice) -> VariationModel:
        """Return the model of a sample with a lattice, in any basis. The latest models are kept."""
        basis = lattice.canonical().matrix.round(9)  # without the last bits, in which bases of one lattice differ
        return _fit_model(sample.tobytes(), sample.shape, Lattice.from_basis(basis, lattice.origin))

    @classmethod
    def fit(cls, sample: Image, lattice: Lattice) -> VariationModel:
        """Return the model of a sample with a reduced lattice: the first of three that draws nothing strange.

        New colors are drawn, unless colors form classes; else elements are whole instances; else the sample is to be
        copied. What is drawn is compared with the sample (:class:`.novelty.NoveltyTest`).
        """
        shape, mean = sample.shape[:2], fold(sample, lattice, grid=map_grid(lattice))
        residual = sample - mean.unfold(shape)
        copies = cls._fit_elements(sample, mean, residual)
        fitted = sum(int(color.known.sum()) for color in copies.colors.colors.values())
        rest = residual - copies.colors.render(copies.colors.of_sample(shape), shape)
        if rest.var() >= (1 - _EXPLAINED - _BY_CHANCE * fitted / rest[..., 0].size) * residual.var():
            copies = cls._fit_elements(sample, mean, residual, whole_cells=True)
        fewest = min(map(len, copies.detail.whole))
        if fewest < FEWEST:
            return replace(copies, copied=f"the sample shows {fewest} whole instances of an element")
        test = NoveltyTest(sample, copies.detail.elements, copies.colors.threads)
        task = Task(sample, test.shape, lattice, np.random.default_rng(0))
        why = "their colors form classes"
        if not copies.colors.classes:
            drawn = copies.with_drawn_colors(sample)
            why = "their tones vary inside them"
            if explain_tones(residual, drawn.detail) >= _TONES:
                why = "new ones are stranger than those of the sample are to each other"
                if test.passes(drawn.draw(task, 1.0)[0]):
                    return drawn
        if test.passes(copies.draw(task, 1.0)[0]):
            return replace(copies, notes=(*copies.notes, f"elements are whole instances: {why}"))
        return replace(copies, copied="what it draws is stranger than the elements of the sample are to each other")

    @classmethod
    def _fit_elements(cls, sample: Image, mean: Tile, residual: Values, whole_cells: bool = False) -> VariationModel:
        elements = segment(sample, residual, mean.lattice, whole_cells=whole_cells)
        colors = ElementColors.fit(elements, residual)
        while parts := find_object({k: c for k, c in colors.classes.items() if colors.threads[k].turn == (0, 0)}):
            elements = elements.joined(*parts)
            colors = ElementColors.fit(elements, residual)
        outlines = ElementOutlines.fit(sample, sample - residual, colors)
        copies = ElementCopies(elements, sample.astype(np.float64), outlines, colors.of_sample(sample.shape[:2]))
        notes = ("elements are whole cells: smaller ones explain too little",) if whole_cells else ()
        return cls(mean, colors, copies, notes)

    def with_drawn_colors(self, sample: Image) -> VariationModel:
        """Return the model whose elements take new colors, inside the outlines of copied ones."""
        shape = sample.shape[:2]
        rest = sample - self.mean.unfold(shape) - self.detail.outlines.lay(self.colors.of_sample(shape))
        return replace(self, detail=replace(self.detail, rest=rest, own=None))

    def torus(self, task: Task) -> CellTorus | None:
        """Return the cells of the output, if it repeats."""
        return CellTorus.closing(self.mean.lattice, task.shape) if task.tileable else None

    def describe_threads(self, task: Task) -> str:
        """Return how many threads differ in an output that repeats, if fewer do than in the sample."""
        torus = self.torus(task)
        if torus is None:
            return ""
        threads = {t.first: t.torus for t in self.colors.on_torus(torus).threads if t.turn != (0, 0)}
        count = sum(own.columns * own.rows for own in threads.values() if own is not None)
        shown = sum(int(self.colors.colors[first].known.sum()) for first in threads)
        if count >= shown:
            return ""
        return f"threads run around the edges and meet others: {count} differ, {shown} in the sample"

    def tints(self) -> NDArray[np.float32] | None:
        """Return the colors of the sample's elements, see :class:`~nrbench.plugins.forms.Synthesis`.

        None if elements are whole instances, whose maps are whole as well.
        """
        if self.detail.own is not None:
            return None
        shape = self.detail.rest.shape[:2]
        places = pixel_grid(shape[1], shape[0])
        return np.concatenate([places, self.colors.render(self.colors.of_sample(shape), shape)], -1, dtype=np.float32)

    def draw(self, task: Task, variation: float) -> tuple[Image, NDArray[np.float32]]:
        """Return a new texture of the task's shape, its departures from the mean tile times ``variation``.

        Also return the sources of its details, ``(H, W, 4, 3)``, see :meth:`.ElementCopies.render`. No pixel is a copy.
        """
        height, width = task.shape
        torus = self.torus(task)
        colors = self.colors.draw(task.shape, task.rng, torus)
        own = self.colors.of_classes(self.detail.rest.shape[:2])
        whole = self.detail.own is not None
        exact = [whole and (t.first in self.colors.classes or t.turn != (0, 0)) for t in self.colors.threads]
        copied = self.detail.draw(task.shape, task.rng, (own, colors), torus, exact)
        cells = self.detail.rest[..., 0].size / self.mean.lattice.area
        strength = np.sqrt(cells / (cells - 1))  # the mean of n cells takes 1 / n of the variance with it
        image = np.empty((height, width, self.detail.rest.shape[2]), np.float32)
        source = np.empty((height, width, FURTHER + 1, 3), np.float32)
        for top in range(0, height, _ROWS):
            rows = slice(top, min(top + _ROWS, height))
            mean = self.mean.unfold((rows.stop - top, width), (0.0, -top)).astype(np.float64)
            if whole:
                part, source[rows] = self.detail.render(copied, task.shape, rows, self.detail.colors_of(copied))
                part -= mean
            else:
                part, source[rows] = self.detail.render(copied, task.shape, rows, colors, strength)
            image[rows] = np.clip(mean + variation * part, 0, 1)
            task.progress(rows.stop / height)
        return image, source * np.array((1, 1, _NO_COPY), np.float32)

    def pictures(self) -> dict[str, Image]:
        """Return the mean tile, the elements and their colors as pictures of the sample's shape."""
        shape = self.detail.rest.shape[:2]
        label, cell = self.detail.elements.instances(shape)
        hue = (0.38 * label + cell @ (0.618, 0.267))[..., np.newaxis] + np.arange(3) / 3
        color = self.colors.lay(self.colors.of_sample(shape), shape) + self.mean.values.mean((0, 1))
        pictures = {"template": self.mean.unfold(shape), "elements": np.abs(2 * (hue % 1) - 1), "attributes": color}
        return {name: np.clip(picture, 0, 1).astype(np.float32) for name, picture in pictures.items()}


def explain_tones(residual: Values, detail: ElementCopies) -> float:
    """Return the share of the variance of a coarse residual that the colors of elements explain."""
    width = _COARSE * detail.elements.lattice.s
    left, whole = (scipy.ndimage.gaussian_filter(a, (width, width, 0)).var() for a in (detail.rest, residual))
    return float(1 - left / max(whole, 1e-12))


@lru_cache(maxsize=2)
def _fit_model(pixels: bytes, shape: tuple[int, ...], lattice: Lattice) -> VariationModel:
    return VariationModel.fit(np.frombuffer(pixels, np.float32).reshape(shape), lattice)
