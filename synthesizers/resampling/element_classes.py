"""Colors that form classes, such as a print's inks: which class each element is in, and new random classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from ..lattice_places.equal_places import CellTorus
from .element_map import WHOLE, InstanceColors, Lag, Numbers, Pair, overlap

_MOST_CLASSES = 8
"""Largest number of classes of one element."""
_MOST = 1000
"""Largest number of colors that are grouped; others take the nearest group."""
_FEWEST = 6
"""Fewer colors are not taken for classes."""
_SPREAD = 0.01
"""Standard deviation of the colors of one class that is not seen, in values from 0 to 1."""
_GAIN = (0.5, 8.0)
"""n colors are classes if their log-likelihood per color exceeds that of a Gaussian by at least a + b / n."""
_AROUND: tuple[Lag, ...] = ((0, 0), (0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1))
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
_UNSEEN = 1e-3
"""Share of a pair of classes that the sample does not show."""


def group_colors(color: InstanceColors) -> Numbers | None:
    """Return the class of each instance, ``(I, J)``, -1 where it is not known; None if the colors form no classes.

    The colors are grouped by Ward's method. Groups of 2 to 8 are compared with one Gaussian by their classification
    likelihood, with the penalty of BIC: each group is an isotropic Gaussian, all as wide, and pays for its share. No
    number of groups explains a smooth distribution better than a Gaussian by this measure, as each halving of the width
    costs as much as it gains.
    """
    known = color.values[color.known]
    chosen = np.random.default_rng(0).permutation(len(known))[:_MOST]
    colors = known[chosen]
    count, channels = colors.shape
    if count < _FEWEST:
        return None
    spread = np.maximum(np.linalg.eigvalsh(np.atleast_2d(np.cov(colors.T, bias=True))), 0)
    power = spread + _SPREAD**2
    gaussian = -count / 2 * (np.log(power).sum() + (spread / power).sum()) - channels * (channels + 3) / 4 * np.log(
        count
    )
    tree = scipy.cluster.hierarchy.linkage(colors, "ward")
    best, found = -np.inf, None
    numbers = range(2, min(_MOST_CLASSES, count // 2) + 1)
    for groups, label in zip(numbers, scipy.cluster.hierarchy.cut_tree(tree, numbers).T, strict=True):
        size = np.bincount(label)
        means = np.stack([colors[label == k].mean(0) for k in range(groups)])
        within = float(((colors - means[label]) ** 2).sum())
        power = within / (channels * (count - groups)) + _SPREAD**2
        likelihood = -count * channels / 2 * np.log(power) - within / (2 * power) + (size * np.log(size / count)).sum()
        likelihood -= groups * (channels + 1) / 2 * np.log(count)
        if likelihood > best:
            best, found = likelihood, label
    if found is None or best - gaussian < _GAIN[0] * count + _GAIN[1]:
        return None
    # Instances that the sample shows in part may seem a class of their own, of which none can be copied.
    whole = np.unique(found[color.shown[color.known][chosen] >= WHOLE])
    if len(whole) < 2:
        return None
    means = np.stack([colors[found == k].mean(0) for k in whole])
    classes = np.full(color.known.shape, -1)
    classes[color.known] = scipy.spatial.distance.cdist(known, means).argmin(-1)
    return classes


def link_classes(classes: Sequence[Numbers]) -> dict[Pair, NDArray[np.float64]]:
    """Return the pairs of neighbors whose classes depend on each other, and the shares ``(Ka, Kb)`` of their classes.

    The classes of element a and, ``lag`` cells on, of b are compared with independent ones by their likelihood ratio,
    less the penalty of BIC. Either each pair of classes has a probability of its own, or pairs of one element are only
    more or less often equal.
    """
    links = {}
    for a, b in np.ndindex(len(classes), len(classes)):
        for lag in _AROUND:
            one, other = overlap(classes[a], classes[b], lag)
            known = (one >= 0) & (other >= 0)
            table = np.zeros((classes[a].max() + 1, classes[b].max() + 1))
            np.add.at(table, (one[known], other[known]), 1)
            shares = _test_pairs(table, a == b)
            if shares is not None and (a != b or lag != (0, 0)):
                links[a, b, lag] = shares
    return links


def find_object(classes: Mapping[int, Numbers]) -> Pair | None:
    """Return two elements and a lag at which their classes decide each other: they are parts of one object."""
    names = list(classes)
    for (a, b, lag), shares in link_classes(list(classes.values())).items():
        alone = [scipy.special.entr(shares.sum(axis)).sum() for axis in (0, 1)]
        both = scipy.special.entr(shares).sum()
        if a != b and both - min(alone) <= _UNDECIDED * max(alone):
            return names[a], names[b], lag
    return None


def _test_pairs(table: NDArray[np.float64], same: bool) -> NDArray[np.float64] | None:
    """Return the shares of pairs of classes by the best of two models, or None if independent classes are as good."""
    count = max(table.sum(), 1)
    found = table / count
    apart = found.sum(1, keepdims=True) * found.sum(0)
    models = [(found, apart.size - sum(apart.shape) + 1)]
    if same:
        equal = np.eye(len(apart), dtype=bool)
        ratios = [found[part].sum() / max(float(apart[part].sum()), 1e-12) for part in (equal, ~equal)]
        models.append((apart * np.where(equal, *ratios), 1))
    gains = [2 * count * scipy.special.rel_entr(s, apart).sum() - free * np.log(count) for s, free in models]
    if max(gains) <= _BY_CHANCE:
        return None
    shares, _ = models[int(np.argmax(gains))]
    return np.asarray(np.where((shares == 0) & (count * apart < _EXPECTED), apart / (count + 1), shares))


def draw_classes(classes: Sequence[Numbers], torus: CellTorus, rng: np.random.Generator) -> Numbers:
    """Return new classes on a torus, ``(I, J, E)``: a random field with the sample's shares of classes and of pairs.

    It is a Markov random field. Classes are drawn in an order in which each is given the neighbors before it, then
    again given all neighbors. Before each sweep, the potentials of classes and pairs that are too rare are raised, and
    of others lowered.

    Parameters
    ----------
    classes
        The classes of each element in the sample, ``(I, J)``, -1 where unknown.
    torus
        The cells of the output.
    rng
        Draws the classes.
    """
    links = link_classes(classes)
    most = max((own.max() + 1 for own in classes), default=1)
    counts = np.array([np.bincount(own[own >= 0], minlength=most) for own in classes]).reshape(-1, most)
    shares = counts / counts.sum(1, keepdims=True)
    level = np.log(np.maximum(shares, 1e-99))
    target = np.full((len(_AROUND), *shares.shape, *shares.shape), np.nan)
    for (a, b, lag), joint in links.items():
        target[_AROUND.index(lag), a, : len(joint), b, : joint.shape[1]] = joint
    potential = np.nan_to_num(np.log((target + _UNSEEN) / (np.multiply.outer(shares, shares) + _UNSEEN)))
    cells = np.stack(np.meshgrid(np.arange(torus.columns), np.arange(torus.rows), indexing="ij"), -1).reshape(-1, 2)
    near = torus.wrap(cells + np.array(_AROUND)[:, np.newaxis]) @ (torus.rows, 1)
    drawn = np.zeros((len(cells), *shares.shape))  # 1 where a cell's element is in a class
    order = cells @ (2, 1) * bool(links)  # no two neighbors are equal in it
    for sweep in range(_SWEEPS + 1 if links else 1):
        for turn, k in np.ndindex(order.max() + 1, len(classes)):
            at = order == turn
            likelihood = level[k] + np.einsum("lnbj,lcbj->nc", drawn[near[:, at]], potential[:, k])
            if sweep:
                likelihood += level[k] - np.log(scipy.special.softmax(likelihood, -1).mean(0) + _UNSEEN)
            drawn[at, k] = np.eye(most)[(likelihood + rng.gumbel(size=likelihood.shape)).argmax(-1)]
        now = np.einsum("nac,lnbj->lacbj", drawn, drawn[near], optimize=True) / len(cells)
        potential += _RATE * np.nan_to_num(np.log((target + _UNSEEN) / (now + _UNSEEN)))
        order %= 5
    return np.asarray(drawn.argmax(-1).reshape(torus.columns, torus.rows, -1))
