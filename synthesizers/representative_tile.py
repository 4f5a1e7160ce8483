"""Representative tile: the tile whose repetition best reconstructs the sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.ssdn import Ssdn
from nrbench.errors import checker
from nrbench.imaging.box_sums import box_sums
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Refused, SourceMap, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from .rectangular_tiles.tile_frame import TileFrame, find_tile_frame
from .sampling.patches import Patches, resample

Values = NDArray[np.float32]
"""``float32 (H, W, C)``, any range."""
Costs = NDArray[np.float64]
"""``float64 (H - h + 1, W - w + 1)``: one for each place (row, column) of a tile's first pixel."""
Mask = NDArray[np.bool_]
"""``bool (H, W)``."""
Size = tuple[int, int]
"""(h, w): rows and columns of a tile."""

_SEARCH_SHARE: Final = 0.4
"""Progress when the tile is chosen."""
MAX_WEIGHT: Final = 1e6
"""Largest weight: beyond it the other term has no effect."""


@dataclass(frozen=True)
class RepresentativeTile:
    """The tile whose repetition best reconstructs the sample and whose borders match: periodic output, small and fast.

    The period gives the tile's size in whole pixels, to which the sample is scaled down (section 3). The tile is the
    one with the least S = alpha h + SSDN over all places in the scaled sample (equation 6 with beta = 1, as in all
    figures of the paper): h, the continuity, compares its first row and column with its last (equation 5); SSDN, the
    resemblance, compares the sample with the repetition of the tile (section 4.2). The paper rates only a share p of
    the places, those with the least h; here integral images rate every place exactly.

    The tile is the paper's, of whole pixels (``extras["tile"]``, a PNG beside a picture). The paper repeats these
    pixels, so that a period of 21.37 px becomes 21. Here every output pixel shows the point of the tile that is
    equivalent to it by the real-valued period, interpolated once from the sample: nothing drifts or blurs, and where
    periods are whole pixels are copied (``rescale=false``: as in the paper).

    If the lattice is not rectangular, the tile is the smallest rectangle that is a period of it, turned or of several
    cells if necessary; its sides may miss lattice vectors by ``tolerance``. Without a given lattice the detector
    ``ssdn`` finds the period along the sample's axes, as in the paper.

    The output is periodic: it keeps regularity and loses randomness, as the paper says.

    ``preset=paper`` repeats the pixels of the tile, with the period x_n / n scaled down to whole pixels (section 3; in
    section 5 the paper does without, where periods are hundreds of pixels long). Its weight alpha and its share p are
    those of figure 5. The share of figure 7, 0.0001, leaves a single place in a sample of 128 x 128 px, and then
    resemblance and alpha have no effect.

    Extras: ``tile``; ``frame``, ``(3, 2)``: the tile's first pixel (x, y) in the sample, and the steps (x, y) in the
    sample of one pixel along its rows and columns, of lengths r (equation 4); ``best``, ``(best_tiles, 5)``: x, y in
    the scaled sample, h, SSDN and S of the best tiles; ``best-01`` ... their images, if there are several.

    Parameters
    ----------
    continuity_weight
        alpha, the weight of continuity beside that of resemblance, which is 1: 0 to 1e6 (the paper: 1, 30 or 0).
    rated_share
        p, the share in (0, 1] of the places, those of least h, that are rated (the paper: 0.0001 to 0.02). None: all.
    best_tiles
        The tile is drawn uniformly from so many best ones, 1 to 99 (the paper lets the user choose one of m).
    rescale
        True: the output has the sample's period. False: it repeats the tile's pixels, with the tile's period.
    finder
        Detector that finds the period where no lattice is given. ``"ssdn:primitive=false"``: fitted to all minima,
        sub-pixel, and refused if it may be due to chance. ``"ssdn:preset=paper"``: x_n / n, the last minimum over its
        number (equation 3), never refused.
    tolerance
        Largest distance of a side of the tile from a lattice vector, in shares of s, in [0, 0.5).

    References
    ----------
    .. [1] "Extraction of a Representative Tile from a Near-Periodic Texture." Université de Sherbrooke, Québec, Canada.
           The text that was implemented has no date, authors or venue.
    """

    continuity_weight: float = 1.0
    rated_share: float | None = None
    best_tiles: int = 1
    rescale: bool = True
    finder: Literal["ssdn:primitive=false", "ssdn:preset=paper"] = "ssdn:primitive=false"
    tolerance: float = 0.1

    reference: ClassVar[bool] = False
    uses_lattice: ClassVar[bool] = True
    version: ClassVar[str] = "1"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {
            "continuity_weight": 30.0,
            "rated_share": 0.01,
            "best_tiles": 1,
            "rescale": False,
            "finder": "ssdn:preset=paper",
        }
    }
    patch_shape: ClassVar[str] = "rectangular tile from the period"
    patch_placement: ClassVar[str] = "side by side"
    patch_stitching: ClassVar[str] = "none"
    paper: ClassVar[str] = Ssdn.paper

    def __post_init__(self) -> None:
        weight, share = self.continuity_weight, self.rated_share
        _check(0 <= weight <= MAX_WEIGHT, f"continuity_weight {weight}; choose from 0 to {MAX_WEIGHT:g}")
        _check(share is None or 0 < share <= 1, f"rated_share {share}; choose above 0, at most 1, or leave it out")
        _check(1 <= self.best_tiles <= 99, f"best_tiles {self.best_tiles}; choose from 1 (the best tile) to 99")
        _check(0 <= self.tolerance < 0.5, f"tolerance {self.tolerance}; choose a share of s from 0 to below 0.5")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis; see :class:`RepresentativeTile`.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest one.

        Raises
        ------
        Refused
            When no lattice is found, or the sample shows less than two periods or holds no rectangular tile.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no period to cut a tile by")
        frame = find_tile_frame(lattice, task.sample.shape, self.tolerance)
        patches = Patches(task.sample)
        image, known = frame.scale_sample(task.sample, patches)
        best = self._find_best(image, known, frame)
        chosen = best[task.rng.integers(len(best))] if len(best) > 1 else best[0]
        place = (int(chosen[0]), int(chosen[1]))
        task.progress(_SEARCH_SHARE)
        rest = replace(task, progress=lambda done: task.progress(_SEARCH_SHARE + (1 - _SEARCH_SHARE) * done))
        output, source = repeat_tile(rest, frame, place, self.rescale, patches)
        corner = frame.to_sample(np.array(place, np.float64))
        extras = {"tile": _cut(image, frame, place), "frame": np.vstack([corner, frame.steps]), "best": best}
        if len(best) > 1:
            places = best[:, :2].astype(int).tolist()
            extras |= {f"best-{number:02d}": _cut(image, frame, (x, y)) for number, (x, y) in enumerate(places, 1)}
        note = f"a tile holds {frame.cells} cells" if frame.cells > 1 else ""
        return Synthesis(output, lattice, source, extras, seconds, note)

    def _find_best(self, image: Image, known: NDArray[np.bool_] | None, frame: TileFrame) -> Points:
        """Return the m best places, ``(m, 5)``: x, y, h, SSDN, S (section 4). Of equal places the first comes first."""
        smooth, alike = continuity(image, frame.size), resemblance(image, frame.size, known)
        allowed = np.isfinite(alike)
        if not allowed.any():
            size = f"{frame.size[1]}x{frame.size[0]} px"
            raise Refused(f"turned as the lattice is, a tile of {size} is larger than the sample")
        if self.rated_share is not None:
            allowed = preselect(np.where(allowed, smooth, np.inf), self.rated_share * float(allowed.sum()))
        rating = np.full(alike.shape, np.inf)
        rating[allowed] = np.round(self.continuity_weight * smooth[allowed] + alike[allowed], 12)
        order = _least(rating, min(self.best_tiles, int(allowed.sum())))
        y, x = np.unravel_index(order, rating.shape)
        return np.stack([x, y, smooth[y, x], alike[y, x], rating[y, x]], -1).astype(np.float64)


