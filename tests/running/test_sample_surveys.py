"""The survey of a sample is made once for all methods of a run."""

import json
import time
from pathlib import Path

import pytest

import nrbench
from nrbench.calling.bent_samples import SampleSurvey
from nrbench.plugins.forms import Synthesizer, Task
from nrbench.running import phases


def execute(out: Path, methods: list[str], texture: str = "brick-mild") -> list[nrbench.CellRecord]:
    """Return the cells of methods on a texture that is given its lattice."""
    options = nrbench.Options(jobs=0)
    done = nrbench.run(
        "default" if texture == "hexagon-bent" else "core",
        methods=methods,
        textures=texture,
        replicates=1,
        lattice="given",
        size="64x64",
        metrics=["cost"],
        out=out,
        options=options,
    )
    return done.cells


def test_a_survey_is_made_once_and_its_cost_counts_for_each_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second method reads the survey of the first; its seconds include those of the survey, its output none."""
    (first,) = execute(tmp_path / "run", ["rsgf"])
    (file,) = (tmp_path / "run" / "prepared").glob("*.json")
    kept = json.loads(file.read_text("utf-8"))
    kept["spent"]["seconds"] = 100.0
    file.write_text(json.dumps(kept), "utf-8")
    monkeypatch.setattr(phases, "survey_sample", None)  # nothing may call it again
    second = execute(tmp_path / "run", ["rsgf:block=20"])[0]
    assert second.status == "ok" and second.seconds is not None and second.seconds > 100
    assert first.seconds is not None and first.seconds < 100


def test_a_bent_sample_is_surveyed_once_by_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second method finds the bent sample straightened, and its output is that of a process that did it itself."""
    (alone,) = execute(tmp_path / "alone", ["tile-set"], "hexagon-bent")
    surveyed, survey = [], phases.survey_sample

    def survey_slowly(method: Synthesizer, task: Task) -> SampleSurvey | None:
        surveyed.append(method)
        time.sleep(0.1)
        return survey(method, task)

    monkeypatch.setattr(phases, "survey_sample", survey_slowly)
    cells = execute(tmp_path / "run", ["rsgf", "tile-set"], "hexagon-bent")
    assert len(surveyed) == 1 and not list((tmp_path / "run" / "prepared").glob("*.json"))
    assert all(cell.seconds is not None and cell.seconds > 0.1 for cell in cells)
    (second,) = (cell for cell in cells if cell.method == "tile-set")
    assert second.note == alone.note and "bent by" in second.note
    assert (second.folder / "output.png").read_bytes() == (alone.folder / "output.png").read_bytes()
