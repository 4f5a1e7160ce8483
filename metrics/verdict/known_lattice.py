"""The lattice that an output is judged by, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from nrbench.detectors.dominance import Dominance
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import NoLatticeFound, Observation

Origin = Literal["model", "given", "dominance"]
NO_LATTICE = "not applicable: no lattice in the truth"
_SNAP = 9


@dataclass(frozen=True)
class KnownLattice:
    """The lattice of the sample.

    Parameters
    ----------
    lattice
        In the one basis and with the one origin that depend on the lattice alone; None where there is none.
    origin
        ``"model"``: the texture's model says so; ``"given"``: it was handed over for a photograph, and is uncertain;
        ``"dominance"``: nobody gave one, the detector ``dominance``, which is no contestant, found it in the sample.
    reason
        Why there is none.
    """

    lattice: Lattice | None
    origin: Origin
    reason: str = ""


def known_lattice(observation: Observation) -> KnownLattice:
    """Return the lattice of the sample: the truth's, or, where nothing is known, what ``dominance`` finds in it.

    A model or a truth of kind ``"stochastic"`` that has no lattice is believed. What the method was handed, or says it
    used, is not asked: the same sample is judged by the same lattice, whatever the method.
    """
    truth, again = observation.truth, observation.again
    if truth is not None and truth.lattice is not None:
        modelled = again is not None and truth.ideal is not None
        return KnownLattice(settled(truth.lattice), "model" if modelled else "given")
    if again is not None or (truth is not None and truth.kind == "stochastic"):
        return KnownLattice(None, "model", NO_LATTICE)
    return _detected(observation.sample)


def settled(lattice: Lattice) -> Lattice:
    """Return the lattice in its canonical basis, its origin the point nearest to (0, 0)."""
    one = lattice.canonical()
    x, y = (round(float(value), _SNAP) for value in one.wrap(one.origin))
    return Lattice(one.t1, one.t2, (x, y))


_LAST: list[tuple[Image, KnownLattice]] = []


def _detected(sample: Image) -> KnownLattice:
    """Ask the detector; the last answer is kept for the metrics that follow."""
    for seen, answer in _LAST:
        if seen is sample:
            return answer
    try:
        found = KnownLattice(settled(Dominance().detect(sample).lattice), "dominance")
    except NoLatticeFound as none:
        reason = f"not applicable: no lattice is given, and the detector dominance finds none in the sample: {none}"
        found = KnownLattice(None, "dominance", reason)
    _LAST[:] = [(sample, found)]
    return found
