"""The benchmark of labels reads both forms of its files alike, and recognizes the outputs that it makes again."""

import contextlib
from pathlib import Path
from types import ModuleType
from unittest import mock

import numpy as np
import pandas as pd
import pytest

from nrbench.labelling.labels import QUESTIONS
from nrbench.streams import pixels_hash
from nrbench.suites.plan import draw_samples
from nrbench.suites.suite import load_suite


def test_stored_labels_are_read(script: ModuleType) -> None:
    """The stored file holds six sets of outputs, each with the answers of two labelers to all questions."""
    labels = script.read_labels(script.LABELS)
    counts = labels.groupby(["set", "labeler", "question"]).size()
    assert set(counts.index.get_level_values("question")) == {*QUESTIONS, script.GRADE}
    assert set(counts.index.get_level_values("labeler")) == {"first", "second"}
    assert {name: set(part) for name, part in counts.groupby("set")} == {
        "models-1": {334},
        "models-2": {118},
        "photographs": {62},
        "photographs-2": {113},
        "models-3": {36},
        "prints": {24},
    }
    assert set(labels["labeled_by"]) == {"vision-language model"}
    assert set(labels[labels["question"] == script.GRADE]["answer"]) == {1.0, 2.0, 3.0, 4.0, 5.0}
    assert labels["answer"].isna().sum() == 2 and set(labels["lattice_source"]) == {"given"}


def test_labeled_textures_stay_as_they_were(script: ModuleType) -> None:
    """A labeled output on a texture with a material is made again to the byte, with the material of then."""
    labels = script.read_labels(script.LABELS)
    rows = labels[labels["texture"].eq("brick-middle-rotated") & labels["method"].eq("tiling")][script.OUTPUT]
    (row,) = rows.drop_duplicates().to_dict("records")
    suite = load_suite(str(script.FOLDER / "models.toml"))
    with mock.patch.dict(script.MATERIALS, script.MATERIALS_THEN):
        (sample,) = draw_samples(suite, ["brick-middle-rotated"])
        output = script.make_output(sample, sample.recipe.again(sample.texture), suite.seed, row)
    assert pixels_hash(output).startswith(row["pixels"])


@pytest.mark.parametrize("method", ["oracle", "precomputed:directory=invented"])
def test_labeled_prints_are_drawn_again(script: ModuleType, tmp_path: Path, method: str) -> None:
    """A fresh draw of a print, and one of invented colors, are made again to the byte."""
    labels = script.read_labels(script.LABELS)
    rows = labels[labels["texture"].eq("checks-candy") & labels["method"].eq(method)][script.OUTPUT].drop_duplicates()
    suite = load_suite(str(script.FOLDER / "prints.toml"))
    with script.pictures_of(suite, tmp_path) as folder, contextlib.chdir(folder):
        (sample,) = draw_samples(suite, ["checks-candy"])
        again = sample.recipe.again(sample.texture)
        (output,) = (script.make_output(sample, again, suite.seed, row) for row in rows.to_dict("records"))
    assert pixels_hash(output).startswith(rows["pixels"].item())


def test_labels_of_a_report_are_read(script: ModuleType, tmp_path: Path) -> None:
    """Yes is 1, no is 0 and "cannot say" is no number; second showings are left out."""
    rows = [
        ["ada", "person", "core", "a", "rsgf:block=30", "own", 1, again, question, answer, "f00d"]
        for question, answer, again in (
            ("lattice", "yes", False),
            ("elements", "no", False),
            ("more", "cannot say", False),
            ("lattice", "no", True),
        )
    ]
    columns = ["labeler", "labeled_by", *script.OUTPUT[1:-1], "again", "question", "answer", "pixels"]
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "labels.csv", index=False)
    labels = script.read_labels(tmp_path / "labels.csv")
    assert labels["question"].tolist() == ["lattice", "elements", "more"]
    assert labels["answer"].tolist() == pytest.approx([1.0, 0.0, np.nan], nan_ok=True)
    assert labels[script.OUTPUT].drop_duplicates().to_numpy().tolist() == [
        ["labels.csv", "core", "a", "rsgf:block=30", "own", 1, "f00d"]
    ]
