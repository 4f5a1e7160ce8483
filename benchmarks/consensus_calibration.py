"""What the consensus detector's confidence is worth: fitted on one set of draws, reported on another.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/consensus_calibration.py [--count 10]``. Draws of 25 models
at random departures, from none to beyond recognition, 64 to 256 px a side, and of noise of five spectra, which has no
lattice. It prints the weights of the logistic regression, and how often answers of each confidence were right on draws
that it was not fitted to; and the same for the weights that stand in ``nrbench/lattice/confidence.py``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from nrbench import plugins
from nrbench.detectors.consensus import WEIGHTS, Consensus
from nrbench.imaging.convert import quantize
from nrbench.lattice.comparison import lattice_error
from nrbench.plugins.forms import NoLatticeFound, Texture

MODELS = (
    *(
        "wallpaper",
        "jigsaw",
        "pavement",
        "card",
        "plate",
        "ceramic",
        "scales",
        "squares",
        "cans",
        "swirl",
        "mat",
        "pie",
    ),
    *("toothpaste", "windows", "mosaic", "cracker", "carpet", "rug", "corduroy", "knit", "plaid", "basket"),
    *("brick", "weave", "hexagon"),
)
SPECTRA = ("white", "pink", "brown", "blobs", "grass")
PENALTY = 0.05


class Answer(NamedTuple):
    """What was found: the logarithms that the regression reads, with a leading 1, whether it is exact, and of noise."""

    terms: tuple[float, ...]
    exact: bool
    stochastic: bool


def departures(rng: np.random.Generator) -> dict[str, Any]:
    """Return random departures, from none to beyond recognition."""
    drawn: dict[str, Any] = {
        "color": rng.choice([0, 0.15, 0.3, 0.5, 0.8]),
        "noise": rng.choice([0, 0.03, 0.06, 0.1, 0.2]),
    }
    drawn["rotation"] = rng.uniform(0, 90) * (rng.random() < 0.5)
    choices = {"jitter": ([0.1, 0.2, 0.5], 0.25), "light": ([0.5], 0.25), "damage": ([0.15], 0.2)}
    drawn |= {name: rng.choice(values) for name, (values, odds) in choices.items() if rng.random() < odds}
    return {name: float(value) for name, value in drawn.items()}


def textures(seed: int, count: int) -> Iterator[Texture]:
    """Yield ``count`` draws of each model and each noise."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        for model in MODELS:
            side = int(rng.choice([64, 96, 128, 192, 256]))
            yield plugins.build("datasets", model, departures(rng)).render((side, side), rng)
        for spectrum in SPECTRA:
            side, scale = int(rng.choice([96, 128, 192, 256])), float(rng.choice([5, 12, 20, 30]))
            yield plugins.build("datasets", "noise", {"spectrum": spectrum, "scale": scale}).render((side, side), rng)


def answers(seed: int, count: int) -> Iterator[Answer]:
    """Yield what the detector, without rejection, answers on each draw."""
    for texture in textures(seed, count):
        try:
            found = Consensus(reject="none").detect(quantize(texture.image))
        except NoLatticeFound:
            continue
        told, truth = found.diagnostics, texture.lattice
        exact = truth is not None and lattice_error(found.lattice, truth, texture.image.shape[:2]).relation == "exact"
        terms = (max(told["sigmas"], 1e-3), max(told["relief"], 1e-2), max(told["tiles"], 1.0))
        yield Answer((1.0, *np.log(terms)), exact, truth is None)


def fitted(terms: NDArray[np.float64], signs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights of a logistic regression."""

    def loss(weights: NDArray[np.float64]) -> float:
        return float(np.logaddexp(0, -signs * (terms @ weights)).sum() + PENALTY * (weights[1:] ** 2).sum())

    return np.asarray(minimize(loss, np.zeros(terms.shape[1])).x)


def report(title: str, probabilities: NDArray[np.float64], exact: NDArray[np.bool_]) -> None:
    """Print how often answers of each confidence were right."""
    bins = np.clip((probabilities * 5).astype(int), 0, 4)
    print(f"{title}: n = {len(exact)}")
    gap = 0.0
    for number in np.unique(bins):
        there = bins == number
        said, right = probabilities[there].mean(), exact[there].mean()
        gap += abs(said - right) * there.mean()
        print(f"  said {said:.2f}   right {right:.2f}   n {there.sum()}")
    print(f"  expected calibration error {gap:.3f}")


def main() -> None:
    """Fit on the first draws, report on the second."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=10)
    count = parser.parse_args().count
    first, second = (list(answers(seed, count)) for seed in (11, 12))
    noise = [np.exp(one.terms[1]) for one in first + second if one.stochastic]
    print(f"noise: the best lattice reaches {max(noise, default=0):.1f} sigmas in {2 * count * len(SPECTRA)} draws")
    terms, exact = (np.array([getattr(one, name) for one in first]) for name in ("terms", "exact"))
    weights = fitted(terms, 2.0 * exact - 1)
    print("weights", dict(zip(WEIGHTS, weights.round(2).tolist(), strict=True)))
    terms, exact = (np.array([getattr(one, name) for one in second]) for name in ("terms", "exact"))
    for title, used in (("fitted now", weights), ("as shipped", np.array(list(WEIGHTS.values())))):
        report(title, 1 / (1 + np.exp(-terms @ used)), exact)


if __name__ == "__main__":
    main()
