"""What happens before and after a method is called: it prepares for a sample or a part of it; its output is checked.

A preparation, such as training, is done once, and found again by all cells of the sample. An output is rounded to the
bits of the sample, 8 or 16.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.imaging.convert import MIN_SIDE, Image, box_sums, depth_of, quantize, shrink
from nrbench.imaging.masks import Mask
from nrbench.imaging.source_maps import read_nearest
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import NoLatticeFound, Shape, SourceMap, Synthesis, Synthesizer, Task
from nrbench.plugins.registry import NamedDetector
from nrbench.storage import read_json, remove, temporary_folder, write_json
from nrbench.streams import pixels_hash, stream

RECORD = ".prepared.json"
"""The file of a prepared folder that says how long the preparation took."""


def prepare_method(method: Any, task: Task, folder: Path, seed: int) -> tuple[Task, float | None]:
    """Let a method with ``prepare(task)`` prepare for a sample, unless it has done so before.

    The method works in another folder, which is renamed at the end: a preparation that is interrupted leaves nothing,
    and of two at the same time one counts.

    Parameters
    ----------
    method
        The method.
    task
        The task of the synthesis.
    folder
        The folder that ``task.cache`` is to be.
    seed
        The seed of the run.

    Returns
    -------
    task
        The task with the folder; as it was if the method has no ``prepare``.
    seconds
        Wall seconds of the preparation, also of an earlier one; None if the method has none.
    """
    if not hasattr(method, "prepare"):
        return task, None
    seconds = _read_seconds(folder)
    if seconds is None:
        remove(folder)  # it is damaged, if it is there
        aside = folder.with_name(f".{folder.name}-{uuid.uuid4().hex}")
        aside.mkdir(parents=True)
        rng, start = stream("prepare", seed, pixels_hash(task.sample)), time.perf_counter()
        given = replace(task, shape=task.sample.shape[:2], rng=rng, cache=aside, again=None, recompose=None)
        try:
            method.prepare(given)
            seconds = time.perf_counter() - start
            write_json(aside / RECORD, {"seconds": seconds})
            with contextlib.suppress(OSError):  # that of another cell is there
                aside.rename(folder)
        finally:
            remove(aside)
    return replace(task, cache=folder), seconds


@contextlib.contextmanager
def briefly_prepared(method: Any, task: Task, seed: int) -> Iterator[Task]:
    """Yield the task of a method outside of a run, for which it has prepared; the folder does not last."""
    with temporary_folder() if hasattr(method, "prepare") else contextlib.nullcontext(Path()) as folder:
        yield prepare_method(method, task, folder / "prepared", seed)[0]


def _read_seconds(folder: Path) -> float | None:
    """Return how long the preparation of a folder took; None if the folder is not complete."""
    seconds = (read_json(folder / RECORD) or {}).get("seconds")
    return seconds if isinstance(seconds, float) and 0 <= seconds < float("inf") else None


COPY_TOLERANCE = 1.5 / 255
"""Largest difference between a copied pixel and its source: the rounding to 8 bits."""
RANGE_TOLERANCE = 0.1
"""How far values of an output may lie outside [0, 1]. Interpolation overshoots by less; they are clipped."""
_BAND = 1 << 20
"""Number of pixels that are checked at a time: a large output leaves no room for copies."""


def synthesize_exactly(method: Synthesizer, task: Task) -> Synthesis:
    """Return the synthesis of a method. Of a sample of 16 bits, copies are exact: some methods compute in 8 bits."""
    made = method.synthesize(task)
    source: Any = getattr(made, "source", None)
    if depth_of(task.sample) == 8 or np.shape(source) != (*task.shape, 3):
        return made  # what is wrong with it, the check says
    places = np.nan_to_num(source)
    copy = (places[..., 2] > 1 - 1e-6) & (places[..., :2] == np.rint(places[..., :2])).all(-1)
    x, y = np.clip(places[copy][:, :2].astype(int).T, 0, np.array(task.sample.shape[1::-1])[:, np.newaxis] - 1)
    image = np.array(made.image, np.float32)
    image[copy] = task.sample[y, x]
    return replace(made, image=image)


class InvalidOutput(Exception):
    """A method returned something that is no valid :class:`~nrbench.plugins.forms.Synthesis` of its task."""


def checked_synthesis(synthesis: Any, sample: Image, shape: Shape, known: Mask | None = None) -> Synthesis:
    """Return what a method returned, checked, with its image rounded to the bits of the sample.

    ``known`` tells which pixels of the sample count; None: all.

    Raises
    ------
    InvalidOutput
        When it is no :class:`~nrbench.plugins.forms.Synthesis`, its image is not finite or of another shape, its
        source map is not true or has pixels that do not count, or a field is not of its declared type.
    """
    if not isinstance(synthesis, Synthesis):
        raise InvalidOutput(f"returned {type(synthesis).__name__} instead of a Synthesis")
    image = _checked_image(synthesis.image, (*shape, sample.shape[2]), depth_of(sample))
    source = None if synthesis.source is None else _numbers(synthesis.source, "source map").astype(np.float32)
    if source is not None:
        check_source(source, image, sample)
        if known is not None:
            counted = read_nearest(known, source[np.isfinite(source).all(-1)])
            if not counted.all():
                raise InvalidOutput(f"copied {int((~counted).sum())} pixels that the mask leaves out")
    blended = None if synthesis.blended is None else _numbers(synthesis.blended, "array of blended sources")
    if blended is not None and (blended.ndim != 4 or blended.shape[:2] + blended.shape[3:] != (*shape, 3)):
        raise InvalidOutput(
            f"returned blended sources of the wrong shape: expected {(*shape, 'K', 3)}, got {blended.shape}"
        )
    if blended is not None and not (np.isfinite(blended).all() and (blended[..., 2] >= 0).all()):
        raise InvalidOutput("returned blended sources with NaN, infinity or negative weights")
    if not (synthesis.lattice is None or isinstance(synthesis.lattice, Lattice)):
        raise InvalidOutput(
            f"returned a lattice of the wrong type: expected Lattice or None, got {synthesis.lattice!r}"
        )
    extras = {_checked_name(name): _numbers(array, f"extra {name!r}") for name, array in synthesis.extras.items()}
    seconds = synthesis.detection_seconds
    if not (isinstance(seconds, int | float | np.number) and np.isfinite(seconds) and seconds >= 0):
        raise InvalidOutput(f"returned wrong detection_seconds: expected a number of seconds, got {seconds!r}")
    return dataclasses.replace(
        synthesis,
        image=image,
        sample=sample,
        source=source,
        extras=extras,
        detection_seconds=float(seconds),
        note=str(synthesis.note or ""),
        files={_checked_name(name): _checked_file(name, describe) for name, describe in synthesis.files.items()},
    )


def is_picture(extra: NDArray[Any]) -> bool:
    """Return whether a method's extra is a picture: ``(h, w, 1)`` or ``(h, w, 3)``, floats in [0, 1]."""
    if extra.ndim != 3 or extra.shape[2] not in (1, 3) or extra.dtype.kind != "f" or not extra.size:
        return False
    return bool(extra.min() >= 0 and extra.max() <= 1)


