"""Whether labels given by two vision-language models agree with the scores.

``python benchmarks/labels.py [FILE.csv] [--photographs FOLDER] [--outputs FOLDER] [--sets NAME ...]``

``labels/outputs.csv``, which is read by default, holds sets of labels. Each row has the answers of two labelers, who
saw nothing but pictures, about one output: is the lattice kept (1 or 0), are the elements whole (1 or 0), does it look
like more of the same texture (1 or 0), and a grade of this likeness (1 to 5). ``labeled_by`` says what they are. The
suites of the textures stand beside it. Photographs are files in the FOLDER that ``--photographs`` names;
``prints.py`` draws the prints. Another file is a table ``labels.csv`` that ``nrbench report RUN --labels ...`` wrote.

Each output is made again, compared with the hash of its pixels, and scored. Outputs that differ are counted, and so are
outputs of pictures that are not there and of changed suites, which cannot be made again. Outputs in the FOLDER that
``--outputs`` names are read instead, and those that are made are kept there, under the hashes of their pixels.

For each set it prints Cohen's kappa of the labelers with each other and with the automatic answers; the correlation of
``quality.score`` with the grade (Spearman over all outputs, and Kendall's tau of the methods within a texture), for all
outputs, without planted ones, without references, and for five leading methods, each with a 95 % interval by bootstrap
over textures; the outputs on which grade and quality differ most; and, by the size of a planted step, how often the
lattice is called lost.
"""

import argparse
import contextlib
import itertools
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd
from prints import SUITE, draw_labeled

from nrbench import plugins
from nrbench.calling.method_calls import checked_synthesis
from nrbench.datasets_procedural.modelling.materials import MATERIALS, Material
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.labelling.labels import ANSWERS, ELEMENTS, LATTICE, MORE
from nrbench.pictures.files import read_image, write_image
from nrbench.plugins.forms import Again, Observation, Task
from nrbench.plugins.parameters import parse_spec
from nrbench.reports.statistics.estimates import Estimate
from nrbench.reports.statistics.labelers import JUDGE, compare_orders, compare_raters
from nrbench.running.phases import score_observation
from nrbench.streams import pixels_hash, stream
from nrbench.suites.plan import Sample, draw_samples
from nrbench.suites.suite import Suite, load_suite

FOLDER = Path(__file__).parent / "labels"
LABELS = FOLDER / "outputs.csv"
OUTPUT = ["set", "suite", "texture", "method", "lattice_source", "replicate", "pixels"]
"""The columns that identify an output of a set."""
ANSWER = ["labeled_by", "labeler", "question", "answer"]
GRADE = "grade"
REASON = "integrity.reason"
"""The column of the reason why integrity has no score."""
LEADING = ("fftm-patch", "graph-cuts", "regularized-patch", "rsgf", "tile-set")
"""The methods of the highest quality on ``default`` when the labels were given."""
FAR = {"high": (0.85, 2.5), "low": (0.4, 4.0)}
"""Quality and grade from which an output is listed: high quality with a low grade, and low quality with a high one."""
MATERIALS_THEN = {
    "clay": Material(
        grain=(0.03, 0.02, 0.01), soft=(0.03, 0.015, 0.0), speckles=(-0.05, -0.045, -0.04), relief=(0.03, 0.03, 0.03)
    ),
    "stone": Material(soft=(0.02, 0.025, 0.035), relief=(0.05, 0.05, 0.05), stains=(0.03, 0.02, 0.0), light=0.06),
    "cloth": Material(grain=(0.04, 0.03, 0.03), streaks=(0.04, 0.04, 0.05), speckles=(0.03, 0.03, 0.02), light=0.05),
}
"""The materials as they were when the labels of ``SUITES_THEN`` were given, before edges wore."""
SUITES_THEN = ("models", "frontier")
"""The suites of these labels."""
_STORED_QUESTIONS = {"lattice": LATTICE.name, "whole": ELEMENTS.name, "more": MORE.name, "grade": GRADE}
_VALUES = dict(zip(ANSWERS, (1.0, 0.0, np.nan), strict=True))


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
        table = table[table["again"] == "False"].assign(set=path.name)
        labels = table[OUTPUT + ANSWER].assign(answer=table["answer"].map(_VALUES))
    else:
        table = table.assign(lattice_source="given", replicate="0")
        parts = [
            table[[*OUTPUT, "labeled_by"]].assign(
                labeler=labeler, question=name, answer=pd.to_numeric(table[f"{labeler}_{column}"])
            )
            for labeler, (column, name) in itertools.product(("first", "second"), _STORED_QUESTIONS.items())
        ]
        labels = pd.concat(parts, ignore_index=True)
    return labels.assign(replicate=labels["replicate"].astype(int))


