"""Drawing one of several places: uniformly, or from those whose surroundings were shown least of late."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points

from ..sampling.equal_places import Positions

REMEMBERED: Final = 64
"""Patches laid last that count: few enough that a draw costs the same however large the output."""
_ALIKE: Final = 0.05
"""Places that were shown less than this share of a patch more than the least shown are drawn from, too."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Draws places in a sample for square patches.

    Parameters
    ----------
    rng
        Where randomness comes from.
    block
        Side of the patches in px.
    spread
        Whether places are preferred that patches laid of late overlap least; the first draw is uniform either way.
    """

    rng: np.random.Generator
    block: int
    spread: bool
    _laid: deque[Points] = field(default_factory=lambda: deque(maxlen=REMEMBERED), init=False)

    def one_of(self, candidates: NDArray[Any]) -> Points:
        """Return one of the candidates ``(n, 2)``, n at least 1, and remember it: O(n)."""
        if self.spread and self._laid:
            shown = self.shown(candidates)
            candidates = candidates[shown <= shown.min() + _ALIKE]
        place = np.asarray(candidates[self.rng.integers(len(candidates))], np.float64)
        self._laid.append(place)
        return place

    def shown(self, places: NDArray[Any]) -> NDArray[np.float64]:
        """Return for each place how many patches laid of late show what lies there, those that overlap in part."""
        apart = np.abs(places[:, np.newaxis] - np.array(self._laid).reshape(-1, 2))
        return np.asarray(np.maximum(1 - apart / self.block, 0).prod(-1).sum(-1))


def best_places(
    candidates: Positions, ratings: NDArray[np.float64], lattice: Lattice, at: Points, share: float
) -> Positions:
    """Return the best candidate at each of the places that are equal by the lattice, for a share of these, best first.

    Parameters
    ----------
    candidates, ratings
        ``(n, 2)`` and ``(n,)``: places, several around each of those that are equal, the higher the better.
    lattice, at
        Which places are equal: (x, y) of one of them. The lattice's basis is reduced; candidates are of one place where
        they round to the same point of it.
    share
        Of the places, in [0, 1]; the best always, and what is as good as the last.
    """
    cells = np.rint(lattice.to_cell(candidates) - lattice.to_cell(at)).astype(np.int64)
    cells -= cells.min(0)
    place = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)[1]
    top = np.full(place.max() + 1, -np.inf)
    np.maximum.at(top, place, ratings)
    last = np.sort(top)[::-1][max(int(np.ceil(share * len(top))) - 1, 0)]
    return np.asarray(candidates[(ratings == top[place]) & (ratings >= last)])
