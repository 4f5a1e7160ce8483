"""Whether labels agree with the scores; the labels were given without knowing the methods or the scores.

``python benchmarks/labels.py [FILE.csv] [--photographs FOLDER]``

``labels/outputs.csv``, which is read by default, holds the answers of two labellers (vision-language models that saw
nothing but the pictures) about outputs of methods and references on textures of four suites, and about planted steps of
phase: is the lattice kept (1 or 0), are the elements whole (1 or 0), does it look like more of the same texture (1 or
0), and a grade of this likeness (1 to 5). ``labels/photographs.csv`` holds the same for photographs, whose names are
those of files in FOLDER. Another file is a table ``labels.csv`` that ``nrbench report RUN --labels ...`` wrote: one row
for each output, person and question, with the answers yes, no and cannot say.

Each output is made again, compared with the hash of its pixels, and scored. Outputs that differ are counted, and so are
outputs of pictures that are not there and of changed suites, which cannot be made again. Prints Cohen's kappa between
the labellers, and between them and the automatic answers, over the outputs that both decide; the rank correlation of
``quality.score`` with the grades; and, by the size of a planted step, the share of answers that the lattice is lost.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import kendalltau, spearmanr

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.labelling.questions import ELEMENTS, LATTICE, MORE
from nrbench.metrics.integrity import Integrity
from nrbench.metrics.quality import Quality
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Task
from nrbench.plugins.parameters import parse_spec
from nrbench.running.output_checks import checked_synthesis
from nrbench.streams import pixels_hash, stream
from nrbench.suites.plan import Sample, draw_samples
from nrbench.suites.suite import load_suite

LABELS = Path(__file__).parent / "labels" / "outputs.csv"
OUTPUT = ["suite", "texture", "method", "lattice_source", "replicate", "pixels"]
"""The columns that identify an output."""
ANSWER = ["person", "question", "answer"]
GRADE = "grade"
_STORED_QUESTIONS = {"lattice": LATTICE.name, "whole": ELEMENTS.name, "more": MORE.name, "grade": GRADE}
_VALUES = {"yes": 1.0, "no": 0.0, "cannot say": np.nan}


def read_labels(path: Path) -> pd.DataFrame:
    """Read the first answers of a file of labels.

    Returns
    -------
    pandas.DataFrame
        One row an answer, with the columns :data:`OUTPUT` and :data:`ANSWER`. The answers are numbers: 1 for yes, 0 for
        no, NaN for cannot say, or a grade from 1 to 5.
    """
    table = pd.read_csv(path, keep_default_na=False, dtype=str)
    if "question" in table:
        table = table[table["again"] == "False"]
        labels = table[OUTPUT + ANSWER].assign(answer=table["answer"].map(_VALUES))
    else:
        table = table.assign(lattice_source="given", replicate="0")
        parts = [
            table[OUTPUT].assign(person=person, question=name, answer=pd.to_numeric(table[f"{person}_{column}"]))
            for person, (column, name) in itertools.product(("first", "second"), _STORED_QUESTIONS.items())
        ]
        labels = pd.concat(parts, ignore_index=True)
    return labels.assign(replicate=labels["replicate"].astype(int))


def score_output(sample: Sample, seed: int, row: Mapping[str, Any]) -> dict[str, Any]:
    """Make an output again, and return its scores by ``metric.column``.

    Raises
    ------
    ValueError
        When the pixels differ from those that were labelled, or the lattice came from a detector of its own.
    """
    assert sample.texture is not None
    texture, again = sample.texture, sample.recipe.again(sample.texture)
    method = plugins.build("synthesizers", *parse_spec(row["method"]))
    reference = getattr(method, "reference", False)
    rng = stream("synthesis", seed, pixels_hash(texture.image), row["replicate"])
    if row["lattice_source"] not in ("given", "own", "none"):
        raise ValueError(f"{row['texture']}, {row['method']}: the lattice of a detector is not detected again")
    given = row["lattice_source"] == "given" and getattr(method, "uses_lattice", True)
    task = Task(
        texture.image,
        sample.shape,
        texture.lattice if given else None,
        rng,
        again=again if reference else None,
        recompose=sample.recipe.recompose(sample.recipe.render()) if reference else None,
    )
    output = checked_synthesis(method.synthesize(task), texture.image, sample.shape).image
    if not pixels_hash(output).startswith(row["pixels"]):
        raise ValueError(f"{row['texture']}, {row['method']}: the output is not the one that was labelled")
    observation = Observation(texture.image, output, texture, again=again if sample.recipe.procedural else None)
    metrics = {"regularity": Regularity(), "integrity": Integrity(), "quality": Quality()}
    return {
        f"{name}.{column}": value
        for name, metric in metrics.items()
        for column, value in metric.score(observation).values.items()
    }


def score_outputs(outputs: pd.DataFrame, photographs: str = "photographs") -> tuple[pd.DataFrame, list[str]]:
    """Return the outputs that could be made again, with their scores, and why the others could not.

    Parameters
    ----------
    outputs
        One row an output, with the columns :data:`OUTPUT`.
    photographs
        The folder of the pictures of the suite ``photographs``.
    """
    scored, lost = [], []
    for name, part in outputs.groupby("suite"):
        try:
            suite = load_suite(photographs if name == "photographs" else str(name))
            samples = {
                (sample.row.name, sample.recipe.replicate): sample
                for sample in draw_samples(suite, sorted(set(part["texture"])))
            }
        except BadInput as error:
            lost += [str(error)] * len(part)
            continue
        for row in part.to_dict("records"):
            sample = samples.get((row["texture"], row["replicate"]))
            if sample is None:
                lost.append(f"{row['texture']}: suite {name} has no draw {row['replicate']} of it")
                continue
            try:
                scored.append({**row, **score_output(sample, suite.seed, row)})
            except ValueError as error:
                lost.append(str(error))
    return pd.DataFrame(scored, columns=None if scored else OUTPUT), lost


def kappa(one: pd.Series[Any], other: pd.Series[Any]) -> float:
    """Return Cohen's kappa of two series of answers."""
    agreement = float((one == other).mean())
    answers = sorted({*one, *other})
    chance = sum(float((one == answer).mean() * (other == answer).mean()) for answer in answers)
    return (agreement - chance) / (1 - chance) if chance < 1 else 1.0


