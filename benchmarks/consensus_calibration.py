"""What the confidence of the consensus detector is worth: fitted on some draws, reported on others.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/consensus_calibration.py [--count 4] [--kinds 1]``. With
``--keep FOLDER`` a run that was stopped goes on where it stopped. The shipped weights are those of ``--count 10 --kinds
6``, which takes about an hour.

The draws are of 25 models at random departures, from none to beyond recognition, 64 to 256 px a side, of noise, and of
kinds of texture that the models lack (``benchmarks/texture_kinds.py``). A multinomial logistic regression tells from
the traits of a lattice (:class:`nrbench.detectors.agreement.short_list.Traits`) whether it is exact, a sub- or
supercell, or neither. The script prints the weights that belong into ``nrbench/detectors/agreement/weights.py``, and
for the chosen lattices: how often answers of each confidence were right, the expected calibration error, the mean
confidence of wrong answers, and how often the right lattice was among the first three. It does so for

- the weights as shipped, on draws that were not used for the fit;
- weights that are fitted without the family of the texture (leave one family out), and without its kind.

Where the colors repeat by a coarser lattice than the structure, people measure either lattice. Such a texture counts
half for each of the two; so does an answer with both, one of which is right.
"""

from __future__ import annotations

import argparse
import itertools
import pickle
import pprint
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.optimize import minimize
from texture_kinds import Case, draw_kinds, draw_models

from nrbench.detectors.agreement import short_list, weights
from nrbench.detectors.agreement.short_list import Rival, Traits, classify
from nrbench.detectors.consensus import Consensus
from nrbench.imaging.convert import quantize
from nrbench.jit import load_kernels
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import Probabilities

PENALTY = 0.3
PASSES = 2
"""Number of fits to the chosen lattices: the detail at which a lattice is chosen depends on its confidence."""
ENOUGH = 40
"""Least number of textures in a tenth whose reliability is judged."""
FIT_SEEDS, CHOICE_SEEDS, REPORT_SEED = (11, 12), (21, 22, 23, 24, 25, 26), 13
"""The weights of all lattices are fitted to the draws of the first seeds. Those of the chosen lattice, of which each
texture has one only, are fitted to the draws of the second seeds, too."""
FOLDS = 6
"""Parts into which the families are divided to leave one out."""
CLASSES = Probabilities._fields


class Rated(NamedTuple):
    """One texture and what the detector, without rejection, makes of it.

    Parameters
    ----------
    case
        The texture without its image.
    details
        For each detail at which there are any: the factor by which the image was shrunk, and the lattices that were
        rated, the best stable one first.
    truths
        For each lattice that a person may measure (at least one; None for no lattice), the class of each rival of all
        details.
    """

    case: Case
    details: list[tuple[int, list[Rival]]]
    truths: list[list[str]]

    @property
    def rivals(self) -> list[Rival]:
        """The lattices of all details."""
        return [rival for _, rivals in self.details for rival in rivals]


def rate(cases: Iterable[Case]) -> Iterator[Rated]:
    """Yield the rated lattices of each texture."""
    detector = Consensus(reject="none")
    for case in cases:
        image = quantize(case.image)
        details = detector.list_rivals(image)
        every = [rival for _, rivals in details for rival in rivals]
        truths = [[_class_of(rival, truth, image.shape[:2]) for rival in every] for truth in case.lattices or [None]]
        yield Rated(case._replace(image=image[:1, :1]), details, truths)


def _class_of(rival: Rival, truth: Lattice | None, shape: tuple[int, int]) -> str:
    if truth is None:
        return "none"
    relation = lattice_error(Lattice.from_basis(rival.basis), truth, shape, share=0.04).relation
    return {"exact": "exact", "wrong": "none"}.get(relation, "sub_or_supercell")


Weights = dict[str, list[float]]


