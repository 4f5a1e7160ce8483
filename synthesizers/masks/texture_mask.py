"""Fractional Fourier texture masks: the regular part of a sample, drawn at any size (Nicoll et al. 2005, section 3)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Final, get_args

import numpy as np
import skimage
from numpy.typing import NDArray

from nrbench.errors import require
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.plugins.forms import Geometry, Refused, Shape, Synthesis, Task
from nrbench.plugins.parameters import SharedParameters
from nrbench.spectra.harmonics import (
    Channels,
    Harmonic,
    Signal,
    WaveAnalysis,
    find_channel_waves,
    find_free_waves,
    find_tied_waves,
)
from nrbench.work import make_once, work_clock

from ..lattice_places.equal_places import shows_two_periods

FINEST = 2.5
"""px: lattices with s up to this are ignored. They have at most one wave well below the Nyquist frequency."""
SLACK = 0.1
"""Share of s by which the mask may be stretched or sheared over the whole output, so that it tiles."""
LONGEST = 4096
"""px: a wave with a longer period along an axis counts as constant along this axis."""
MASK_OF_THE_PAPER: Final[Mapping[str, Any]] = {
    "threshold": 2.0,
    "harmonics": "free",
    "signal": "analytic",
    "channels": "each",
    "geometry": "as-is",
}
"""The mask of Nicoll et al. (2005) in terms of :class:`MaskParameters`. Their table 1 tries thresholds of 0.5, 1, 2 and
5; they set it for each texture and do not say which values they used."""


@dataclass(frozen=True, kw_only=True)
class MaskParameters(SharedParameters):
    """The parameters of a mask. All methods that are guided by a mask inherit from this class.

    The descriptions below are appended to the page of each method.

    Parameters
    ----------
    tileable
        Whether copies of the output can be laid side by side without a seam (section 4.3). The mask is then fitted to
        the output's size, which must be a period of the mask up to a tenth of s. Other sizes are refused; the message
        names the nearest valid size. ``nrbench synth --tileable`` sets it, and strains the sample first, so that more
        sizes are valid.
    threshold
        Least amplitude of a wave of the mask, in units of 1/255; 0: automatic. With 0, tied waves must exceed the
        irregular structure at their frequency, and free waves must exceed the amplitude that noise reaches with
        probability 0.01. With a positive threshold, the mask has all free waves above it, as in the paper, and all
        tied harmonics above it of each group of which one wave exceeds the irregular structure around it.
    harmonics
        ``"tied"``: the frequencies are integer combinations of the fundamentals of regular groups. ``"free"``: the
        frequencies are independent, as in the paper; such a mask cannot tile.
    signal
        The signal in which waves are searched: ``"real"``, or ``"analytic"`` as in the paper. For tied harmonics the
        analytic signal serves only the waves that propose fundamentals.
    channels
        ``"joint"``: a wave has the same frequency in all channels. ``"each"``: every channel is analyzed separately, as
        in the paper, so that the frequencies of a wave may differ between channels.
    geometry
        How the method is run where the sample is bent (:func:`~nrbench.calling.bent_samples.synthesize_in_geometry`).
        It gets the straightened sample, and its output is ``"bent"`` as the sample is, or left ``"straight"``;
        ``"waves"``: bent if the sample waves, straight if it is in perspective, round or distorted by a lens.
        ``"argmax"``: bent so that each vertex takes its most likely place, given its eight neighbors (equation 3 of Lin
        and others 2004), with warps of one pass. ``"as-is"``: it gets the sample itself, as in the paper
        and for a tileable output.
    """

    wraps: ClassVar[bool] = True
    needs_lattice: ClassVar[bool] = False
    family: ClassVar[str] = "patches and pixels under a mask"
    maps: ClassVar[str] = "source"

    tileable: bool = False
    threshold: float = 0.0
    harmonics: Harmonic = "tied"
    signal: Signal = "real"
    channels: Channels = "joint"
    geometry: Geometry = "waves"

    def __post_init__(self) -> None:
        require(self.harmonics in get_args(Harmonic), f"harmonics {self.harmonics!r}; choose free or tied")
        require(self.channels in get_args(Channels), f"channels {self.channels!r}; choose joint or each")
        require(self.signal in get_args(Signal), f"signal {self.signal!r}; choose real or analytic")
        require(0 <= self.threshold < 255, f"threshold {self.threshold}; choose 0 (automatic), or below 255")
        periodic = not self.tileable or self.harmonics == "tied"
        if self.tileable:
            object.__setattr__(self, "geometry", "as-is")
        require(periodic, "tileable with harmonics 'free', which have no common period; choose harmonics 'tied'")

    def find_mask(self, sample: Image, lattice: Lattice | None = None) -> TextureMask:
        """Return the mask of a sample; :mod:`nrbench.spectra.harmonics` finds its frequencies.

        Parameters
        ----------
        sample
            ``(H, W, 1 or 3)``.
        lattice
            The sample's lattice, with an error of at most about 2 %. The search for tied waves starts from its dual,
            even if the lattice is coarser than necessary. It is ignored if the sample shows less than two periods, or
            if s is at most :data:`FINEST`. None: the lattice is found.

        Raises
        ------
        Refused
            If the sample has no regular part: no group of waves is regular, or no wave is above the threshold.
        """
        pixels = sample.astype(np.float64)
        planes = skimage.color.rgb2ypbpr(pixels) if sample.shape[2] == 3 else pixels
        usable = lattice is not None and lattice.s > FINEST and shows_two_periods(lattice, planes.shape)
        given = lattice.reduced().dual().matrix if lattice is not None and usable else None
        find = partial(find_free_waves, threshold=self.threshold or None, signal=self.signal)
        if self.harmonics == "tied":
            find = partial(find_tied_waves, threshold=self.threshold or None, signal=self.signal, given=given)
        each = partial(find_channel_waves, find) if self.channels == "each" else find
        key = "waves", planes, given, self.threshold, self.signal, self.harmonics, self.channels
        waves = make_once(key, each, planes)
        if not len(waves.frequencies):
            limit = f" and the threshold of {self.threshold:g}" if self.threshold else ""
            raise Refused(f"no wave of the sample exceeds its noise{limit}: there is no regular part for a mask")
        return TextureMask(waves, self.harmonics == "tied")

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis. The mask is the extra picture ``mask``.

        Raises
        ------
        Refused
            If the sample has no regular part or is too small, or if the output cannot tile.
        """
        if task.tileable and not self.tileable:
            return replace(self, tileable=True).synthesize(task)
        start = work_clock()
        mask = self.find_mask(task.sample, task.lattice)
        seconds = 0.0 if task.lattice else work_clock() - start
        return replace(self.synthesize_with_mask(task, mask), detection_seconds=seconds)

    def synthesize_with_mask(self, task: Task, mask: TextureMask) -> Synthesis:
        """Return the synthesis guided by a given mask of the sample; each method has its own."""
        raise NotImplementedError

    def fit_to_output(self, mask: TextureMask, shape: Shape) -> TextureMask:
        """Return the mask for an output; if it is tileable, with a whole number of waves along each side of the output.

        Equation 7 divides by the components of one frequency pair, which can be 0. Here a side is accepted if it is a
        vector of the mask's lattice (or a period of its stripes) up to :data:`SLACK`, and the lattice is then fitted to
        it. Other groups of waves are stretched by at most half a period over the whole output.

        Parameters
        ----------
        mask
            A mask, of tied harmonics if the output is tileable.
        shape
            (height, width) px of the output.

        Raises
        ------
        Refused
            If a side is no period; the message names the nearest valid size.
        """
        if not self.tileable:
            return mask
        height, width = shape
        fundamentals = mask.groups[0] if mask.lattice is None else mask.lattice.dual().matrix
        near = [_nearest_period(fundamentals, axis, side) for axis, side in enumerate((width, height))]
        if near != [width, height]:
            sides = "x".join("?" if side is None else str(side) for side in near)
            raise Refused(
                f"{width}x{height} px is no period of the mask, so the output cannot tile; nearest valid size: {sides}"
            )
        harmonics = mask.harmonics
        fitted = np.rint(harmonics.fundamentals * (width, height)) / (width, height)
        return replace(mask, harmonics=replace(harmonics, fundamentals=fitted, frequencies=harmonics.orders @ fitted))


