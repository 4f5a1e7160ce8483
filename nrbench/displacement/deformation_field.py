"""The deformation of an image: where each point of its mean lattice lies, how far that is off, and how to undo it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import MIN_SIDE, Image, largest_box
from nrbench.imaging.masks import Mask, known_at
from nrbench.imaging.mean_tile import explained_share, interpolate_planes
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.vertices import Vertex, lay_vertices, list_vertices

from .growth import Knots

LEAST_AMPLITUDE: Final = 0.04
"""Amplitude, in s, below which displacements are taken for errors of measurement."""
LEAST_GAIN: Final = 1.25
"""Factor by which straightening must raise the share of the variance that the mean tile explains."""
LEAST_SMOOTHNESS: Final = 7.0
"""Evidence, in nats, below which elements move on their own: jitter, not deformation. In 12 draws of each model, of 96
px, seeds 301 to 312, jitter of strength 0.3 reached 6, but for 2 of 12 of ``card``, which straightening does not make
more regular. Jitter of 0.5 exceeded it in 4 of 312 draws, and waves 5 s long of brick, weave and hexagon in 35 of 36.
"""
HOMOGRAPHY_REST: Final = 0.35
"""Root mean square distance of the places from a homography, over that from an affine map, up to which they are that
homography."""
CUBIC_REST: Final = 0.3
"""Root mean square rest of the displacements after a cubic polynomial, over that of the displacements, up to which they
are that polynomial. Cylinders and lenses left at most 0.25, waves of brick, weave, hexagon and basket, in 112 draws, at
least 0.49 where there were 120 knots (``bend`` 0.3 to 1, 128 to 256 px, seeds 1 to 18)."""
_LEAST_CUBIC = 120
"""Least number of knots of a cubic polynomial, which has 10 parameters for each axis: fewer may show one wave alone."""
_WHOLE = 1e-6
"""Largest distance of a number from a whole one that counts as none."""
_AFFINE = 3
"""Parameters of an affine map for each axis."""
_LEAST_VERTICES = 16
"""Points about s apart that are needed to tell smooth displacements from others."""
_MOST_VERTICES = 256
"""Points, those nearest to the middle of the image, that tell it."""
_WAVES, _WAVE_ERROR = (5.0, 7.0), 0.1
"""Wave lengths, in s, of smooth displacements, and the share of their power that is an error of measurement."""
_ELEMENT, _ELEMENT_ERROR = 0.7, 0.3
"""Standard deviation, in s, of the covariance of elements that move on their own, as windows see them: they overlap and
elements are about as large as a cell. And the share of the power that does not depend on the neighbors."""
_ROUNDS = 4
"""Number of fits of a homography; before each but the first, outliers are left out."""
_OUTLYING = 4.0
"""Distance, in median distances, above which a pair is an outlier."""
LEAST_PAIRS = 12
"""Least number of pairs: a homography has 8 parameters, an affine map 6."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """A lattice as it lies in an image: a field of displacements, known at knots.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    knots
        Where lattice points, and points between them, were found in the image.
    confidence
        Confidence of the detector that the lattice is the right one, on the straightened image; None if it was given.
    regular
        The regular lattice, if it is known for sure. It then takes the place of the mean lattice: the part of a wave
        that looks like a stretch is undone, too.
    """

    image: Image
    knots: Knots
    confidence: float | None = None
    regular: Lattice | None = None

    @cached_property
    def _knot_lattice(self) -> Lattice:
        """The mean lattice in the basis of the knots, or the regular one, in phase with it on average."""
        mean = self.knots.mean_lattice()
        if self.regular is None:
            return mean
        change = np.rint(mean.matrix @ np.linalg.inv(self.regular.matrix))
        if abs(round(float(np.linalg.det(change)))) != 1:  # another lattice than that of the knots
            return mean
        basis = change @ self.regular.matrix
        return Lattice.from_basis(basis, (self.places - self.knots.cells[self.knots.known] @ basis).mean(0))

    @cached_property
    def lattice(self) -> Lattice:
        """The mean lattice, origin included, reduced.

        Of all regular lattices it is the one whose points lie nearest to the knots (least squares).
        """
        return self._knot_lattice.reduced()

    @cached_property
    def cells(self) -> Points:
        """``(n, 2)``: cell coordinates (u, v) of the knots that were found: lattice points and points between them."""
        return self.lattice.to_cell(self._knot_lattice.from_cell(self.knots.cells[self.knots.known]))

    @cached_property
    def places(self) -> Points:
        """``(n, 2)``: (x, y) px where they were found."""
        return self.knots.places[self.knots.known]

    @cached_property
    def correlation(self) -> NDArray[np.float64]:
        """``(n,)``: correlation of the image with the mean tile around each."""
        return self.knots.correlation[self.knots.known]

    @property
    def covered(self) -> float:
        """Share of the image in which the lattice was found; 0 if it could not be followed: nothing else is known."""
        return min(self.knots.area / math.prod(self.image.shape[:2]), 1.0)

    @property
    def score(self) -> float:
        """Covered share of the image times the mean correlation."""
        return self.covered * self.knots.quality

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
    def mesh(self) -> Lattice:
        """The lattice of the vertices: the mean lattice, each vector divided into steps about s long."""
        parts = np.maximum(np.rint(np.hypot(*self.lattice.matrix.T) / self.lattice.s), 1)
        return Lattice.from_basis(self.lattice.matrix / parts[:, np.newaxis], self.lattice.origin)

    @cached_property
    def vertices(self) -> tuple[NDArray[np.int64], Points]:
        """``(n, 2)`` each: numbers of the knots that are vertices, on :attr:`mesh`, and their displacements, px.

        Those nearest to the middle come first.
        """
        return self._choose_vertices((0.0, 0.0))

    def _choose_vertices(self, phase: tuple[float, float]) -> tuple[NDArray[np.int64], Points]:
        """Return the same for the vertices moved by a phase, in steps of the mesh."""
        points = self.lattice.from_cell(self.cells)
        numbers = self.mesh.to_cell(points) - phase
        vertex = (np.abs(numbers - np.rint(numbers)) < _WHOLE).all(1)
        points = points[vertex]
        middle = (points.min(0) + points.max(0)) / 2 if len(points) else np.zeros(2)
        order = np.argsort(np.abs(points - middle).max(1), kind="stable")
        return np.rint(numbers[vertex][order]).astype(np.int64), self.field[vertex][order]

    @cached_property
    def smoothness(self) -> float:
        """Evidence that the displacements are smooth, in nats.

        The logarithm of the ratio of two likelihoods: of normal displacements that are waves of 5 and 7 s, and of
        normal displacements of elements that move on their own. The variance is estimated for each. The affine part,
        which belongs to the mean lattice, is left out of both (restricted likelihood; Patterson and Thompson 1971,
        Biometrika 58). All pairs of points about s apart, in all directions, count, so that a few cells suffice. There
        are four such sets of points, between vertices and at them; the mean over the sets counts. 0 if there are fewer
        than 16 points.
        """
        sets = [self._choose_vertices((u, v)) for u in (0.0, 0.5) for v in (0.0, 0.5)]
        found = [
            self._rate_smoothness(numbers[:_MOST_VERTICES], field[:_MOST_VERTICES])
            for numbers, field in sets
            if len(field) >= _LEAST_VERTICES and field.any()
        ]
        return float(np.mean(found)) if found else 0.0

    def _rate_smoothness(self, numbers: NDArray[np.int64], field: Points) -> float:
        """Return the logarithm of the ratio of both likelihoods for one set of points."""
        places, field = self.mesh.from_cell(numbers) / self.lattice.s, field / self.lattice.s
        design = np.column_stack([places - places.mean(0), np.ones(len(places))])
        free = np.linalg.qr(design, mode="complete")[0][:, _AFFINE:]
        distances = np.hypot(*np.moveaxis(places[:, np.newaxis] - places, -1, 0))
        waves = np.mean([scipy.special.j0(2 * math.pi / length * distances) for length in _WAVES], 0)
        elements = np.exp(-((distances / _ELEMENT) ** 2) / 2)
        smooth, loose = (
            _log_likelihood(free.T @ field, free.T @ ((1 - error) * covariance + error * np.eye(len(places))) @ free)
            for covariance, error in ((waves, _WAVE_ERROR), (elements, _ELEMENT_ERROR))
        )
        return smooth - loose

    @cached_property
    def is_smooth(self) -> bool:
        """Whether there are displacements of at least 0.04 s that are smooth.

        Those that a homography explains are smooth, too: in an image of few elements, displacements that grow toward
        the corners change much within one s. So are those of a cubic polynomial: in an image of many elements, they
        change little within the waves of :attr:`smoothness`.
        """
        if not self.covered or self.amplitude < LEAST_AMPLITUDE:
            return False
        return self.smoothness >= LEAST_SMOOTHNESS or self._fitted_homography is not None or self._is_cubic

    @property
    def is_global(self) -> bool:
        """Whether the image shows a plane in perspective, a round surface, or the distortion of a lens.

        The displacements are those of a homography or of a cubic polynomial. A cloth that waves has neither.
        """
        return self.bent and (self._fitted_homography is not None or self._is_cubic)

    @cached_property
    def _is_cubic(self) -> bool:
        """Whether a cubic polynomial explains the displacements."""
        if len(self.cells) < _LEAST_CUBIC:
            return False
        x, y = (self.cells - self.cells.mean(0)).T / np.abs(self.cells - self.cells.mean(0)).max()
        terms = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], -1)
        rest = self.field - terms @ np.linalg.lstsq(terms, self.field, rcond=None)[0]
        return math.sqrt(float((rest**2).sum() / (self.field**2).sum())) <= CUBIC_REST

    @cached_property
    def gain(self) -> float:
        """Share of the variance that the mean tile explains in the straight image, over that in the image itself.

        Where a texture hardly changes along a line, displacements along that line may be large, and undoing them gains
        nothing. 1 if the displacements are not smooth.
        """
        if not self.is_smooth:
            return 1.0
        straight, lattice = self._straight
        if min(straight.shape[:2]) < MIN_SIDE:
            return 0.0
        return explained_share(straight, lattice) / max(explained_share(self.image, self.lattice), 1e-6)

    @property
    def bent(self) -> bool:
        """Whether the image is bent: its displacements are smooth, and undoing them makes it more regular."""
        return self.is_smooth and self.gain >= LEAST_GAIN

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
        if not self.covered:
            return np.asarray(points, np.float64)
        if self.is_smooth and self._fitted_homography is not None:
            return map_points(self._fitted_homography, points)
        return self.knots.locate(self._knot_lattice.to_cell(points))

    def covers(self, points: Points) -> NDArray[np.bool_]:
        """Return which points ``(..., 2)`` of the mean lattice's plane are near knots, or lie in a known homography."""
        if not self.covered or (self.is_smooth and self._fitted_homography is not None):
            return np.ones(np.shape(points)[:-1], np.bool_)
        return self.knots.is_near(self._knot_lattice.to_cell(points))

    @cached_property
    def lattice_points(self) -> tuple[Vertex, ...]:
        """The points of the lattice that lie in the image, where it was followed; all of them if it is not bent."""
        height, width = self.image.shape[:2]
        if not self.bent:
            return lay_vertices(self.lattice, (height, width))
        low, high = np.floor(self.cells.min(0)), np.ceil(self.cells.max(0))
        cells = np.stack(np.meshgrid(*(np.arange(*ends) for ends in zip(low, high + 1, strict=True))), -1)
        points = self.lattice.from_cell(cells)
        places = self.locate(points)
        seen = self.covers(points) & ((places >= -0.5) & (places < np.array([width, height]) - 0.5)).all(-1)
        return list_vertices(cells[seen], places[seen])

    def straighten(self) -> tuple[Image, Lattice]:
        """Return the image with its deformation undone, and the mean lattice in its pixels.

        The picture is cropped to a box that shows the image alone. One px is one px of the mean lattice's plane; the
        affine part of a deformation cannot be known, and stays. An image that is not bent is returned as it is.
        """
        return self.rectify() if self.bent else (self.image, self.lattice)

    def rectify(self) -> tuple[Image, Lattice]:
        """Return the same as :meth:`straighten`, with displacements of any size undone, errors of tracking too."""
        return self._straight if self.covered else (self.image, self.lattice)

    def straighten_mask(self, known: Mask) -> Mask:
        """Return which pixels of the image that :meth:`straighten` returns count, for a mask of this image."""
        return known_at(known, self._box[0]) if self.bent and self.covered else known

    @cached_property
    def _box(self) -> tuple[Points, tuple[int, int]]:
        """``(h, w, 2)`` px: places in the image of the straight image's pixels; and its corner (x, y)."""
        size = np.array(self.image.shape[1::-1])
        ends = self.lattice.from_cell(self.cells)
        reach = self.lattice.s
        left, top = (int(end) for end in np.floor(ends.min(0) - reach))
        right, bottom = (int(end) for end in np.ceil(ends.max(0) + reach))
        plane = pixel_places(bottom - top + 1, right - left + 1, top, left)
        sources = self.locate(plane)
        inside = np.asarray(((sources >= 0) & (sources <= size - 1)).all(-1)) & self.covers(plane)
        box = largest_box(inside)
        return sources[box[0] : box[1], box[2] : box[3]], (left + box[2], top + box[0])

    @property
    def corner(self) -> tuple[int, int]:
        """(x, y) px on the mean lattice's plane of the first pixel of the straight image."""
        return self._box[1]

    @cached_property
    def _straight(self) -> tuple[Image, Lattice]:
        places, (left, top) = self._box
        return read_spline(self.image, places), self.lattice.shifted((-left, -top))

    def as_dict(self) -> dict[str, Any]:
        """Return what is known about the deformation as a mapping that JSON can hold; lengths are in s."""
        return {
            "bent": self.bent,
            "amplitude": self.amplitude,
            "smoothness": self.smoothness,
            "covered": self.covered,
            "homography": None if self.homography is None else self.homography.tolist(),
        }