def main(path: Path, photographs: str) -> None:
    """Score all labelled outputs and print the agreement."""
    labels = read_labels(path)
    table, lost = score_outputs(labels[OUTPUT].drop_duplicates(ignore_index=True), photographs)
    print(f"{len(table)} outputs of {table['texture'].nunique()} textures; {len(lost)} cannot be made again")
    for why, count in Counter(lost).most_common(5):
        print(f"  {count} x {why}")
    if table.empty:
        return
    answers = labels.pivot(index=OUTPUT, columns=["question", "person"], values="answer")
    answers = answers.reindex(pd.MultiIndex.from_frame(table[OUTPUT]))
    scores = table.to_dict("records")
    for question in (LATTICE, ELEMENTS):
        if question.name not in answers or question.rule is None:
            continue
        given = answers[question.name]
        automatic = pd.Series([question.rule(values) for values in scores], given.index).astype(float)
        for one, other in itertools.combinations(given.columns, 2):
            print_kappa(f"{question.name}: {one} and {other}", given[one], given[other])
        for person in given.columns:
            print_kappa(f"{question.name}: automatic answer and {person}", automatic, given[person])
    if MORE.name not in answers:
        return
    for one, other in itertools.combinations(answers[MORE.name].columns, 2):
        print_kappa(f"{MORE.name}: {one} and {other}", answers[MORE.name][one], answers[MORE.name][other])
    if LATTICE.name in answers:
        print_steps(table, answers[LATTICE.name])
    asked = GRADE if GRADE in answers else MORE.name
    table["same"] = answers[asked].mean(axis=1).to_numpy()
    known = table[table[MORE.column].notna() & table["same"].notna()]
    print(f"quality and the {asked}: Spearman {spearmanr(known[MORE.column], known['same']).statistic:.2f}")
    methods = known[~known["method"].str.startswith("planted")]
    by_texture = [
        kendalltau(part[MORE.column], part["same"]).statistic
        for _, part in methods.groupby("texture")
        if len(part) >= 4 and part["same"].nunique() > 1 and part[MORE.column].nunique() > 1
    ]
    print(f"order of methods by texture: mean Kendall's tau {np.mean(by_texture):.2f} ({len(by_texture)} textures)")
    means = table.groupby("method")[[MORE.column, ELEMENTS.column, "same"]].mean()
    print(means.sort_values("same").round(2).to_string())


def print_steps(table: pd.DataFrame, kept: pd.DataFrame) -> None:
    """Print, by the size of a planted step of phase, how often the lattice is called lost, and by the verdict."""
    sizes = table["method"].str.extract(r"phase-step,size=([\d.]+)")[0].astype(float).to_numpy()
    verdicts = table[LATTICE.column].map({True: 0.0, False: 1.0}).to_numpy(float)
    frame = pd.DataFrame({"size": sizes, "labels": 1 - kept.mean(axis=1).to_numpy(), "verdict": verdicts})
    if frame["size"].notna().any():
        means = frame.dropna(subset="size").groupby("size")[["labels", "verdict"]].mean()
        print(f"share called lost, by the size of a planted step (s):\n{means.round(2).to_string()}")


def print_kappa(name: str, one: pd.Series[Any], other: pd.Series[Any]) -> None:
    """Print the kappa of two series of answers over those that both give."""
    both = one.notna() & other.notna()
    print(f"{name}: kappa {kappa(one[both], other[both]):.2f} (n {int(both.sum())})")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", nargs="?", type=Path, default=LABELS)
    parser.add_argument("--photographs", default="photographs", metavar="FOLDER", help="folder of photographs.csv")
    options = parser.parse_args()
    main(options.file, options.photographs)
