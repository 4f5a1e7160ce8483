"""An output in the making, of patches of a sample that are cut into it along the least visible seams.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from ..sampling.patches import Source
from ..seams.minimum_cut import Links, Mask, minimum_cut
from .patchwork_kernels import FIRST, SECOND, STAY, UNIT, link_choices
from .translations import Features

Window = tuple[int, int, int, int]
"""(y0, y1, x0, x1), half-open: rows and columns of the output."""
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]
Seams = NDArray[np.int64]
"""``int64 (2, H, W)``: what the links to the right, and to below, of each pixel cost; 0 inside a patch."""


@dataclass(frozen=True, eq=False)
class Patchwork:
    """An output in the making.

    Every pixel is a copy, so that the map of sources tells all: which patch a pixel is from, what that patch,
    continued, would show beside it, and so what every seam costs. Laying a patch finds the part of it to show for which
    all seams together, old and new, cost least. That is the paper's graph with its seam nodes (section 3.1): what seams
    cost is a metric on patches (equation 1), and then each choice between old and new is a cut without further nodes,
    the move of Boykov, Veksler and Zabih 2001 (Fast approximate energy minimization via graph cuts). Nothing ties the
    rim of a patch: outside the window, old pixels are neighbours as any.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    features
        ``int32 (H, W, F)``: what seams are judged by, in gray levels: the sample's colors, or more than them.
    shape
        (height, width) of the output, px.
    normalized
        False: a change from patch A to B between pixels s and t costs ``|A(s) - B(s)| + |A(t) - B(t)|``, Euclidean over
        the features (equation 1). True: its square over the gradients of both at both pixels along the link (section
        5 with the squares of :func:`~nrbench.synthesizers.gap_filling.canvas.visible_links`). That is no metric: an old seam that
        costs more than two new ones counts as those two while it is weighed: the cut is not always the least, but never
        costs more than what was there.
    wrap
        Whether the output's edges meet their opposites.
    """

    sample: Image
    features: Features
    shape: tuple[int, int]
    normalized: bool = False
    wrap: bool = False

    @cached_property
    def origin(self) -> NDArray[np.int64]:
        """``int64 (H, W, 2)``: the (x, y) in the sample of each known pixel."""
        return np.zeros((*self.shape, 2), np.int64)

    @cached_property
    def known(self) -> Mask:
        """Where the output shows something already."""
        return np.zeros(self.shape, np.bool_)

    @cached_property
    def seams(self) -> Seams:
        """What the output's seams cost, parts of a gray level."""
        return np.zeros((2, *self.shape), np.int64)

    @property
    def cost(self) -> float:
        """What all seams cost, gray levels."""
        return float(self.seams.sum() / UNIT)

    def finished(self) -> tuple[Image, Source]:
        """Return the output and its source map."""
        source = np.ones((*self.shape, 3), np.float32)
        source[..., :2] = self.origin
        return self.shown(self.sample, (0, self.shape[0], 0, self.shape[1])), source

    def shown(self, sample: NDArray[Any], window: Window) -> NDArray[Any]:
        """Return what a window shows of anything as large as the sample, ``(H, W, ...)``; any value where unknown."""
        x, y = np.moveaxis(self.origin[self.pixels(window)], -1, 0)
        return np.asarray(sample[y, x])

    def pixels(self, window: Window) -> Pixels:
        """Return the rows and columns of a window, for indexing; they wrap where the output does."""
        y0, y1, x0, x1 = window
        rows, columns = np.arange(y0, y1) % self.shape[0], np.arange(x0, x1) % self.shape[1]
        return rows[:, np.newaxis], columns[np.newaxis]

    def lay(self, window: Window, place: tuple[int, int], reach: int = 0) -> int:
        """Cut a patch into a window: all of it where nothing was, else what makes the seams cost least.

        Parameters
        ----------
        window
            Inside the output; where it wraps, beyond its edges, too, but two px less than it high and wide.
        place
            (x, y) in the sample of what the patch has in the window's first pixel; the window wholly inside.
        reach
            How far, px, the patch may give pixels beyond the window as well, where something is known and the sample
            holds it: room for the seams.

        Returns
        -------
        int
            How many pixels are new.
        """
        around, ring = self._around(self._reached(window, place, reach))
        pixels = self.pixels(around)
        known, origin = np.ascontiguousarray(self.known[pixels]), np.ascontiguousarray(self.origin[pixels])
        forced = np.zeros_like(known)
        forced[_within(window, around)] = ~known[_within(window, around)]
        x, y = place[0] + around[2] - window[2], place[1] + around[0] - window[0]
        choices = link_choices(self.features, self._slopes, self.normalized, origin, known, x, y)
        new = least_seams(choices, (ring | ~known) & ~forced, forced)
        self._show(pixels, new, (x, y))
        kept = np.stack([_kept(choices[axis], new, axis) for axis in (0, 1)])
        self.seams[:, pixels[0], pixels[1]] = np.where(_links_of(ring), kept, self.seams[:, pixels[0], pixels[1]])
        return int(new.sum())

    def _show(self, pixels: Pixels, new: Mask, place: tuple[int, int]) -> None:
        rows, columns = np.nonzero(new)
        at = pixels[0][rows, 0], pixels[1][0, columns]
        self.origin[at] = np.stack([columns + place[0], rows + place[1]], -1)
        self.known[at] = True

    def _around(self, window: Window) -> tuple[Window, Mask]:
        """Return a window with the ring of pixels around it, and that ring."""
        y0, y1, x0, x1 = window
        if self.wrap:
            around = (y0 - 1, y1 + 1, x0 - 1, x1 + 1)
        else:
            around = (max(y0 - 1, 0), min(y1 + 1, self.shape[0]), max(x0 - 1, 0), min(x1 + 1, self.shape[1]))
        ring = np.ones((around[1] - around[0], around[3] - around[2]), np.bool_)
        ring[_within(window, around)] = False
        return around, ring

    def _reached(self, window: Window, place: tuple[int, int], reach: int) -> Window:
        """Return a window made larger on all sides, as far as sample and output go."""
        ends: list[int] = []
        for axis in (0, 1):
            start, stop, first = window[2 * axis], window[2 * axis + 1], window[2 * axis] - place[1 - axis]
            side, last = self.shape[axis], first + self.sample.shape[axis]
            if self.wrap:
                more = max(min(reach, (side - 2 - (stop - start)) // 2), 0)
                ends += [max(start - more, first), min(stop + more, last)]
            else:
                ends += [max(start - reach, first, 0), min(stop + reach, last, side)]
        return ends[0], ends[1], ends[2], ends[3]

    @cached_property
    def _slopes(self) -> Features:
        """``int32 (2, H, W)``: the gradient of the sample's features along x and y, in the unit of costs."""
        values = self.features.astype(np.float64)
        slopes = [
            np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values) for axis in (1, 0)
        ]
        return np.stack([np.rint(UNIT * np.sqrt((slope**2).sum(-1))) for slope in slopes]).astype(np.int32)


def _within(window: Window, around: Window) -> tuple[slice, slice]:
    """Return the rows and columns of a window in one around it."""
    y0, y1, x0, x1 = window
    return slice(y0 - around[0], y1 - around[0]), slice(x0 - around[2], x1 - around[2])


def least_seams(choices: NDArray[np.int64], fixed_old: Mask, fixed_new: Mask) -> Mask:
    """Return which pixels of a window become new such that its links cost least.

    Parameters
    ----------
    choices
        Of :func:`~nrbench.synthesizers.patchwork.patchwork_kernels.link_choices`.
    fixed_old, fixed_new
        ``bool (h, w)``: pixels that must stay, or become new.

    Notes
    -----
    A link that costs c when both its pixels s and t stay, b when s becomes new, a when t does and 0 when both do is,
    but for a constant, a link of (a + b - c) / 2 between them, with (b - a - c) / 2 when s becomes new and
    (a - b - c) / 2 when t does. c counts as a + b where it is more (which with a metric never happens). All is doubled,
    and stays whole.
    """
    stay, second, first = np.moveaxis(choices.astype(np.float64), 1, 0)
    stay = np.minimum(stay, first + second)
    links = first + second - stay
    becoming = (first - second - stay).sum(0)
    becoming[:, 1:] += (second - first - stay)[0, :, :-1]
    becoming[1:] += (second - first - stay)[1, :-1]
    source = np.where(fixed_new, np.inf, np.maximum(-becoming, 0))
    sink = np.where(fixed_old, np.inf, np.maximum(becoming, 0))
    return minimum_cut(Links(links[0, :, :-1], links[1, :-1]), source, sink)


def _kept(choices: NDArray[np.int64], new: Mask, axis: int) -> NDArray[np.int64]:
    """Return what the links of one axis cost once pixels are new."""
    there = np.roll(new, -1, 1 - axis)
    one = np.where(new, choices[FIRST], choices[SECOND])
    return np.where(new & there, 0, np.where(new | there, one, choices[STAY]))


def _links_of(ring: Mask) -> Mask:
    """Return which links ``(2, h, w)`` have a pixel off the ring."""
    inside = ~ring
    links = np.stack([inside, inside])
    links[0, :, :-1] |= inside[:, 1:]
    links[1, :-1] |= inside[1:]
    return links
