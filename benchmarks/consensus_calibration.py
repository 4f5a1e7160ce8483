"""Fit the weights of the detector ``consensus`` on some draws, and report on others what its confidence is worth.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/consensus_calibration.py [--count 6] [--kinds 1]``. The
draws are of 25 models at random departures, from none to beyond recognition, 64 to 256 px a side, of noise, and of
kinds of texture that the models lack (``benchmarks/texture_kinds.py``): ``--count`` of each model, ``--kinds`` of each
kind, for each seed. ``--report N --plot FILE.png`` fits nothing,
and draws the reliability diagram for N draws of each model and kind, also of those with structure of the pixels.

The script prints the weights that belong into ``nrbench/detectors/candidate_search/candidates.py``, the mean loss of
the choice (nats for each image and level) on the draws of the fit, on families that were left out, and on fresh draws.
For the weights as shipped it prints how often answers of each confidence are right on fresh draws.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from studies import read_options
from texture_kinds import Case, draw_kinds, draw_models, draw_pixel_kinds

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
BINS = 5
"""Bins of confidence in the reliability diagram."""
FOLDS = 6
"""Parts into which the families are divided to leave one out."""
Weights = dict[str, float]


class ChoiceSet(NamedTuple):
    """The candidates of one image at one level: their traits ``(n, k)``, and the exact one (n: none) of n."""

    family: str
    traits: NDArray[np.float64]
    exact: int


def draw(seeds: Sequence[int], count: int, kinds: int, pixels: int = 0) -> list[Case]:
    """Return the textures of some seeds, rounded to 8 bits."""
    generators = [np.random.default_rng(seed) for seed in seeds]
    parts = [(draw_models(rng, count), draw_kinds(rng, kinds), draw_pixel_kinds(rng, pixels)) for rng in generators]
    cases = [case for part in parts for case in itertools.chain(*part)]
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


def report(cases: Sequence[Case], plot: str) -> None:
    """Print how often the detector is right at each confidence, and by kind; draw the reliability diagram."""
    rows = []
    for case in cases:
        try:
            found = Consensus().detect(case.image)
        except NoLatticeFound:
            continue
        lattices = [found.lattice, *(other.lattice for other in found.alternatives[:2])]
        exact = [_is_exact(lattice, case) for lattice in lattices]
        rows.append((case.kind, found.confidence, exact[0], any(exact)))
    said, true = np.array([(confidence, exact) for _, confidence, exact, _ in rows]).T
    bins = np.clip((said * BINS).astype(int), 0, BINS - 1)
    gaps = [(np.count_nonzero(bins == n), said[bins == n].mean(), true[bins == n].mean()) for n in sorted(set(bins))]
    error = sum(n * abs(mean - right) for n, mean, right in gaps) / len(said)
    print(f"calibration error {error:.3f}; said/true (n):", *(f"{a:.2f}/{b:.2f} ({n})" for n, a, b in gaps))
    worst = max(gaps, key=lambda gap: abs(gap[1] - gap[2]))
    error = np.sqrt(worst[1] * (1 - worst[1]) / worst[0])
    print(f"worst bin: said {worst[1]:.2f}, true {worst[2]:.2f}, standard error {error:.2f}")
    for kind in sorted({case.kind for case in cases}):
        part = [row for row in rows if row[0] == kind]
        exact, listed = (sum(row[column] for row in part) for column in (2, 3))
        count = sum(case.kind == kind for case in cases)
        told = f"said {np.mean([row[1] for row in part]):.2f}, exact {exact}" if part else "exact 0"
        print(f"  {kind:12} {count}: {len(part)} lattices, {told}, among the first three {listed}")
    if plot:
        draw_reliability(gaps, plot)


def draw_reliability(gaps: Sequence[tuple[int, float, float]], plot: str) -> None:
    """Draw the share of right answers over the confidence, with 95 % intervals and the numbers of answers."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7")
    for count, mean, right in gaps:
        low, high = scipy.stats.binomtest(round(right * count), count).proportion_ci(method="wilson")
        axes.errorbar(mean, right, [[right - low], [high - right]], fmt="o", color="C0", capsize=2)
        axes.annotate(str(count), (mean, right), (5, -10), textcoords="offset points", fontsize=8)
    axes.set(xlabel="confidence", ylabel="share of right answers", xlim=(0, 1.02), ylim=(0, 1.02))
    figure.savefig(plot, dpi=120)


def main() -> None:
    """Fit on the draws of some seeds, report on those of others."""
    options = read_options(__doc__, count=6, kinds=1, report=0, plot="")
    load_kernels()
    if options.report:
        report(draw(REPORT_SEEDS, options.report, options.report, options.report), options.plot)
        return
    known, fresh = (draw(seeds, options.count, options.kinds) for seeds in (FIT_SEEDS, REPORT_SEEDS))
    choices, others = list_choices(known), list_choices(fresh)
    noise = [choice.traits[0, 1] for choice in choices + others if choice.family == "noise"]
    print(f"noise: the most probable lattice reaches {np.exp(max(noise, default=0)):.1f} sigmas")
    weights = fit(choices)
    print(f"{len(known)} textures, {len(choices)} choices, penalty {PENALTY}: {weights}")
    print(f"loss {mean_loss(choices, weights):.3f}, fresh draws {mean_loss(others, weights):.3f}")
    print(f"loss on families that were left out {leave_families_out(choices):.3f}")
    report(fresh, options.plot)


if __name__ == "__main__":
    main()
