"""Regularity: whether the output kept the lattice, measured on pixels against the periodic image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, gray
from nrbench.imaging.mean_tile import cell_coordinates
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Column, Observation, Score, Value

from .verdict import limits
from .verdict.examination import examine
from .verdict.tiles import Tiles
from .verdict.verdict import Verdict
from .verdict.windows import stretch_matrix

COLORS = {"region": (1.0, 0.6, 0.0), "displaced": (0.9, 0.1, 0.1), "broken": (0.7, 0.1, 0.8)}
"""Colors of a tile in a displaced region, of one that fits better elsewhere, and of one that fits nowhere."""
_DIM = 0.5


def draw_defects(verdict: Verdict, output: Image) -> Image:
    """Return the output in faint gray, with the quarter cells around the middles of bad tiles in :data:`COLORS`.

    If a tile has several faults, displaced takes precedence over broken, and broken over region.
    """
    tiles, shape = verdict.output.tiles, output.shape[:2]
    faint = np.repeat((1 - _DIM + _DIM * gray(output))[..., np.newaxis], 3, 2)
    flags = {"region": verdict.in_displaced_region, "broken": verdict.broken, "displaced": verdict.displaced}
    tints = np.full((len(tiles.centers) + 1, 3), np.nan, np.float32)
    for name, flag in flags.items():
        tints[:-1][flag] = COLORS[name]
    tint = tints.take(verdict.map_to_output(find_nearest_tiles(tiles, verdict.output.image.shape[:2]), shape), 0)
    return np.clip(np.where(np.isnan(tint), faint, (1 - _DIM) * faint + _DIM * tint), 0, 1)


def find_nearest_tiles(tiles: Tiles, shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return for each pixel the index of the nearest tile in cell coordinates; -1 where there is none."""
    halves = _halves(cell_coordinates(tiles.lattice, shape))
    own = _halves(tiles.lattice.to_cell(tiles.centers))
    low, high = halves.reshape(-1, 2).min(0), halves.reshape(-1, 2).max(0)
    table = np.full(high - low + 1, -1, np.intp)
    table[tuple((own - low).T)] = np.arange(len(own))
    return np.asarray(table[tuple(np.moveaxis(halves - low, -1, 0))])


def _halves(uv: Points) -> NDArray[np.intp]:
    return np.rint(2 * uv).astype(np.intp)


def _distance(meaning: str, unit: str = "of s") -> Column:
    over = ", over the shortest lattice vector s" if unit == "of s" else ""
    return Column(f"{meaning}{over}.", unit, (0.0, math.inf), "lower")


_MEDIAN, _P95 = (f"{what} displacement of windows from their place" for what in ("Median", "95th percentile of the"))


