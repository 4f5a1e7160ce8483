"""What the metrics of one observation share: the known lattice, the reference and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nrbench.plugins.forms import Observation

from ..ncc.periodic import WINDOW_TILES, window_shape
from .reference import LATTICE_UNCERTAINTY, KnownLattice, Reference, find_known_lattice, make_reference
from .verdict import Verdict, compare


@dataclass(frozen=True)
class Examination:
    """An output and its reference, each part computed when a metric first needs it.

    Parameters
    ----------
    observation
        Sample, output, truth and fresh draws; nothing else of an observation counts.
    """

    observation: Observation

    @cached_property
    def known_lattice(self) -> KnownLattice:
        """The lattice of the sample."""
        return find_known_lattice(self.observation)

    @cached_property
    def reference(self) -> Reference | str:
        """What the output is compared with, or the reason why there is nothing."""
        reason = self.known_lattice.reason or self._find_small_picture()
        return reason or make_reference(self.observation, self.known_lattice)

    @cached_property
    def verdict(self) -> Verdict | str:
        """The output beside its reference, or the reason why they cannot be compared."""
        if isinstance(self.reference, str):
            return self.reference
        verdict = compare(self.observation.output, self.reference)
        return verdict.obstacle or verdict

    def _find_small_picture(self) -> str:
        """Say which picture is smaller than a window. Checked first: a reference of a large lattice costs much."""
        lattice = self.known_lattice.lattice
        assert lattice is not None
        window = np.array(window_shape(lattice.canonical(), WINDOW_TILES)) * (1 - LATTICE_UNCERTAINTY)
        pictures = {"output": self.observation.output}
        if self.observation.again is None:
            pictures["sample"] = self.observation.sample
        small = [name for name, picture in pictures.items() if (picture.shape[:2] < window).any()]
        return f"undecided: the {small[0]} is smaller than a window of 2 tiles" if small else ""


def examine(observation: Observation) -> Examination:
    """Return the examination that all metrics of an observation share.

    Examples
    --------
    A metric that needs the verdict::

        verdict = examine(observation).verdict
        if isinstance(verdict, str):
            return Score.missing(self.columns, verdict)
    """
    return observation.shared(_start)


def _start(observation: Observation) -> Examination:
    return Examination(Observation(observation.sample, observation.output, observation.truth, again=observation.again))