@dataclass(frozen=True)
class TextureMask:
    """The regular part of a sample as a sum of waves, which can be drawn at any size (section 3.2).

    Parameters
    ----------
    harmonics
        The waves: of the planes Y, Pb and Pr for color samples (YCbCr without its offsets), else of the gray values.
    tied
        Whether the frequencies are integer combinations of common fundamentals.
    """

    harmonics: WaveAnalysis = field(repr=False)
    tied: bool = True

    def draw(self, shape: Shape, offset: Vector = (0.0, 0.0)) -> Image:
        """Return the mask in a window at any place, clipped to [0, 1], with the sample's channels (equation 6).

        Parameters
        ----------
        shape
            (height, width) px.
        offset
            (x, y) px of the window's first pixel, in coordinates of the sample.
        """
        planes = self.harmonics.evaluate(shape, offset)
        colors: NDArray[np.float64] = skimage.color.ypbpr2rgb(planes) if planes.shape[2] == 3 else planes
        return np.clip(colors, 0, 1).astype(np.float32)

    @property
    def groups(self) -> tuple[NDArray[np.float64], ...]:
        """The fundamentals of each group of several waves, ``(1 or 2, 2)`` cycles/px, the group of most energy first.

        If each group has only one wave, the fundamentals of all groups.
        """
        several = tuple(fundamentals for fundamentals, count in self._groups_by_energy if count > 1)
        return several or tuple(fundamentals for fundamentals, _ in self._groups_by_energy)

    @cached_property
    def _groups_by_energy(self) -> list[tuple[NDArray[np.float64], int]]:
        """The fundamentals and the number of waves of each group, the group of most energy first."""
        ends = np.cumsum(self.harmonics.groups)[:-1]
        fundamentals = np.split(self.harmonics.fundamentals, ends)
        members = np.stack([block.any(1) for block in np.split(self.harmonics.orders, ends, 1)])
        order = np.argsort(-(members @ (self.harmonics.amplitudes**2).sum(1)), kind="stable")
        return [(fundamentals[k], int(members[k].sum())) for k in order]

    @cached_property
    def lattice(self) -> Lattice | None:
        """The lattice dual to the strongest group of two fundamentals, else to two crossed gratings, else None."""
        if not self.tied:
            return None
        pairs = [group for group in self.groups if len(group) == 2]
        lone = np.concatenate([group for group, _ in self._groups_by_energy if len(group) == 1] or [np.zeros((0, 2))])
        pairs += [np.stack([lone[0], other]) for other in lone[1:] if _are_crossed(lone[0], other)]
        return Lattice.from_basis(np.linalg.inv(pairs[0]).T).reduced() if pairs else None

    def find_period(self, tolerance: float = 0.5, limit: int = 1024) -> tuple[int, int] | None:
        """Return the (width, height) px of the smallest upright rectangle that is a period of all groups of waves.

        Each side is the shortest length that is near a period of every group. A period of a lattice is a lattice
        vector; a period of stripes is the distance between stripes along the side. The paper (equation 7) divides by
        the components of the lowest frequency, which may be 0. Here a side along which nothing varies gets the length
        of the other one.

        Parameters
        ----------
        tolerance
            px: the largest allowed distance of a side from a period; at least 0, and less than half the shortest
            period.
        limit
            The longest side that is examined, px.

        Returns
        -------
        tuple of int or None
            None if no length up to ``limit`` is a period, or if the waves are free and thus have no common period.
        """
        if not self.tied:
            return None
        errors = [np.max([_period_errors(group, axis, limit) for group in self.groups], 0) for axis in (0, 1)]
        across, down = (_shortest_side(along, max(tolerance, 1e-6)) for along in errors)
        if across is None or down is None:
            return None
        (width, free_x), (height, free_y) = across, down
        width = min(width, height) if free_x else width
        return width, min(height, width) if free_y else height


