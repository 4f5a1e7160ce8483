"""Broken tiles: those whose departures only tiles joined of two parts can have."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from nrbench.imaging.door import Image
from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice, Points
from nrbench.synthesis import Again

from .elements import Cutter, Windows, departures, places, slope
from .joined import Joint, Levels, Rows, joined
from .judgement import Judgement
from .periodic import tile_box
from .residual import offset_noise
from .surprise import Tail
from .yardstick import FIRST_DRAW

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
    """Return the broken tiles of the output, or why none can be looked for."""
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
    own = [[cutter.cut(spot).values[part] for cutter, part in half] for half in halves]
    parts = [np.concatenate([departures(values) for values in half]) for half in own]
    if min(len(part) for part in parts) < _LEAST_REFERENCES:
        return _Place(few=f"undecided: the references hold fewer than 2 x {_LEAST_REFERENCES} whole tiles")
    if len(seen.values) < _LEAST_WINDOWS:
        return _Place(few=f"undecided: fewer than {_LEAST_WINDOWS} whole tiles in place to compare")
    floor = _floor([values for half in own for values in half], output.lattice, parts)
    crossed = [(Joint.fit(a, b, floor), b) for a, b in (parts, parts[::-1])]
    pairs = [(joint, other, max(float(joint.evidence(other).mean()), 1e-9)) for joint, other in crossed]
    shown = departures(seen.values)
    return _Place(
        seen.middles,
        np.mean([joint.evidence(shown) / level for joint, _, level in pairs], 0),
        np.concatenate([joint.evidence(other) / level for joint, other, level in pairs]),
        np.concatenate([joint.evidence(joined(other, other.shape[1])) / level for joint, other, level in pairs]),
    )


def _floor(own: list[Values], lattice: Lattice, parts: list[Rows]) -> Levels:
    """Return the variance that is held against no tile: of rounding, of misalignment, and a share of the texture's."""
    steep = slope(np.mean([values.mean(0) for values in own], 0), lattice)
    variance = float(np.mean([part.var(0).mean() for part in parts]))
    return np.asarray(_NOISE**2 + _SHARE_OF_VARIANCE * variance + _ALIGNMENT**2 * steep.ravel())


def _in_place(windows: Windows, judgement: Judgement) -> Windows:
    """Return those windows that regularity does not call displaced."""
    output = judgement.output
    _, tile = cKDTree(output.tiles.centers).query(windows.middles)
    moved = judgement.misplaced[output.placement.nearest(windows.middles)] | judgement.displaced[tile]
    return Windows(windows.middles[~moved], windows.values[~moved])


def _counted(lattice: Lattice, anchor: Points, found: list[_Place]) -> Broken:
    """Return the broken tiles, each counted once though windows at several places see it."""
    tail = Tail.fit(np.concatenate([place.whole for place in found]), _TAIL, overlap=_OVERLAP)
    windows = sum(len(place.output) for place in found)
    surprise = [tail.surprise(place.output) - np.log(windows / len(place.output)) for place in found]
    kept, values = _apart(lattice, [place.middles for place in found], surprise)
    worst = max(float(own.max(initial=-np.inf)) for own in surprise)
    order = np.argsort(-values, kind="stable")
    whole, all_seen = (np.concatenate([getattr(p, name) for p in found]) for name in ("whole", "output"))
    ratio = float(np.quantile(all_seen, 0.9) / max(float(np.quantile(whole, 0.9)), 1e-9))
    one = found[0].joined
    power = float((tail.surprise(one) - np.log(windows / len(one)) > BROKEN_SURPRISE).mean())
    return Broken(lattice, anchor, kept[order], values[order], len(found[0].output), worst, ratio, power)


def _apart(lattice: Lattice, middles: list[Points], surprise: list[Levels]) -> tuple[Points, Levels]:
    """Return middles and surprises of the broken windows, of those that overlap only that of the first place."""
    kept, values = np.zeros((0, 2)), np.zeros(0)
    for at, own in zip(middles, surprise, strict=True):
        flagged = own > BROKEN_SURPRISE
        new = at[flagged]
        if len(kept) and len(new):
            near, _ = cKDTree(lattice.to_cell(kept)).query(lattice.to_cell(new), p=np.inf)
            flagged[np.flatnonzero(flagged)[near < _TOUCHING]] = False
        kept, values = np.concatenate([kept, at[flagged]]), np.concatenate([values, own[flagged]])
    return kept, values
