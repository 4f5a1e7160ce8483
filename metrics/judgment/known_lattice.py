"""The lattice by which all outputs of a sample are judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Literal

import numpy as np

from nrbench.detectors.dominance import Dominance
from nrbench.imaging.masks import fill_periodically
from nrbench.lattice.geometry import Lattice, Points, reduce_basis
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import NoLatticeFound, Observation, Shape

from ..perception import limits
from ..perception.visible import Lab, SeenSample, perceive_sample
from ..registration.coherence import SampleMatches
from ..registration.lattice_net import LatticeNet, Values, fold_cells, sample_planes, split_cells

Origin = Literal["model", "given", "dominance"]
NO_LATTICE = "not applicable: no lattice in the truth"
_DIGITS = 9
"""Decimals to which the origin of a lattice, px, is rounded."""
_FRACTIONS = ((2, (0, 1)), (2, (1, 0)), (2, (1, 1)), (3, (0, 1)), (3, (1, 0)), (3, (1, 1)), (3, (1, 2)))
"""The parts of a cell that may be lattice vectors: k1 t1 / parts + k2 t2 / parts."""
_MOST_SPLITS = 2


@dataclass(frozen=True)
class KnownLattice:
    """The lattice of the sample that all metrics use.

    Parameters
    ----------
    lattice
        Reduced, with the point nearest to (0, 0) as origin; None if the sample has no lattice.
    origin
        Source of the lattice. ``"model"``: the model of the texture. ``"given"``: the user, for a photograph; the
        lattice is then uncertain. ``"dominance"``: the detector of that name, applied to the sample.
    reason
        Reason why there is no lattice.
    """

    lattice: Lattice | None
    origin: Origin
    reason: str = ""


def find_known_lattice(observation: Observation) -> KnownLattice:
    """Return the lattice of the sample: that of the truth, else what the detector ``dominance`` finds in the sample.

    If a model, or a truth of kind ``"stochastic"``, has no lattice, no detector is used. The lattice that the method
    received or used does not count: outputs of different methods are compared by one lattice of their sample. A given
    lattice may be a supercell; it is then replaced by the smallest lattice by which the sample repeats.

    The detector is ``dominance`` because no synthesizer uses it by default (``rsgf`` and ``tile-set`` use
    ``consensus``). A score must not use the detector of a method that it ranks.
    """
    truth, again = observation.truth, observation.again
    if truth is not None and truth.lattice is not None:
        if again is not None and truth.ideal is not None:
            return KnownLattice(canonical_lattice(truth.lattice), "model")
        sample = perceive_masked(observation, truth.lattice)
        return KnownLattice(split_supercell(sample, canonical_lattice(truth.lattice)), "given")
    if again is not None or (truth is not None and truth.kind == "stochastic"):
        return KnownLattice(None, "model", NO_LATTICE)
    try:
        return KnownLattice(
            canonical_lattice(Dominance().detect(observation.sample, observation.known).lattice), "dominance"
        )
    except NoLatticeFound as none:
        reason = f"not applicable: no lattice is given, and the detector dominance finds none in the sample: {none}"
        return KnownLattice(None, "dominance", reason)


def perceive_masked(observation: Observation, lattice: Lattice | None) -> SeenSample:
    """Return what is seen of a sample; pixels that do not count show those a lattice vector away, and are marked."""
    sample, known = observation.sample, observation.known
    if known is not None and lattice is not None:
        sample = fill_periodically(sample, known, lattice)
    return perceive_sample(sample, known)


@lru_cache(maxsize=8)
def declared_drift(declared: Lattice | None, true: Lattice | None, shape: Shape) -> Points:
    """Return the drift of a declared lattice from the true one, ``(2, 2)``; 0 if there is none or it does not count.

    Neither basis matters. The shape is that of the output.
    """
    none = np.zeros((2, 2))
    if not (declared and true) or lattice_error(declared, true, shape).relation not in ("exact", "supercell"):
        return none
    basis, other = declared.canonical().matrix, true.canonical().matrix
    drift = np.linalg.solve(other, np.linalg.solve(np.rint(basis @ np.linalg.inv(other)), basis)) - np.eye(2)
    return np.asarray(drift) if np.linalg.norm(drift, 2) <= limits.MOST_DRIFT else none


def canonical_lattice(lattice: Lattice) -> Lattice:
    """Return the lattice in its canonical basis, with the point nearest to (0, 0) as origin."""
    canonical = lattice.canonical()
    x, y = (round(float(value), _DIGITS) for value in canonical.wrap(canonical.origin))
    return Lattice(canonical.t1, canonical.t2, (x, y))


@lru_cache(maxsize=2)
def split_supercell(sample: SeenSample, lattice: Lattice) -> Lattice:
    """Return the smallest lattice, with up to nine points in the given cell, by which the mean cell repeats.

    A half or a third of a cell is a lattice vector if the mean cell m, folded again from there as m', is the same. The
    departures r = m' - m are divided by the variances of both means and (JND / 2)^2. At 99 % of the places r^2 is then
    at most ``SAME_CELL``, and in all at most ``SAME_SHARE`` of the variance of m and m' over the cell. The mean cell of
    a wall whose courses wander is smeared along them, and seems to repeat by thirds. So thirds must be matched, too
    (:meth:`~.registration.coherence.SampleMatches.prefers`).
    """
    lab = sample.lab[..., :3]
    for _ in range(_MOST_SPLITS):
        net = LatticeNet(sample.shape, reduce_basis(lattice.matrix), np.array(lattice.origin), sample.known)
        mean, error = _fold(lab, net)
        steps = [np.array(k) / parts @ net.vectors for parts, k in _FRACTIONS]
        ratios = [_compare_cells(mean, error, *_fold(lab, replace(net, origin=net.origin + step))) for step in steps]
        best = int(np.argmin(ratios))
        parts = _FRACTIONS[best][0]
        basis = _add_vector(net.vectors, steps[best], parts)
        if ratios[best] > 1 or (parts == 3 and SampleMatches(lab, net).prefers(basis)):
            break
        lattice = canonical_lattice(Lattice.from_basis(basis, lattice.origin))
    return lattice


def _compare_cells(mean: Values, error: Values, other: Values, other_error: Values) -> float:
    """Return the departure of two mean cells over what is allowed."""
    weight = 1 / (error + other_error + (limits.JND / 2) ** 2)
    own = [(m - (m * weight).sum((0, 1)) / weight.sum((0, 1))) ** 2 * weight for m in (mean, other)]
    moved = (other - mean) ** 2 * weight
    share = moved.sum() / max(float(own[0].sum() + own[1].sum()), 1e-9)
    return max(float(np.quantile(moved, 0.99)) / limits.SAME_CELL, float(share) / limits.SAME_SHARE)


def _fold(lab: Lab, net: LatticeNet) -> tuple[Values, Values]:
    """Return the mean cell and its variance, by lines of cells in the direction in which they scatter most.

    Cells of one thread go together, so only lines of them are independent.
    """
    plane = sample_planes(lab, net.points)
    mean = fold_cells(plane, net.inside, net.samples)
    known = split_cells(net.inside, net.samples)[..., np.newaxis]
    rest = np.where(known, split_cells(plane, net.samples) - mean, 0)
    total, error = np.maximum(known.sum((0, 1)), 1), np.zeros_like(mean)
    i, j = np.indices((int(net.cells[0]), int(net.cells[1])))
    for line in (i, j, i + j, i - j + net.cells[1]):
        number = np.unique(line[known.any((2, 3, 4))], return_inverse=True)[1]
        count = int(number.max()) + 1
        sums = np.zeros((count, *mean.shape))
        np.add.at(sums, number, rest[known.any((2, 3, 4))])
        error = np.maximum(error, (sums**2).sum(0) / total**2 * count / max(count - 1, 1))
    return mean, error


def _add_vector(vectors: Points, extra: Points, parts: int) -> Points:
    """Return a basis of the lattice that two vectors and a third one generate; ``parts`` times the third is in it."""
    area = abs(float(np.linalg.det(vectors))) / parts
    shifts = [extra + np.array(k) @ vectors for k in product((-1, 0, 1), repeat=2)]
    combined = [np.array([a, shift]) for a in vectors for shift in shifts]
    fits = [basis for basis in combined if abs(abs(float(np.linalg.det(basis))) - area) < 1e-6 * area]
    return reduce_basis(fits[0]) if fits else vectors
