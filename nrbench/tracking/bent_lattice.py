"""The deformation of an image: where each point of its mean lattice lies, how far that is off, and how to undo it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.boxes import largest_box
from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile_kernels import spline_coefficients, spline_windows
from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking.growth import Knots
from nrbench.tracking.homography import fit_homography, map_points

__all__ = ["LEAST_AMPLITUDE", "Deformation"]

LEAST_AMPLITUDE: Final = 0.04
"""Amplitude, in s, below which displacements are taken for errors of the tracker."""
LEAST_SMOOTHNESS: Final = 7.0
"""Evidence, in nats, below which elements move on their own: jitter, not deformation. In 12 draws of each model, of 96
px, seeds 301 to 312, jitter of strength 0.3 reached 6, but for 2 of 12 of ``card``, which straightening does not make
more regular. Jitter of 0.5 exceeded it in 4 of 312 draws, and waves 5 s long of brick, weave and hexagon in 35 of 36.
"""
HOMOGRAPHY_REST: Final = 0.35
"""Root mean square distance of the places from a homography, over that from an affine map, up to which they are that
homography."""
_WHOLE = 1e-6
"""Largest distance of a number from a whole one that counts as none."""
_AFFINE = 3
"""Parameters of an affine map for each axis."""
_LEAST_VERTICES = 16
"""Points about s apart that are needed to tell smooth displacements from others."""
_MOST_VERTICES = 256
"""Points, those nearest to the middle of the image, that tell it."""
_WAVES, _WAVE_ERROR = (5.0, 7.0), 0.1
"""Wave lengths, in s, of smooth displacements, and the share of their power that is the tracker's error."""
_ELEMENT, _ELEMENT_ERROR = 0.7, 0.3
"""Standard deviation, in s, of the covariance of elements that move on their own, as windows see them: they overlap and
elements are about as large as a cell. And the share of the power that does not depend on the neighbors."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """A lattice as it lies in an image.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The mean lattice, origin included: of all regular lattices the one whose points lie nearest to the places where
        their content was found (least squares).
    cells
        ``(n, 2)``: cell coordinates (u, v) of the knots that were found: lattice points and points between them.
    places
        ``(n, 2)``: (x, y) px where they were found.
    correlation
        ``(n,)``: correlation of the image with the mean tile around each.
    covered
        Share of the image in which the lattice was found; 0 if it could not be followed, so that the deformation is not
        known.
    confidence
        Confidence of the detector that the lattice is the right one, on the straightened image; None if it was given.
    knots
        The same knots as a grid; None if they were not followed because the image is not bent.
    """

    image: Image
    lattice: Lattice
    cells: Points
    places: Points
    correlation: NDArray[np.float64]
    covered: float
    confidence: float | None = None
    knots: Knots | None = None

    @classmethod
    def of(cls, image: Image, knots: Knots, confidence: float | None = None) -> Deformation:
        """Return the deformation that knots describe, in the reduced basis of their mean lattice."""
        mean = knots.mean_lattice()
        reduced = mean.reduced()
        height, width = image.shape[:2]
        covered = min(knots.area / (height * width), 1.0)
        known = knots.known
        cells = reduced.to_cell(mean.from_cell(knots.cells[known]))
        return cls(image, reduced, cells, knots.places[known], knots.correlation[known], covered, confidence, knots)

    @cached_property
    def field(self) -> Points:
        """``(n, 2)`` px: displacement (x, y) of each knot from its place on the mean lattice."""
        return np.asarray(self.places - self.lattice.from_cell(self.cells))

    @cached_property
    def amplitude(self) -> float:
        """Root mean square length of the displacements, in s; the affine part belongs to the mean lattice."""
        count = len(self.field)
        return math.sqrt(float((self.field**2).sum()) / max(count - _AFFINE, 1)) / self.lattice.s

    @cached_property
    def smoothness(self) -> float:
        """Evidence that the displacements are smooth, in nats.

        The logarithm of the ratio of two likelihoods: of normal displacements that are waves of 5 and 7 s, and of
        normal displacements of elements that move on their own. The variance is estimated for each. The affine part,
        which belongs to the mean lattice, is left out of both (restricted likelihood; Patterson and Thompson 1971,
        Biometrika 58). All pairs of points, in all directions, count, so that a few cells suffice. 0 if there are
        fewer than 16 points about s apart.
        """
        s = self.lattice.s
        parts = np.maximum(np.rint(np.hypot(*self.lattice.matrix.T) / s), 1)
        vertex = (np.abs(self.cells * parts - np.rint(self.cells * parts)) < _WHOLE).all(1)
        places, field = self.lattice.from_cell(self.cells[vertex]) / s, self.field[vertex] / s
        if len(places) < _LEAST_VERTICES or not field.any():
            return 0.0
        middle = (places.min(0) + places.max(0)) / 2
        near = np.argsort(np.abs(places - middle).max(1), kind="stable")[:_MOST_VERTICES]
        places, field = places[near], field[near]
        design = np.column_stack([places - middle, np.ones(len(places))])
        free = np.linalg.qr(design, mode="complete")[0][:, _AFFINE:]
        distances = np.hypot(*np.moveaxis(places[:, np.newaxis] - places, -1, 0))
        waves = np.mean([scipy.special.j0(2 * math.pi / length * distances) for length in _WAVES], 0)
        elements = np.exp(-((distances / _ELEMENT) ** 2) / 2)
        smooth, loose = (
            _log_likelihood(free.T @ field, free.T @ ((1 - error) * covariance + error * np.eye(len(places))) @ free)
            for covariance, error in ((waves, _WAVE_ERROR), (elements, _ELEMENT_ERROR))
        )
        return smooth - loose

    @property
    def bent(self) -> bool:
        """Whether the lattice is deformed: displacements of at least 0.04 s that are smooth.

        Those that a homography explains are smooth, too: in an image of few elements, displacements that grow toward
        the corners change much within one s.
        """
        if self.knots is None or self.amplitude < LEAST_AMPLITUDE:
            return False
        return self.smoothness >= LEAST_SMOOTHNESS or self._fitted_homography is not None

    @property
    def homography(self) -> Points | None:
        """The 3 x 3 matrix that maps points (x, y, 1) of the mean lattice's plane to the image, if there is one.

        None if the image is not bent, or if no homography explains the displacements: their rest must be at most 0.35
        times as large. A plane in perspective is a homography, a curved surface or a wavy cloth is none.
        """
        return self._fitted_homography if self.bent else None

    @cached_property
    def _fitted_homography(self) -> Points | None:
        """The homography that explains the displacements, if there is one, whether or not the image is bent."""
        points = self.lattice.from_cell(self.cells)
        matrix = fit_homography(points, self.places)
        if matrix is None:
            return None
        rest = np.hypot(*(map_points(matrix, points) - self.places).T)
        # The median is not moved by a few knots that lie a period off.
        usual = np.median(np.hypot(*self.field.T))
        return matrix if np.median(rest) <= HOMOGRAPHY_REST * usual else None

    def locate(self, points: Points) -> Points:
        """Return the places (x, y) px in the image of points ``(..., 2)`` of the mean lattice's plane.

        The homography if there is one, else splines through the knots, whose slopes continue beyond them. The points
        themselves if the lattice was not followed.
        """
        if self.knots is None:
            return np.asarray(points, np.float64)
        if self.homography is not None:
            return map_points(self.homography, points)
        return self.knots.locate(self._knot_lattice.to_cell(points))

    @cached_property
    def _knot_lattice(self) -> Lattice:
        """The mean lattice in the basis of the knots."""
        assert self.knots is not None
        return self.knots.mean_lattice()

    def covers(self, points: Points) -> NDArray[np.bool_]:
        """Return which points ``(..., 2)`` of the mean lattice's plane are near knots, or lie in a known homography."""
        if self.knots is None or self.homography is not None:
            return np.ones(np.shape(points)[:-1], np.bool_)
        return self.knots.is_near(self._knot_lattice.to_cell(points))

    def straighten(self) -> tuple[Image, Lattice]:
        """Return the image with its deformation undone, and the mean lattice in its pixels.

        The picture is cropped to a box that shows the image alone. One px is one px of the mean lattice's plane; the
        affine part of a deformation cannot be known, and stays. An image that is not bent is returned as it is.
        """
        return self.rectify() if self.bent else (self.image, self.lattice)

    def rectify(self) -> tuple[Image, Lattice]:
        """Return the same as :meth:`straighten`, with displacements of any size undone, errors of tracking too."""
        if self.knots is None:
            return self.image, self.lattice
        size = np.array(self.image.shape[1::-1])
        points = self.lattice.from_cell(self.cells)
        low, high = np.floor(points.min(0)), np.ceil(points.max(0))
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        plane = np.stack([x, y], -1)
        sources = self.locate(plane)
        inside = np.asarray(((sources >= 0) & (sources <= size - 1)).all(-1)) & self.covers(plane)
        top, bottom, left, right = largest_box(inside)
        places = np.clip(sources[top:bottom, left:right], 0, size - 1)
        coefficients = spline_coefficients(np.array(self.image, np.float32, order="C"))
        values = spline_windows(coefficients, np.ascontiguousarray(places.reshape(-1, 2)), np.zeros((1, 2)))
        straight = np.clip(values.reshape(bottom - top, right - left, self.image.shape[2]), 0, 1)
        return np.asarray(straight, np.float32), self.lattice.shifted(-(low + np.array([left, top])))

    def as_dict(self) -> dict[str, Any]:
        """Return what is known about the deformation as a mapping that JSON can hold; lengths are in s."""
        return {
            "bent": self.bent,
            "amplitude": self.amplitude,
            "smoothness": self.smoothness,
            "covered": self.covered,
            "homography": None if self.homography is None else self.homography.tolist(),
        }


def _log_likelihood(values: Points, covariance: Points) -> float:
    """Return the log likelihood of normal ``(n, 2)`` values, with the variance that fits them best.

    The covariance ``(n, n)`` is known but for a factor. What is the same for all covariances is left out.
    """
    squares = float((values * np.linalg.solve(covariance, values)).sum())
    return -len(values) * math.log(squares) - float(np.linalg.slogdet(covariance)[1])
