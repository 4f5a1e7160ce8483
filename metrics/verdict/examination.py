"""The known lattice, the reference and the verdict, which the metrics of one observation share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nrbench.plugins.forms import Observation

from ..ncc.periodic import WINDOW_TILES, window_shape
from .bent import BentReference, bent_reference_from_model, compute_bent_verdict
from .reference import LATTICE_UNCERTAINTY, KnownLattice, NoFreshDraw, Reference, find_known_lattice, make_reference
from .verdict import Verdict, compute_verdict

_BENT_KINDS = ("II", "III")
"""Types of textures whose geometry varies."""


@dataclass(frozen=True)
class Examination:
    """An output and its reference, each part computed when a metric first needs it.

    Parameters
    ----------
    observation
        Sample, output, truth and fresh draws; no other field of an observation is used.
    """

    observation: Observation

    @cached_property
    def known_lattice(self) -> KnownLattice:
        """The lattice of the sample."""
        return find_known_lattice(self.observation)

    @cached_property
    def reference(self) -> Reference | str:
        """The reference of the output, or the reason why there is none."""
        reason = self.known_lattice.reason or self._find_small_picture()
        if reason:
            return reason
        try:
            return self._make_reference()
        except NoFreshDraw as without:
            return str(without)

    @cached_property
    def verdict(self) -> Verdict | str:
        """The verdict on the output, or the reason why there is none."""
        if isinstance(self.reference, str):
            return self.reference
        output, reference = self.observation.output, self.reference
        try:
            verdict = (
                compute_bent_verdict(output, reference)
                if isinstance(reference, BentReference)
                else compute_verdict(output, reference)
            )
        except NoFreshDraw as without:  # one as large as the output is drawn here
            return str(without)
        return verdict.obstacle or verdict

    def _make_reference(self) -> Reference:
        truth, again, lattice = self.observation.truth, self.observation.again, self.known_lattice.lattice
        if self.known_lattice.origin == "model" and truth is not None and truth.kind in _BENT_KINDS:
            assert lattice is not None and again is not None
            return bent_reference_from_model(truth, lattice, again)
        return make_reference(self.observation, self.known_lattice)

    def _find_small_picture(self) -> str:
        """Return the reason if the output or the sample is smaller than a window; empty if none is.

        This is checked first, because the reference of a large lattice is expensive.
        """
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
