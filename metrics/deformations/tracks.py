"""The lattice as it was followed through sample, output and fresh draws."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Again, Observation
from nrbench.tracking.tracker import FLAT, MeanTile, Track, track

from ..verdict.reference import FIRST_DRAW

LEAST_POINTS = 9
"""Lattice points that an image must hold for its lattice to be measured."""
LEAST_CORRELATION = 0.5
"""A tile that correlates less with the mean tile, in the mean tile's colors, was not found."""
LEAST_TRACKED = 0.5
"""Share of tiles that must be found for a track to be one."""
_LARGEST = 320


@dataclass(frozen=True)
class Tracks:
    """The same lattice, followed through three kinds of images.

    Parameters
    ----------
    sample, output
        As they are.
    tile
        What was looked for in the output.
    again
        Fresh draws; None where there are none.
    """

    sample: Track
    output: Track
    tile: MeanTile
    again: Again | None

    @cached_property
    def fresh(self) -> tuple[Track, ...]:
        """A fresh draw of the output's shape, of up to 320 px a side; () where there is none."""
        height, width = (min(side, _LARGEST) for side in self.output.image.shape[:2])
        drawn = self.again((height, width), FIRST_DRAW) if self.again else None
        return () if drawn is None else (track(quantize(drawn.image), self.output.lattice, self.tile),)


_LAST: list[tuple[Observation, Tracks | None]] = []


def tracks(observation: Observation) -> Tracks | None:
    """Return the tracks of an observation; None where no lattice is known or its mean tile is flat.

    What is looked for is the mean tile: of the ideal image where the truth has one, else of the sample by the known
    lattice. The last tracks are kept: metrics that need the same ones, one after the other, share them.
    """
    for seen, found in _LAST:
        if all(getattr(seen, name) is getattr(observation, name) for name in ("sample", "output", "truth", "again")):
            return found
    lattice = known_lattice(observation)
    found = None if lattice is None else _followed(observation, lattice)
    _LAST[:] = [(observation, found)]
    return found


def known_lattice(observation: Observation) -> Lattice | None:
    """Return the true lattice, else the one that was given, reduced; None where there is neither."""
    truth = observation.truth.lattice if observation.truth is not None else None
    lattice = truth or observation.lattice_given
    return None if lattice is None else lattice.reduced()


def obstacle(found: Tracks | None) -> str:
    """Return why nothing can be measured; empty where something can."""
    if found is None:
        return "not applicable: no lattice is known, or its mean tile is flat"
    for name, one in (("sample", found.sample), ("output", found.output)):
        if len(one.numbers) < LEAST_POINTS:
            return f"not measured: the {name} holds {len(one.numbers)} whole tiles, at least {LEAST_POINTS} are needed"
        if one.tracked(LEAST_CORRELATION) < LEAST_TRACKED:
            share = one.tracked(LEAST_CORRELATION)
            return f"not measured: the tile was found again at only {share:.0%} of the places in the {name}"
    return ""


def _followed(observation: Observation, lattice: Lattice) -> Tracks | None:
    truth = observation.truth
    ideal = truth.ideal if truth is not None else None
    first = MeanTile.of(observation.sample if ideal is None else ideal, lattice)
    if not first.power > FLAT:
        return None
    sample = track(observation.sample, lattice, first)
    tile = sample.tile.unweighted() if ideal is None else MeanTile.of(ideal, lattice)
    output = track(observation.output, lattice, tile)
    return Tracks(sample, output, tile, observation.again)
