"""Fill the holes of a picture with patches of the rest, on the picture's own lattice; for methods that need no hole."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.calling.method_calls import move_sources
from nrbench.imaging.convert import Image, box_sums, shrink
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import FoundLattice, Refused, SourceMap, Synthesis, Task, find_lattice
from nrbench.plugins.registry import NamedDetector, in_role

from ..canvas.canvas import Canvas, Mask, Window, copy_patch, edge_mask
from ..canvas.seam_kernels import cut_overlap, link_costs, record_seams
from ..lattice_places.equal_places import EqualPlaces, Pixels, nearest_pixels
from ..patch_laying.raster_order import draw_within

Method = TypeVar("Method", bound=type[Any])
_REACH = 1.5
"""Sides of a patch, in the extents of a cell along x and along y: it shows an element whole, with what is around it."""
_BESIDE = 0.49
"""px: largest distance of a place from the pixel that filled a hole, so that the pixel is the nearest one."""
_LEAST = 12
"""px: least side of a patch, if the picture holds such patches; else patches are halved, down to a pixel."""
_PARTS: Final = (1.0, 0.5, 0.3)
"""Sides of the patches of each pass that improves seams, as parts of the first. Of small ones, more have the color that
continues an element which the border of a hole cuts."""
_TRIES = 30
"""Patches that a pass tries in each window: those that agree best with what is known around the hole."""
_MOST_PLACES, _MOST_PIXELS = 2000, 400
"""Places that are compared in a window, and pixels by which; more are drawn at random, or left out evenly."""
_ACCEPTED = 0.2
"""A patch is drawn from those whose summed squared difference is at most so much above the least (in quilting, .21)."""


_QUICK: Final = 20_000
"""Pixels of holes that are filled within seconds. Where there are more, a sample is cropped to what is well known."""
_WELL_KNOWN: Final = 0.9
"""Share of a box that counts, from which it is well known."""
_CELLS, _LEAST_BOX = 4, 64
"""Sides of a box that shows enough: extents of a cell along x and along y, and px."""
_SIDES, _STEPS = 16, 96
"""Lengths of each side of the boxes that are compared, and places along the longer side of the sample."""
_LEAST_KNOWN: Final = 0.1
"""Share of a picture that must count for its holes to be filled: what fills them is copied from there."""
TOLERANCE: Final = 0.07
"""Default tolerance of a gap's patch over s, along x and along y: both together are less than a tenth of s."""