@dataclass(frozen=True)
class Regularity:
    """How well the output keeps the true lattice, measured on its pixels.

    The template is the periodic image of the texture: that of the model, or the mean tile of the sample folded by the
    given lattice. Windows of the output, 2 tiles wide and half a window apart, are registered against the template by
    weighted NCC over one cell of displacements, to fractions of a pixel. The most common displacement is the phase of
    the output, which is free. The rest of each displacement, modulo the lattice and over its shortest vector s, is the
    misplacement of the window. Then windows of one tile, half a cell apart, are compared with the template at that
    phase. Each pixel is weighted by the inverse of its variance across tiles. This shows single tiles that are
    displaced, missing or broken.

    All limits are relative to fresh draws of the model. For a photograph they are relative to the sample, each part of
    which is compared with the mean tile of the rest. See :mod:`nrbench.metrics.verdict.limits`. The windows are then 2,
    3 or 4 tiles wide: the smallest size at which the windows of the sample lie in their places. The record
    ``resolution`` is the smallest displacement of a neighborhood, in s, that would be called lost. ``preserved`` is
    undecided if it exceeds 0.3 s, unless most windows are misplaced or the mean tile of the output is not that of the
    sample (record ``tile_fit``). For a photograph the
    affine part of the displacement is reported as drift. It is left out of everything else as long as the lattice of
    the output is within 2 % of the given one, which is the uncertainty of a lattice marked by hand.

    If a model displaces its content (types II and III), the lattice is tracked through output and fresh draws, and the
    smooth part of the displacements is removed before the windows are compared. The displacements themselves are tested
    for phase steps along lines, for displaced patches, and for their amplitude and roughness beside fresh draws. See
    :class:`~nrbench.metrics.verdict.bent.BentVerdict`.

    Without a model the given lattice is used. If none is given, the detector ``dominance`` finds the lattice of the
    sample; no method uses it by default. The record ``lattice_from`` names the source: model, given, or dominance.
    """

    version: ClassVar[str] = "8"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "preserved": Column("Whether the output kept the lattice everywhere.", better="higher"),
        "intact": Column(
            "Whether no single tile is displaced, missing or doubled; undecided if one could stay undetected.",
            better="higher",
        ),
        "score": Column(
            "Share of tiles that show the pattern in its place; tiles joined of parts count, see integrity.",
            better="higher",
        ),
        "misplacement_median": _distance(_MEDIAN),
        "misplacement_p95": _distance(_P95),
        "misplacement_median_px": _distance(_MEDIAN, "px"),
        "misplacement_p95_px": _distance(_P95, "px"),
        "misplacement_ratio": Column(
            "Displacements over those of fresh draws: their amplitude where the geometry varies (types II, III).",
            range=(0.0, math.inf),
            better="one",
        ),
        "pairwise_displacement": _distance("Mean displacement of two windows relative to each other"),
        "misplaced_share": Column("Share of windows that are out of place.", better="lower"),
        "worst_neighborhood": _distance("Largest median displacement of 3 x 3 windows"),
        "structure": Column(
            "Median correlation of windows with the periodic image, over that of fresh draws.",
            range=(-math.inf, math.inf),
            better="one",
        ),
        "structure_spread": Column(
            "Interquartile range of the windows' correlations over that of fresh draws; larger if patches are torn.",
            range=(0.0, math.inf),
            better="one",
        ),
        "bad_tiles": Column("Number of single tiles that are displaced or broken.", "tiles", (0.0, math.inf), "lower"),
        "worst_tile": Column(
            "Ratio of the fault of the worst single tile to its limit: above 1 the tile is bad.",
            range=(-math.inf, math.inf),
            better="lower",
        ),
        "worst_tile_displacement": _distance("Displacement of the tile that gains most by a fit elsewhere"),
        "worst_course": _distance("Displacement of the course that gains most by a fit elsewhere"),
        "drift": Column(
            "Stretch or rotation of the whole output from the true lattice.", "%", (0.0, math.inf), "lower"
        ),
        "lattice_exact": Column(
            "Whether the output's own least-squares lattice is the true one, to 1 px of its vectors.", better="higher"
        ),
        "lattice_vector_error": _distance("Larger error of the generating vectors of the output's own lattice", "px"),
        "lattice_area_ratio": Column(
            "Area of the output's own cell over the true cell's.", range=(0.0, math.inf), better="one"
        ),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``defects``, which shows the bad tiles in color on the dimmed output."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    verdict = examine(observation).verdict
    if isinstance(verdict, str):
        return Score.missing(Regularity.columns, verdict)
    values = compute_columns(verdict)
    reasons = {name: _reason(name, verdict) for name, value in values.items() if value is None}
    return Score(values, reasons, {"defects": draw_defects(verdict, observation.output)}, _records(verdict))


def compute_columns(verdict: Verdict) -> dict[str, Value]:
    """Return all columns of a verdict."""
    return {**_verdict_columns(verdict), **_displacement_columns(verdict), **_lattice_columns(verdict)}


