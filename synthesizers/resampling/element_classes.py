"""Colors that form classes, such as a print's inks: which class each element is in, and new random classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ..lattice_places.equal_places import CellTorus
from .element_map import WHOLE, InstanceColors, Lag, Numbers, Pair, overlap

_MOST_CLASSES = 8
"""Largest number of classes of one element."""
_FEWEST = 6
"""Fewer colors are not taken for classes."""
_SPREAD = 0.01
"""Standard deviation of the colors of one class that is not seen, in values from 0 to 1."""
_GAIN = (0.5, 8.0)
"""n colors are classes if their log-likelihood per color exceeds that of a Gaussian by at least a + b / n."""
_AROUND: tuple[Lag, ...] = ((0, 0), (0, 1), (1, 0), (1, 1), (1, -1))
"""Lags in cells at which classes may go together."""
_BY_CHANCE = 4.0
"""Twice the log-likelihood by which pairs of classes have to exceed chance, after BIC."""
_UNDECIDED = 0.1
"""Share of the entropy of an element's class that a part of the same object leaves."""
_EXPECTED = 1.0
"""A pair of classes that chance would show so often, but that is never seen, is kept away."""
_SWEEPS = 30
"""Times that all classes are drawn again, given their neighbors'."""
_RATE = 0.3
"""Part of the logarithm of its ratio to the sample's by which a pair's share is corrected in a sweep."""
_MOST = 12.0
"""Largest potential of a pair."""
_BALANCES = 3
"""Steps in which the shares of classes are made the sample's, before they are drawn."""
_UNSEEN = 1e-3
"""Share of a pair of classes that the sample does not show."""


