"""Geometry and appearance: the G-score and the A-score of a tracked lattice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import examine
from .judgment.texture_reference import CannotTell
from .registration.followed import FollowedPicture
from .registration.lattice_net import sample_planes, split_cells
from .registration.node_field import NodeField

_LEAST_G, _LEAST_A = 0.005, 1 / 255


@dataclass(frozen=True)
class GeometryAppearance:
    """Irregularity of the lattice (G), and dissimilarity of its tiles (A); both are 0 for a perfectly regular texture.

    In the spirit of Liu, Lin, Hays: Near-regular texture analysis and manipulation (SIGGRAPH 2004), and Lin, Hays, Wu,
    Kwatra, Liu: Quantitative evaluation of near regular texture synthesis algorithms (CVPR 2006). There a user helps to
    find the lattice; here it is followed (:class:`~.deformation.DeformationAmplitude`). Let p_i be the places of the n
    windows that are in place, k_i their cell coordinates, and (M, o) the affine map that fits best. Then::

        G = sqrt(sum_i |p_i - (k_i M + o)|^2 / n) / s,   s the shortest lattice vector
        A = mean over points x of the cell and channels of std_i T_i(x)

    where T_i is the i-th cell, straightened by the followed lattice, and std_i the standard deviation over the whole
    cells (with the divisor n - 1) of pixels in [0, 1]. G is divided by s, and A is unbiased, so that images of
    different size compare; do not compare them with figures printed in the papers. G describes each image as a whole,
    while ``deformation`` compares parts of equal size.
    """

    version: ClassVar[str] = "2"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "g": Column("Deviation of the output's lattice from its best regular fit.", "of s", (0.0, math.inf)),
        "a": Column("Mean standard deviation of the output's aligned tiles.", "values", (0.0, 1.0)),
        "sample_g": Column("Deviation of the sample's lattice from its best regular fit.", "of s", (0.0, math.inf)),
        "sample_a": Column("Mean standard deviation of the sample's aligned tiles.", "values", (0.0, 1.0)),
        "g_difference": Column("G of the output less that of the sample.", "of s", (-math.inf, math.inf)),
        "a_difference": Column("A of the output less that of the sample.", "values", (-1.0, 1.0)),
        "g_ratio": Column("G of the output over that of the sample.", "", (0.0, math.inf), "one"),
        "a_ratio": Column("A of the output over that of the sample.", "", (0.0, math.inf), "one"),
    }

    def score(self, observation: Observation) -> Score:
        """Return both scores for sample and output."""
        try:
            pictures = examine(observation).both
        except CannotTell as none:
            return Score.missing(self.columns, str(none))
        images = (observation.output, observation.sample)
        g, sample_g = (NodeField.of(picture).deviation / picture.net.s for picture in pictures)
        a, sample_a = (appearance(image, picture) for image, picture in zip(images, pictures, strict=True))
        numbers: dict[str, float | None] = {
            "g": g,
            "a": a,
            "sample_g": sample_g,
            "sample_a": sample_a,
            "g_difference": g - sample_g,
            "a_difference": a - sample_a,
            "g_ratio": None if sample_g < _LEAST_G else g / sample_g,
            "a_ratio": None if sample_a < _LEAST_A else a / sample_a,
        }
        values: dict[str, Value] = {}
        reasons = {}
        for name, number in numbers.items():
            values[name] = None if number is None or math.isnan(number) else number
            if number is None:
                reasons[name] = "not applicable: the sample's own value is too near 0 for a ratio"
            elif values[name] is None:
                reasons[name] = "undecided: fewer than two whole cells are in place"
        return Score(values, reasons)


def appearance(image: Image, picture: FollowedPicture) -> float:
    """Return the A-score of an image that was followed; NaN if fewer than two whole cells are in place."""
    points, known = picture.locate_points(picture.unwrapped)
    samples = picture.net.samples
    cells = split_cells(sample_planes(image, points), samples)[split_cells(known, samples).all((2, 3))]
    return float(cells.std(0, ddof=1).mean()) if len(cells) > 1 else math.nan