def _verdict_columns(verdict: Verdict) -> dict[str, Value]:
    course = verdict.output.courses.worst_slide
    return {
        "preserved": verdict.preserved,
        "intact": verdict.intact,
        "score": None if verdict.lattice_doubtful else verdict.score,
        "bad_tiles": float(len(verdict.bad_places)),
        "worst_tile": float(verdict.tile_excess.max(initial=0.0)),
        "worst_tile_displacement": verdict.worst_tile_displacement,
        "worst_course": course / verdict.reference.lattice.s if course is not None else None,
        "structure": verdict.structure,
        "structure_spread": verdict.structure_spread,
    }


def _displacement_columns(verdict: Verdict) -> dict[str, Value]:
    misplacement, s = verdict.output.windows.misplacement, verdict.reference.lattice.s
    median, p95 = (float(value) for value in np.quantile(misplacement, (0.5, 0.95)))
    return {
        "misplacement_median": median,
        "misplacement_p95": p95,
        "misplacement_median_px": median * s,
        "misplacement_p95_px": p95 * s,
        "misplacement_ratio": verdict.misplacement_ratio,
        "pairwise_displacement": verdict.output.windows.pairwise_displacement,
        "misplaced_share": float(verdict.misplaced_windows.mean()),
        "worst_neighborhood": verdict.worst_neighborhood,
    }


def _lattice_columns(verdict: Verdict) -> dict[str, Value]:
    """Return the output's own lattice beside the true one: the model's, or the given one as fitted to the sample."""
    own = verdict.own_lattice if verdict.structure >= limits.STRUCTURE else None
    error = own.error(verdict.reference.lattice, verdict.output.image.shape[:2]) if own else None
    return {
        "drift": 100 * float(np.linalg.norm(stretch_matrix(verdict.drift) - np.eye(2), 2)) if error else None,
        "lattice_exact": error.relation == "exact" if error else None,
        "lattice_vector_error": error.vector if error else None,
        "lattice_area_ratio": error.area_ratio if error else None,
    }


def _reason(name: str, verdict: Verdict) -> str:
    """Return the reason why a column is None."""
    if name == "intact" and verdict.preserved is False:
        return "undecided: regularity is lost, and no single tile stands out"
    if name == "preserved" and verdict.preserved is None:
        return f"undecided: {verdict.doubt}"
    if name in ("preserved", "intact", "score"):
        fault = "one bad tile" if name == "intact" else "a course that slid by 0.15 s"
        faint = f"{fault} could stay undetected at the regular share {verdict.reference.regular_share:.2f}"
        return f"undecided: {verdict.lack_of_power or faint}"
    if name == "misplacement_ratio":
        return "not measured: the windows of the reference are not displaced at all"
    if name == "worst_course":
        return "not measured: no course of two whole tiles"
    if name == "structure_spread":
        return "not measured: the windows of the reference hardly differ"
    if verdict.structure < limits.STRUCTURE:
        return f"not measured: windows show {max(verdict.structure, 0):.0%} of the structure of the references'"
    if verdict.own_lattice is None:
        return "not measured: fewer than 3 x 3 windows"
    return f"not measured: only {verdict.own_lattice.followers:.0%} of the windows lie on one lattice"


def _records(verdict: Verdict) -> dict[str, Any]:
    windows = verdict.output.windows
    return {
        "reference": verdict.reference.source,
        "lattice_from": verdict.reference.known.origin,
        "own_lattice": verdict.own_lattice.lattice.as_dict() if verdict.own_lattice else None,
        "followers": verdict.own_lattice.followers if verdict.own_lattice else None,
        "regular_share": verdict.reference.regular_share,
        "judged": "detail" if verdict.reference.detail else "image",
        "lattice": verdict.output.tiles.lattice.as_dict(),
        "phase": [float(value) for value in windows.phase],
        "windows": list(windows.grid),
        "misplacement_limit": verdict.limit,
        "window_tiles": verdict.reference.periodic.window_tiles,
        "resolution": verdict.resolution,
        "tile_fit": verdict.tile_fit if verdict.reference.source == "sample" else None,
        "faults": list(verdict.faults),
        "excess": verdict.excesses,
        "bad_places": [[float(x), float(y)] for x, y in verdict.locate_in_output(verdict.bad_places)],
        **verdict.describe_displacements(),
    }
