"""Scores of one cell, what of an output is a picture, and the pace of a run."""

import dataclasses
import json
from collections import Counter
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from suites import wall_suite

import nrbench
from nrbench import plugins, run
from nrbench.calling.method_calls import is_picture
from nrbench.plugins.forms import Observation, Score
from nrbench.running import phases
from nrbench.running.runner import Options, Pace, _interleave
from nrbench.runs.store import CellFolder
from nrbench.suites.cell import Cell, Recipe
from nrbench.suites.plan import PlannedSample


class Broken:
    """A metric that raises."""

    columns = {"value": None}

    def score(self, observation: Observation) -> Score:
        """Raise."""
        raise ArithmeticError("out of luck")


def pair() -> tuple[Any, Any, Any]:
    """Return a sample, an output of the same texture, and the lattice."""
    sample, output = (nrbench.texture("brick", shape=(side, side), seed=0, color=0.3) for side in (128, 160))
    return sample.image, output.image, sample.lattice


def test_a_metric_that_raises_takes_no_other_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its columns are None with the error as the reason; all others are scored."""
    build = plugins.build
    monkeypatch.setattr(
        plugins, "build", lambda kind, name, *rest: Broken() if name == "source" else build(kind, name, *rest)
    )
    sheet = nrbench.score(*pair()[:2], lattice=pair()[2], metrics=["source", "regularity"])
    assert sheet.values["source.value"] is None
    assert sheet.reasons["source.value"].startswith("failed: ArithmeticError: out of luck (test_phases.py, line ")
    assert sheet.values["regularity.preserved"] is True


@pytest.mark.parametrize(
    ("lattice", "reason"),
    [("2,0,0,2", "of the reference itself is out of place"), ("500,0,0,500", "fewer than three cells")],
)
def test_an_unsuitable_lattice_gives_a_reason(lattice: str, reason: str) -> None:
    """For a too fine or too coarse lattice, the verdict, the scores and the quality are None, and no metric fails."""
    sheet = nrbench.score(*pair()[:2], lattice=lattice)
    for name in ("regularity.preserved", "regularity.score", "regularity.misplaced_share", "quality.score"):
        assert sheet.values[name] is None and reason in sheet.reasons[name]
    assert not [why for why in sheet.reasons.values() if why.startswith("failed")]


def test_what_is_not_measured_is_not_zero() -> None:
    """For a constant output, drift and integrity cannot be measured: the columns are None, with a reason."""
    sample, output, lattice = pair()
    sheet = nrbench.score(sample, np.full_like(output, 0.5), lattice=lattice)
    assert sheet.values["regularity.preserved"] is False
    for name in ("regularity.drift", "regularity.lattice_exact", "integrity.score"):
        assert sheet.values[name] is None
        assert sheet.reasons[name]


def test_replicates_are_judged_by_the_same_draws(tmp_path: Path) -> None:
    """Two draws of a texture have truths of their own, but the fresh draws of the first one judge both."""
    suite = wall_suite(["scatter"], "cost", replicates=2)
    folders = [CellFolder(record.folder) for record in run(suite, out=tmp_path, options=Options(jobs=0)).cells]
    cells = [Cell.from_dict(json.loads(folder.cell_file.read_text())) for folder in folders]
    one, other = (phases.observe(folder, cell) for folder, cell in zip(folders, cells, strict=True))
    assert one.truth and other.truth and one.truth.lattice != other.truth.lattice
    assert one.again and other.again
    np.testing.assert_array_equal(one.again((64, 64), 3).image, other.again((64, 64), 3).image)


@pytest.mark.parametrize(
    ("extra", "picture"),
    [
        (np.full((5, 7, 3), 0.5, np.float32), True),
        (np.zeros((5, 7, 1)), True),
        (np.zeros((5, 7, 2)), False),
        (np.full((5, 7, 3), 1.5), False),
        (np.full((5, 7, 3), np.nan), False),
        (np.zeros((5, 7, 3), np.int64), False),
        (np.zeros((0, 7, 3)), False),
        (np.zeros((5, 7)), False),
    ],
)
def test_pictures_among_extras(extra: NDArray[np.generic], picture: bool) -> None:
    """Only floats in [0, 1] of one or three channels are written as pictures; displacements and tables are not."""
    assert is_picture(extra) is picture


def make_cells(labels: list[str]) -> list[Cell]:
    """Return cells that differ in their methods."""
    recipe = Recipe("brick", {}, 0, "wall", 0, (64, 64))
    first = Cell("s", "wall", recipe, "m", "1", {}, "m", False, "none", 0, 0, (64, 64), "")
    return [dataclasses.replace(first, label=label) for label in labels]


def test_the_time_left_knows_each_methods_pace() -> None:
    """Each method counts with its own mean; as long as one is unknown, nothing is estimated."""
    cells = make_cells(["first", "fast", "slow", "fast", "slow", "fast"])
    pace = Pace(cells)
    steps = [pace.step(cell, "ok", seconds, 2) for cell, seconds in zip(cells[:4], (60.0, 1.0, 9.0, 3.0), strict=True)]
    assert [step.remaining for step in steps] == [None, None, (9 + 2 * 1) / 2, (9 + 2) / 2]
    assert steps[-1].remaining_text == "about 6 s left"
    last = [pace.step(cell, status, None, 2) for cell, status in zip(cells[4:], ("error", "ok"), strict=True)][-1]
    assert (last.done, last.cached, last.failed, last.remaining, last.remaining_text) == (6, 2, 1, 0, "")


def test_the_time_left_knows_what_a_new_texture_costs() -> None:
    """First cells of textures have a mean of their own, in which those that started a worker do not count."""
    cells = [
        dataclasses.replace(cell, texture=texture)
        for texture in ("wall", "cloth", "mesh", "tiles")
        for cell in make_cells(["first", "slow"])
    ]
    pace = Pace(cells)
    walls = (60.0, 9.0, 3.0, 9.0, 5.0)
    steps = [pace.step(cell, "ok", seconds, 1) for cell, seconds in zip(cells, walls, strict=False)]
    assert [step.remaining for step in steps] == [None, None, 9 + 2 * (3 + 9), 2 * (3 + 9), 9 + (4 + 9)]


def test_a_fast_worker_finds_cells_of_its_own_texture() -> None:
    """As many textures as workers are open; whichever ends cells faster gets more of its own, and then the next one."""
    cells = [dataclasses.replace(cell, texture=name) for name in "abc" for cell in make_cells(["m"] * 6)]
    running: Counter[str] = Counter()
    order = _interleave([(cell, cast("PlannedSample", None)) for cell in cells], 2, running)
    assert "".join(next(order)[0].texture for _ in range(4)) == "abab"
    for expected in "bbbbcccccc":
        running["b" if running["b"] > 1 else "c"] -= 1
        assert next(order)[0].texture == expected
    assert "".join(cell.texture for cell, _ in order) == "aaaa"


def test_a_run_of_cached_cells_has_no_pace() -> None:
    """Nothing is estimated before a cell was run."""
    cells = make_cells(["one", "other"])
    assert Pace(cells).step(cells[0], "ok", None, 1).remaining is None
