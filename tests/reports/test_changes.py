"""The comparison of two runs: what counts as better, worse, the same, and noise."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import call

from nrbench import run
from nrbench.reports.changes import RunChanges, compare_runs
from nrbench.running.runner import Options
from nrbench.runs.records import Run

from .conftest import cell_maker, run_maker


@pytest.fixture
def runs(tmp_path: Path) -> Callable[..., tuple[Run, Run]]:
    """Return a maker of two runs with the given quality of each texture and a given method."""

    def make(first: list[float], second: list[float], method: str = "rsgf", **more: Any) -> tuple[Run, Run]:
        made = []
        for name, values in (("A", first), ("B", second)):
            make_cell, make_run = cell_maker(tmp_path / name), run_maker(tmp_path / name)
            cells = [make_cell(f"t{i}", method, perils=value, **more) for i, value in enumerate(values)]
            made.append(make_run(cells))
        return made[0], made[1]

    return make


def states(changes: RunChanges) -> dict[str, str]:
    """Return the state of each score of the only method."""
    return {change.score: change.state for change in changes.changes}


def test_equal_runs_are_the_same(runs: Callable[..., tuple[Run, Run]]) -> None:
    """Runs with equal scores differ in nothing, and nothing is worse."""
    changes = compare_runs(*runs([0.2, 0.5, 0.9], [0.2, 0.5, 0.9]))
    assert set(states(changes).values()) == {"same"}
    assert not changes.worse and not changes.newly_failed and changes.equal_samples == changes.pairs == 3


@pytest.mark.parametrize(("shift", "state"), [(0.1, "better"), (-0.1, "worse")])
def test_a_shift_of_every_texture_is_no_noise(runs: Callable[..., tuple[Run, Run]], shift: float, state: str) -> None:
    """A loss of 0.1 on each of six textures is found, with its size, and in the right direction."""
    before = [0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    changes = compare_runs(*runs(before, [value + shift + i % 2 / 100 for i, value in enumerate(before)]))
    assert states(changes)["quality"] == state
    quality = next(change for change in changes.changes if change.score == "quality")
    assert quality.difference.value == pytest.approx(shift + 0.005) and quality.before == pytest.approx(0.55)
    assert bool(changes.worse) == (state == "worse")


def test_a_change_of_both_signs_is_noise(runs: Callable[..., tuple[Run, Run]]) -> None:
    """Textures that move up and down by the same amount show no change of the mean."""
    changes = compare_runs(*runs([0.4, 0.5, 0.6, 0.7, 0.5, 0.6], [0.5, 0.4, 0.7, 0.6, 0.6, 0.5]))
    assert states(changes)["quality"] == "noise" and not changes.worse


def test_five_textures_are_too_few(runs: Callable[..., tuple[Run, Run]]) -> None:
    """Five textures carry no test, so nothing is called worse."""
    changes = compare_runs(*runs([0.9] * 5, [0.1] * 5))
    assert states(changes)["quality"] == "unknown" and not changes.worse


def test_two_sided_and_lower_scores_know_their_better_way(tmp_path: Path) -> None:
    """A variation that moves from 0.5 to 0.9 is better, one from 1.1 to 1.5 is worse, as is more repetition."""
    made = []
    for name, low, high, twins in (("A", 0.5, 1.1, 0.1), ("B", 0.9, 1.5, 0.3)):
        make_cell, make_run = cell_maker(tmp_path / name), run_maker(tmp_path / name)
        cells = [
            make_cell(f"t{i}", method, values={"randomness.variation": value + i / 100, "randomness.repetition": twins})
            for i in range(7)
            for method, value in (("low", low), ("high", high))
        ]
        made.append(make_run(cells))
    changes = compare_runs(*made, ["randomness.variation", "randomness.repetition"])
    found = {(change.method, change.score): change.state for change in changes.changes}
    assert found["low (own)", "randomness.variation"] == "better"
    assert found["high (own)", "randomness.variation"] == "worse"
    assert found["low (own)", "randomness.repetition"] == "worse"


def test_references_and_wall_times_are_no_reason_to_fail(runs: Callable[..., tuple[Run, Run]]) -> None:
    """A reference that is worse is shown but does not count; the seconds count only if they are named."""
    changes = compare_runs(*runs([0.9, 0.8, 0.7] * 3, [0.3, 0.2, 0.0] * 3, reference=True))
    assert states(changes)["quality"] == "worse" and not changes.worse
    first, second = runs([0.5, 0.6, 0.7] * 3, [0.5, 0.6, 0.7] * 3)
    for i, record in enumerate(second.cells):
        record.result["seconds"] = 9.0 + i
    assert states(compare_runs(first, second))["seconds"] == "worse" and not compare_runs(first, second).worse
    assert [change.score for change in compare_runs(first, second, ["seconds"]).worse] == ["seconds"]


def test_more_failures_and_missing_methods_are_told(tmp_path: Path) -> None:
    """A method that is gone, one that is new, and a cell that fails now are named."""
    made = []
    for name, status, other in (("A", "ok", "old"), ("B", "crash", "new")):
        make_cell, make_run = cell_maker(tmp_path / name), run_maker(tmp_path / name)
        made.append(make_run([make_cell("t0", status=status), make_cell("t0", other)]))
    changes = compare_runs(*made)
    assert changes.newly_failed == ["rsgf (own)"]
    assert (changes.only_first, changes.only_second) == (["old (own)"], ["new (own)"])
    assert any("1 ok in the first run, 1 failed in the second" in note for note in changes.notes)


def _draws(root: Path, values: np.ndarray, sample: str, failed: int = -1) -> Run:
    """Return a run of textures by draws, whose samples are named after ``sample``."""
    make_cell, make_run = cell_maker(root), run_maker(root)
    cells = []
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            status = "error" if i == failed else "ok"
            cells.append(make_cell(f"t{i}", replicate=j, perils=float(value), status=status))
            object.__setattr__(cells[-1].cell, "sample_hash", f"{sample}-{i}-{j}")
    return make_run(cells)


def test_other_draws_are_no_change_and_a_shift_of_them_is(tmp_path: Path) -> None:
    """Two seeds of one code do not differ, whatever their numbers of draws; a loss of 0.15 everywhere is found."""
    rng = np.random.default_rng(0)
    level = rng.uniform(0.4, 0.8, (24, 1))
    first, second, third = (level + rng.normal(0, 0.05, (24, draws)) for draws in (2, 2, 3))
    before = _draws(tmp_path / "A", first, "a")
    same = compare_runs(before, _draws(tmp_path / "B", second, "b"), ["quality"])
    worse = compare_runs(before, _draws(tmp_path / "C", third - 0.15, "c"), ["quality"])
    assert (states(same)["quality"], states(worse)["quality"]) == ("noise", "worse")
    assert worse.equal_samples == 0 and worse.changes[0].difference.n == 24
    assert worse.changes[0].difference.value == pytest.approx(third.mean() - 0.15 - first.mean(), abs=1e-9)


def test_equal_samples_are_paired(tmp_path: Path) -> None:
    """A loss of 0.02, far below the scatter between draws, is found where the samples are equal."""
    values = np.random.default_rng(0).uniform(0.3, 0.9, (20, 2))
    changes = compare_runs(
        _draws(tmp_path / "A", values, "a"), _draws(tmp_path / "B", values - np.array([0.03, 0.01]), "a"), ["quality"]
    )
    (change,) = changes.changes
    assert change.state == "worse" and change.difference.ends == pytest.approx((-0.02, -0.02), abs=0.01)


def test_a_failure_of_another_draw_is_no_new_failure(tmp_path: Path) -> None:
    """A cell that fails on the same sample is listed; one that fails on another draw counts among the scores."""
    values = np.full((8, 1), 0.5)
    before = _draws(tmp_path / "A", values, "a")
    assert compare_runs(before, _draws(tmp_path / "B", values, "a", failed=3)).newly_failed == ["rsgf (own)"]
    other = compare_runs(before, _draws(tmp_path / "C", values, "c", failed=3))
    assert not other.newly_failed and states(other)["failed"] == "noise"


@pytest.fixture(scope="module")
def tiny_runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return two runs of one texture with different seeds."""
    folder = tmp_path_factory.mktemp("tiny")
    for seed in (0, 1):
        run(
            "core",
            methods="quilting",
            textures="brick-mild",
            out=folder / str(seed),
            options=Options(jobs=0),
            seed=seed,
            size="128x128",
            metrics=["quality", "regularity"],
        )
    return folder / "0", folder / "1"


def test_the_command_decides_by_its_exit_code(tiny_runs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    """`compare` exits with 0, with 1 where a limit is missed or a score is worse, and with 2 for bad input."""
    before, after = map(str, tiny_runs)
    assert call("compare", before, before, "--fail-on-worse") == 0
    assert "within draws" not in capsys.readouterr().out
    assert call("compare", before, after, "--json", "--fail-under", "appearance.color_distance=1e9") == 2
    assert call("compare", before, after, "--fail-under", "x") == 2
    assert call("compare", before, after, "--columns", "quality.scor") == 2
    assert call("compare", before, "missing") == 2
    older = Path(before).with_name("older")
    shutil.copytree(before, older)
    info = json.loads((older / "run.json").read_text("utf-8"))
    (older / "run.json").write_text(json.dumps({**info, "results_version": 1}), "utf-8")
    assert call("compare", str(older), before) == 0
    assert call("compare", str(older), before, "--fail-on-worse") == 2
    assert call("compare", before, after, "--json", "--markdown") == 2
    capsys.readouterr()
    assert call("compare", before, after, "--json", "--fail-under", "2", "--fail-under", "preserved=0") == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["failures"] and "is not at least 2" in printed.err
