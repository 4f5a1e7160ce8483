"""Fractional Fourier texture masks: the regular part of a texture, drawn anew at any size."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2ypbpr, ypbpr2rgb

from nrbench.errors import BadInput
from nrbench.imaging.door import Image
from nrbench.imaging.harmonics import Harmonic, Harmonics, Signal, analyze
from nrbench.lattice.geometry import Lattice, Vector
from nrbench.lattice.rectangle import Rectangle, upright_rectangle
from nrbench.synthesis import Refused
from nrbench.texture import Shape


@dataclass(frozen=True)
class Analysis:
    """How the regular part is told from the rest (Nicoll et al. 2005, section 3).

    Parameters
    ----------
    threshold
        Least amplitude of a wave, units of 1/255; 0: automatic, what noise reaches with probability 0.01.
    harmonics
        ``"tied"`` to whole combinations of common fundamentals, or ``"free"`` (the paper's).
    signal
        ``"real"``, or ``"analytic"`` (the paper's).
    """

    threshold: float = 0.0
    harmonics: Harmonic = "tied"
    signal: Signal = "real"

    def __post_init__(self) -> None:
        if not 0 <= self.threshold < 255:
            raise BadInput(
                f"threshold {self.threshold}; choose 0 (automatic) or an amplitude below 255, units of 1/255"
            )

    def of(self, sample: Image) -> TextureMask:
        """Return the mask of a sample.

        Raises
        ------
        Refused
            Where no wave stands out of the noise: there is no regular part.
        """
        planes = rgb2ypbpr(sample.astype(np.float64)) if sample.shape[2] == 3 else sample.astype(np.float64)
        found = analyze(planes, self.threshold or None, self.harmonics, signal=self.signal)
        if not len(found.frequencies):
            raise Refused("no wave of the sample stands out of its noise: it has no regular part to make a mask of")
        return TextureMask(found)


@dataclass(frozen=True)
class TextureMask:
    """A mask (section 3.2).

    Parameters
    ----------
    harmonics
        The waves of the planes: Y, Pb, Pr of color samples (YCbCr without its offsets), else gray.
    """

    harmonics: Harmonics = field(repr=False)

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

    @cached_property
    def lattice(self) -> Lattice | None:
        """The lattice dual to the fundamentals of the strongest group of two; None where all are stripes, or free."""
        start = 0
        for count in self.harmonics.groups:
            if count == 2:
                pair = self.harmonics.fundamentals[start : start + 2]
                return Lattice.from_basis(np.linalg.inv(pair).T).reduced()
            start += count
        return None

    def tileable(self, tolerance: float, limit: float = 1024.0) -> Rectangle | None:
        """Return the smallest upright rectangle of whole px that is a period within ``tolerance`` px (eq. 7)."""
        return None if self.lattice is None else upright_rectangle(self.lattice, tolerance, limit, whole=True)
