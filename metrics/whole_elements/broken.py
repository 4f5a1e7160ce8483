"""Broken tiles: those whose departures only tiles joined of two parts can have."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Again

from ..ncc.periodic import tile_box
from ..residual_tiles.tile_alignment import offset_noise
from ..verdict.exponential_tail import Tail
from ..verdict.reference import FIRST_DRAW
from ..verdict.verdict import Judgement
from .alterations import alterations
from .composite_tiles import Joint, Levels, Rows, Whole, joined
from .elements import Cutter, Windows, departures, places, slope

_Half = list[tuple[Cutter, slice]]

BROKEN_SURPRISE = 8.0
"""Surprise above which a tile is broken: see ``benchmarks/appearance_validation.py``."""
DRAWS = 4
_OWN_DRAWS = FIRST_DRAW + (1 << 11)
_TILES_A_SIDE, _SIDES = 10, (160, 360)
_LEAST_WINDOWS, _LEAST_REFERENCES = 12, 12
_TAIL = 0.9
_OVERLAP = 2.0
"""How many windows, half a cell apart, see what one sees."""
_ALIGNMENT = 0.4
"""Pixels by which a tile may be cut off its place: a fraction of a whole-pixel copy's rounding."""
_NOISE = 1 / 255
_SHARE_OF_VARIANCE = 0.02
_LEAST_CONTRAST, _LOW = 0.8, 0.01
"""Tiles that show less of the periodic image's contrast than this share of what nearly all references' show are not
looked at: a strong blur leaves nothing to tell parts by."""
_ROUNDS = 3
_CALM, _LEAST_CALM, _MANY_CALM = 0.99, 0.25, 0.9
"""Calm is what shows no more evidence than this share of the references, at least a quarter of the tiles; where more
than nine tenths are calm, as in all right images, they keep their own mean."""
_TOUCHING = 0.9
"""Windows nearer than this, in cells along both vectors, overlap."""


@dataclass(frozen=True)
class Broken:
    """The broken tiles of an output.

    Parameters
    ----------
    lattice
        Whose cells the tiles are.
    anchor
        Cell coordinates of the windows around whole elements.
    places
        ``(n, 2)``: middles (x, y) px of the broken tiles, most surprising first; none overlap.
    surprises
        ``(n,)``: about -log of the chance that a fresh draw's worst tile exceeds it.
    tiles
        How many tiles, in place and whole within the output, were looked at.
    worst
        Surprise of the most suspicious tile, broken or not.
    evidence_p90
        90th percentile of the evidence over that of fresh draws.
    power
        Share of joined tiles of fresh draws that would be counted.
    """

    lattice: Lattice
    anchor: Points
    places: Points
    surprises: Levels
    tiles: int
    worst: float
    evidence_p90: float
    power: float

    @property
    def number(self) -> int:
        """How many tiles are broken."""
        return len(self.places)

    @property
    def share(self) -> float:
        """Share of the tiles that are broken."""
        return min(self.number / max(self.tiles, 1), 1.0)


@dataclass(frozen=True)
class _Place:
    """The windows at one place of the cell: where, their evidence, references', and joined ones'; or why none."""

    middles: Points = field(default_factory=lambda: np.zeros((0, 2)))
    output: Levels = field(default_factory=lambda: np.zeros(0))
    whole: Levels = field(default_factory=lambda: np.zeros(0))
    joined: Levels = field(default_factory=lambda: np.zeros(0))
    few: str = ""


def find_broken(judgement: Judgement, sample: Image, again: Again | None) -> Broken | str:
    """Return the broken tiles of the output, or why none can be looked for.

    Where the judge of regularity is blind, it is not known where the tiles are.
    """
    if judgement.blindness:
        return f"undecided: {judgement.blindness}"
    halves = _references(judgement, sample, again)
    output = Cutter.following(judgement.output, offset_noise(judgement.references))
    spots = places([cutter for half in halves for cutter, _ in half])
    found = [_compare(output, halves, spot, judgement) for spot in spots]
    few = [place.few for place in found if place.few]
    return few[0] if few else _counted(output.lattice, spots[0], found)


