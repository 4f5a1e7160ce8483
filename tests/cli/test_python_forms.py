"""Each verb of the command line has a function that says the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import call

import nrbench

CHOICE = "core -m scatter -t brick-mild --size 64x64"
WORDS = {"methods": "scatter", "textures": "brick-mild", "size": "64x64"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> nrbench.Run:
    """Return a run of one cell."""
    options = nrbench.Options(jobs=0)
    return nrbench.run("core", **WORDS, metrics=["cost"], out=tmp_path_factory.mktemp("run") / "one", options=options)  # type: ignore[arg-type]


def test_plan_says_what_the_command_says(capsys: pytest.CaptureFixture[str]) -> None:
    """``plan`` returns the rows that ``nrbench plan --json`` prints."""
    assert call(f"plan {CHOICE} --json") == 0
    assert nrbench.plan("core", **WORDS).to_dict("records") == json.loads(capsys.readouterr().out)["cells"]  # type: ignore[arg-type]


def test_status_says_what_the_command_says(made: nrbench.Run, capsys: pytest.CaptureFixture[str]) -> None:
    """``status`` returns what ``nrbench status --json`` prints, for a run and for its directory."""
    assert call("status", str(made.root), "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told == nrbench.status(made) == nrbench.status(made.root)
    assert told["status"] == {"ok": 1}


def test_report_writes_the_formats_of_its_text(made: nrbench.Run) -> None:
    """``report`` writes the named formats alone; a report that is not known is refused."""
    assert {path.suffix for path in nrbench.report(made, "markdown,text")} == {".md", ".txt"}
    with pytest.raises(nrbench.BadInput, match="did you mean 'latex'"):
        nrbench.report(made, "latx")


def test_label_writes_the_page_and_refuses_a_share_above_one(made: nrbench.Run) -> None:
    """``label`` writes a page beside its key, and a share must be from 0 to 1."""
    page = nrbench.label(made, repeat=0)
    assert page.suffix == ".html" and page.with_suffix(".json").is_file()
    with pytest.raises(nrbench.BadInput, match="share from 0 to 1"):
        nrbench.label(made, repeat=2)


def test_site_takes_runs_and_directories(made: nrbench.Run, tmp_path: Path) -> None:
    """``site`` makes its directory and takes runs as well as their directories."""
    assert (tmp_path / "new" / "index.html") in nrbench.site([made, str(made.root)], tmp_path / "new")


def test_list_and_show_say_what_the_commands_say(capsys: pytest.CaptureFixture[str]) -> None:
    """The functions hold what the commands print; an unknown kind is refused with the nearest one."""
    assert call("list --json") == 0
    told = json.loads(capsys.readouterr().out)
    listed = nrbench.list_plugins()
    assert {kind: [row["name"] for row in rows] for kind, rows in told.items()} == {
        kind: rows["name"].tolist() for kind, rows in listed.groupby("kind", sort=False)
    }
    assert call("show rsgf") == 0
    assert repr(nrbench.show_plugin("rsgf")) == capsys.readouterr().out.rstrip("\n")
    with pytest.raises(nrbench.BadInput, match="did you mean 'metrics'"):
        nrbench.list_plugins("metric")


def test_new_takes_the_kinds_of_the_command(tmp_path: Path) -> None:
    """``new_plugin`` writes the package of ``nrbench new``, and refuses a kind that is none."""
    assert {path.parent for path in nrbench.new_plugin("metric", "sharpness", str(tmp_path / "m"))} == {tmp_path / "m"}
    with pytest.raises(nrbench.BadInput, match="did you mean 'metric'"):
        nrbench.new_plugin("metrics", "sharpness")
