"""Geometry and appearance: the G-score and the A-score of a tracked lattice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.displacement.deformation_field import Deformation
from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import interpolate, tile_grid
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import examine
from .registration.node_field import follow_lattice

_LEAST_G, _LEAST_A = 0.005, 1 / 255


@dataclass(frozen=True)
class GeometryAppearance:
    """Irregularity of the lattice (G), and dissimilarity of its tiles (A); both are 0 for a perfectly regular texture.

    In the spirit of Liu, Lin, Hays: Near-regular texture analysis and manipulation (SIGGRAPH 2004), and Lin, Hays, Wu,
    Kwatra, Liu: Quantitative evaluation of near regular texture synthesis algorithms (CVPR 2006). There a user helps to
    find the lattice; here it is followed (:class:`~.deformation.DeformationAmplitude`). Let p_i be the places of the n
    places that are found, k_i their cell coordinates, and (M, o) the affine map that fits best. Then::

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
        known = examine(observation).known_lattice
        if known.lattice is None:
            return Score.missing(self.columns, known.reason)
        output, sample = (measure(image, known.lattice) for image in (observation.output, observation.sample))
        if output is None or sample is None:
            return Score.missing(self.columns, "not measured: the lattice cannot be followed through sample and output")
        (g, a), (sample_g, sample_a) = output, sample
        ratios = g / sample_g if sample_g >= _LEAST_G else None, a / sample_a if sample_a >= _LEAST_A else None
        measured = g, a, sample_g, sample_a, g - sample_g, a - sample_a, *ratios
        values: dict[str, Value] = dict(zip(self.columns, measured, strict=True))
        reason = "not applicable: the sample's own value is too near 0 for a ratio"
        return Score(values, {name: reason for name, value in values.items() if value is None})


def measure(image: Image, lattice: Lattice) -> tuple[float, float] | None:
    """Return both scores of an image; None if the lattice cannot be followed, or if fewer than two cells are whole."""
    knots = follow_lattice(image, lattice)
    if knots is None:
        return None
    deformation = Deformation(image, knots)
    straight, regular = deformation.rectify()
    rows, columns = tile_grid(regular)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows - 0.5, (np.arange(columns) + 0.5) / columns - 0.5, indexing="ij")
    around = np.stack([u, v], -1) @ regular.matrix
    reach, middles = np.abs(around).reshape(-1, 2).max(0), regular.points(straight.shape[:2])
    whole = ((middles >= reach) & (middles <= np.array(straight.shape[1::-1]) - 1 - reach)).all(1)
    if whole.sum() < 2:
        return None
    cells = interpolate(straight, middles[whole][:, np.newaxis, np.newaxis] + around)
    g = math.sqrt(float((deformation.field**2).sum(1).mean())) / regular.s
    return g, float(cells.std(0, ddof=1).mean())
