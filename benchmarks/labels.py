"""Whether labels agree with the scores; the labels were given without knowing the methods or the scores.

``python benchmarks/labels.py``

``labels/outputs.csv`` holds the answers of two labellers (vision-language models that saw nothing but the pictures) to
three questions about outputs of methods on textures of ``core`` and ``report2004``: is the lattice kept (1 or 0), are
the elements whole (1 or 0), does it look like more of the same texture (1 to 5). Each output is made again, compared
with the hash of its pixels, and scored. Prints Cohen's kappa between the labellers, and between them and the verdict,
and the rank correlation of ``quality.score`` with the answers.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import kendalltau, spearmanr

from nrbench import plugins
from nrbench.metrics.integrity import Integrity
from nrbench.metrics.quality import Quality
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Task
from nrbench.running.phases import checked_synthesis
from nrbench.streams import pixels_hash, stream
from nrbench.suites.plan import Sample, draw_samples
from nrbench.suites.suite import load_suite

LABELS = Path(__file__).parent / "labels" / "outputs.csv"


def score_output(sample: Sample, seed: int, row: dict[str, str]) -> dict[str, Any]:
    """Make an output again, and return its scores.

    Raises
    ------
    ValueError
        When the pixels differ from those that were labelled.
    """
    assert sample.texture is not None
    texture, again = sample.texture, sample.recipe.again(sample.texture)
    method = plugins.build("synthesizers", row["method"], {})
    own = getattr(method, "reference", False)
    rng = stream("synthesis", seed, pixels_hash(texture.image), 0)
    lattice = texture.lattice if getattr(method, "uses_lattice", True) else None
    task = Task(texture.image, sample.shape, lattice, rng, again=again if own else None)
    output = checked_synthesis(method.synthesize(task), texture.image, sample.shape).image
    if not pixels_hash(output).startswith(row["pixels"]):
        raise ValueError(f"{row['texture']}, {row['method']}: the output is not the one that was labelled")
    observation = Observation(texture.image, output, texture, again=again)
    return {
        "preserved": Regularity().score(observation).values["preserved"],
        "integrity": Integrity().score(observation).values["score"],
        "quality": Quality().score(observation).values["score"],
    }


def kappa(one: pd.Series[Any], other: pd.Series[Any]) -> float:
    """Return Cohen's kappa of two series of answers."""
    agreement = float((one == other).mean())
    answers = sorted({*one, *other})
    chance = sum(float((one == answer).mean() * (other == answer).mean()) for answer in answers)
    return (agreement - chance) / (1 - chance) if chance < 1 else 1.0


def main() -> None:
    """Score all labelled outputs and print the agreement."""
    with LABELS.open(newline="") as file:
        rows = list(csv.DictReader(file))
    scores, lost = [], []
    for name in sorted({row["suite"] for row in rows}):
        suite = load_suite(name)
        textures = sorted({row["texture"] for row in rows if row["suite"] == name})
        samples = {sample.row.name: sample for sample in draw_samples(suite, textures)}
        for row in rows:
            if row["suite"] == name:
                try:
                    scores.append({**row, **score_output(samples[row["texture"]], suite.seed, row)})
                except ValueError as error:
                    lost.append(str(error))
    table = pd.DataFrame(scores)
    table["same"] = (table["first_same"].astype(float) + table["second_same"].astype(float)) / 2
    print(f"{len(table)} outputs of {table['texture'].nunique()} textures; {len(lost)} differ from the labelled ones")
    for question in ("lattice", "whole"):
        print(
            f"{question}: kappa of the labellers {kappa(table[f'first_{question}'], table[f'second_{question}']):.2f}"
        )
    decided = table[table["preserved"].notna()]
    verdict = decided["preserved"].map({True: "1", False: "0"})
    for who in ("first", "second"):
        print(
            f"verdict and the {who} labeller: kappa {kappa(verdict, decided[f'{who}_lattice']):.2f} (n {len(decided)})"
        )
    known = table[table["quality"].notna()]
    print(f"quality and the third answer: Spearman {spearmanr(known['quality'], known['same']).statistic:.2f}")
    by_texture = [
        kendalltau(part["quality"], part["same"]).statistic
        for _, part in known.groupby("texture")
        if len(part) >= 4 and part["same"].nunique() > 1 and part["quality"].nunique() > 1
    ]
    print(f"order of methods by texture: mean Kendall's tau {np.mean(by_texture):.2f} ({len(by_texture)} textures)")
    means = table.groupby("method")[["quality", "integrity", "same"]].mean().sort_values("same")
    print(means.round(2).to_string())


if __name__ == "__main__":
    main()
