"""How often the statistics of a table err: stars lost by equal methods, coverage of intervals, alarms of compare.

``stars``
    The share of tables in which a method that is as good as the best loses its star, or any two equal methods differ.
``coverage``
    The share of 95 % intervals that hold the mean, over draws of a fixed list and over a population of textures. It is
    taken of those that are printed; in parentheses is how many are.
``compare``
    The share of comparisons of two runs with any alarm where the code is the same, and in which a loss is found.

``--runs`` is the number of simulated tables for each figure; ``--short`` takes a few sizes.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from studies import Options, run_studies

from nrbench.reports.statistics.estimates import (
    ALPHA,
    compare_pairs,
    detectable_losses,
    draw_intervals,
    p_values_by_flips,
    population_intervals,
)

Floats = NDArray[np.float64]
Rng = np.random.Generator
SIZES, SHORT_SIZES = (2, 5, 6, 9, 12, 18, 24, 36), (6, 24)


def smooth(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return qualities whose draws scatter by 0.1 about the level of a texture."""
    return rng.uniform(0.3, 0.8, (*shape[:2], 1)) + 0.1 * rng.standard_normal(shape)


def unequal(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return qualities of which the first scatter by 0.02 and the last by 0.2."""
    return rng.uniform(0.3, 0.8, (*shape[:2], 1)) + np.geomspace(0.02, 0.2, shape[-1]) * rng.standard_normal(shape)


def ones(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return qualities of which 70 % are 1; tests of differences show the same where 70 % are 0."""
    return 1 - (rng.random(shape) < 0.3) * rng.beta(2, 3, shape)


def refusals(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return smooth qualities of which 6 % are refusals."""
    return np.where(rng.random(shape) < 0.06, 0.0, smooth(rng, shape))


def tastes(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return qualities of methods that are better on some textures of the list and worse on others, equal as a mean."""
    taste = 0.15 * rng.standard_normal(shape)
    return smooth(rng, shape) + taste - taste.mean(1, keepdims=True)


def half(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return smooth qualities of methods of which the second half is worse by 0.15."""
    return smooth(rng, shape) - 0.15 * (np.arange(shape[-1]) >= max(2, shape[-1] // 2))


def holes(rng: Rng, shape: tuple[int, ...]) -> Floats:
    """Return smooth qualities of which 10 % are undecided."""
    return np.where(rng.random(shape) < 0.1, np.nan, smooth(rng, shape))


CASES: tuple[Callable[[Rng, tuple[int, ...]], Floats], ...] = (
    smooth, unequal, ones, refusals, tastes, half, holes,
)  # fmt: skip


def study_stars(options: Options) -> None:
    """Print the share of tables with a wrong star, and with any wrong difference."""
    runs, sizes, methods = options.runs, *((SHORT_SIZES, (4,)) if options.short else (SIZES, (2, 4, 10)))
    print(f"| qualities | methods | {' | '.join(f'{n} textures' for n in sizes)} |")
    print(f"| --- | --- |{' --- |' * len(sizes)}")
    for case in CASES:
        for count in methods:
            cells, rng = [], np.random.default_rng([*case.__name__.encode(), count])
            for n in sizes:
                stars = pairs = 0
                for values in case(rng, (runs, n, count)):
                    equal = np.arange(count) < (max(2, count // 2) if case is half else count)
                    better = compare_pairs(values).better
                    best = int(np.nanmean(values, axis=0).argmax()) if np.isfinite(values).any() else 0
                    stars += bool((better[best] & equal).any())
                    pairs += bool(better[np.ix_(equal, equal)].any())
                cells.append(f"{stars / runs:.3f} {pairs / runs:.3f}")
            print(f"| {case.__name__} | {count} | {' | '.join(cells)} |", flush=True)


def draws(rng: Rng, case: str, runs: int, textures: int, count: int) -> tuple[Floats, float]:
    """Return draws ``(runs, textures, count)`` of a fixed list, and the mean that the intervals should hold."""
    shape = (runs, textures, count)
    level, noise = rng.uniform(0.3, 0.8, (1, textures, 1)), rng.standard_normal(shape)
    if case == "equal scatter":
        return level + 0.1 * noise, float(level.mean())
    if case == "scatter 0.02 to 0.2":
        return level + np.geomspace(0.02, 0.2, textures)[:, None] * noise, float(level.mean())
    if case == "two thirds are 1":
        fixed = (np.arange(textures) % 3 > 0)[:, None]
        return np.where(fixed, 1.0, level + 0.1 * noise), float(np.where(fixed, 1.0, level).mean())
    if case.endswith("of draws are 1"):
        share = 1 - int(case[:2]) / 100
        return 1 - (rng.random(shape) < share) * rng.beta(2, 3, shape), 1 - share * 0.4
    if case == "a fifth refused":
        fixed = (np.arange(textures) % 5 == 0)[:, None]
        return np.where(fixed, 0.0, level + 0.1 * noise), float(np.where(fixed, 0.0, level).mean())
    return np.where(rng.random(shape) < 0.06, 0.0, level + 0.1 * noise), 0.94 * float(level.mean())


DRAWS = (
    *("equal scatter", "scatter 0.02 to 0.2", "two thirds are 1", "a fifth refused", "70 % of draws are 1"),
    *("90 % of draws are 1", "6 % of draws refused"),
)


def _covered(ends: Floats, mean: float) -> str:
    """Return the share of the printed intervals that hold a mean, and the share that is printed."""
    printed = np.isfinite(ends[:, 0])
    if not printed.any():
        return "none"
    held = (ends[printed, 0] <= mean) & (mean <= ends[printed, 1])
    return f"{held.mean():.3f}" + ("" if printed.all() else f" ({printed.mean():.2f})")


def study_coverage(options: Options) -> None:
    """Print the coverage over draws of a fixed list, then over a population of textures."""
    rng, runs, sizes = np.random.default_rng(0), options.runs, SHORT_SIZES if options.short else SIZES
    print(f"| draws of the list | replicates | {' | '.join(f'{n} textures' for n in sizes)} |")
    print(f"| --- | --- |{' --- |' * len(sizes)}")
    for case in DRAWS:
        for count in (1, 2, 4):
            made = (draws(rng, case, 10 * runs, n, count) for n in sizes)
            print(f"| {case} | {count} | {' | '.join(_covered(draw_intervals(y), m) for y, m in made)} |", flush=True)
    print(f"\n| a population of textures | replicates | {' | '.join(f'{n} textures' for n in sizes)} |")
    print(f"| --- | --- |{' --- |' * len(sizes)}")
    for count in (1, 2):
        cells = []
        for n in sizes:
            level = rng.beta(4, 3, (runs, n, 1)) + 0.05 * rng.standard_normal((runs, n, count))
            cells.append(_covered(population_intervals(level), 4 / 7))
        print(f"| levels of textures from a beta distribution | {count} | {' | '.join(cells)} |", flush=True)


def _scores(rng: Rng, level: Floats, scatter: float, failed: NDArray[np.bool_]) -> Floats:
    """Return the scores of a run, ``(textures, methods, scores)``: four perils, their minimum, a verdict, failures."""
    perils = level[..., None] + scatter * rng.standard_normal((*level.shape, failed.shape[-1]))
    perils = np.where(failed, 0.0, perils.clip(0, 1))
    verdict = (perils[:, :, :1] > 0.5).astype(float)
    return np.concatenate([perils, perils.min(2, keepdims=True), verdict, 1.0 - failed], 2).mean(3)


def study_compare(options: Options) -> None:
    """Print the share of comparisons with an alarm, and with the loss found that one of the methods has.

    2 % of the cells fail: the same ones in both runs where cells are paired, others where the seed is another.
    """
    runs, sizes, methods = options.runs, SHORT_SIZES if options.short else (6, 12, 24), 10
    heads = ("draws", "textures", "replicates", "alarm", "loss .05 found", "the same, quality alone", "loss .1 found")
    heads += ("detectable in quality",)
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for paired, scatter in ((True, 0.05), (False, 0.1)):
        for n in sizes:
            for replicates in (1, 2, 4):
                alarms, found, least = 0, np.zeros(3), []
                rng = np.random.default_rng([paired, n, replicates])
                for run in range(runs):
                    level = rng.uniform(0.4, 0.7, (n, 1, 1)) + rng.uniform(0, 0.3, (n, methods, 4))
                    first, second = rng.random((2, n, methods, 1, replicates)) < 0.02
                    second = first if paired else second
                    before, after = _scores(rng, level, scatter, first), _scores(rng, level, scatter, second)
                    alarms += _alarm(before - after)
                    if run < 20:
                        least.append(np.median(detectable_losses((before - after).reshape(n, -1))[4::7]))
                    small, large = before - after, before - after
                    small[:, 0] = before[:, 0] - _scores(rng, level[:, :1] - 0.05, scatter, second[:, :1])[:, 0]
                    large[:, 0] = before[:, 0] - _scores(rng, level[:, :1] - 0.1, scatter, second[:, :1])[:, 0]
                    found += [_alarm(small, 0), _alarm(small[..., 4:5], 0), _alarm(large, 0)]
                name = f"paired, scatter {scatter}" if paired else f"other seed, scatter {scatter}"
                shares = " | ".join(f"{x / runs:.2f}" for x in found)
                row = f"| {name} | {n} | {replicates} | {alarms / runs:.3f} | {shares} | {np.median(least):.3f} |"
                print(row, flush=True)


def _alarm(losses: Floats, method: int | None = None) -> bool:
    """Return whether any score is worse, or any of one method."""
    p = p_values_by_flips(losses.reshape(len(losses), -1), one_sided=True).reshape(losses.shape[1:])
    return bool((p <= ALPHA).any() if method is None else (p[method] <= ALPHA).any())


if __name__ == "__main__":
    run_studies(__doc__, study_stars, study_coverage, study_compare, runs=1000, short=False)
