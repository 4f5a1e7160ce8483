"""The benchmark of graders reads answers by their key, and counts them by method."""

from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from nrbench.errors import BadInput
from nrbench.pictures.files import write_image
from nrbench.streams import pixels_hash

METHODS = ("fftm-patch", "resample", "rsgf", "tile-set")


@pytest.fixture
def run(tmp_path: Path) -> SimpleNamespace:
    """Return a run of four methods on three regions; one method failed on one of them."""
    rng, cells = np.random.default_rng(0), []
    for texture in ("a", "b", "c"):
        for method in METHODS:
            folder = tmp_path / texture / method
            folder.mkdir(parents=True)
            for name, side in (("sample", 16), ("output", 24)):
                write_image(folder / f"{name}.png", rng.random((side, side, 3)).astype(np.float32))
            status = "refused" if (texture, method) == ("c", "rsgf") else "ok"
            cells.append(SimpleNamespace(texture=texture, method=method, folder=folder, status=status, result={}))
    return SimpleNamespace(cells=cells)


def key_of(script: ModuleType, run: SimpleNamespace, name: str = "first") -> pd.DataFrame:
    """Return the key of what is shown of a run."""
    return script.make_key(script.pair_outputs(run, 46), name, "photographs-3")


def answer(key: pd.DataFrame, file: Path, **columns: list[str]) -> Path:
    """Write answers to all pairs: by default equal, and nothing odd."""
    n = len(key)
    defaults = {"better": ["equal"] * n, "odd_a": ["0"] * n, "odd_b": ["0"] * n, "why": [""] * n}
    pd.DataFrame({"number": key["number"], **defaults, **columns}).to_csv(file, index=False)
    return file


def test_each_pair_has_one_output_of_resample(script: ModuleType, run: SimpleNamespace) -> None:
    """`resample` is shown with each other method that has an output, on both sides; the key has the pixels shown."""
    key = key_of(script, run)
    pairs = {(row.texture, *sorted((row.a, row.b))) for row in key.itertuples()}
    assert pairs == {
        (texture, *sorted(("resample", other)))
        for texture in "abc"
        for other in METHODS
        if other != "resample" and (texture, other) != ("c", "rsgf")
    }
    assert key["number"].tolist() == [str(number) for number in range(1, 9)]
    assert {*key["a"]} & {"resample"} and {*key["b"]} & {"resample"}
    row, files = key.iloc[0], {(cell.texture, cell.method): cell.folder / "output.png" for cell in run.cells}
    assert pixels_hash(script.read_image(files[row["texture"], row["b"]])).startswith(row["b_pixels"])


def test_pages_tell_no_method(script: ModuleType, run: SimpleNamespace, tmp_path: Path) -> None:
    """Each pair has a page of its own, which is no larger than what is shown at full size; its name is a number."""
    pages = script.write_pages(script.pair_outputs(run, 46), tmp_path / "pages")
    assert [page.name for page in pages] == [f"page_{number:02d}.png" for number in range(1, 9)]
    height, width, _ = script.read_image(pages[0]).shape
    assert height <= 600 and width <= 1600


def test_preferences_and_oddities_follow_the_key(script: ModuleType, run: SimpleNamespace, tmp_path: Path) -> None:
    """A grader who always names the side of `resample` prefers it always; what she calls odd belongs to its method."""
    key = key_of(script, run)
    better = np.where(key["a"] == "resample", "A", "B").tolist()
    odd = {f"odd_{side}": key[side].eq("rsgf").astype(int).astype(str).tolist() for side in "ab"}
    answers = script.read_answers(key, answer(key, tmp_path / "ada.csv", better=better, **odd), "person")
    assert set(answers["grader"]) == {"ada"} and list(answers.columns) == script.STORED
    assert script.preferences(answers)["value"].eq(1).all()
    means = script.oddities(answers).groupby("method")["value"].mean()
    assert means.to_dict() == {"fftm-patch": 0, "resample": 0, "rsgf": 1, "tile-set": 0}
    other = script.read_answers(key, answer(key, tmp_path / "ada.csv"), "person")
    assert script.preferences(other)["value"].eq(0.5).all()


def test_wrong_answers_are_refused(script: ModuleType, run: SimpleNamespace, tmp_path: Path) -> None:
    """An answer that is not allowed, a missing number, and other columns are named."""
    key, file = key_of(script, run), tmp_path / "ada.csv"
    for columns, message in (
        ({"better": ["C"] * 8}, "better of number 1 is 'C'"),
        ({"odd_a": [""] * 8}, "odd_a of number 1"),
        ({"number": ["1", *key["number"][1:7], "1"]}, "missing, unknown or answered twice"),
        ({"sure": ["1"] * 8}, "expected columns number,better"),
    ):
        with pytest.raises(BadInput, match=message):
            script.read_answers(key, answer(key, file, **columns), "person")


def test_prints_are_shown_singly_beside_fresh_draws(script: ModuleType, run: SimpleNamespace, tmp_path: Path) -> None:
    """Where the run has fresh draws, each output and each draw is shown alone, and asked whether it is odd."""
    for cell in run.cells:
        cell.method = {"rsgf": "oracle"}.get(cell.method, cell.method)
    run.cells = [cell for cell in run.cells if cell.method in ("resample", "oracle")]
    key = key_of(script, run)
    assert set(key["b"]) == {""} and sorted(key["a"]) == ["oracle"] * 2 + ["resample"] * 3
    rows = {"number": key["number"], "odd": key["a"].eq("resample").astype(int), "why": ""}
    pd.DataFrame(rows).to_csv(tmp_path / "ada.csv", index=False)
    answers = script.read_answers(key, tmp_path / "ada.csv", "person")
    assert script.preferences(answers).empty
    assert script.oddities(answers).groupby("method")["value"].mean().to_dict() == {"oracle": 0, "resample": 1}


def test_stored_answers_are_counted_once(
    script: ModuleType, run: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Answers that are added twice count once, and the share is the mean over regions."""
    monkeypatch.setattr(script, "ANSWERS", tmp_path / "graders.csv")
    key = key_of(script, run)
    key.to_csv(tmp_path / "key.csv", index=False)
    for _ in range(2):
        script.add(tmp_path, [answer(key, tmp_path / "ada.csv")], "person")
    stored = pd.read_csv(tmp_path / "graders.csv", dtype=str, keep_default_na=False)
    assert len(stored) == len(key)
    rows = pd.DataFrame({"texture": ["a", "a", "a", "b"]})
    assert script.share_text(rows, pd.Series([1, 1, 1, 0])).startswith("0.50 [")
