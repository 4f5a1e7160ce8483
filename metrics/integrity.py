"""Integrity: share of tiles that are whole, not joined of parts that do not belong together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nrbench.imaging.convert import Image, gray
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again, Column, Observation, Score

from .ncc.periodic import tile_box
from .residual_tiles.tiles import offset_noise, squared_gradient
from .verdict.examination import examine
from .verdict.exponential_tail import ExponentialTail
from .verdict.reference import FIRST_DRAW, Reference
from .verdict.verdict import Verdict
from .whole_elements.composite_tiles import (
    Discriminant,
    Levels,
    Rows,
    WholeTiles,
    alteration_moments,
    compose_tiles,
)
from .whole_elements.elements import Cutter, Windows, find_element_places, subtract_mean

BROKEN_SURPRISAL = 8.0
"""Surprisal above which a tile is broken: see ``benchmarks/validation.py alarms``."""
LEAST_POWER = 0.1
"""Detection power below which broken tiles are not counted."""

_DRAWS = 4
_FIRST_DRAW = FIRST_DRAW + (1 << 11)
_TILES_A_SIDE, _SIDES = 10, (160, 360)
"""Side of a fresh draw in tiles, and its limits in px."""
_LEAST_WINDOWS, _LEAST_REFERENCES = 12, 12
_TAIL = 0.9
"""Quantile above which the evidence of whole tiles has an exponential tail."""
_OVERLAP = 2.0
"""Number of windows, half a cell apart, that contain the same pixel."""
_ALIGNMENT = 0.4
"""Misalignment of a tile, px: a fraction of the rounding of a whole-pixel copy."""
_ROUNDING = 1 / 255
_SHARE_OF_VARIANCE = 0.02
_LEAST_CONTRAST, _LOW = 0.8, 0.01
"""Share of a low quantile of the references' contrast below which a tile is ignored, and that quantile. After a strong
blur the parts of a tile cannot be distinguished."""
_ROUNDS = 3
_CALM, _LEAST_CALM, _MANY_CALM = 0.99, 0.25, 0.9
"""Tiles are calm if their evidence is below this quantile of that of the references. At least a quarter of the tiles
are calm. If more than nine tenths are calm, as in images without defects, the mean is not corrected."""
_TOUCHING = 0.9
"""Windows nearer than this, in cells along both vectors, overlap."""

_DIM = 0.5
_MARK = np.array((0.9, 0.1, 0.1), np.float32)
_WORST, _SIDE, _GAP = 8, 96, 4
"""Tiles in the picture of the worst tiles, their height and the gap between them, px."""


@dataclass(frozen=True)
class Integrity:
    """Share of broken tiles: tiles that are joined of parts that do not belong together.

    A brick has one color. A method that cuts and blends inside bricks makes two-tone bricks. These lie in their places,
    so regularity does not detect them. Windows of one cell are cut around the elements, at the displacements that the
    output shows, and their mean is subtracted. The variation of whole tiles is learned from fresh draws, and that of
    composite tiles from tiles of fresh draws that are joined along straight cuts. Directions along which only composite
    tiles vary provide the evidence (:class:`~.whole_elements.composite_tiles.Discriminant`); each half of the fresh
    draws is measured by directions learned from the other half. A tile is broken if its evidence exceeds chance, given
    the number of tiles (:class:`~.verdict.exponential_tail.ExponentialTail`). ``evidence_p90`` describes the tail and
    not the median, because most tiles of a copier are whole copies.

    The effects of blur, uneven light and smooth bending on whole tiles are no evidence
    (:func:`~.whole_elements.composite_tiles.alteration_moments`). Tiles without contrast after a strong blur, and their
    neighbors, are left out. These are faults of appearance and of regularity. A warp of more than 0.15 s deforms tiles
    and may break some; so may a seam that clips values.

    The scores do not depend on the lattice's origin: the windows are placed where most of a window covaries with its
    middle, and once more half a cell aside along both vectors. Tiles that regularity detects as displaced
    are left out, because they lie over other elements. For a photograph the sample replaces the fresh draws.
    """

    version: ClassVar[str] = "5"
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column(
            "Share of elements that are whole, corrected for missed ones: 1 as in fresh draws, 0 no element whole.",
            better="higher",
        ),
        "broken_share": Column(
            "Share of the tiles in place that are joined of parts that do not belong together.", better="lower"
        ),
        "broken_tiles": Column(
            "Number of tiles in place that are joined of parts that do not belong together.",
            "tiles",
            (0.0, math.inf),
            "lower",
        ),
        "evidence_p90": Column(
            "90th percentile of the tiles' evidence of being joined, over that of fresh draws.",
            range=(0.0, math.inf),
            better="lower",
        ),
        "detection_power": Column("Share of fresh tiles, joined along straight cuts, that would be counted as broken."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and two pictures: ``broken`` shows all broken tiles, ``worst`` enlarges the worst ones."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    verdict = examine(observation).verdict
    if isinstance(verdict, str):
        return Score.missing(Integrity.columns, verdict)
    broken = find_broken(verdict, observation.sample, observation.again)
    if isinstance(broken, str):
        return Score.missing(Integrity.columns, broken)
    values: dict[str, float | None] = {
        "score": broken.score,
        "broken_share": broken.share,
        "broken_tiles": float(len(broken.places)),
        "evidence_p90": broken.evidence_p90,
        "detection_power": broken.detection_power,
    }
    records = {
        "tiles": broken.tiles,
        "limit": BROKEN_SURPRISAL,
        "places": [[float(x), float(y)] for x, y in broken.places],
        "surprisals": [float(value) for value in broken.surprisals],
        "anchor": [float(value) for value in broken.anchor],
    }
    if broken.detection_power < LEAST_POWER:
        reason = f"undecided: only {broken.detection_power:.0%} of joined tiles would be detected"
        reasons = {name: reason for name in Integrity.columns if name != "detection_power"}
        return Score(values | dict.fromkeys(reasons), reasons, records=records)
    pictures = {"broken": draw_broken(observation.output, broken)}
    if len(broken.places):
        pictures["worst"] = enlarge_worst(observation.output, broken)
    return Score(values, {}, pictures, records)


@dataclass(frozen=True)
class BrokenTiles:
    """The broken tiles of an output.

    Parameters
    ----------
    lattice
        The lattice of the tiles.
    anchor
        Cell coordinates of the middles of whole elements.
    places
        ``(n, 2)``: middles (x, y) px of the broken tiles, largest surprisal first; none overlap.
    surprisals
        ``(n,)``: about -log of the probability that the worst tile of a fresh draw has more evidence.
    tiles
        Number of tiles in place, whole within the output.
    worst
        Surprisal of the most suspicious tile, broken or not.
    evidence_p90
        90th percentile of the evidence over that of fresh draws.
    detection_power
        Share of composite tiles of fresh draws that would be counted.
    """

    lattice: Lattice
    anchor: Points
    places: Points
    surprisals: Levels
    tiles: int
    worst: float
    evidence_p90: float
    detection_power: float

    @property
    def score(self) -> float:
        """Estimated share of whole tiles: the share of broken tiles is divided by the share that is detected."""
        return 1 - min(self.share / max(self.detection_power, LEAST_POWER), 1.0)

    @property
    def share(self) -> float:
        """Share of broken tiles."""
        return min(len(self.places) / max(self.tiles, 1), 1.0)


@dataclass(frozen=True)
class _PlaceStatistics:
    """Statistics of the references at one place of the cell.

    Parameters
    ----------
    discriminants
        Two discriminants, each with the mean evidence of whole tiles.
    whole, composite
        Evidence of whole and of composite tiles, over that mean.
    """

    discriminants: list[tuple[Discriminant, float]]
    whole: Levels
    composite: Levels


@dataclass(frozen=True)
class _Evidence:
    """Evidence of the output's windows at one place of the cell.

    Parameters
    ----------
    middles
        ``(n, 2)``: middles of the windows, (x, y) px.
    output
        ``(n,)``: their evidence.
    reference
        Statistics of the references at this place.
    """

    middles: Points
    output: Levels
    reference: _PlaceStatistics


def find_broken(verdict: Verdict, sample: Image, again: Again | None) -> BrokenTiles | str:
    """Return the broken tiles of an output, or the reason why they cannot be found.

    If the verdict on regularity has no power, the places of the tiles are not known.
    """
    if verdict.lack_of_power:
        return f"undecided: {verdict.lack_of_power}"
    output = Cutter.from_measurements(verdict.output, offset_noise(verdict.references))
    places, statistics = learn_references(verdict.reference, sample, again, output.lattice)
    evidence = []
    for place, one in zip(places, statistics, strict=True):
        if isinstance(one, str):
            return one
        windows = _select_in_place(output.cut(place), verdict)
        if len(windows.values) < _LEAST_WINDOWS:
            return f"undecided: fewer than {_LEAST_WINDOWS} whole tiles in place to compare"
        evidence.append(_Evidence(windows.middles, _output_evidence(one, subtract_mean(windows.values)), one))
    return _count_broken(output.lattice, places[0], evidence)


def learn_references(
    reference: Reference, sample: Image, again: Again | None, lattice: Lattice
) -> tuple[Points, list[_PlaceStatistics | str]]:
    """Return the places of elements in the cell, and the statistics of the references at each, or a reason for none.

    The references are fresh draws, or else the sample. Each half of the fresh draws, or every second tile of the
    sample, is measured by directions learned from the other half.

    Parameters
    ----------
    reference
        The reference of the verdict.
    sample, again
        The sample and its fresh draws.
    lattice
        The lattice of the output's tiles.
    """
    if again is None or reference.source == "sample":
        cutter = Cutter(sample, reference.lattice)
        halves = [[(cutter, slice(first, None, 2))] for first in (0, 1)]
    else:
        side = np.ceil(np.clip(_TILES_A_SIDE * tile_box(reference.lattice), *_SIDES)).astype(int)
        draws = [again((int(side[1]), int(side[0])), _FIRST_DRAW + k) for k in range(_DRAWS)]
        cutters = [(Cutter(draw.image, reference.lattice), slice(None)) for draw in draws if draw is not None]
        halves = [cutters[: len(cutters) // 2], cutters[len(cutters) // 2 :]]
    places = find_element_places([cutter for half in halves for cutter, _ in half])
    return places, [_learn(halves, place, lattice) for place in places]


def _learn(halves: list[list[tuple[Cutter, slice]]], place: Points, lattice: Lattice) -> _PlaceStatistics | str:
    own = [[cutter.cut(place).take(part) for cutter, part in half] for half in halves]
    if min(sum(len(windows.middles) for windows in half) for half in own) < _LEAST_REFERENCES:
        return f"undecided: the references hold fewer than 2 x {_LEAST_REFERENCES} whole tiles"
    parts = [_whole_tiles([cutter for cutter, _ in half], windows) for half, windows in zip(halves, own, strict=True)]
    floor = _floor([windows for half in own for windows in half], lattice, [part.rows for part in parts])
    discriminants, whole, composite = [], [], []
    for one, other in (parts, parts[::-1]):
        discriminant = Discriminant.fit(one, other, floor)
        evidence = discriminant.evidence(other.rows)
        level = max(float(evidence.mean()), 1e-9)
        discriminants.append((discriminant, level))
        whole.append(evidence / level)
        composite.append(discriminant.evidence(compose_tiles(other.rows)) / level)
    return _PlaceStatistics(discriminants, np.concatenate(whole), np.concatenate(composite))


def _output_evidence(reference: _PlaceStatistics, rows: Rows) -> Levels:
    """Return the evidence of an output's tiles.

    If many tiles are broken, the mean of the calm tiles is subtracted instead of the mean of all. Otherwise the cuts of
    the broken tiles would change the mean and add evidence to whole tiles.
    """
    calm_level = float(np.quantile(reference.whole, _CALM))
    for _ in range(_ROUNDS):
        evidence = np.mean([discriminant.evidence(rows) / level for discriminant, level in reference.discriminants], 0)
        calm = evidence <= max(calm_level, float(np.quantile(evidence, _LEAST_CALM)))
        if calm.mean() > _MANY_CALM:
            break
        rows = rows - rows[calm].mean(0)
    return np.asarray(evidence)


def _whole_tiles(cutters: list[Cutter], windows: list[Windows]) -> WholeTiles:
    pairs = [(cutter, some) for cutter, some in zip(cutters, windows, strict=True) if len(some.middles)]
    altered = [alteration_moments(cutter, some.middles) for cutter, some in pairs]
    return WholeTiles(np.concatenate([subtract_mean(some.values) for _, some in pairs]), np.mean(altered, 0))


def _floor(windows: list[Windows], lattice: Lattice, parts: list[Rows]) -> Levels:
    """Return the variance of rounding and of misalignment, plus a share of the texture's variance."""
    steep = squared_gradient(np.mean([some.values.mean(0) for some in windows], 0), lattice)
    variance = float(np.mean([part.var(0).mean() for part in parts]))
    return np.asarray(_ROUNDING**2 + _SHARE_OF_VARIANCE * variance + _ALIGNMENT**2 * steep.ravel())