def group_colors(color: InstanceColors) -> Numbers | None:
    """Return the class of each instance, ``(I, J)``, -1 where it is not known; None if the colors form no classes.

    The colors are grouped by Ward's method. Groups of 2 to 8 are compared with one Gaussian by their classification
    likelihood, with the penalty of BIC: each group is an isotropic Gaussian, all as wide, and pays for its share. No
    number of groups explains a smooth distribution better than a Gaussian by this measure, as each halving of the width
    costs as much as it gains.
    """
    colors = color.values[color.known]
    count, channels = colors.shape
    if count < _FEWEST:
        return None
    power = np.maximum(np.linalg.eigvalsh(np.atleast_2d(np.cov(colors.T, bias=True))), 0) + _SPREAD**2
    gaussian = -count / 2 * (np.log(power).sum() + channels) - channels * (channels + 3) / 4 * np.log(count)
    tree = scipy.cluster.hierarchy.linkage(colors, "ward")
    best, found = -np.inf, None
    for groups in range(2, min(_MOST_CLASSES, count // 2) + 1):
        label = scipy.cluster.hierarchy.fcluster(tree, groups, "maxclust") - 1
        size = np.bincount(label, minlength=groups)
        if not size.all():
            continue
        means = np.stack([np.bincount(label, channel) for channel in colors.T], -1) / size[:, np.newaxis]
        within = float(((colors - means[label]) ** 2).sum())
        power = within / (channels * (count - groups)) + _SPREAD**2
        likelihood = -count * channels / 2 * np.log(power) - within / (2 * power) + (size * np.log(size / count)).sum()
        likelihood -= groups * (channels + 1) / 2 * np.log(count)
        if likelihood > best:
            best, found = likelihood, label
    if found is None or best - gaussian < _GAIN[0] * count + _GAIN[1]:
        return None
    # Instances that the sample shows in part may seem a class of their own, of which none can be copied.
    whole = np.unique(found[color.shown[color.known] >= WHOLE])
    if len(whole) < 2:
        return None
    means = np.stack([colors[found == k].mean(0) for k in whole])
    nearest = scipy.spatial.distance.cdist(colors, means).argmin(-1)
    classes = np.full(color.known.shape, -1)
    classes[color.known] = np.where(np.isin(found, whole), np.searchsorted(whole, found), nearest)
    return classes


class ClassLink(NamedTuple):
    """The classes of elements a and, ``lag`` cells on, b go together: their joint shares ``(Ka, Kb)``."""

    a: int
    b: int
    lag: Lag
    shares: NDArray[np.float64]


def link_classes(classes: Sequence[Numbers]) -> list[ClassLink]:
    """Return the pairs of neighbors whose classes depend on each other.

    The pairs of classes at a lag are compared with independent ones by their likelihood ratio, less the penalty of BIC.
    Either each pair has a probability of its own, or pairs of one element are only more or less often equal.
    """
    links = []
    for a, b in np.ndindex(len(classes), len(classes)):
        for lag in _AROUND:
            if lag == (0, 0) and a >= b:
                continue
            one, other = overlap(classes[a], classes[b], lag)
            known = (one >= 0) & (other >= 0)
            table = np.zeros((classes[a].max() + 1, classes[b].max() + 1))
            np.add.at(table, (one[known], other[known]), 1)
            shares = _test_pairs(table, a == b)
            if shares is not None:
                links.append(ClassLink(a, b, lag, shares))
    return links


def find_object(classes: Mapping[int, Numbers]) -> Pair | None:
    """Return two elements and a lag at which their classes decide each other: they are parts of one object."""
    names = list(classes)
    for a, b, lag, shares in link_classes(list(classes.values())):
        alone = [scipy.special.entr(shares.sum(axis)).sum() for axis in (0, 1)]
        both = scipy.special.entr(shares).sum()
        if a != b and both - min(alone) <= _UNDECIDED * max(alone):
            return names[a], names[b], lag
    return None


def _test_pairs(table: NDArray[np.float64], same: bool) -> NDArray[np.float64] | None:
    """Return the shares of pairs of classes by the best of two models, or None if independent classes are as good."""
    count = table.sum()
    if count < 2:
        return None
    shares = table / count
    apart = shares.sum(1, keepdims=True) * shares.sum(0)
    excess = 2 * count * scipy.special.rel_entr(shares, apart).sum() - (apart.size - sum(apart.shape) + 1) * np.log(
        count
    )
    shares = np.where((table == 0) & (count * apart < _EXPECTED), apart / (count + 1), shares)
    if same:
        equal = np.eye(len(apart), dtype=bool)
        ratios = [shares[part].sum() / max(float(apart[part].sum()), 1e-12) for part in (equal, ~equal)]
        alike = apart * np.where(equal, *ratios)
        less = 2 * count * scipy.special.rel_entr(alike, apart).sum() - np.log(count)
        if less > excess - _BY_CHANCE:
            excess, shares = less, alike
    return np.asarray(shares) if excess > _BY_CHANCE else None


def draw_classes(classes: Sequence[Numbers], torus: CellTorus, rng: np.random.Generator) -> Numbers:
    """Return new classes on a torus, ``(I, J, E)``: a random field with the sample's shares of classes and of pairs.

    It is a Markov random field. Classes are drawn in an order in which each is given the neighbors before it, then
    again given all neighbors, in parts that keep the shares of classes. Before each sweep, the potentials of pairs that
    are too rare are raised, and of others lowered.

    Parameters
    ----------
    classes
        The classes of each element in the sample, ``(I, J)``, -1 where unknown.
    torus
        The cells of the output.
    rng
        Draws the classes.
    """
    shares = [np.bincount(own[own >= 0]) / (own >= 0).sum() for own in classes]
    field = _ClassField(torus, link_classes(classes), shares)
    cells = np.stack(np.meshgrid(np.arange(torus.columns), np.arange(torus.rows), indexing="ij"), -1).reshape(-1, 2)
    order = cells @ (2, 1)  # no two neighbors are equal in it
    for turn in range(int(order.max()) + 1 if field.links else 1):
        for element in range(len(classes)):
            field.redraw(element, cells[order == turn] if field.links else cells, rng)
    for _ in range(_SWEEPS if field.links else 0):
        field.correct()
        for part, element in np.ndindex(5, len(classes)):
            field.redraw(element, cells[order % 5 == part], rng, balanced=True)
    return field.classes


class _ClassField:
    """The classes that are drawn, -1 where they are not drawn yet, and the potentials of their pairs."""

    def __init__(self, torus: CellTorus, links: list[ClassLink], shares: list[NDArray[np.float64]]) -> None:
        self.torus, self.links, self.shares = torus, links, shares
        self.classes = np.full((torus.columns, torus.rows, len(shares)), -1)
        pairs = [np.log((s + _UNSEEN) / (s.sum(1, keepdims=True) * s.sum(0) + _UNSEEN)) for *_, s in links]
        # Links of one element repeat each other, but what the sample does not show stays away.
        repeats = max(1, len(links) // max(len(shares), 1))
        self.pairs = [np.where(s > 0, pair / repeats, pair) for pair, (*_, s) in zip(pairs, links, strict=True)]

    def redraw(self, element: int, cells: Numbers, rng: np.random.Generator, balanced: bool = False) -> None:
        """Draw the classes of an element in cells ``(n, 2)``, given its neighbors; ``balanced``: with its shares."""
        likelihood = np.tile(np.log(self.shares[element]), (len(cells), 1))
        for (a, b, lag, _), pairs in zip(self.links, self.pairs, strict=True):
            for own, other, table, sign in ((a, b, pairs, 1), (b, a, pairs.T, -1)):
                if own == element:
                    neighbors = self._read(other, cells + sign * np.array(lag))
                    likelihood += np.where(neighbors[:, np.newaxis] >= 0, table.T[neighbors], 0)
        for _ in range(_BALANCES if balanced else 0):
            share = scipy.special.softmax(likelihood, -1).mean(0)
            likelihood += np.log((self.shares[element] + _UNSEEN) / (share + _UNSEEN))
        self.classes[cells[:, 0], cells[:, 1], element] = (likelihood + rng.gumbel(size=likelihood.shape)).argmax(-1)

    def correct(self) -> None:
        """Raise the potentials of pairs that are rarer than they should be, lower the others."""
        cells = np.moveaxis(np.indices(self.classes.shape[:2]), 0, -1)
        for n, (a, b, lag, target) in enumerate(self.links):
            now = np.zeros(target.shape)
            np.add.at(
                now, (self.classes[..., a], self._read(b, cells + np.array(lag))), 1 / len(cells) / cells.shape[1]
            )
            change = _RATE * np.log((target + _UNSEEN) / (now + _UNSEEN))
            self.pairs[n] = np.clip(self.pairs[n] + change, -_MOST, _MOST)

    def _read(self, element: int, cells: Numbers) -> Numbers:
        """Return the classes of an element in cells, ``(..., 2)``."""
        at = self.torus.wrap(cells)
        return np.asarray(self.classes[at[..., 0], at[..., 1], element])
