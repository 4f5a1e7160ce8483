"""What a lattice detector returns, and how it says no."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points


@dataclass(frozen=True)
class Surface:
    """A diagnostic that is drawn as a picture: a correlation, a spectrum.

    Parameters
    ----------
    values
        ``(H, W)``.
    zero
        (x, y) index of the sample at the coordinates' origin (lag 0, frequency 0).
    peaks
        ``(n, 2)``: the candidates, (x, y) in samples from ``zero``.
    vectors
        ``(2, 2)``, rows (x, y) in samples from ``zero``: the pair that was chosen; None where there is none.
    """

    values: NDArray[np.floating[Any]]
    zero: tuple[int, int]
    peaks: Points
    vectors: Points | None = None


@dataclass(frozen=True)
class Curve:
    """A diagnostic that is drawn as a line: a one-dimensional search.

    Parameters
    ----------
    x, y
        ``(n,)`` each.
    marks
        The x that were chosen.
    label
        What x is, with its unit.
    """

    x: NDArray[np.floating[Any]]
    y: NDArray[np.floating[Any]]
    marks: tuple[float, ...] = ()
    label: str = ""


@dataclass(frozen=True)
class Detection:
    """A lattice found in an image.

    Parameters
    ----------
    lattice
        The lattice; its origin is a phase where the detector gives one, else (0, 0).
    confidence
        In [0, 1]; how each detector makes it is in its docstring.
    diagnostics
        What led to it, by name; each :class:`Surface` and :class:`Curve` can be drawn.
    """

    lattice: Lattice
    confidence: float
    diagnostics: Mapping[str, Any] = field(default_factory=dict)


class NoLatticeFound(Exception):
    """The detector's "there is none": an answer, never a guess.

    Parameters
    ----------
    reason
        One sentence.
    best
        The best candidate that was rejected, or None.
    """

    def __init__(self, reason: str, best: Detection | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.best = best

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.reason, self.best)


@runtime_checkable
class Detector(Protocol):
    """The form of a detector plugin: a frozen dataclass with this method."""

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``, or raise :class:`NoLatticeFound`."""
        ...