def _are_crossed(first: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether two frequencies differ in direction by more than 10 degrees."""
    area = abs(first[0] * other[1] - first[1] * other[0])
    return bool(area > 0.17 * np.hypot(*first) * np.hypot(*other))


def _period_errors(fundamentals: NDArray[np.float64], axis: int, limit: int) -> NDArray[np.float64]:
    """Return the distance in px of each length 1, 2, ..., ``limit`` px along an axis from a period, ``(limit,)``."""
    if len(fundamentals) == 2:
        basis = Lattice.from_basis(np.linalg.inv(fundamentals).T).reduced().matrix
        turns = np.outer(np.arange(1, limit + 1), np.linalg.inv(basis)[axis])
        return np.asarray(np.hypot(*((turns - np.rint(turns)) @ basis).T))
    turns = np.arange(1, limit + 1) * fundamentals[0, axis]
    return np.asarray(np.abs(turns - np.rint(turns)) / np.hypot(*fundamentals[0]))


def _shortest_side(errors: NDArray[np.float64], tolerance: float) -> tuple[int, bool] | None:
    """Return the shortest period, and whether any length is one; None if there is none.

    Lengths near 0 are within the tolerance of the period 0 and do not count. If this holds far beyond the tolerance,
    nothing varies along the side, and the length is the longest of these.
    """
    beyond = np.flatnonzero(errors > tolerance)
    first = int(beyond[0]) if len(beyond) else len(errors)
    if first > 2 * tolerance + 1:
        return first, True
    within = np.flatnonzero(errors[first:] <= tolerance)
    return (first + int(within[0]) + 1, False) if len(within) else None


def _nearest_period(fundamentals: NDArray[np.float64], axis: int, side: int) -> int | None:
    """Return the period along an axis that is nearest to ``side``; ``side`` itself if nothing varies along the axis."""
    waves = np.abs(fundamentals[:, axis])
    slack = SLACK * float(np.hypot(*np.linalg.pinv(fundamentals)).min())
    reach = 1 / waves[waves > 1 / LONGEST].min(initial=1.0)
    lengths = np.arange(1, math.ceil(2 * max(side, reach)) + 1)
    fits = _period_errors(fundamentals, axis, len(lengths)) <= slack
    good = lengths[fits & ((lengths > 2 * slack) | fits.all())]
    return int(good[np.abs(good - side).argmin()]) if len(good) else None
