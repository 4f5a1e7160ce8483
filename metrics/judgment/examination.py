"""The examination of one output, which the metrics of the four perils share."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Observation

from ..perception import limits
from ..perception.visible import Lab, SeenSample, perceive
from ..registration.coherence import MatchedPicture, SampleMatches, match_sample
from ..registration.followed import FollowedPicture
from .known_lattice import KnownLattice, declared_drift, find_known_lattice, perceive_masked
from .texture_reference import CannotTell, TextureReference, reference_from_draws, reference_from_sample

Followed = TypeVar("Followed", FollowedPicture, MatchedPicture | None)


@dataclass(frozen=True)
class Examination:
    """An output beside its reference, each part computed when a metric first needs it.

    Parameters
    ----------
    observation
        Sample, output, truth, fresh draws and the declared lattice; no other field of an observation is used.
    """

    observation: Observation

    @cached_property
    def known_lattice(self) -> KnownLattice:
        """The lattice of the sample."""
        return find_known_lattice(self.observation)

    @cached_property
    def sample(self) -> SeenSample:
        """What is seen of the sample."""
        return perceive_masked(self.observation, self.known_lattice.lattice)

    @cached_property
    def lab(self) -> Lab:
        """What is seen of the output."""
        return perceive(self.observation.output)

    @cached_property
    def reference(self) -> TextureReference:
        """The reference of the texture; raises :class:`CannotTell` if there is none."""
        known, seen = self.known_lattice, self.observation
        if known.lattice is None:
            raise CannotTell(known.reason)
        sample = (seen.sample.shape[0], seen.sample.shape[1])
        if known.origin == "model" and seen.again is not None:
            vectors, output = (known.lattice.t1, known.lattice.t2), (seen.output.shape[0], seen.output.shape[1])
            return reference_from_draws(seen.again, vectors, output, sample)
        return reference_from_sample(self.sample, known.lattice)

    @cached_property
    def declared(self) -> Points:
        """``(2, 2)``: drift of the lattice that the method declares; see :func:`~.known_lattice.declared_drift`."""
        seen, (height, width) = self.observation, self.lab.shape[:2]
        return declared_drift(seen.lattice_used, self.known_lattice.lattice, (height, width))

    def follow(self, follow: Callable[[Lab, Points | float], Followed]) -> Followed:
        """Follow the declared lattice if the output lies nearer to it than to the true one, else the true one.

        Beyond about 4 % a drift from the lattice that is followed is taken for slips. The declared lattice is followed
        if its vectors depart from the true ones by more than 2 % of s. The output lies nearer to it if most windows are
        in place on it and drift from it by less than half of the declared drift.
        """
        drift, true = self.declared, self.known_lattice.lattice
        if true is not None and np.linalg.norm(true.matrix @ drift, axis=1).max() > limits.DRIFT * true.s:
            with suppress(CannotTell):
                nodes = follow(self.lab, drift)
                sure = nodes is not None and 2 * nodes.in_place.sum() > nodes.valid.sum()
                if nodes and sure and 2 * np.linalg.norm(nodes.drift, 2) < np.linalg.norm(drift, 2):
                    return nodes
        return follow(self.lab, 0.0)

    @cached_property
    def traced(self) -> FollowedPicture:
        """The output followed by the lattice, whether or not its sample can be; few cells are in place if it cannot."""
        return self.follow(self.reference.follow)

    @cached_property
    def followed(self) -> FollowedPicture:
        """The output followed by the lattice; raises :class:`CannotTell` if it or a sample is too small or too bent."""
        own = self.reference.most_misplaced
        if self.reference.from_sample and own > limits.MOST_OWN:
            raise CannotTell(f"undecided: up to {own:.0%} of the reference itself is out of place by chance")
        return self.traced

    @cached_property
    def matches(self) -> SampleMatches | None:
        """The sample, to which the output is matched if there is no model."""
        known = self.known_lattice
        if known.lattice is None or known.origin == "model":
            return None
        return match_sample(self.sample, known.lattice)

    @cached_property
    def misplacement(self) -> NDArray[np.float64]:
        """How far each node is out of place, ``(R, C)``, as the reference finds it."""
        return self.reference.misplacement(self.followed)

    @cached_property
    def misplaced(self) -> float:
        """Share of the output that is out of place beyond what the references show, in [0, 1]."""
        usual = self.reference.most_misplaced
        return max(0.0, float(self.misplacement[self.followed.valid].mean()) - usual) / (1 - usual)


def examine(observation: Observation) -> Examination:
    """Return the examination that all metrics of an observation share.

    Examples
    --------
    A metric that needs the followed output::

        try:
            followed = examine(observation).followed
        except CannotTell as reason:
            return Score.missing(self.columns, str(reason))
    """
    return observation.shared(_start)


def _start(seen: Observation) -> Examination:
    used, again = seen.lattice_used, seen.again
    return Examination(Observation(seen.sample, seen.output, seen.truth, None, used, again=again, known=seen.known))