class HoleFiller:
    """Fills the holes of a picture.

    This is gap filling (RSGF, section 4.2) for gaps of any shape. A hole is filled from its border inward. Each patch
    lies around a pixel at the border of what is known, takes one of the places that the lattice makes equal to its own,
    from those that agree best with what the picture shows there, and is joined along the least visible seam. Further
    passes lay smaller patches over the windows of the hole, as far as they make the seams less visible, also that along
    the border of the hole. All pixels are copies of known ones.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    known
        ``bool (H, W)``: False in the holes.
    lattice
        The lattice of the picture. A patch lies at most :data:`TOLERANCE` s, or 3 px, from an equal place, along x and
        along y. None: patches come from anywhere.
    rng
        The randomness.
    block
        Side of a patch in px where there is no lattice.
    keep
        Whether known pixels never change. False: those up to a third of a patch from a hole may change, so that seams
        can run around the elements that its border cuts.
    """

    def __init__(
        self,
        image: Image,
        known: Mask,
        lattice: Lattice | None,
        rng: np.random.Generator,
        block: int = 40,
        keep: bool = True,
    ) -> None:
        self.image, self.known, self.lattice, self.rng = image, known, lattice, rng
        self.shape = image.shape[0], image.shape[1]
        self.canvas = Canvas(self.shape, image.shape[2])
        self.canvas.place((0, self.shape[0], 0, self.shape[1]), copy_patch(image, (0, 0), self.shape), known)
        across = down = float(block)
        if lattice is not None:
            across, down = _REACH * np.abs(lattice.reduced().matrix).sum(0)
        self.size = max(_LEAST, round(down)), max(_LEAST, round(across))
        # Only what is near the hole tells which patch continues it.
        distance = scipy.ndimage.distance_transform_edt(known)
        self._near = known & (distance <= max(min(self.size) / 4, 2))
        self._kept = known if keep else distance > max(self.size) / 3
        reach = 0 if lattice is None else int(min(3.0, TOLERANCE * lattice.s))
        steps = np.arange(-reach, reach + 1)
        self._moves = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)

    def fill(self, progress: Callable[[float], None]) -> tuple[Image, SourceMap]:
        """Return the picture without holes, and its source map.

        Raises
        ------
        Refused
            If no known pixel is equal to one of a hole.
        """
        holes = int((~self.known).sum())
        while (left := int((~self.canvas.known).sum())) > 0:
            self._fill_next()
            progress(0.5 - 0.5 * left / holes)
        for number, part in enumerate(_PARTS):
            self._improve((max(round(part * self.size[0]), 3), max(round(part * self.size[1]), 3)), part)
            progress(0.5 + 0.5 * (number + 1) / len(_PARTS))
        return self.canvas.output()

    def _fill_next(self) -> None:
        """Lay a patch around the unknown pixel at the border of what is known that has most known pixels around it."""
        known, size = self.canvas.known, self.size
        rim = ~known & scipy.ndimage.binary_dilation(known)
        share = scipy.ndimage.uniform_filter(known.astype(np.float32), size)
        row, column = divmod(int(np.where(rim, share, -1).argmax()), known.shape[1])
        while True:
            window = self._window_around(row, column, size)
            seen = known[self.canvas.pixels(window)]
            whole = box_sums(~self.known, seen.shape) == 0
            places, differences = self._rate_places(window, seen, whole)
            if len(places):
                break
            if max(size) == 1:
                raise Refused(
                    f"the hole at ({column}, {row}) repeats with the lattice, so that nothing can fill it; if holes "
                    "belong to the texture, as in a fence, use --keep-alpha"
                )
            size = max(size[0] // 2, 1), max(size[1] // 2, 1)
        self._lay(window, places[draw_within(differences, (1 + _ACCEPTED) * float(differences.min()), self.rng)])

    def _window_around(self, row: int, column: int, size: tuple[int, int]) -> Window:
        """Return the window of a size around a pixel, moved into the picture."""
        (height, width), (down, across) = self.shape, np.minimum(size, self.shape).tolist()
        y, x = min(max(row - size[0] // 2, 0), height - down), min(max(column - size[1] // 2, 0), width - across)
        return y, y + down, x, x + across

    def _improve(self, size: tuple[int, int], part: float) -> None:
        """Lay patches over windows half a side apart, as far as they make the seams of a hole less visible.

        Small ones, of a ``part`` of the first size, are laid only at the border of a hole.
        """
        for row in range(0, self.shape[0], max(size[0] // 2, 1)):
            for column in range(0, self.shape[1], max(size[1] // 2, 1)):
                window = self._window_around(row, column, size)
                pixels = self.canvas.pixels(window)
                near = self._near[pixels]
                if not self._kept[pixels].all() and (part == 1 or near.any()):
                    anywhere = np.ones(np.subtract(self.shape, near.shape) + 1, np.bool_)
                    for place in self._rate_places(window, near, anywhere)[0]:
                        self._lay(window, place)

    def _rate_places(self, window: Window, seen: Mask, allowed: Mask) -> tuple[Pixels, NDArray[np.float64]]:
        """Return the places whose patches agree best with a window where it is ``seen``, and their differences.

        Each is moved by at most the tolerance to where it agrees best. If nothing is seen, places are drawn.
        """
        if self.lattice is None:
            places = np.argwhere(allowed)[:, ::-1]
        else:
            equal = EqualPlaces(self.lattice, allowed.shape).find_places((window[2], window[0]))
            places = nearest_pixels(equal, allowed.shape)
            places = places[allowed[places[:, 1], places[:, 0]]]
        places = self.rng.permutation(places)[:_MOST_PLACES]
        if not len(places) or not seen.any():
            return places[:_TRIES], np.zeros(min(len(places), _TRIES))
        rows, columns = np.nonzero(seen)
        spread = slice(None, None, -(-len(rows) // _MOST_PIXELS))
        rows, columns = rows[spread], columns[spread]
        shown = self.canvas.image[rows + window[0], columns + window[2]]

        def rate(at: Pixels) -> NDArray[np.float64]:
            apart = self.image[at[:, 1, np.newaxis] + rows, at[:, 0, np.newaxis] + columns] - shown
            return np.asarray(np.einsum("nmc,nmc->n", apart, apart), np.float64)

        places = places[np.argsort(rate(places), kind="stable")[:_TRIES]]
        moved = np.clip(places[:, np.newaxis] + self._moves, 0, np.array(allowed.shape[::-1]) - 1)
        moved[~allowed[moved[..., 1], moved[..., 0]]] = -1
        moved = np.where(moved < 0, places[:, np.newaxis], moved)
        rated = rate(moved.reshape(-1, 2)).reshape(moved.shape[:2])
        best = rated.argmin(1)
        return moved[np.arange(len(places)), best], rated.min(1)

    def _lay(self, window: Window, place: NDArray[np.int64]) -> None:
        """Cut the patch at a place into a window, where both the patch is known and the picture is not given."""
        y0, y1, x0, x1 = window
        (x, y), pixels, shape = place.tolist(), self.canvas.pixels(window), (y1 - y0, x1 - x0)
        patch, shown = copy_patch(self.image, (x, y), shape), self.known[y : y + shape[0], x : x + shape[1]]
        old, known, given = self.canvas.image[pixels], self.canvas.known[pixels].copy(), self.known[pixels]
        inner = x0 > 0, y0 > 0, x1 < self.shape[1], y1 < self.shape[0]
        fixed_new = ~known & shown
        fixed_old = (self._kept[pixels] | ~shown | edge_mask(shape, inner)) & ~fixed_new
        new = np.ascontiguousarray(patch[0])
        costs = link_costs(np.where(known[..., np.newaxis], old, new), new, True)
        # Beyond the border of a hole nothing is known that a patch could be compared with: its near side counts twice.
        border = 2 * link_costs(np.where(given[..., np.newaxis], old, new), new, True)
        for axis, first, second in ((0, np.s_[:, :-1], np.s_[:, 1:]), (1, np.s_[:-1], np.s_[1:])):
            np.copyto(costs[axis][first], border[axis][first], where=given[first] != given[second])
        seams = np.ascontiguousarray(self.canvas.seams[:, *pixels])
        mask = cut_overlap(costs, seams, fixed_old, fixed_new)
        record_seams(seams, known, mask, costs)
        self.canvas.place(window, patch, mask)
        self.canvas.seams[:, *pixels] = seams


def fill_task(task: Task, found: FoundLattice, block: int = 40, keep: bool = True) -> Synthesis:
    """Return the sample of a task with its holes filled: on its lattice, or with patches from anywhere if it has none.

    Parameters
    ----------
    task
        Its ``known`` leaves pixels out. The shape of the output does not count.
    found
        The lattice of the sample.
    block, keep
        See :class:`HoleFiller`.

    Raises
    ------
    Refused
        If less than a tenth of the sample counts.
    """
    assert task.known is not None
    if (share := float(task.known.mean())) < _LEAST_KNOWN:
        raise Refused(
            f"mask: leaves {100 * share:.2g} % of {task.known.shape[1]}x{task.known.shape[0]} px, too little to fill "
            f"the rest from; leave at least {100 * _LEAST_KNOWN:.0f} %"
        )
    image, source = HoleFiller(task.sample, task.known, found.lattice, task.rng, block, keep).fill(task.progress)
    note = "" if found.lattice else f"holes filled with patches from anywhere: no lattice found ({found.reason})"
    return Synthesis(image, found.lattice, source, detection_seconds=found.seconds, note=note)


def leaves_out(method: Method) -> Method:
    """Make a method leave out the pixels that do not count; a decorator of its class.

    The holes of the sample are filled first, and the method gets the full sample, or, where the holes are large, a
    well-known part of it. What it copies from a filled place is a copy of a pixel that counts, and the source map names
    that one.
    """
    synthesize: Callable[[Any, Task], Synthesis] = method.synthesize

    @functools.wraps(synthesize)
    def synthesize_filled(self: Any, task: Task) -> Synthesis:
        if task.known is None:
            return synthesize(self, task)
        detector = NamedDetector(getattr(self, "finder", "") or in_role("detector"))
        found = find_lattice(task, detector)
        share = f"{100 * (1 - task.known.mean()):.3g} % of the sample left out"
        whole, (task, found, corner) = task.sample.size, crop_to_known(task, found)
        if task.sample.size < whole:
            share += f", and all but {task.sample.shape[1]}x{task.sample.shape[0]} px of it"
        filled = fill_task(task, found, keep=False)
        made = synthesize(
            self, replace(task, sample=filled.image, known=None, detected=(filled.image, detector, found))
        )
        note = "; ".join(filter(None, (made.note, share, "" if found.reason in made.note else filled.note)))
        seconds = made.detection_seconds + filled.detection_seconds
        source = filled.source
        assert source is not None
        made = move_sources(made, lambda places: trace_places(places, source) + corner)
        lattice = None if made.lattice is None else made.lattice.shifted(corner)
        return replace(made, detection_seconds=seconds, note=note, lattice=lattice)

    method.synthesize, method.masks = synthesize_filled, True
    return method


def crop_to_known(task: Task, found: FoundLattice) -> tuple[Task, FoundLattice, NDArray[np.int64]]:
    """Return a task with the part of its sample that is well known, its lattice, and the corner (x, y) of the part.

    The part has the phase of the sample, to half a pixel. It is as large as the output if it can be, and shows four
    periods; a sample without such a part, or with small holes, stays whole.
    """
    assert task.known is not None
    box, cells = None, np.full(2, _LEAST_BOX)
    if found.lattice is not None:
        cells = np.maximum(cells, np.ceil(_CELLS * np.abs(found.lattice.reduced().matrix).sum(0)[::-1]).astype(int))
    if (~task.known).sum() > _QUICK:
        box = _find_known_box(task.known, np.maximum(cells, task.shape)) or _find_known_box(task.known, cells)
    if box is None:
        return task, found, np.zeros(2, np.int64)
    top, bottom, left, right = box
    corner = np.array((left, top))
    if (lattice := found.lattice) is not None:
        vectors = lattice.reduced().matrix
        numbers = np.rint(corner @ np.linalg.inv(vectors)) + np.stack(np.meshgrid(*[np.arange(-2, 3)] * 2), -1)
        points = np.rint(numbers @ vectors).astype(int).reshape(-1, 2)
        points = points[(points >= corner).all(-1)]
        corner = points[points.sum(-1).argmin()]
        lattice = lattice.shifted(-corner)
        found = replace(found, lattice=lattice, vertices=())
    part = np.s_[corner[1] : bottom, corner[0] : right]
    given = None if task.lattice is None else lattice
    sample, known = np.ascontiguousarray(task.sample[part]), np.ascontiguousarray(task.known[part])
    return replace(task, sample=sample, known=known, lattice=given), found, corner


def _find_known_box(known: Mask, least: NDArray[np.int64]) -> tuple[int, int, int, int] | None:
    """Return first and last row and column, half-open, of the box of most known pixels among well-known ones.

    It has at least ``least`` (rows, columns). None: there is none.
    """
    step = -(-max(known.shape) // _STEPS)
    coarse = shrink(known[..., np.newaxis].astype(np.float32), step)[..., 0]
    most, found = 0.0, None
    lengths: list[list[int]] = [
        np.unique(np.geomspace(-(-low // step), high, _SIDES).astype(int)).tolist() if low <= high * step else []
        for low, high in zip(least.tolist(), coarse.shape, strict=True)
    ]
    for size in itertools.product(lengths[0], lengths[1]):
        counts = box_sums(coarse, size)
        count = float(counts.max())
        if count > most and count >= _WELL_KNOWN * math.prod(size):
            most, (row, column) = count, np.unravel_index(counts.argmax(), counts.shape)
            top, left = int(row) * step, int(column) * step
            found = top, top + size[0] * step, left, left + size[1] * step
    return found


def trace_places(places: Points, filled: SourceMap) -> Points:
    """Return the places (x, y) in a sample of places ``(..., 2)`` in the sample with its holes filled."""
    pixels = np.rint(places).astype(np.intp).clip(0, np.array(filled.shape[1::-1]) - 1)
    moved = filled[pixels[..., 1], pixels[..., 0], :2]
    beside = moved + np.clip(places - pixels, -_BESIDE, _BESIDE)
    return np.where((moved == pixels).all(-1, keepdims=True), places, beside)
