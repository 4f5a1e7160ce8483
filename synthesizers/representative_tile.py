"""Representative tile: the one tile that best retells the sample, and repeats without showing where."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.ssdn import Ssdn
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Refused, SourceMap, Synthesis, Task, find_lattice

from .rectangular_tiles.tile_costs import Costs, continuity, resemblance
from .rectangular_tiles.tile_layout import Laying, laid
from .rectangular_tiles.tile_rectangle import TileFrame, rectangle_frame
from .rectangular_tiles.wang import WangSet, colors_for, wang_set
from .rectangular_tiles.wang_pieces import Cutter
from .sampling.patches import Patches

_DEPTH = 0.8
"""Share of the deepest minima that a period's must reach to be found: more than the detector asks by itself, for a tile
of several cells keeps the lattice, and one of a part of a cell breaks it. Of 27 procedural samples with departures
(seeds 1 to 3, 128 x 128 px) 2 tiles are wrong, 8 at 0.7; larger shares find needlessly large tiles."""

_SEARCHED = 0.4
"""Share of the work that is done when the tile is chosen."""

MOST = 1e6
"""Of either weight: larger ones leave nothing of the other."""


@dataclass(frozen=True)
class RepresentativeTile:
    """The tile of the sample that retells it best when repeated, and whose borders meet: periodic, tiny, fast.

    The period gives the tile's size in whole pixels, to which the sample is scaled down (section 3). Of all places in
    the scaled sample the tile is taken for which S = alpha h + beta SSDN is least (equation 6): h, the continuity,
    compares its first row and column with its last (equation 5); SSDN, the resemblance, compares the sample with the
    tile repeated over it from where it lies (section 4.2). The paper rates only the share ``p`` of places with the
    least h; here integral images rate every place exactly.

    The tile is the paper's, of whole pixels (``extras["tile"]``, a PNG beside a picture). The output is not made by
    repeating its pixels, as in the paper, where the period of 21.37 px becomes 21: every output pixel shows the point
    of the tile that the real-valued period calls equal, read from the sample by one patches, so that nothing drifts or
    blurs, and copies where periods are whole (``rescale=false``: the paper's).

    A lattice that is not rectangular gets the smallest rectangle that is a period of it, turned where it must be, of
    several cells where it must be; sides may miss lattice vectors by ``tolerance``. With no lattice given the period
    comes from ``ssdn``, as in the paper, along the sample's axes.

    The output is periodic: it keeps regularity and loses randomness, as the paper says. With ``tiles`` some survives:
    Wang tiles, the paper's future work (:func:`~nrbench.synthesizers.rectangular_tiles.wang.wang_set`).

    Extras: ``tile``, or ``tile-01`` ... of a set with their ``edges`` (north, east, south, west colors); ``frame``,
    ``(3, 2)``: the tile's first pixel (x, y) in the sample, and the steps (x, y) in the sample of one pixel along its
    rows and columns, of lengths r (equation 4); ``best``, ``(m, 5)``: x, y in the scaled sample, h, SSDN and S of the m
    best; ``best-01`` ... those tiles, where m > 1.

    Parameters
    ----------
    alpha, beta
        Weights of continuity and resemblance, 0 to 1e6, not both 0 (the paper: alpha 1, 30 or 0, beta 1).
    p
        Share in (0, 1] of the places, those of least h, of which the best is taken (the paper: 0.0001 to 0.02). None:
        all of them.
    m
        The tile is drawn from the m best, 1 to 99, uniformly, where the paper lets the user choose; 1: the best.
    rescale
        Output of the sample's period; false: of the tile's, the tile's own pixels repeated.
    scale_down
        Shrink periods to whole pixels (equation 4); false: the tile keeps the sample's scale and lacks the rest of
        the period, as where the paper did without.
    period
        Where none is given: ``"fitted"``, sub-pixel, fitted to all minima, refused where no better than chance;
        ``"last"``, x_n / n, the last minimum over its number (equation 3), whatever the sample.
    tolerance
        How far a side of the tile may be from a lattice vector, in shares of s, in [0, 0.5).
    tiles
        1, or how many Wang tiles: 4, or 6 and more.
    """

    alpha: float = 1.0
    beta: float = 1.0
    p: float | None = None
    m: int = 1
    rescale: bool = True
    scale_down: bool = True
    period: Literal["fitted", "last"] = "fitted"
    tolerance: float = 0.1
    tiles: int = 1

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    version: ClassVar[str] = "1"
    paper: ClassVar[str] = Ssdn.paper

    def __post_init__(self) -> None:
        weights = min(self.alpha, self.beta) >= 0 and 0 < self.alpha + self.beta <= MOST
        _check(weights, f"alpha {self.alpha}, beta {self.beta}; choose weights from 0 to {MOST:g}, not both 0")
        _check(self.p is None or 0 < self.p <= 1, f"p {self.p}; choose a share above 0, at most 1, or leave it out")
        _check(1 <= self.m <= 99, f"m {self.m}; choose from 1 (the best tile) to 99")
        _check(0 <= self.tolerance < 0.5, f"tolerance {self.tolerance}; choose a share of s from 0 to below 0.5")
        _check(self.tiles == 1 or colors_for(self.tiles) is not None, f"tiles {self.tiles}; choose 1, 4, or 6 and more")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`RepresentativeTile`.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest one.

        Raises
        ------
        Refused
            When no lattice is found, or the sample shows less than two periods or holds no rectangular tile.
        """
        found = find_lattice(task, self._detector())
        if found.lattice is None:
            raise Refused(f"no lattice found ({found.reason}): there is no period to cut a tile by")
        frame = rectangle_frame(found.lattice, task.sample.shape, self.tolerance, self.scale_down)
        patches = Patches(task.sample)
        image, known = frame.scaled(task.sample, patches)
        best = self._best(image, known, frame)
        chosen = best[task.rng.integers(len(best))] if len(best) > 1 else best[0]
        place = (int(chosen[0]), int(chosen[1]))
        task.progress(_SEARCHED)
        several = self.tiles > 1
        cutter = Cutter(patches, task.sample.shape, frame, found.lattice, task.rng)
        tiles = wang_set(cutter, place, self.tiles) if several else WangSet.single(frame, place)
        output, source = self._laid(task, frame, tiles, patches)
        shown = tiles.pictures(patches, frame) if several else {"tile": _cut(image, frame, place)}
        extras = {**shown, **_search_extras(image, frame, place, best)}
        note = f"a tile holds {frame.cells} cells" if frame.cells > 1 else ""
        return Synthesis(output, found.lattice, source, extras, found.seconds, note)

    def _detector(self) -> Ssdn:
        """Return the detector of the period: fitted and tested, or as the paper reads it off the curve."""
        if self.period == "last":
            return Ssdn(depth=_DEPTH, subpixel=False, primitive=False, reject="none")
        return Ssdn(depth=_DEPTH, primitive=False)

    def _laid(self, task: Task, frame: TileFrame, tiles: WangSet, patches: Patches) -> tuple[Image, SourceMap]:
        """Return the output and its source map; progress goes on from where the search left it."""
        told = replace(task, progress=lambda done: task.progress(_SEARCHED + (1 - _SEARCHED) * done))
        return laid(told, Laying(frame, tiles, self.rescale), patches)

    def _best(self, image: Image, known: NDArray[np.bool_] | None, frame: TileFrame) -> Points:
        """Return the m best places, ``(m, 5)``: x, y, h, SSDN, S; of equals the first in reading order (section 4)."""
        smooth, alike = continuity(image, frame.size), resemblance(image, frame.size, known)
        allowed = np.isfinite(alike)
        if not allowed.any():
            size = f"{frame.size[1]}x{frame.size[0]} px"
            raise Refused(f"turned as the lattice is, a tile of {size} is larger than the sample")
        if self.p is not None:
            allowed = preselected(np.where(allowed, smooth, np.inf), self.p * float(allowed.sum()))
        rating = np.full(alike.shape, np.inf)
        rating[allowed] = np.round(self.alpha * smooth[allowed] + self.beta * alike[allowed], 12)
        order = _least(rating, min(self.m, int(allowed.sum())))
        y, x = np.unravel_index(order, rating.shape)
        return np.stack([x, y, smooth[y, x], alike[y, x], rating[y, x]], -1).astype(np.float64)


def preselected(smooth: Costs, number: float) -> NDArray[np.bool_]:
    """Return S1: the ``number`` places, at least one, that are smoothest; of equals the first (section 4.1)."""
    chosen = np.zeros(smooth.shape, np.bool_)
    chosen.flat[_least(np.round(smooth, 12), max(round(number), 1))] = True
    return chosen


def _least(values: Costs, number: int) -> NDArray[np.intp]:
    """Return the flat indices of the ``number`` least values in order, of equals the first; O(n) for few."""
    flat = values.ravel()
    if number == 1:
        return np.array([flat.argmin()])
    limit = np.partition(flat, number - 1)[number - 1]
    below = np.flatnonzero(flat <= limit)
    return np.asarray(below[np.argsort(flat[below], kind="stable")][:number])


def _cut(image: Image, frame: TileFrame, place: tuple[int, int]) -> Image:
    """Return the tile at a place (x, y) of the scaled sample."""
    x, y = place
    return image[y : y + frame.size[0], x : x + frame.size[1]]


def _search_extras(image: Image, frame: TileFrame, place: tuple[int, int], best: Points) -> dict[str, NDArray[Any]]:
    """Return what is kept of the search: the frame, the m best and, of several, their tiles."""
    corner = frame.to_sample(np.array(place, np.float64))
    kept: dict[str, NDArray[Any]] = {"frame": np.vstack([corner, frame.steps]), "best": best}
    if len(best) > 1:
        places = best[:, :2].astype(int).tolist()
        kept |= {f"best-{number:02d}": _cut(image, frame, (x, y)) for number, (x, y) in enumerate(places, 1)}
    return kept


_check = checker("representative-tile")
