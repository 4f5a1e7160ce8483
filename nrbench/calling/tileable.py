"""Outputs that repeat without a seam: the sample is strained so that its lattice closes, and the method wraps.

An output that repeats along one axis only is cut from a longer one that repeats along both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.calling.method_calls import synthesize_exactly
from nrbench.displacement.deformation_field import pixel_places, read_spline
from nrbench.imaging.convert import Image, depth_of, largest_box, quantize
from nrbench.imaging.masks import known_at
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Shape, Synthesis, Synthesizer, Task

from .bent_samples import recognize_sample, trace_sources

_LITTLE = 0.0025
"""Strain at which the note names no better size."""
_NEAR = 0.2
"""Largest change of a side, as a share of it, to a size that needs little strain."""
AXES: Final[dict[str, tuple[int, ...]]] = {"both": (0, 1), "x": (0,), "y": (1,)}
"""The axes along which an output can repeat: x to the right, y down."""
_BEYOND = 48
"""Least px that an output which repeats along one axis is cut from beyond its other side, if there is no lattice."""
_STILL = 0.05
"""px: a sample that would move by less anywhere stays as it is."""


def synthesize_tileable(method: Synthesizer, task: Task, along: str = "both") -> Synthesis:
    """Return a synthesis whose opposite edges continue each other.

    The sides of the output must be vectors of the lattice. The sample is therefore stretched and sheared by the
    smallest change that makes them so, and the method gets the strained sample with its lattice, and a task whose
    ``tileable`` is True. Where the sample is bent, it is straightened first unless the method has
    ``geometry="as-is"``, and the output stays straight. If the sample has no lattice, it is not changed.

    Parameters
    ----------
    method
        A method whose class variable ``wraps`` is True.
    task
        The task.
    along
        A key of :data:`AXES`. The sides along the other axis need not be vectors of the lattice.

    Raises
    ------
    BadInput
        If the method cannot wrap; the message names those that can.
    Refused
        If the strain would exceed :data:`MOST_STRAIN`; the message names the nearest size that closes. Also if the
        method refuses the sample.
    """
    plugins.require_abilities("synthesizers", method, wraps=True)
    survey, axes = recognize_sample(method, task), AXES[along]
    found = survey.found
    if found.lattice is None:
        shape = _lengthened(None, task.shape, axes)
        return _cut(synthesize_exactly(method, replace(task, shape=shape, tileable=True)), task.shape)
    bent, bending = (None, "") if getattr(method, "geometry", "") == "as-is" else (survey.bent, survey.note)
    sample, lattice = (task.sample, found.lattice) if bent is None else bent.straighten()
    strained = StrainedSample.of(sample, lattice, task.shape, axes, depth_of(task.sample))
    wrapped = replace(task, sample=strained.image, shape=strained.shape, lattice=strained.lattice, tileable=True)
    if task.known is not None:
        known = task.known if bent is None else bent.straighten_mask(task.known)
        places = strained.locate(pixel_places(*strained.image.shape[:2]))
        wrapped = replace(wrapped, known=known if strained.image is sample else known_at(known, places))
    made = _cut(synthesize_exactly(method, wrapped), task.shape)
    if bent is not None:
        made = trace_sources(made, lambda at: bent.locate(strained.locate(at) + bent.corner), task.sample.shape)
    elif strained.image is not sample:
        made = trace_sources(made, strained.locate, task.sample.shape)
    note = "; ".join(filter(None, (made.note, bending, describe_strain(lattice, task.shape, axes))))
    seconds = made.detection_seconds + (0.0 if task.lattice else survey.seconds)
    return replace(made, lattice=found.lattice, detection_seconds=seconds, note=note)


def _lengthened(lattice: Lattice | None, shape: Shape, axes: tuple[int, ...]) -> Shape:
    """Return a shape that is longer along the axes that are left out, by a period or more, where the lattice closes."""
    sides = list(shape[::-1])
    for axis in {0, 1}.difference(axes):
        sides[axis] += _BEYOND if lattice is None else math.ceil(2 * lattice.covering_radius)
        if lattice is not None:
            lengths = sides[axis] + np.arange(max(shape[1 - axis], sides[axis]))
            strains = _strains(lattice, axis, lengths)
            sides[axis] = int(lengths[(strains <= _LITTLE).argmax() if strains.min() <= _LITTLE else strains.argmin()])
    return sides[1], sides[0]


def _cut(made: Synthesis, shape: Shape) -> Synthesis:
    """Return the upper left part of a synthesis; all of it if it has the shape."""
    whole, part = made.image.shape[:2], np.s_[: shape[0], : shape[1]]
    if whole == shape:
        return made
    kept = {name: array for name, array in made.extras.items() if name != "tileable"}
    extras = {name: array[part] if np.shape(array)[:2] == whole else array for name, array in kept.items()}
    source, blended = (each if each is None else each[part] for each in (made.source, made.blended))
    return replace(made, image=made.image[part], source=source, blended=blended, extras=extras)


def describe_strain(lattice: Lattice, shape: Shape, axes: tuple[int, ...] = (0, 1)) -> str:
    """Return by how much the sample was strained along some axes, and a size nearby that needs less."""
    strain, better = closing_strain(lattice, shape, axes), _better_shape(lattice, shape, axes)
    less = closing_strain(lattice, better, axes)
    other = f", {better[1]}x{better[0]} would need {100 * less:.2g} %" if less < strain / 2 else ""
    return f"the lattice closes by a strain of {100 * strain:.2g} %" + (other if strain > _LITTLE else "")


def _better_shape(lattice: Lattice, shape: Shape, axes: tuple[int, ...]) -> Shape:
    """Return the nearest shape that needs little strain; if it is not near, the nearest that needs more."""
    for strain in (_LITTLE, 2 * _LITTLE, MOST_STRAIN / 2, MOST_STRAIN):
        better = nearest_closing_shape(lattice, shape, strain, axes)
        if max(abs(new - old) / old for new, old in zip(better, shape, strict=True)) < _NEAR:
            break
    return better


@dataclass(frozen=True, eq=False)
class StrainedSample:
    """A sample whose lattice closes on an output.

    Parameters
    ----------
    image
        ``(h, w, C)``: the strained sample, rounded to 8 or 16 bits; the sample itself if it would hardly move.
    lattice
        The lattice that closes, in pixels of ``image``.
    corner
        (x, y) px of the first pixel of ``image`` on the strained plane.
    back
        ``(2, 2)``: the linear map from the strained plane to the sample.
    shape
        (height, width) px on which the lattice closes along both axes.
    """

    image: Image
    lattice: Lattice
    corner: Points
    back: Points
    shape: Shape

    @classmethod
    def of(cls, sample: Image, lattice: Lattice, shape: Shape, axes: tuple[int, ...], bits: int = 8) -> StrainedSample:
        """Return the sample, strained so that the lattice closes on an output of ``shape``, and rounded to ``bits``.

        Raises
        ------
        Refused
            If the strain is too large.
        """
        whole = _lengthened(lattice, shape, axes)
        closed, strain = close_lattice(lattice, whole), closing_strain(lattice, shape, axes)
        if closed is None or max(strain, closing_strain(lattice, whole)) > MOST_STRAIN:
            height, width = _better_shape(lattice, shape, axes)
            raise Refused(
                f"a tileable output of {shape[1]}x{shape[0]} px would need a strain of {100 * strain:.2g} % to close "
                f"the lattice, more than {100 * MOST_STRAIN:g} %; use --size {width}x{height}"
            )
        height, width = sample.shape[:2]
        back = np.asarray(np.linalg.solve(closed.matrix, lattice.matrix), np.float64)
        ends = np.array([(width, 0), (0, height), (width, height)])
        if np.abs(ends @ back - ends).max() < _STILL:
            return cls(sample, closed, np.zeros(2), np.eye(2), whole)
        reach = np.ceil((ends @ np.linalg.inv(back)).max(0)).astype(int)
        places = pixel_places(int(reach[1]), int(reach[0])) @ back
        box = largest_box(np.asarray(((places >= 0) & (places <= (width - 1, height - 1))).all(-1)))
        image = quantize(read_spline(sample, places[box[0] : box[1], box[2] : box[3]]), bits)
        corner = np.array([box[2], box[0]], np.float64)
        return cls(image, closed.shifted(-corner), corner, back, whole)

    def locate(self, points: Points) -> Points:
        """Return the places (x, y) px in the sample of points of :attr:`image`, ``(..., 2)``."""
        return np.asarray((points + self.corner) @ self.back)


MOST_STRAIN: Final = 0.025
"""Largest strain that closes a lattice. Stretched by 2.5 %, a brick of 60 px gains 1.5 px."""


def close_lattice(lattice: Lattice, shape: tuple[int, int]) -> Lattice | None:
    """Return the nearest lattice that has (width, 0) and (0, height) as vectors.

    A linear map moves the lattice's vectors nearest to the two sides onto the sides.

    Parameters
    ----------
    lattice
        The lattice. Its origin is moved with it.
    shape
        (height, width) px of the output.

    Returns
    -------
    Lattice or None
        None if the two sides are shorter than the lattice's own periods, so that no lattice closes.

    Examples
    --------
    >>> from nrbench.lattice.geometry import Lattice
    >>> close_lattice(Lattice((31, 0), (15.5, 15)), (60, 128)).t1
    (32.0, 0.0)
    """
    sides = np.diag(shape[::-1]).astype(np.float64)
    near = sides - lattice.wrap(sides)
    if abs(np.linalg.det(near)) < lattice.area / 2:
        return None
    change = np.linalg.solve(near, sides)
    return Lattice.from_basis(lattice.matrix @ change, np.array(lattice.origin) @ change)


def closing_strain(lattice: Lattice, shape: tuple[int, int], axes: tuple[int, ...] = (0, 1)) -> float:
    """Return how far sides of an output are from vectors of a lattice, over their length; the most along ``axes``."""
    return max(float(_strains(lattice, axis, np.array([shape[1 - axis]]))[0]) for axis in axes)


def nearest_closing_shape(
    lattice: Lattice, shape: tuple[int, int], strain: float, axes: tuple[int, ...] = (0, 1)
) -> tuple[int, int]:
    """Return the (height, width) px nearest to a shape at which a lattice closes along ``axes`` with at most a strain.

    Examples
    --------
    >>> from nrbench.lattice.geometry import Lattice
    >>> nearest_closing_shape(Lattice((31, 0), (15.5, 15)), (50, 128), 0.002)
    (60, 124)
    """
    found = list(shape[::-1])
    for axis in axes:
        side = found[axis]
        # A vector lies no farther from a side than the covering radius, so that a long side always closes.
        lengths = np.arange(1, max(2 * side, math.ceil(lattice.covering_radius / strain)) + 1)
        good = lengths[_strains(lattice, axis, lengths) <= strain]
        found[axis] = int(good[np.abs(good - side).argmin()])
    return found[1], found[0]


def _strains(lattice: Lattice, axis: int, lengths: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the distance of each length along an axis from a vector of the lattice, over the length."""
    sides = np.zeros((len(lengths), 2))
    sides[:, axis] = lengths
    return np.asarray(np.hypot(*lattice.wrap(sides).T) / lengths)
