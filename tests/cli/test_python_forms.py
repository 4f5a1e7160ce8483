"""Each verb of the command line has a function that says the same."""

from __future__ import annotations

import inspect
import json
import os
from pathlib import Path
from typing import Any

import pytest
from commands import call

import nrbench
from nrbench.cli.main import VERBS
from nrbench.cli.main import nrbench as program

FUNCTIONS = {verb: getattr(nrbench, verb, None) for verb in VERBS} | {
    "list": nrbench.list_plugins,
    "show": nrbench.show_plugin,
    "synth": nrbench.synthesize,
    "render": nrbench.render_textures,
    "new": nrbench.new_plugin,
}
"""The function of each verb. Those of `check` and `lattice` take what the commands find in files and folders."""
IN_PYTHON = {"progress", "options", "parameters", "changes", "tell_failure"}
"""Parameters for programs, which the command line fills itself or writes within the name of a plugin."""
CHOICE = "core -m scatter -t brick-mild --size 64x64"
WORDS = {"methods": "scatter", "textures": "brick-mild", "size": "64x64"}


@pytest.mark.parametrize("verb", sorted({*VERBS} - {"check", "lattice"}))
def test_a_command_and_its_function_have_the_same_options(verb: str) -> None:
    """Each parameter of the function is an option of the command with the same default, and each has a help."""
    command: Any = program.get_command(None, verb)  # type: ignore[arg-type]
    given = {option.name: option for option in command.params}
    signature = inspect.signature(FUNCTIONS[verb]).parameters  # type: ignore[arg-type]
    parameters = {name: each.default for name, each in signature.items() if name not in IN_PYTHON}
    assert command.function is FUNCTIONS[verb] and parameters.keys() <= given.keys()
    for name, default in parameters.items():
        assert given[name].required == (default is inspect.Parameter.empty), name
        assert given[name].required or (given[name].to_info_dict()["default"] or None) == (default or None), name
    how = {name: each.default for name, each in inspect.signature(nrbench.Options).parameters.items()}
    for name in given.keys() & how.keys() - {"jobs"}:
        assert (given[name].to_info_dict()["default"] or None) == (how[name] or None), name
    assert nrbench.Options().jobs == (os.cpu_count() or 1)
    assert all(option.help for option in command.params if option.param_type_name == "option")


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


def test_few_frames_lead_from_main_to_execute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the entry point and the runner stand at most two functions of nrbench."""
    seen: list[str] = []

    def stop(*_: object, **__: object) -> None:
        frames = [frame.function for frame in inspect.stack() if "/nrbench/" in frame.filename]
        seen.extend(frames[: frames.index("main") + 1])
        raise KeyboardInterrupt

    monkeypatch.setattr("nrbench.running.runner.execute", stop)
    assert call(f"run {CHOICE} --out r") == 130
    assert seen[-1] == "main" and len(seen) <= 3
