"""How far a sample is in phase with itself, and by that, whether an output is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice

from ..perception import limits
from ..perception.visible import Lab, perceive
from ..registration.coherence import MatchedPicture, SampleMatches
from ..registration.lattice_net import LatticeNet
from ..registration.lattice_nodes import WIDEST, Strips, choose_windows, explain_share
from .texture_reference import STRIPS, CannotTell


@dataclass(frozen=True, eq=False)
class CoherenceReference:
    """A sample whose places are matched to each other.

    Parameters
    ----------
    matches
        The points of the sample.
    picture
        The sample itself, followed by matches with its other parts.
    """

    matches: SampleMatches
    picture: MatchedPicture

    @cached_property
    def slip_limit(self) -> float:
        """Difference in s between two sides of a line beyond which they have slipped."""
        return max(limits.SLIP, limits.OF_SLIP * limits.LOOSE * float(self.picture.slip.max(initial=0)))

    @cached_property
    def most_misplaced(self) -> float:
        """Share out of place that chance explains: by the strips of the sample, and by the number of its cells.

        If k of n cells are out of place, the next one is with a probability of (k + 1) / (n + 2), by Laplace's rule of
        succession.
        """
        bad, net = self.picture.misplacement(self.slip_limit), self.picture.net
        shares = Strips.across(net.shape, STRIPS).share_out(bad, self.picture)
        cells = net.shape[0] * net.shape[1] / abs(float(np.linalg.det(net.vectors)))
        return max(explain_share(shares, by_sample=True), (cells * float(shares.mean()) + 1) / (cells + 2))

    def follow(self, lab: Lab) -> MatchedPicture:
        """Follow the lattice through an output; raises :class:`CannotTell` if it is too small."""
        followed = replace(self.matches.match(lab), limit=self.picture.limit, size=self.picture.size)
        if (followed.net.cells < followed.size).any() or not followed.valid.any():
            raise CannotTell("undecided: no window of whole cells lies inside the output")
        return followed


def match_sample(sample: Image, lattice: Lattice) -> CoherenceReference:
    """Match the places of a sample to each other.

    Raises
    ------
    CannotTell
        If the sample shows fewer than four cells, or its places do not match at one phase of the lattice.
    """
    return _match(np.ascontiguousarray(sample, np.float32).tobytes(), sample.shape, lattice)


@lru_cache(maxsize=2)
def _match(pixels: bytes, shape: tuple[int, ...], lattice: Lattice) -> CoherenceReference:
    """Match a sample; cached, because many outputs have one sample."""
    net = LatticeNet((shape[0], shape[1]), lattice.matrix, np.array(lattice.origin))
    if shape[0] * shape[1] < limits.FEWEST_CELLS * abs(np.linalg.det(net.vectors)):
        raise CannotTell("undecided: the sample shows fewer than four cells")
    matches = SampleMatches(perceive(np.frombuffer(pixels, np.float32).reshape(shape)), net)
    if matches.right.mean() < matches.chance + limits.COHERENT:
        raise CannotTell("undecided: the lattice cannot be followed through the sample")

    def follow(size: int) -> Sequence[MatchedPicture]:
        return [replace(matches.own, size=size)]

    pictures = choose_windows(follow, range(1, min(WIDEST, int(net.cells.min())) + 1), by_sample=True)
    if not pictures:
        raise CannotTell("undecided: no window of whole cells lies inside the sample")
    return CoherenceReference(matches, pictures[0])