def make_output(sample: Sample, again: Again, seed: int, row: Mapping[str, Any], kept: Path | None = None) -> Image:
    """Return an output that was labeled: read from the folder ``kept`` if it is there, else made again.

    Raises
    ------
    ValueError
        When the pixels differ from those that were labeled, or the lattice came from a detector of its own.
    """
    file = kept / f"{row['pixels']}.png" if kept else None
    if file and file.exists():
        output = read_image(file)
    else:
        assert sample.texture is not None
        texture, method = sample.texture, plugins.build("synthesizers", *parse_spec(row["method"]))
        if row["lattice_source"] not in ("given", "own", "none"):
            raise ValueError(f"{row['texture']}, {row['method']}: the lattice of a detector is not detected again")
        given = row["lattice_source"] == "given" and getattr(method, "uses_lattice", True)
        reference = is_reference(row["method"])
        task = Task(
            texture.image,
            sample.shape,
            texture.lattice if given else None,
            stream("synthesis", seed, pixels_hash(texture.image), row["replicate"]),
            again=again if reference else None,
            recompose=sample.recipe.recompose(sample.recipe.render()) if reference else None,
        )
        output = checked_synthesis(method.synthesize(task), texture.image, sample.shape).image
    if not pixels_hash(output).startswith(row["pixels"]):
        raise ValueError(f"{row['texture']}, {row['method']}: the output is not the one that was labeled")
    if file and not file.exists():
        write_image(file, output)
    return output


def is_reference(method: str) -> bool:
    """Return whether a method is a reference, such as a fresh draw or a planted defect."""
    return bool(getattr(plugins.find("synthesizers", parse_spec(method)[0]).cls, "reference", False))


def score_output(sample: Sample, again: Again, output: Image) -> dict[str, Any]:
    """Return the scores of an output by ``metric.column``."""
    assert sample.texture is not None
    seen = Observation(sample.texture.image, output, sample.texture, again=again if sample.recipe.procedural else None)
    scores = {name: score_observation(seen, name) for name in ("regularity", "integrity", "quality")}
    values = {f"{name}.{column}": value for name, score in scores.items() for column, value in score.values.items()}
    return values | {REASON: scores["integrity"].reasons.get("score", "")}


@contextlib.contextmanager
def pictures_of(suite: Suite, photographs: Path) -> Iterator[Path]:
    """Yield the folder of the pictures of a suite: of prints, which are drawn, or of photographs."""
    if suite.name != load_suite(str(SUITE)).name:
        yield photographs
        return
    with tempfile.TemporaryDirectory() as folder:
        draw_labeled(Path(folder))
        yield Path(folder)