def _select_in_place(windows: Windows, verdict: Verdict) -> Windows:
    """Return the windows that are not displaced and not next to a tile without contrast."""
    output, tiles = verdict.output, verdict.output.tiles
    _, tile = cKDTree(tiles.centers).query(windows.middles)
    displaced = verdict.misplaced_windows[output.windows.find_nearest(windows.middles)] | verdict.displaced[tile]
    usual = np.quantile(np.concatenate([one.tiles.slope for one in verdict.references]), _LOW)
    empty = tiles.centers[tiles.slope < _LEAST_CONTRAST * usual]
    if not len(empty):
        return windows.take(~displaced)
    near, _ = cKDTree(tiles.lattice.to_cell(empty)).query(tiles.lattice.to_cell(windows.middles), p=np.inf)
    return windows.take(~(displaced | (near <= 1)))


def _count_broken(lattice: Lattice, anchor: Points, evidence: list[_Evidence]) -> BrokenTiles:
    """Return the broken tiles; each counts once, although windows at several places show it."""
    whole = np.concatenate([one.reference.whole for one in evidence])
    output = np.concatenate([one.output for one in evidence])
    tail = ExponentialTail.fit(whole, _TAIL, overlap=_OVERLAP)

    def surprisal(levels: Levels) -> Levels:
        return np.asarray(tail.surprisal(levels) - np.log(len(output) / len(levels)))

    surprisals = np.concatenate([surprisal(one.output) for one in evidence])
    places, values = _drop_overlapping(lattice, np.concatenate([one.middles for one in evidence]), surprisals)
    return BrokenTiles(
        lattice,
        anchor,
        places,
        values,
        tiles=len(evidence[0].output),
        worst=float(surprisals.max(initial=-np.inf)),
        evidence_p90=float(np.quantile(output, 0.9) / max(float(np.quantile(whole, 0.9)), 1e-9)),
        detection_power=float((surprisal(evidence[0].reference.composite) > BROKEN_SURPRISAL).mean()),
    )