def preselect(smooth: Costs, number: float) -> NDArray[np.bool_]:
    """Return S1: the ``number`` places, at least one, of least continuity cost (section 4.1)."""
    chosen = np.zeros(smooth.shape, np.bool_)
    chosen.flat[_least(np.round(smooth, 12), max(round(number), 1))] = True
    return chosen


def _least(values: Costs, number: int) -> NDArray[np.intp]:
    """Return the flat indices of the ``number`` least values in order, equal values as they stand; O(n) for few."""
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


def resemblance(image: Values, size: Size, known: Mask | None = None) -> Costs:
    """Return the mean squared difference between the image and each of its tiles repeated over it.

    Every tile stays where it lies, so that pixel q is compared with the tile's pixel of its residue class, modulo the
    tile's sides. A tile holds one pixel p of each class r. It contributes D(p), the sum over the class of (I - I(p))^2,
    which is Q_r - 2 I(p) S_r + n_r I(p)^2 with the class's sum of squares Q_r, sum S_r and number n_r. The cost of a
    tile is the sum of D over its box: one integral image serves all tiles.

    Parameters
    ----------
    image
        The squares are summed over channels.
    size
        Size of the tile, at most that of the image.
    known
        The pixels that count; None: all. Tiles that hold other pixels cost infinity.

    Returns
    -------
    Costs
        SSDN(I, I_T) of representative tile, section 4.2. O(H W C), whatever the number of tiles; trying each of n tiles
        is O(n H W C).
    """
    shape, mask = image.shape[:2], np.ones(image.shape[:2], np.bool_) if known is None else known
    weight = mask.astype(np.float64)
    number, cost = _spread(_classes(weight, size), shape), np.zeros(shape)
    for channel in np.moveaxis(image, -1, 0):
        plane = (channel - channel[mask].mean(dtype=np.float64)) * weight
        cost += _spread(_classes(plane**2, size), shape)
        cost += plane * (number * plane - 2 * _spread(_classes(plane, size), shape))
    total = np.maximum(box_sums(cost, size), 0) / max(weight.sum(), 1)
    if known is not None:
        total[box_sums(weight, size) < size[0] * size[1] - 0.5] = np.inf
    return np.asarray(total)


