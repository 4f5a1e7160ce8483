"""The survey of a sample is made once for all methods of a run."""

import json
from pathlib import Path

import pytest

import nrbench
from nrbench.running import phases


def execute(out: Path, methods: list[str]) -> list[nrbench.CellRecord]:
    """Return the cells of methods on a wall that is given its lattice."""
    options = nrbench.Options(jobs=0)
    done = nrbench.run(
        "core",
        methods=methods,
        textures="brick-mild",
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
