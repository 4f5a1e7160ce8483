"""How sure the consensus detector is: a probability, fitted to textures whose lattice is known."""

from __future__ import annotations

import math

WEIGHTS = {"constant": -5.44, "sigmas": 3.75, "relief": 1.21, "tiles": -1.0}
"""Of a logistic regression on the logarithms, fitted by ``benchmarks/consensus_calibration.py``."""


FURTHEST = 60.0
"""Standard deviations; the fit saw few lattices that stand out further, and nothing is concluded from more."""


def confidence(sigmas: float, relief: float, tiles: float) -> float:
    """Return the probability that a lattice is exact: neither supercell nor subcell, nor wrong, nor chance.

    Parameters
    ----------
    sigmas
        How far the correlation at its multiples lies above chance, in standard deviations.
    relief
        By which share of it the correlation at any finer lattice's further vectors is lower.
    tiles
        The image's area in cells: at the same significance, many small cells are rather subcells.

    Notes
    -----
    A logistic regression on the logarithms of the three, fitted to draws of 25 models and of noise, whose departures
    reach from none to beyond recognition: it says how often such an answer was right there.
    """
    logit = WEIGHTS["constant"] + WEIGHTS["sigmas"] * math.log(min(max(sigmas, 1e-3), FURTHEST))
    logit += WEIGHTS["relief"] * math.log(max(relief, 1e-2)) + WEIGHTS["tiles"] * math.log(max(tiles, 1.0))
    return 1 / (1 + math.exp(-logit)) if logit > -700 else 0.0
