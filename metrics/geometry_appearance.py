"""Geometry and appearance: the G-score and the A-score of a tracked lattice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.imaging.mean_tile import Values, interpolate, tile_grid
from nrbench.plugins.forms import Column, Observation, Score, Value
from nrbench.tracking.tracker import Track

from .deformations.tracked_lattices import DeformationField, track_images

_LEAST_G, _LEAST_A = 0.005, 1 / 255


@dataclass(frozen=True)
class GeometryAppearance:
    """Irregularity of the lattice (G), and dissimilarity of its tiles (A); both are 0 for a perfectly regular texture.

    In the spirit of Liu, Lin, Hays: Near-regular texture analysis and manipulation (SIGGRAPH 2004), and Lin, Hays, Wu,
    Kwatra, Liu: Quantitative evaluation of near regular texture synthesis algorithms (CVPR 2006). There a user helps to
    find the lattice; here it is tracked (:class:`~.deformation.DeformationAmplitude`). Let p_i be the places of the n
    lattice points that lie at least half a tile inside the image, k_i their integer cell coordinates, and (M, o) the
    affine map that fits best. Then::

        G = sqrt(sum_i |p_i - (k_i M + o)|^2 / n) / s,   s the shortest lattice vector
        A = mean over pixels x of the tile and channels of std_i T_i(x)

    where T_i is the i-th tile, straightened by the tracked lattice, and std_i the standard deviation over the n tiles
    (with the divisor n - 1) of pixels in [0, 1]. G is divided by s, and A is unbiased, so that images of different size
    compare; do not compare them with figures printed in the papers. G describes each image as a whole, while
    ``deformation`` compares parts of equal size.
    """

    version: ClassVar[str] = "1"
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
        tracks = observation.shared(track_images)
        reason = tracks if isinstance(tracks, str) else tracks.obstacle
        if isinstance(tracks, str) or reason:
            return Score.missing(self.columns, reason)
        g, sample_g = (geometry(track) for track in (tracks.output, tracks.sample))
        a, sample_a = (appearance(track) for track in (tracks.output, tracks.sample))
        values: dict[str, Value] = {
            "g": g,
            "a": a,
            "sample_g": sample_g,
            "sample_a": sample_a,
            "g_difference": g - sample_g,
            "a_difference": a - sample_a,
            "g_ratio": g / sample_g if sample_g >= _LEAST_G else None,
            "a_ratio": a / sample_a if sample_a >= _LEAST_A else None,
        }
        reason = "not applicable: the sample's own value is too near 0 for a ratio"
        return Score(values, {name: reason for name, value in values.items() if value is None})


def geometry(track: Track) -> float:
    """Return the G-score."""
    return DeformationField.of(track).deviation / track.lattice.s


def appearance(track: Track) -> float:
    """Return the A-score."""
    return float(aligned_tiles(track).std(0, ddof=1).mean())


def aligned_tiles(track: Track) -> Values:
    """Return the image's whole tiles, straightened by the tracked lattice, ``(n, V, U, C)``, bilinear."""
    rows, columns = tile_grid(track.lattice)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows - 0.5, (np.arange(columns) + 0.5) / columns - 0.5, indexing="ij")
    uv = track.numbers[:, np.newaxis, np.newaxis] + np.stack([u, v], -1)
    return interpolate(track.image, track.locate(uv))