def _drop_overlapping(lattice: Lattice, middles: Points, surprisals: Levels) -> tuple[Points, Levels]:
    """Return middles and surprisals of the broken windows, largest first; of overlapping ones only the first."""
    flagged = np.flatnonzero(surprisals > BROKEN_SURPRISAL)
    flagged = flagged[np.argsort(-surprisals[flagged], kind="stable")]
    if not len(flagged):
        return np.zeros((0, 2)), np.zeros(0)
    uv = lattice.to_cell(middles[flagged])
    free = np.ones(len(flagged), np.bool_)
    kept = []
    for one, near in enumerate(cKDTree(uv).query_ball_point(uv, _TOUCHING, p=np.inf)):
        if free[one]:
            kept.append(flagged[one])
            free[near] = False
    return middles[kept], surprisals[kept]


def draw_broken(output: Image, broken: BrokenTiles) -> Image:
    """Return the output in faint gray, with the broken tiles in color and framed."""
    faint = np.repeat((1 - _DIM + _DIM * gray(output))[..., np.newaxis], 3, 2)
    colored = np.broadcast_to(output, (*output.shape[:2], 3))
    reach = np.abs(broken.lattice.matrix).sum(0) / 2 + 1
    for place in broken.places:
        x0, y0 = np.maximum(np.floor(place - reach), 0).astype(int)
        x1, y1 = np.ceil(place + reach).astype(int) + 1
        y, x = np.indices(output[y0:y1, x0:x1].shape[:2])
        uv = np.abs(broken.lattice.shifted(place - broken.lattice.origin).to_cell(np.stack([x + x0, y + y0], -1)))
        inside, edge = (uv < 0.5).all(-1), (uv.max(-1) >= 0.5 - 1.0 / np.sqrt(broken.lattice.area))
        faint[y0:y1, x0:x1][inside] = colored[y0:y1, x0:x1][inside]
        faint[y0:y1, x0:x1][inside & edge] = _MARK
    return np.asarray(np.clip(faint, 0, 1), np.float32)


def enlarge_worst(output: Image, broken: BrokenTiles) -> Image:
    """Return up to eight of the worst tiles with their neighborhoods, two tiles wide, side by side, worst first."""
    reach = np.maximum(np.ceil(tile_box(broken.lattice)).astype(int), 3)
    crops = [_enlarged_crop(output, place, reach) for place in broken.places[:_WORST]]
    gap = np.ones((max(crop.shape[0] for crop in crops), _GAP, output.shape[2]), np.float32)
    return np.concatenate([part for crop in crops for part in (crop, gap)][:-1], 1)


def _enlarged_crop(output: Image, place: Points, reach: NDArray[np.int64]) -> Image:
    middle = np.rint(place).astype(int)
    x, y = (
        np.clip(np.arange(m - r, m + r + 1), 0, side - 1)
        for m, r, side in zip(middle, reach, output.shape[1::-1], strict=True)
    )
    crop = output[np.ix_(y, x)]
    times = max(round(_SIDE / crop.shape[0]), 1)
    return np.asarray(crop.repeat(times, 0).repeat(times, 1))
