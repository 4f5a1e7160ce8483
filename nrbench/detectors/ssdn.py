"""Representative tile's lattice detector: the periods along the two axes, from sums of squared differences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.chance.excerpt import excerpt
from nrbench.detectors.chance.surrogates import chance, upper_limit
from nrbench.detectors.rectangular_periods.periods import Period, find_period
from nrbench.detectors.rectangular_periods.rectangles import SEVERAL, inner_repetition
from nrbench.detectors.rectangular_periods.ssd import Sequence, shift_ssdn
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import FLAT, half_autocorrelation
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Curve, Detection, NoLatticeFound
from nrbench.streams import pixels_hash, stream

AXES = (("x", 1), ("y", 0))
UPRIGHT = "only rectangular lattices along the axes are found"


@dataclass(frozen=True)
class Ssdn:
    """Normalized sum of squared differences: rectangular, upright lattices, from a period along each axis.

    For each lag k along an axis, g(k) is the mean squared difference of the image and its own copy shifted by k over
    their overlap. The period is x_n / n, with x_n the place of the last of n minima (section 3, equations 1 to 3).

    The paper reads the minima off the curve by eye. Here a period's minima are those at its multiples, and of all
    periods the shortest counts whose minima are, on average, nearly as deep (``depth``) as those of the deepest. Depth
    is measured on 1 - g / e, where e is what g would be for unrelated parts of the same means and variances.

    The paper tiles by rectangles, whatever the lattice: a running bond gets a rectangle of two cells, a supercell. Here
    that is refused, as is any other lattice that is not rectangular along the axes. The paper's own choice is
    ``ssdn:subpixel=false,primitive=false,reject=none``.

    The confidence is 1 - g / e at the minima, on average, along the axis where it is smaller.

    Parameters
    ----------
    depth
        Share in (0, 1] of the greatest depth that a period's minima must reach.
    overlap
        Lags are looked at up to which the image and its copy overlap by this share, in (0, 1), of the axis.
    subpixel
        Minima are vertices of parabolas and the period is fitted to all of them; else it is the paper's x_n / n.
    primitive
        Refuse rectangles that hold more than one cell: those inside which the image repeats nearly as well as at their
        corners (:func:`~nrbench.detectors.rectangular_periods.rectangles.inner_repetition`).
    reject
        ``"none"``: answer wherever both curves have a minimum. ``"surrogate"``: no lattice where the minima, above
        all the farthest, are no deeper than those of phase-randomized copies of the image (of its middle, where it is
        large); both axes together, by the geometric mean, so that a grating is none.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability at which a phase-randomized copy would be taken for a lattice.
    """

    depth: float = 0.7
    overlap: float = 0.1
    subpixel: bool = True
    primitive: bool = True
    reject: Literal["none", "surrogate"] = "surrogate"
    surrogates: int = 30
    false_alarms: float = 0.01

    version: ClassVar[str] = "1"
    paper: ClassVar[str] = """@misc{representativetile,
  title        = {Extraction of a Representative Tile from a Near-Periodic Texture},
  howpublished = {Universit{\\'e} de Sherbrooke, Qu{\\'e}bec, Canada},
  note         = {Title after its abstract; 2005 or later. Authors and venue are not in the text that was implemented},
}"""

    def __post_init__(self) -> None:
        _check(0 < self.depth <= 1, f"depth is {self.depth}; give a share above 0, at most 1")
        _check(0 < self.overlap < 1, f"overlap is {self.overlap}; give a share between 0 and 1")
        _check(self.reject in ("none", "surrogate"), f"reject is {self.reject!r}; give none or surrogate")
        _check(self.surrogates >= 2, f"surrogates is {self.surrogates}; give at least 2")
        _check(0 < self.false_alarms < 1, f"false_alarms is {self.false_alarms}; give a probability, e.g. 0.01")

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``; its origin is (0, 0), the method finds no phase.

        Diagnostics: ``ssdn_x``, ``ssdn_y`` (g over the lag, with the minima); where looked at, ``inner`` (the image's
        repetition inside the rectangle over that at the corners); where tested, ``strength`` (of both periods),
        ``surrogate_strength`` and ``limit``.

        Raises
        ------
        NoLatticeFound
            Where the image is constant, an axis has no period, or none better than chance, or the lattice is not
            rectangular along the axes.
        """
        if np.ptp(image, (0, 1)).max() == 0:
            raise NoLatticeFound("the image is constant: it has no texture")
        curves = [shift_ssdn(image, axis) for _, axis in AXES]
        x, y = (self._period(*curve) for curve in curves)
        if x is None or y is None:
            raise NoLatticeFound(f"along {'y' if x else 'x'} the image has no period: {UPRIGHT}")
        found = self._detection((x, y), [g for g, _ in curves])
        if self.reject == "surrogate":
            found = self._tested(image, found)
        return self._own_cell(image, found) if self.primitive else found

    def _period(self, g: Sequence, unrelated: Sequence) -> Period | None:
        """Return the period of one axis: that of 1 - g / e, 0 where e is, at the lags that are looked at."""
        known = unrelated > FLAT * unrelated[0]
        likeness = 1 - np.divide(g, unrelated, out=np.ones_like(g), where=known)
        return find_period(likeness[: int(len(g) * (1 - self.overlap)) + 1], self.depth, self.subpixel)

    def _detection(self, periods: tuple[Period, Period], curves: list[Sequence]) -> Detection:
        """Return the lattice of the periods along x and y, with the curves that led to it."""
        lattice = Lattice((periods[0].length, 0.0), (0.0, periods[1].length)).reduced()
        drawn = {
            f"ssdn_{name}": Curve(np.arange(len(g), dtype=np.float64), g, period.peaks, f"lag along {name}, px")
            for (name, _), g, period in zip(AXES, curves, periods, strict=True)
        }
        return Detection(lattice, min(max(min(period.height for period in periods), 0.0), 1.0), drawn)

    def _strength(self, image: NDArray[np.float32]) -> float:
        """Return the geometric mean of the strengths of the periods along x and y; 0 where one has none."""
        periods = [self._period(*shift_ssdn(image, axis)) for _, axis in AXES]
        strengths = [max(period.strength, 0.0) if period else 0.0 for period in periods]
        return float(np.sqrt(strengths[0] * strengths[1]))

    def _tested(self, image: Image, found: Detection) -> Detection:
        """Return what was found, with what it was compared with, unless it is chance."""
        part, rng = excerpt(image, found.lattice), stream("detection", pixels_hash(image))
        reached, copies = self._strength(part), chance(part, self._strength, rng, self.surrogates)
        limit = upper_limit(copies, self.false_alarms)
        more = {"strength": reached, "surrogate_strength": copies, "limit": limit}
        found = replace(found, diagnostics={**found.diagnostics, **more})
        if reached <= limit:
            reason = f"the periods along x and y (strength {reached:.2f}) are no better than chance ({limit:.2f})"
            raise NoLatticeFound(f"{reason}: {UPRIGHT}", found)
        return found

    def _own_cell(self, image: Image, found: Detection) -> Detection:
        """Return what was found, unless it is a supercell."""
        width, height = found.lattice.matrix.max(0)
        x_end, y_end = (int((1 - self.overlap) * n) for n in image.shape[1::-1])
        inner = inner_repetition(half_autocorrelation(image), width, height, (x_end, y_end))
        found = replace(found, diagnostics={**found.diagnostics, "inner": inner})
        if inner >= SEVERAL:
            reason = f"the image repeats inside the rectangle as well as at its corners (ratio {inner:.2f})"
            raise NoLatticeFound(f"{reason}: it holds several cells, and {UPRIGHT}", found)
        return found


_check = checker("ssdn")