def fit(rated: Sequence[Rated], further: Sequence[Rated]) -> tuple[Weights, Weights]:
    """Return the weights for all rivals, fitted to ``rated``, and those for the chosen lattice, fitted to all textures.

    The latter are fitted to what the former say of families that they were not fitted to.
    """
    return _fit_rivals(rated), _fit_chosen(rated, further)


def _fit_rivals(rated: Sequence[Rated]) -> Weights:
    rows = []
    for one in rated:
        for rival, *names in zip(one.rivals, *one.truths, strict=True):
            if rival.role and "exact" in names:  # its probability is divided afterward
                names = ["exact"]
            rows += [([1.0, *rival.traits], name, 1 / len(names)) for name in names]
    return _regress(rows, PENALTY)


def _fit_chosen(rated: Sequence[Rated], further: Sequence[Rated]) -> Weights:
    families = sorted({one.case.family for one in (*rated, *further)})
    parts = [families[start::FOLDS] for start in range(FOLDS)]
    fitted = [_fit_rivals([one for one in rated if one.case.family not in out]) for out in parts]
    chosen = weights.CHOSEN
    for _ in range(PASSES):
        rows = []
        with _replaced(weights.CHOSEN, chosen):
            for out, found in zip(parts, fitted, strict=True):
                for one in (*rated, *further):
                    if one.case.family in out:
                        rows += _choice_rows(one, found)
        chosen = _regress(rows, PENALTY / 10)
    return chosen


def _choice_rows(one: Rated, used: Weights) -> list[tuple[list[float], str, float]]:
    """Return what the second regression reads of a texture, with each class that the chosen lattice may have."""
    order, truths = _choose(one, used)
    if not order:
        return []
    names = ["exact"] if order[0].role and _holds_right(order, truths) else [each[0] for each in truths]
    return [(short_list.describe_choice(order), name, 1 / len(names)) for name in names]


def _choose(one: Rated, used: Weights) -> tuple[list[Rival], list[list[str]]]:
    """Return the rivals with the given weights, the chosen one first, and their classes; none if there are none."""
    with _replaced(weights.WEIGHTS, used):
        details = [
            (factor, [rival._replace(probabilities=classify(rival.traits)) for rival in rivals])
            for factor, rivals in one.details
        ]
    choice = Consensus().choose(details)
    if choice is None:
        return [], []
    every = [rival for _, rivals in details for rival in rivals]
    numbers = [next(n for n, rival in enumerate(every) if rival.basis is chosen.basis) for chosen in choice.rivals]
    return choice.rivals, [[truth[number] for number in numbers] for truth in one.truths]


@contextmanager
def _replaced(shipped: Weights, used: Weights) -> Iterator[None]:
    """Replace the weights that the detector uses for a while."""
    kept = dict(shipped)
    shipped.update(used)
    try:
        yield
    finally:
        shipped.update(kept)


