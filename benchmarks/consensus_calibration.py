"""Fit the weights of the detector ``consensus`` on some draws, and report on others what its confidence is worth.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/consensus_calibration.py [--count 6] [--kinds 1]``. The
draws are of 25 models at random departures, from none to beyond recognition, 64 to 256 px a side, of noise, and of
kinds of texture that the models lack (``benchmarks/texture_kinds.py``).

The script prints the weights that belong into ``nrbench/detectors/candidate_search/candidates.py``, the mean loss of
the choice (nats for each image and level) on the draws of the fit, on families that were left out, and on fresh draws.
For the weights as shipped it prints how often answers of each confidence are right on fresh draws.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from texture_kinds import Case, draw_kinds, draw_models

from nrbench.detectors.candidate_search.candidates import Traits, classify
from nrbench.detectors.consensus import Consensus, rate_levels
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import NoLatticeFound

PENALTY = 1.0
"""Weight of half the squared weights of the scaled traits, against the sum of the losses."""
FIT_SEEDS, REPORT_SEEDS = (1011, 1012, 1013), (1021,)
FOLDS = 6
"""Parts into which the families are divided to leave one out."""
Weights = dict[str, float]


class ChoiceSet(NamedTuple):
    """The candidates of one image at one level: their traits ``(n, k)``, and the exact one (n: none) of n."""

    family: str
    traits: NDArray[np.float64]
    exact: int


def draw(seeds: Sequence[int], count: int, kinds: int) -> list[Case]:
    """Return the textures of some seeds, rounded to 8 bits."""
    generators = [np.random.default_rng(seed) for seed in seeds]
    cases = [case for rng in generators for case in itertools.chain(draw_models(rng, count), draw_kinds(rng, kinds))]
    return [case._replace(image=quantize(case.image)) for case in cases]


def list_choices(cases: Sequence[Case]) -> list[ChoiceSet]:
    """Return the choice sets of all levels of all textures."""
    choices = []
    for case in cases:
        for level in rate_levels(case.image):
            exact = [
                _is_exact(Lattice.from_basis(level.factor * candidate.basis), case) for candidate in level.candidates
            ]
            traits = np.array([candidate.traits for candidate in level.candidates])
            choices.append(ChoiceSet(case.family, traits, exact.index(True) if any(exact) else len(exact)))
    return choices


def _is_exact(lattice: Lattice, case: Case) -> bool:
    if case.lattice is None:
        return False
    return lattice_error(lattice, case.lattice, case.image.shape[:2], share=0.04).relation == "exact"


def fit(choices: Sequence[ChoiceSet]) -> Weights:
    """Return the weights of the conditional logit that minimize the loss plus :data:`PENALTY`."""
    every = np.concatenate([choice.traits for choice in choices])
    scale = np.where(every.std(0) > 0, every.std(0), 1.0)
    scaled = [np.vstack([choice.traits / scale, np.zeros(len(scale))]) for choice in choices]

    def loss(weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        value, slope = PENALTY * float(weights[1:] @ weights[1:]) / 2, np.append(0.0, PENALTY * weights[1:])
        for choice, traits in zip(choices, scaled, strict=True):
            logs = scipy.special.log_softmax(traits @ weights)
            value -= float(logs[choice.exact])
            slope += np.exp(logs) @ traits - traits[choice.exact]
        return value, slope

    found = scipy.optimize.minimize(loss, np.zeros(len(scale)), jac=True, method="BFGS").x / scale
    return dict(zip(Traits._fields, np.round(found, 3).tolist(), strict=True))


def mean_loss(choices: Sequence[ChoiceSet], weights: Weights) -> float:
    """Return the mean of minus the logarithm of the probability of what is true, in nats."""
    losses = []
    for choice in choices:
        shares = classify([Traits(*row) for row in choice.traits.tolist()], weights)
        losses.append(-np.log(max(float(np.append(shares, 1 - shares.sum())[choice.exact]), 1e-12)))
    return float(np.mean(losses))


def leave_families_out(choices: Sequence[ChoiceSet]) -> float:
    """Return the mean loss on families that were left out of the fit."""
    families = sorted({choice.family for choice in choices})
    losses = []
    for start in range(FOLDS):
        out = families[start::FOLDS]
        weights = fit([choice for choice in choices if choice.family not in out])
        losses += [mean_loss([choice], weights) for choice in choices if choice.family in out]
    return float(np.mean(losses))


def report(cases: Sequence[Case]) -> None:
    """Print how often the detector, without rejection, is right at each confidence, and by kind of texture."""
    rows = []
    for case in cases:
        try:
            found = Consensus(reject="none").detect(case.image)
        except NoLatticeFound:
            continue
        lattices = [found.lattice, *(other.lattice for other in found.alternatives[:2])]
        exact = [_is_exact(lattice, case) for lattice in lattices]
        rows.append((case.kind, found.confidence, exact[0], any(exact)))
    said, true = np.array([(confidence, exact) for _, confidence, exact, _ in rows]).T
    tenths = np.clip((said * 10).astype(int), 0, 9)
    gaps = [(np.count_nonzero(tenths == n), said[tenths == n].mean(), true[tenths == n].mean()) for n in set(tenths)]
    error = sum(n * abs(mean - right) for n, mean, right in gaps) / len(said)
    print(f"calibration error {error:.3f}; said/true (n):", *(f"{a:.2f}/{b:.2f} ({n})" for n, a, b in gaps))
    for kind in sorted({row[0] for row in rows}):
        part = [row for row in rows if row[0] == kind]
        exact, listed = (sum(row[column] for row in part) for column in (2, 3))
        print(f"  {kind:12} exact {exact} of {len(part)}, among the first three {listed}")


def main() -> None:
    """Fit on the draws of some seeds, report on those of others."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=6, help="draws of each model, for each seed")
    parser.add_argument("--kinds", type=int, default=1, help="draws of each further kind, for each seed")
    options = parser.parse_args()
    load_kernels()
    known, fresh = (draw(seeds, options.count, options.kinds) for seeds in (FIT_SEEDS, REPORT_SEEDS))
    choices, others = list_choices(known), list_choices(fresh)
    noise = [choice.traits[0, 1] for choice in choices + others if choice.family == "noise"]
    print(f"noise: the most probable lattice reaches {np.exp(max(noise, default=0)):.1f} sigmas")
    weights = fit(choices)
    print(f"{len(known)} textures, {len(choices)} choices, penalty {PENALTY}: {weights}")
    print(f"loss {mean_loss(choices, weights):.3f}, fresh draws {mean_loss(others, weights):.3f}")
    print(f"loss on families that were left out {leave_families_out(choices):.3f}")
    report(fresh)


if __name__ == "__main__":
    main()