def _numbers(value: Any, what: str) -> NDArray[Any]:
    array = np.asarray(value)
    if array.dtype.kind not in "biufc":
        raise InvalidOutput(f"returned a wrong {what}: expected an array of numbers, got dtype {array.dtype}")
    return array


def _checked_name(name: Any) -> str:
    if not (isinstance(name, str) and re.fullmatch(r"\w[\w.-]{0,79}", name)):
        raise InvalidOutput(f"returned an extra called {name!r}; use letters, digits, '.', '-' and '_'")
    return name


def _checked_file(name: str, describe: Callable[[str], str]) -> Callable[[str], str]:
    if not callable(describe) or not isinstance(describe(""), str) or name.endswith((".npz", ".png")):
        expected = "a function of a prefix that returns text, and no name of a picture or an array"
        raise InvalidOutput(f"returned a wrong file {name!r}: expected {expected}")
    return describe


def _checked_image(image: Any, shape: tuple[int, int, int], bits: int) -> Image:
    pixels = np.asarray(image)
    if pixels.shape != shape:
        raise InvalidOutput(f"returned an image of the wrong shape: expected {shape}, got {pixels.shape}")
    if not np.issubdtype(pixels.dtype, np.floating):
        raise InvalidOutput(f"returned wrong pixels: expected floats in [0, 1], got dtype {pixels.dtype}")
    if not np.isfinite(pixels).all():
        bad = int((~np.isfinite(pixels)).any(-1).sum())
        raise InvalidOutput(f"returned NaN or infinity in {bad} of {shape[0] * shape[1]} pixels")
    low, high = float(pixels.min()), float(pixels.max())
    if low < -RANGE_TOLERANCE or high > 1 + RANGE_TOLERANCE:
        raise InvalidOutput(f"returned values from {low:.3g} to {high:.3g}; an image has values in [0, 1]")
    return quantize(np.asarray(pixels, np.float32), bits)