def _references(judgement: Judgement, sample: Image, again: Again | None) -> tuple[_Half, _Half]:
    """Return two halves of what is right: fresh draws, whose tiles lie where they belong, or the halves of the sample.

    The halves of the sample are every second tile.
    """
    lattice = judgement.yardstick.lattice
    if again is None or judgement.yardstick.source == "sample":
        cutter = Cutter(sample, lattice)
        return [(cutter, slice(0, None, 2))], [(cutter, slice(1, None, 2))]
    side = np.ceil(np.clip(_TILES_A_SIDE * tile_box(lattice), *_SIDES)).astype(int)
    draws = [again((int(side[1]), int(side[0])), _OWN_DRAWS + k) for k in range(DRAWS)]
    cutters = [(Cutter(draw.image, lattice), slice(None)) for draw in draws if draw is not None]
    return cutters[: len(cutters) // 2], cutters[len(cutters) // 2 :]


def _compare(output: Cutter, halves: tuple[_Half, _Half], spot: Points, judgement: Judgement) -> _Place:
    """Return the evidence at one place of the cell; each half of the references is measured by the other."""
    seen = _in_place(output.cut(spot), judgement)
    own = [[_part(cutter.cut(spot), part) for cutter, part in half] for half in halves]
    if min(sum(len(windows.middles) for windows in half) for half in own) < _LEAST_REFERENCES:
        return _Place(few=f"undecided: the references hold fewer than 2 x {_LEAST_REFERENCES} whole tiles")
    if len(seen.values) < _LEAST_WINDOWS:
        return _Place(few=f"undecided: fewer than {_LEAST_WINDOWS} whole tiles in place to compare")
    parts = [_whole([cutter for cutter, _ in half], windows) for half, windows in zip(halves, own, strict=True)]
    rows = [part.rows for part in parts]
    floor = _floor([windows.values for half in own for windows in half], output.lattice, rows)
    crossed = [(Joint.fit(a, b, floor), b.rows) for a, b in (parts, parts[::-1])]
    pairs = [(joint, other, max(float(joint.evidence(other).mean()), 1e-9)) for joint, other in crossed]
    whole = np.concatenate([joint.evidence(other) / level for joint, other, level in pairs])
    measures = [(joint, level) for joint, _, level in pairs]
    return _Place(
        seen.middles,
        _evidence(measures, departures(seen.values), float(np.quantile(whole, _CALM))),
        whole,
        np.concatenate([joint.evidence(joined(other, other.shape[1])) / level for joint, other, level in pairs]),
    )


def _evidence(measures: list[tuple[Joint, float]], shown: Rows, usual: float) -> Levels:
    """Return the evidence of an output's tiles; where many are broken their mean is that of the calm ones.

    The joints of many broken tiles do not quite cancel in the mean of all, and would leave their traces in whole ones.
    """
    for _ in range(_ROUNDS):
        found = np.mean([joint.evidence(shown) / level for joint, level in measures], 0)
        calm = found <= max(usual, float(np.quantile(found, _LEAST_CALM)))
        if calm.mean() > _MANY_CALM:
            break
        shown = shown - shown[calm].mean(0)
    return np.asarray(found)


def _part(windows: Windows, part: slice | NDArray[np.bool_]) -> Windows:
    return Windows(windows.middles[part], windows.values[part])


def _whole(cutters: list[Cutter], windows: list[Windows]) -> Whole:
    """Return the windows of whole tiles of some images, and how they would look altered."""
    seen = [(cutter, some) for cutter, some in zip(cutters, windows, strict=True) if len(some.middles)]
    altered = [alterations(cutter, some.middles) for cutter, some in seen]
    return Whole(np.concatenate([departures(some.values) for _, some in seen]), np.mean(altered, 0))


def _floor(own: list[Values], lattice: Lattice, parts: list[Rows]) -> Levels:
    """Return the variance that is held against no tile: of rounding, of misalignment, and a share of the texture's."""
    steep = slope(np.mean([values.mean(0) for values in own], 0), lattice)
    variance = float(np.mean([part.var(0).mean() for part in parts]))
    return np.asarray(_NOISE**2 + _SHARE_OF_VARIANCE * variance + _ALIGNMENT**2 * steep.ravel())


def _in_place(windows: Windows, judgement: Judgement) -> Windows:
    """Return those windows that regularity does not call displaced, and that no strong blur has reached."""
    output = judgement.output
    _, tile = cKDTree(output.tiles.centers).query(windows.middles)
    moved = judgement.misplaced[output.placement.nearest(windows.middles)] | judgement.displaced[tile]
    return _part(windows, ~(moved | _emptied(windows.middles, judgement)))


def _emptied(middles: Points, judgement: Judgement) -> NDArray[np.bool_]:
    """Return which windows touch a tile that lacks the contrast that nearly all of the references' have."""
    tiles = judgement.output.tiles
    usual = np.quantile(np.concatenate([look.tiles.slope for look in judgement.references]), _LOW)
    empty = tiles.centers[tiles.slope < _LEAST_CONTRAST * usual]
    if not len(empty):
        return np.zeros(len(middles), np.bool_)
    near, _ = cKDTree(tiles.lattice.to_cell(empty)).query(tiles.lattice.to_cell(middles), p=np.inf)
    return np.asarray(near <= 1)


def _counted(lattice: Lattice, anchor: Points, found: list[_Place]) -> Broken:
    """Return the broken tiles, each counted once though windows at several places see it."""
    tail = Tail.fit(np.concatenate([place.whole for place in found]), _TAIL, overlap=_OVERLAP)
    windows = sum(len(place.output) for place in found)
    surprise = [tail.surprise(place.output) - np.log(windows / len(place.output)) for place in found]
    kept, values = _apart(lattice, np.concatenate([place.middles for place in found]), np.concatenate(surprise))
    worst = max(float(own.max(initial=-np.inf)) for own in surprise)
    whole, all_seen = (np.concatenate([getattr(p, name) for p in found]) for name in ("whole", "output"))
    ratio = float(np.quantile(all_seen, 0.9) / max(float(np.quantile(whole, 0.9)), 1e-9))
    one = found[0].joined
    power = float((tail.surprise(one) - np.log(windows / len(one)) > BROKEN_SURPRISE).mean())
    return Broken(lattice, anchor, kept, values, len(found[0].output), worst, ratio, power)


def _apart(lattice: Lattice, middles: Points, surprise: Levels) -> tuple[Points, Levels]:
    """Return middles and surprises of the broken windows, most surprising first; of those that overlap only the first.

    So a broken tile counts once, as the window sees it in whose middle it lies.
    """
    flagged = np.flatnonzero(surprise > BROKEN_SURPRISE)
    flagged = flagged[np.argsort(-surprise[flagged], kind="stable")]
    if not len(flagged):
        return np.zeros((0, 2)), np.zeros(0)
    around = cKDTree(lattice.to_cell(middles[flagged])).query_ball_point(
        lattice.to_cell(middles[flagged]), _TOUCHING, p=np.inf
    )
    free = np.ones(len(flagged), np.bool_)
    kept = []
    for one, near in enumerate(around):
        if free[one]:
            kept.append(flagged[one])
            free[near] = False
    return middles[kept], surprise[kept]