def score_outputs(
    outputs: pd.DataFrame, photographs: Path = FOLDER, kept: Path | None = None
) -> tuple[pd.DataFrame, list[str]]:
    """Return the outputs that could be made again, with their scores, and why the others could not.

    Parameters
    ----------
    outputs
        One row an output, with the columns :data:`OUTPUT`.
    photographs
        The folder of the photographs.
    kept
        The folder of outputs that are read instead of made, and where others are kept.
    """
    scored, lost = [], []
    for name, part in outputs.groupby("suite"):
        own = FOLDER / f"{name}.toml"
        try:
            suite, then = load_suite(str(own if own.exists() else name)), MATERIALS_THEN if name in SUITES_THEN else {}
            with pictures_of(suite, photographs) as folder, contextlib.chdir(folder), mock.patch.dict(MATERIALS, then):
                samples = {
                    (sample.row.name, sample.recipe.replicate): sample
                    for sample in draw_samples(suite, sorted(set(part["texture"])))
                    if sample.texture is not None
                }
                for (texture, replicate), rows in part.groupby(["texture", "replicate"]):
                    sample = samples.get((texture, replicate))
                    if sample is None:
                        lost += [f"suite {name} has no draw {replicate} of {texture}"] * len(rows)
                        continue
                    assert sample.texture is not None
                    again = sample.recipe.again(sample.texture)
                    for row in rows.to_dict("records"):
                        try:
                            output = make_output(sample, again, suite.seed, row, kept)
                            scored.append({**row, **score_output(sample, again, output)})
                        except ValueError as error:
                            lost.append(str(error))
        except BadInput as error:
            lost += [str(error)] * len(part)
    return pd.DataFrame(scored, columns=None if scored else OUTPUT), lost


def print_kappas(answers: pd.DataFrame, automatic: Mapping[str, Sequence[float | None]]) -> None:
    """Print the kappas of labelers with each other and of the automatic answers with them, by question."""
    words = {value: word for word, value in _VALUES.items()}
    textures = {str(i): texture for i, texture in enumerate(answers.index.get_level_values("texture"))}

    def name_answers(numbers: Sequence[float | None]) -> dict[str, str]:
        values = pd.Series(numbers, dtype=float)
        return {str(i): words.get(value, ANSWERS[2]) for i, value in enumerate(values)}

    for question in (LATTICE.name, ELEMENTS.name, MORE.name):
        if question not in answers:
            continue
        labelers = {name: name_answers(column) for name, column in answers[question].items()}
        pairs = [(*names, *(labelers[name] for name in names)) for names in itertools.combinations(labelers, 2)]
        judged = [(JUDGE, name, name_answers(automatic.get(question, ())), own) for name, own in labelers.items()]
        for group, raters in (("labelers", pairs), (JUDGE, judged if question in automatic else [])):
            if raters:
                kappa = compare_raters(raters, textures, group).decided
                print(f"  {question}: {group} with labelers: kappa of what both decide {text_of(kappa)}")


def print_orders(table: pd.DataFrame, of: str) -> None:
    """Print the agreement of ``quality.score`` with the grade or the share of yes, by the outputs that are compared."""
    outputs = table.assign(label=table["method"], score=table[MORE.column].astype(float))
    planted = outputs["method"].str.startswith("planted")
    names, rows = ["all", "without references", "leading five"], compare_orders(outputs, LEADING, "labelers")
    if planted.any():
        names.insert(1, "without planted ones")
        rows.insert(1, compare_orders(outputs[~planted], (), "labelers")[0])
    bounds = int((outputs["quality.complete"].eq(False) & outputs["score"].notna()).sum())
    print(f"  quality and the {of}; {bounds} are upper bounds, {outputs['score'].isna().sum()} unknown:")
    print("  outputs compared             n  textures  Spearman             tau                  pairs in order")
    for name, row in zip(names, rows, strict=True):
        parts = [text_of(part) for part in (row.spearman, row.tau, row.ordered)]
        print(f"  {name:24s} {row.n:5d} {row.tau.of:9d}  " + "".join(f"{part:21s}" for part in parts))


def text_of(estimate: Estimate) -> str:
    """Return an estimate with its interval."""
    ends = "" if estimate.ends is None else f" [{estimate.ends[0]:.2f}, {estimate.ends[1]:.2f}]"
    return "-" if estimate.value is None else f"{estimate.value:.2f}{ends}"


def print_far(table: pd.DataFrame) -> None:
    """Print the outputs on which the quality and the mean grade differ most."""
    quality, grade = table[MORE.column].astype(float), table["answer"]
    (high, poor), (low, good) = FAR["high"], FAR["low"]
    for text, chosen in (
        (f"quality >= {high}, grade <= {poor}", (quality >= high) & (grade <= poor)),
        (f"quality <= {low}, grade >= {good}", (quality <= low) & (grade >= good)),
    ):
        print(f"  {text}: {chosen.sum()} outputs")
        for row in table[chosen].to_dict("records"):
            print(f"    {row[MORE.column]:.2f}  {row['answer']:.1f}  {row['texture']}, {row['method']}")