def check_source(source: SourceMap, image: Image, sample: Image) -> None:
    """Check that a source map points into the sample, and that copies of whole pixels equal their sources.

    Raises
    ------
    InvalidOutput
        When the map is wrong. The message gives the number of pixels that differ from their sources.
    """
    shape = (*image.shape[:2], 3)
    if source.shape != shape:
        raise InvalidOutput(f"returned a source map of the wrong shape: expected {shape}, got {source.shape}")
    rows = max(1, _BAND // source.shape[1])
    starts = range(0, len(source), rows)
    wrong = sum(_count_wrong(source[top : top + rows], image[top : top + rows], sample) for top in starts)
    if wrong:
        raise InvalidOutput(f"returned a source map that is not true: {wrong} copied pixels differ from their source")


def _count_wrong(source: SourceMap, image: Image, sample: Image) -> int:
    """Return how many pixels of some rows are copies that differ from their sources."""
    x, y, weight = np.moveaxis(source.reshape(-1, 3), 1, 0).copy()
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(weight)
    inside = (x >= -0.5) & (x <= sample.shape[1] - 0.5) & (y >= -0.5) & (y <= sample.shape[0] - 0.5)
    if (known & ~(inside & (weight > 0) & (weight <= 1 + 1e-6))).any():
        raise InvalidOutput("returned a source map that points outside the sample, or has weights outside (0, 1]")
    copies = np.flatnonzero(known & (weight > 1 - 1e-6) & (x == np.rint(x)) & (y == np.rint(y)))
    pixels = sample[y[copies].astype(np.intp), x[copies].astype(np.intp)]
    apart = np.abs(image.reshape(-1, image.shape[2])[copies] - pixels) > COPY_TOLERANCE
    return int(apart.any(1).sum())


_ROWS = 256
"""Rows whose sources are moved at a time."""
LARGE: Final = 1024
"""px: smaller samples are used whole."""
PERIODS: Final = 16
"""Periods along each side that are enough: they hold 256 tiles."""


def synthesize_from_part(
    synthesize: Callable[[Synthesizer, Task], Synthesis], method: Synthesizer, task: Task
) -> Synthesis:
    """Return a synthesis from the middle of a large sample, as large as the lattice and the output need.

    If pixels do not count, it is made from the part in which most count, and no larger than the box of all that do.

    A method that finds a lattice gets at most :data:`LARGE` px, :data:`PERIODS` periods, or the longer side of the
    output, whichever is the most, so that its time and memory do not grow with the sample. The periods are those of the
    given lattice, or of one that the method's detector finds in the reduced sample.

    Parameters
    ----------
    synthesize
        Is called with the method and a task with the part.
    method, task
        The method and its task.
    """
    whole: tuple[int, int] = task.sample.shape[:2]
    top, left, shape = _known_part(task)
    finder = "" if getattr(method, "reference", False) else getattr(method, "finder", "")
    seconds, where = 0.0, "the known"
    if max(shape) > LARGE and finder:
        start = time.perf_counter()
        side = max(LARGE, *task.shape, math.ceil(PERIODS * _longest_period(task, finder)))
        seconds = 0.0 if task.lattice else time.perf_counter() - start
        size = min(side, shape[0]), min(side, shape[1])
        middle = np.array([top + (shape[0] - size[0]) // 2, left + (shape[1] - size[1]) // 2])
        if task.known is None:
            (top, left), where = middle.tolist(), "the middle"
        else:
            counts = box_sums(task.known, size)
            best = np.argwhere(counts == counts.max())
            (top, left), where = best[np.abs(best - middle).sum(1).argmin()].tolist(), "the best known"
        shape = size
    window = np.s_[top : top + shape[0], left : left + shape[1]]
    part, known = task.sample[window], None if task.known is None else task.known[window]
    lattice = None if task.lattice is None else task.lattice.shifted((-left, -top))
    few = known is not None and lattice is not None and known.sum() < 2 * lattice.area
    require(not few, "mask: leaves less than two periods of the lattice; leave out less, or take a larger picture")
    if shape != whole:
        known = None if known is None or known.all() else known
        task = replace(task, sample=np.ascontiguousarray(part), lattice=lattice, known=known)
    made = synthesize(method, task)
    if shape == whole:
        return replace(made, detection_seconds=made.detection_seconds + seconds) if seconds else made
    note = "; ".join(filter(None, (made.note, f"from {where} {shape[1]}x{shape[0]} px of the sample")))
    made = move_sources(made, lambda places: places + np.array((left, top)))
    return replace(
        made,
        lattice=None if made.lattice is None else made.lattice.shifted((left, top)),
        detection_seconds=made.detection_seconds + seconds,
        note=note,
    )


def _known_part(task: Task) -> tuple[int, int, tuple[int, int]]:
    """Return the first row and column, and the size, of the box of all pixels of a sample that count."""
    whole: tuple[int, int] = task.sample.shape[:2]
    if task.known is None:
        return 0, 0, whole
    rows, columns = (np.flatnonzero(task.known.any(axis)) for axis in (1, 0))
    size = int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    return (int(rows[0]), int(columns[0]), size) if min(size) >= MIN_SIDE else (0, 0, whole)


def move_sources(made: Synthesis, locate: Callable[[Points], Points]) -> Synthesis:
    """Return a synthesis from a part of a sample, or from a deformed one, with its sources in the sample itself.

    Parameters
    ----------
    made
        The synthesis.
    locate
        Returns the places (x, y) in the sample of those that the method saw, ``(..., 2)``.
    """
    moved: dict[str, Any] = {}
    for name in ("source", "blended", "tints"):
        if (before := getattr(made, name)) is not None:
            moved[name] = np.array(before, np.float32)
            for rows in (moved[name][top : top + _ROWS] for top in range(0, len(before), _ROWS)):
                places = locate(np.nan_to_num(rows[..., :2].astype(np.float64)))
                rows[..., :2] = np.where(np.isfinite(rows[..., :2]), places, np.nan)
    return replace(made, **moved)


def _longest_period(task: Task, finder: str) -> float:
    """Return the longer of the two shortest periods of the sample, px; 0 if the reduced sample shows none."""
    factor, lattice = 1, task.lattice
    if lattice is None:
        factor = math.ceil(max(task.sample.shape) / LARGE)
        try:
            lattice = NamedDetector(finder).detect(shrink(task.sample, factor)).lattice
        except NoLatticeFound:
            return 0.0
    return factor * float(np.hypot(*lattice.reduced().matrix.T).max())
