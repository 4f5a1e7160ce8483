"""Fractional Fourier texture masks: the regular part of a texture, drawn anew at any size."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2ypbpr, ypbpr2rgb

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.plugins.forms import Refused, Shape
from nrbench.spectra.harmonics import Channels, Harmonic, Harmonics, Signal, analyze

from ..sampling.two_periods import shows_two_periods
from .common_period import CommonPeriod, common_period

FINEST = 2.5
"""px: of a finer lattice no wave, or one alone, is below Nyquist and clear of it."""


@dataclass(frozen=True)
class Analysis:
    """How the regular part is told from the rest (Nicoll et al. 2005, section 3).

    Parameters
    ----------
    threshold
        Least amplitude of a wave, units of 1/255; 0: automatic. Where tied, that is what stands out of the irregular
        structure at the wave's place; where free, what noise reaches with probability 0.01. Above a threshold that is
        given all waves are regular, as in the paper, where they are free; where tied, all that their groups' places
        hold, and each group must have a wave that stands out of what is around it.
    harmonics
        ``"tied"`` to whole combinations of the fundamentals of regular groups, or ``"free"`` (the paper's).
    signal
        ``"real"``, or ``"analytic"`` (the paper's search; where tied, for the waves that propose fundamentals).
    channels
        ``"joint"``: a wave has one frequency in all channels. ``"each"``: every channel is analyzed by itself (the
        paper's), so that frequencies of one wave may differ.
    """

    threshold: float = 0.0
    harmonics: Harmonic = "tied"
    signal: Signal = "real"
    channels: Channels = "joint"

    def __post_init__(self) -> None:
        if not 0 <= self.threshold < 255:
            raise BadInput(
                f"threshold {self.threshold}; choose 0 (automatic) or an amplitude below 255, units of 1/255"
            )

    def of(self, sample: Image, lattice: Lattice | None = None) -> TextureMask:
        """Return the mask of a sample.

        Parameters
        ----------
        sample
            ``(H, W, 1 or 3)``.
        lattice
            Where it is known, within about 2 %: tied waves then start from its dual, be it that it is coarser than
            need be. One of which the sample does not show two periods, or one too fine for its pixels, is left aside:
            it is looked for, as with None.

        Raises
        ------
        Refused
            Where no group of waves is regular, or none above the threshold: there is no regular part.
        """
        planes = rgb2ypbpr(sample.astype(np.float64)) if sample.shape[2] == 3 else sample.astype(np.float64)
        shown = lattice is not None and lattice.s > FINEST and shows_two_periods(lattice, planes.shape)
        given = lattice.reduced().dual().matrix if lattice is not None and shown else None
        found = analyze(planes, self.threshold or None, self.harmonics, self.channels, signal=self.signal, given=given)
        if not len(found.frequencies):
            limit = f" and reaches the threshold of {self.threshold:g}" if self.threshold else ""
            raise Refused(f"no wave of the sample stands out of its noise{limit}: there is no regular part for a mask")
        return TextureMask(found, self.harmonics == "tied")


@dataclass(frozen=True)
class TextureMask:
    """A mask (section 3.2).

    Parameters
    ----------
    harmonics
        The waves of the planes: Y, Pb, Pr of color samples (YCbCr without its offsets), else gray.
    tied
        Whether they are tied to common fundamentals.
    """

    harmonics: Harmonics = field(repr=False)
    tied: bool = True

    def picture(self, shape: Shape, offset: Vector = (0.0, 0.0)) -> Image:
        """Return the mask on any window, clipped to [0, 1], in the sample's channels (eq. 6).

        Parameters
        ----------
        shape
            (height, width) px.
        offset
            (x, y) px of the window's first pixel in the sample's coordinates.
        """
        planes = self.harmonics.evaluate(shape, offset)
        colors: NDArray[np.float64] = ypbpr2rgb(planes) if planes.shape[2] == 3 else planes
        return np.clip(colors, 0, 1).astype(np.float32)

    @property
    def groups(self) -> tuple[NDArray[np.float64], ...]:
        """The fundamentals of each group, ``(1 or 2, 2)`` cycles/px, of such as have harmonics; of all if none has.

        The group whose waves have most energy comes first.
        """
        several = tuple(fundamentals for fundamentals, count in self._sorted if count > 1)
        return several or tuple(fundamentals for fundamentals, _ in self._sorted)

    @cached_property
    def _sorted(self) -> list[tuple[NDArray[np.float64], int]]:
        """The fundamentals of each group and how many waves it has, the group of most energy first."""
        ends = np.cumsum(self.harmonics.groups)[:-1]
        fundamentals = np.split(self.harmonics.fundamentals, ends)
        members = np.stack([block.any(1) for block in np.split(self.harmonics.orders, ends, 1)])
        order = np.argsort(-(members @ (self.harmonics.amplitudes**2).sum(1)), kind="stable")
        return [(fundamentals[k], int(members[k].sum())) for k in order]

    @cached_property
    def lattice(self) -> Lattice | None:
        """The lattice dual to the strongest group of two fundamentals, or to those of two gratings; else None."""
        if not self.tied:
            return None
        pairs = [group for group in self.groups if len(group) == 2]
        lone = np.concatenate([group for group, _ in self._sorted if len(group) == 1] or [np.zeros((0, 2))])
        pairs += [np.stack([lone[0], other]) for other in lone[1:] if _cross(lone[0], other)]
        return Lattice.from_basis(np.linalg.inv(pairs[0]).T).reduced() if pairs else None

    def tileable(self, tolerance: float, limit: float = 1024.0) -> CommonPeriod | None:
        """Return the smallest upright rectangle of whole px that is a period of all groups within ``tolerance`` px.

        None where there is none, and where waves are free: they have no common period.
        """
        return common_period(self.groups, tolerance, int(limit)) if self.tied else None


def _cross(first: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether two frequencies differ in direction by more than 10 degrees."""
    area = abs(first[0] * other[1] - first[1] * other[0])
    return bool(area > 0.17 * np.hypot(*first) * np.hypot(*other))