def print_steps(table: pd.DataFrame, kept: pd.DataFrame) -> None:
    """Print, by the size of a planted step of phase, how often the lattice is called lost, and by the verdict."""
    sizes = table["method"].str.extract(r"phase-step,size=([\d.]+)")[0].astype(float).to_numpy()
    verdicts = table[LATTICE.column].map({True: 0.0, False: 1.0}).to_numpy(float)
    frame = pd.DataFrame({"size": sizes, "labels": 1 - kept.mean(axis=1).to_numpy(), "verdict": verdicts})
    if frame["size"].notna().any():
        means = frame.dropna(subset="size").groupby("size")[["labels", "verdict"]].mean()
        print(f"  share called lost, by the size of a planted step (s):\n{means.round(2).to_string()}")


def print_set(labels: pd.DataFrame, table: pd.DataFrame) -> None:
    """Print the agreement of one set of labels."""
    answers = labels.pivot(index=OUTPUT, columns=["question", "labeler"], values="answer")
    answers = answers.reindex(pd.MultiIndex.from_frame(table[OUTPUT]))
    records = [SimpleNamespace(values=row, reasons={ELEMENTS.column: row[REASON]}) for row in table.to_dict("records")]
    asked = [question for question in (LATTICE, ELEMENTS) if question.name in answers and question.rule]
    print_kappas(answers, {q.name: [q.rule(record) for record in records] for q in asked if q.rule})
    if LATTICE.name in answers:
        print_steps(table, answers[LATTICE.name])
    grade = GRADE if GRADE in answers else MORE.name
    if grade not in answers:
        return
    given = answers[grade]
    if grade == GRADE and given.shape[1] == 2:
        one, other = (given[name].to_numpy() for name in given)
        columns = {"label": table["method"], "score": one, "answer": other}
        ceiling, *_ = compare_orders(table.assign(**columns), LEADING, "labelers")
        print(f"  first and second labeler: Spearman of the grades {text_of(ceiling.spearman)}")
    table = table.assign(answer=given.mean(axis=1).to_numpy())
    print_orders(table, "grade" if grade == GRADE else "share of yes")
    if grade == GRADE:
        print_far(table)
    means = table.groupby("method")[[MORE.column, ELEMENTS.column, "answer"]].agg(lambda one: one.astype(float).mean())
    print(means.sort_values("answer").round(2).to_string())


def main(path: Path, photographs: Path, kept: Path | None, sets: Sequence[str]) -> None:
    """Score all labeled outputs and print the agreement, set by set."""
    begun, labels = time.process_time(), read_labels(path)
    for name in sets or labels["set"].unique():
        part = labels[labels["set"] == name]
        table, lost = score_outputs(part[OUTPUT].drop_duplicates(ignore_index=True), photographs, kept)
        who = ", ".join(f"{part['labeler'].nunique()} x {kind}" for kind in part["labeled_by"].unique())
        print(
            f"{name}, labeled by {who}: {len(table)} outputs of {table['texture'].nunique()} textures; "
            f"{len(lost)} cannot be made again"
        )
        for why, count in Counter(lost).most_common(5):
            print(f"  {count} x {why}")
        if not table.empty:
            print_set(part, table.assign(reference=[is_reference(method) for method in table["method"]]))
    print(f"{(time.process_time() - begun) / 60:.1f} CPU minutes")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", nargs="?", type=Path, default=LABELS)
    parser.add_argument("--photographs", type=Path, default=FOLDER, metavar="FOLDER", help="folder of the photographs")
    parser.add_argument("--outputs", type=Path, metavar="FOLDER", help="folder of outputs that are read, or kept")
    parser.add_argument("--sets", nargs="+", default=(), metavar="NAME", help="the sets of labels; by default all")
    options = parser.parse_args()
    main(options.file, options.photographs, options.outputs, options.sets)