def continuity(image: Values, size: Size) -> Costs:
    """Return how much each tile's first row and column differ from its last, which meet when the tile is repeated.

    The cost is the sum of the squared differences over channels and the h + w pairs of pixels, over 2 (w + h - 1).

    Notes
    -----
    Representative tile, section 4.1, equation 5: h(T). The sums along each border come from cumulative sums, O(H W C).
    The paper calls h a mean, but divides by about twice the number of pairs. This is kept, since its alpha weighs it.
    """
    rows, columns = size
    height, width = image.shape[:2]
    across = _squares(image[:, columns - 1 :], image[:, : width - columns + 1])
    down = _squares(image[rows - 1 :], image[: height - rows + 1])
    total = box_sums(across, (rows, 1)) + box_sums(down, (1, columns))
    return np.asarray(np.maximum(total, 0) / (2 * (columns + rows - 1)))


def _squares(first: Values, last: Values) -> NDArray[np.float64]:
    difference = np.subtract(first, last, dtype=np.float64)
    return np.asarray(np.einsum("ijk,ijk->ij", difference, difference))


def _classes(plane: NDArray[np.float64], size: Size) -> NDArray[np.float64]:
    """Return the sum over each residue class, ``(h, w)``."""
    (height, width), (rows, columns) = plane.shape, size
    padded = np.pad(plane, ((0, -height % rows), (0, -width % columns)))
    return np.asarray(padded.reshape(-1, rows, padded.shape[1]).sum(0).reshape(rows, -1, columns).sum(1))


def _spread(classes: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the value of each pixel's class."""
    wide = classes[:, np.arange(shape[1]) % classes.shape[1]]
    return np.asarray(wide[np.arange(shape[0]) % classes.shape[0]])


def repeat_tile(
    task: Task, frame: TileFrame, place: tuple[int, int], rescale: bool, patches: Patches
) -> tuple[Image, SourceMap]:
    """Return the output, one tile side by side, and its source map.

    The output continues the sample's phase: the place in the sample where the tile's first pixel lies shows the tile's
    first pixel in the output.

    Parameters
    ----------
    task
        The sample and the output's shape.
    frame
        The tile's size, and where its pixels lie in the sample.
    place
        (x, y) of the tile's first pixel in the scaled sample.
    rescale
        True: the output has the sample's periods. False: it has those of the tile in whole pixels.
    patches
        Of the sample.
    """
    size = np.array(frame.size[::-1])
    corner, steps = np.array(place, np.float64), np.eye(2)
    if rescale:
        corner, steps = frame.to_sample(corner), frame.periods / size[:, np.newaxis]

    def points(pixels: Points) -> Points:
        at = (pixels - corner) @ np.linalg.inv(steps)
        nearest = np.floor(at + 0.5)
        return frame.to_sample(place + nearest % size + (at - nearest))

    return resample(task, points, patches)


_check = checker("representative-tile")