def read_spline(image: Image, points: Points) -> Image:
    """Return the values of an image at points (x, y), ``(..., 2)``, by splines of order 5, in [0, 1]: ``(..., C)``."""
    at = np.moveaxis(points, -1, 0)[::-1]
    return np.asarray(np.clip(interpolate_planes(image, at, 5, "mirror"), 0, 1), np.float32)


def pixel_places(height: int, width: int, top: int = 0, left: int = 0) -> Points:
    """Return the (x, y) of each pixel of a box, ``(height, width, 2)``."""
    x, y = np.meshgrid(np.arange(left, left + width), np.arange(top, top + height))
    return np.stack([x, y], -1).astype(np.float64)


def _log_likelihood(values: Points, covariance: Points) -> float:
    """Return the log likelihood of normal ``(n, 2)`` values, with the variance that fits them best.

    The covariance ``(n, n)`` is known but for a factor. What is the same for all covariances is left out.
    """
    squares = float((values * np.linalg.solve(covariance, values)).sum())
    return -len(values) * math.log(squares) - float(np.linalg.slogdet(covariance)[1])


def fit_homography(points: Points, images: Points) -> Points | None:
    """Return the 3 x 3 matrix H, H[2, 2] = 1, such that H (x, y, 1) is parallel to (x', y', 1) for most pairs.

    The direct linear transform minimizes an algebraic error; each further fit weights the equations such that their
    error is the distance in the image.

    Parameters
    ----------
    points, images
        ``(n, 2)`` each.

    Returns
    -------
    Points or None
        None if there are too few pairs, or if the horizon crosses the points.
    """
    if len(points) < LEAST_PAIRS:
        return None
    before, after = _normalization(points), _normalization(images)
    p, q = map_points(before, points), map_points(after, images)
    weights, kept = np.ones(len(p)), np.ones(len(p), np.bool_)
    matrix = np.eye(3)
    for _ in range(_ROUNDS):
        homogeneous = np.column_stack([p, np.ones(len(p))])
        nothing = np.zeros_like(homogeneous)
        equations = np.concatenate(
            [
                np.column_stack([homogeneous, nothing, -q[:, :1] * homogeneous]),
                np.column_stack([nothing, homogeneous, -q[:, 1:] * homogeneous]),
            ]
        )
        rows = np.tile(weights * kept, 2)[:, np.newaxis] * equations
        matrix = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
        depth = homogeneous @ matrix[2]
        if depth[kept].min() * depth[kept].max() <= 0:
            return None
        weights = 1 / np.maximum(np.abs(depth) / np.abs(depth[kept]).mean(), 1e-3)
        off = np.hypot(*(map_points(matrix, p) - q).T)
        kept = off <= _OUTLYING * max(float(np.median(off)), 1e-9)
    matrix = np.linalg.inv(after) @ matrix @ before
    return np.asarray(matrix / matrix[2, 2])


def map_points(matrix: Points, points: Points) -> Points:
    """Return the images of points ``(..., 2)`` under a homography."""
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def _normalization(points: Points) -> NDArray[np.float64]:
    """Return the similarity that moves the mean of points to 0 and their mean distance from it to sqrt 2 (Hartley)."""
    mean = points.mean(0)
    scale = np.sqrt(2) / max(float(np.hypot(*(points - mean).T).mean()), 1e-12)
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])
