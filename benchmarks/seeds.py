"""How the table of the default suite moves over seeds: the mean quality of each method by seed, and its place.

``python benchmarks/seeds.py [--seeds 1 2 ...] [--out FOLDER] [--textures PATTERN ...] [--jobs N]``. A seed draws all
samples and fresh draws anew. Its run goes to ``FOLDER/seed-K``; a run that is complete is only read. The table has each
method's mean over textures at each seed, the mean and the standard deviation of these means, and the places that the
method takes. Below: Kendall's tau between the order at each pair of seeds, and the minutes that one seed took.
"""

import itertools
import os
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from studies import Options, read_options

import nrbench


def mean_qualities(seed: int, options: Options) -> pd.Series:
    """Run one seed; return the mean quality of each ranked method and source of the lattice."""
    run = nrbench.run(
        "default",
        seed=seed,
        textures=options.textures,
        out=options.out / f"seed-{seed}",
        options=nrbench.Options(jobs=options.jobs),
    )
    summary = run.summary()
    return summary.loc[~summary["reference"].astype(bool), "quality"].astype(float).rename(f"seed {seed}")


def main() -> None:
    """Run the seeds and print the tables."""
    jobs = os.cpu_count() or 1
    options = read_options(__doc__, seeds=list(range(1, 9)), out=Path("runs/seeds"), textures=[], jobs=jobs)
    columns, minutes = [], []
    for seed in options.seeds:
        start = time.perf_counter()
        columns.append(mean_qualities(seed, options))
        minutes.append((time.perf_counter() - start) / 60)
    means = pd.concat(columns, axis=1)
    places = means.rank(ascending=False, method="min").astype(int)
    table = means.assign(mean=means.mean(axis=1), sd=means.std(axis=1, ddof=1))
    table["places"] = [" ".join(map(str, row)) for row in places.to_numpy()]
    print(table.sort_values("mean", ascending=False).round(3).reset_index().to_string(index=False))
    pairs = itertools.combinations(means.columns, 2)
    taus = [float(kendalltau(means[one], means[other]).statistic) for one, other in pairs]
    print(f"\nKendall's tau between two seeds: mean {np.mean(taus):.2f}, least {np.min(taus):.2f}")
    print(f"minutes a seed: median {np.median(minutes):.1f}")


if __name__ == "__main__":
    main()
