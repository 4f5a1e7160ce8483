"""The lattice by which all outputs of a sample are judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import map_coordinates

from nrbench.detectors.dominance import Dominance
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points, reduce_basis
from nrbench.plugins.forms import NoLatticeFound, Observation

from ..perception.visible import perceive
from ..registration.lattice_net import LatticeNet, Values, fold_cells, sample_planes

Origin = Literal["model", "given", "dominance"]
NO_LATTICE = "not applicable: no lattice in the truth"
_DIGITS = 9
"""Decimals to which the origin of a lattice, px, is rounded."""
_MOST_TILES = 4
"""Number of tiles in a supercell that is recognized."""


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
        return KnownLattice(split_supercell(observation.sample, canonical_lattice(truth.lattice)), "given")
    if again is not None or (truth is not None and truth.kind == "stochastic"):
        return KnownLattice(None, "model", NO_LATTICE)
    try:
        return KnownLattice(canonical_lattice(Dominance().detect(observation.sample).lattice), "dominance")
    except NoLatticeFound as none:
        reason = f"not applicable: no lattice is given, and the detector dominance finds none in the sample: {none}"
        return KnownLattice(None, "dominance", reason)


def canonical_lattice(lattice: Lattice) -> Lattice:
    """Return the lattice in its canonical basis, with the point nearest to (0, 0) as origin."""
    canonical = lattice.canonical()
    x, y = (round(float(value), _DIGITS) for value in canonical.wrap(canonical.origin))
    return Lattice(canonical.t1, canonical.t2, (x, y))


def split_supercell(sample: Image, lattice: Lattice) -> Lattice:
    """Return the smallest lattice, with up to four points in the given cell, by which the mean cell repeats.

    A shift by a fraction of the cell is a lattice vector if the mean cell changes by little: by no more than a quarter
    of its own variance, nor by more than a tenth of it and four times the variance of a mean of n cells.
    """
    net = LatticeNet((sample.shape[0], sample.shape[1]), reduce_basis(lattice.matrix), np.array(lattice.origin))
    plane = sample_planes(perceive(sample)[..., :3], net.points)
    mean = fold_cells(plane, net.inside, net.samples)
    cells = max(float(net.inside.sum()) / float(net.samples.prod()), 1.0)
    rest = np.asarray((plane - net.tile(mean)) ** 2, np.float32)
    own = float(mean.var((0, 1)).mean())
    chance = min(4 * float(fold_cells(rest, net.inside, net.samples).mean()) / cells + 0.1 * own, 0.25 * own)
    for parts in range(_MOST_TILES, 1, -1):
        for k in np.ndindex(parts, parts):
            shift = np.array(k) / parts
            if np.gcd.reduce([*k, parts]) != 1 or ((_shift_cell(mean, shift) - mean) ** 2).mean() > chance:
                continue
            basis = _add_vector(net.vectors, shift @ net.vectors, parts)
            return canonical_lattice(Lattice.from_basis(basis, lattice.origin))
    return lattice


def _shift_cell(cell: Values, shift: Points) -> Values:
    rows, columns = np.indices(cell.shape[:2])
    at = [rows + shift[0] * cell.shape[0], columns + shift[1] * cell.shape[1]]
    return np.stack([map_coordinates(plane, at, order=1, mode="grid-wrap") for plane in np.moveaxis(cell, -1, 0)], -1)


def _add_vector(vectors: Points, extra: Points, parts: int) -> Points:
    """Return a basis of the lattice that two vectors and a third one generate; ``parts`` times the third is in it."""
    area = abs(float(np.linalg.det(vectors))) / parts
    combined = [
        np.array([a, extra + i * vectors[0] + j * vectors[1]]) for a in vectors for i in (-1, 0, 1) for j in (-1, 0, 1)
    ]
    fits = [basis for basis in combined if abs(abs(float(np.linalg.det(basis))) - area) < 1e-6 * area]
    return reduce_basis(fits[0]) if fits else vectors