def _regress(rows: Sequence[tuple[list[float], str, float]], penalty: float) -> Weights:
    """Return the weights of a multinomial logistic regression on (terms, class, share)."""
    terms = np.array([row for row, _, _ in rows])
    known = np.eye(3)[[CLASSES.index(name) for _, name, _ in rows]]
    parts = np.array([share for _, _, share in rows])[:, np.newaxis]
    scale = np.append(1.0, terms[:, 1:].std(0) + 1e-6)
    terms = terms / scale

    def shares(flat: NDArray[np.float64]) -> NDArray[np.float64]:
        scores = np.column_stack([terms @ flat.reshape(2, -1).T, np.zeros(len(terms))])
        return np.asarray(scipy.special.softmax(scores, 1))

    damp = np.tile(np.append(0.0, np.full(terms.shape[1] - 1, 2 * penalty)), 2)
    logs = parts * known

    def loss(flat: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        said = shares(flat)
        slope = ((said - known) * parts)[:, :2].T @ terms
        value = -(logs * np.log(np.maximum(said, 1e-300))).sum() + (damp * flat**2).sum() / 2
        return float(value), slope.ravel() + damp * flat

    def curvature(flat: NDArray[np.float64]) -> NDArray[np.float64]:
        said = shares(flat)[:, :2]
        blocks = [
            [((said[:, i] * ((i == j) - said[:, j]) * parts[:, 0])[:, np.newaxis] * terms).T @ terms for j in range(2)]
            for i in range(2)
        ]
        return np.asarray(np.block(blocks) + np.diag(damp))

    # Newton's method: tens of steps, where one that knows no curvature takes a thousand.
    start = np.zeros(2 * terms.shape[1])
    found = minimize(loss, start, jac=True, hess=curvature, method="trust-exact", options={"gtol": 1e-4}).x
    found = found.reshape(2, -1) / scale
    return {name: [round(float(weight), 3) for weight in row] for name, row in zip(CLASSES, found, strict=False)}


class Outcome(NamedTuple):
    """The lattice chosen for a texture, with the probabilities that it has, its true relation, and its weight."""

    kind: str
    family: str
    said: Probabilities
    truth: str
    listed: bool
    share: float


def judge(rated: Sequence[Rated], used: tuple[Weights, Weights]) -> Iterator[Outcome]:
    """Yield what the detector says of each texture with the given weights."""
    for one in rated:
        with _replaced(weights.CHOSEN, used[1]):
            order, truths = _choose(one, used[0])
            if not order:
                continue
            said, certainties = short_list.share_certainty(order)
        truths = _share_truths(order, truths)
        first = sorted(range(len(certainties)), key=lambda number: -certainties[number])[:2]
        for truth in truths:
            listed = "exact" in [truth[0], *(truth[1 + number] for number in first)]
            yield Outcome(one.case.kind, one.case.family, said, truth[0], listed, 1 / len(truths))


def _share_truths(order: Sequence[Rival], truths: list[list[str]]) -> list[list[str]]:
    """Return the truths; if a pair of lattices holds the right one, each of the pair is exact in one of the truths."""
    if not _holds_right(order, truths):
        return truths
    pair = [number for number, rival in enumerate(order) if rival.role]
    return [["exact" if n == right else "sub_or_supercell" for n in range(len(order))] for right in pair]


def _holds_right(order: Sequence[Rival], truths: list[list[str]]) -> bool:
    """Return whether one of the two lattices of a pair, of the structure and of the colors, is exact."""
    return any(name == "exact" for truth in truths for rival, name in zip(order, truth, strict=True) if rival.role)


def report(title: str, outcomes: Sequence[Outcome]) -> None:
    """Print reliability, calibration error and ranks."""
    shares = np.array([one.share for one in outcomes])
    print(f"{title}: {shares.sum():.0f} textures")
    for name in CLASSES:
        said = np.array([getattr(one.said, name) for one in outcomes])
        true = np.array([one.truth == name for one in outcomes])
        bins = np.clip((said * 10).astype(int), 0, 9)
        gap, parts, gaps = 0.0, [], []
        for number in np.unique(bins):
            there = bins == number
            weight = shares[there].sum()
            mean, right = (float(np.average(values[there], weights=shares[there])) for values in (said, true))
            gap += abs(mean - right) * weight / shares.sum()
            parts.append(f"{mean:.2f}/{right:.2f} ({weight:.0f})")
            if weight >= ENOUGH:
                gaps.append((abs(mean - right), np.sqrt(mean * (1 - mean) / weight)))
        print(f"  {name:17} expected calibration error {gap:.3f}; said/true (n): {'  '.join(parts)}")
        worst = max(gaps, default=(np.nan, np.nan))
        print(
            f"  {'':17} largest gap of a tenth with {ENOUGH} textures {worst[0]:.3f}, by chance {worst[1]:.3f}", end=""
        )
        print(f" (one standard deviation); {sum(one[0] <= 0.05 for one in gaps)} of {len(gaps)} within 0.05")
    for kind, some in itertools.groupby(sorted(outcomes, key=lambda one: one.kind), key=lambda one: one.kind):
        group = list(some)
        n = sum(one.share for one in group)
        exact, listed = (sum(one.share for one in group if test(one)) for test in (_is_exact, lambda one: one.listed))
        wrong = [one.said.exact for one in group if not _is_exact(one)]
        print(
            f"  {kind:15} exact {exact:5.1f} of {n:5.1f}, among the first three {listed:5.1f}"
            f", confidence of wrong answers {np.mean(wrong) if wrong else 0:.2f} ({len(wrong)})"
        )


def _is_exact(outcome: Outcome) -> bool:
    return outcome.truth == "exact"


def leave_out(rated: Sequence[Rated], further: Sequence[Rated], field: str) -> list[Outcome]:
    """Return the outcomes of each group with weights that are fitted to the other groups, as by :func:`fit`."""
    outcomes = []
    groups = sorted({getattr(one.case, field) for one in (*rated, *further)})
    for some in (groups[start::FOLDS] for start in range(FOLDS)) if field == "family" else ([k] for k in groups):
        inside = [one for one in (*rated, *further) if getattr(one.case, field) in some]
        outside = [[one for one in part if getattr(one.case, field) not in some] for part in (rated, further)]
        outcomes += list(judge(inside, fit(*outside)))
    return outcomes


def load(folder: Path | None, seed: int, count: int, kinds: int) -> list[Rated]:
    """Return rated draws.

    If a folder is given, each one is appended to a file there as soon as it is rated. A run that was stopped goes on
    behind the last one: the draws before it are drawn again, because they share a random stream, but not rated again.
    """
    rng = np.random.default_rng(seed)
    cases = itertools.chain(draw_models(rng, count), draw_kinds(rng, kinds))
    if folder is None:
        return list(rate(cases))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"seed{seed}-count{count}-kinds{kinds}.pickle"
    rated, end = _read_stream(path)
    with path.open("ab") as file:
        file.truncate(end)
        for one in rate(itertools.islice(cases, len(rated), None)):
            pickle.dump(one, file)
            file.flush()
            rated.append(one)
    return rated


def _read_stream(path: Path) -> tuple[list[Rated], int]:
    """Return the rated draws of a file, and where the last complete one ends, in bytes."""
    rated: list[Rated] = []
    end = 0
    if path.exists():
        with path.open("rb") as file, suppress(EOFError, pickle.UnpicklingError):
            while True:
                rated.append(pickle.load(file))
                end = file.tell()
    return rated, end


def main() -> None:
    """Fit on the draws of eight seeds, report on those of a ninth one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=4, help="draws of each model, for each seed")
    parser.add_argument("--kinds", type=int, default=1, help="draws of each further kind, for each seed")
    parser.add_argument("--report", type=int, nargs=2, metavar=("COUNT", "KINDS"), help="the same for the ninth seed")
    parser.add_argument(
        "--keep", type=Path, help="folder in which rated draws are kept, so that a run which was stopped goes on there"
    )
    options = parser.parse_args()
    load_kernels()
    counts = options.count, options.kinds
    used, further = (
        [one for seed in seeds for one in load(options.keep, seed, *counts)] for seeds in (FIT_SEEDS, CHOICE_SEEDS)
    )
    fresh = load(options.keep, REPORT_SEED, *(options.report or counts))
    every = used + further + fresh
    noise = [np.exp(one.rivals[0].traits.sigmas) for one in every if one.rivals and one.case.family == "noise"]
    print(f"noise: the best lattice reaches {max(noise, default=0):.1f} sigmas in {len(noise)} draws")
    print("weights:", Traits._fields)
    found = fit(used, further)
    pprint.pp(found, width=120, compact=True)
    report("fitted, on fresh draws", list(judge(fresh, found)))
    report("as shipped, on fresh draws", list(judge(fresh, (weights.WEIGHTS, weights.CHOSEN))))
    report("fitted without the family", leave_out(used, further + fresh, "family"))
    if options.kinds:
        report("fitted without the kind", leave_out(used, further + fresh, "kind"))


if __name__ == "__main__":
    main()
