"""A metric and a report in a file: the folder of the report exists, own columns are shown, failures are folded."""

from pathlib import Path

import pytest
from commands import call

from nrbench import plugins

PLUGINS = '''
from dataclasses import dataclass
from typing import ClassVar

from nrbench.plugins.forms import Column, Score


@dataclass(frozen=True)
class Brightness:
    """Brightness of the output."""

    columns: ClassVar = {"mean": Column("Mean of all pixels of the output.")}

    def score(self, observation):
        return Score({"mean": float(observation.output.mean())})


@dataclass(frozen=True)
class Careless:
    """A metric that forgets to make a Score."""

    name: ClassVar[str] = "no-score"
    columns: ClassVar = {"value": Column("A value.")}

    def score(self, observation):
        return 0.5


@dataclass(frozen=True)
class Listing:
    """A list of the cells, in a folder of its own."""

    folder: ClassVar[str] = "lists/mine"

    def write(self, run, directory):
        path = directory / "list.txt"
        path.write_text(str(len(run.cells)))
        return [path]
'''
SUITE = """
name = "small"
sample = "48x48"
size = "64x64"
methods = ["tiling", "oracle"]
lattice = ["given"]
metrics = ["quality", "regularity", "brightness", "no-score"]
texture = [{ name = "one", dataset = "brick" }, { name = "two", dataset = "weave" }]
"""


def test_own_plugins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The summary has the own column; the failure of the other metric is one line; the report is written."""
    (tmp_path / "mine.py").write_text(PLUGINS)
    (tmp_path / "small.toml").write_text(SUITE)
    try:
        assert call("--plugin mine.py run small.toml --jobs 0 --out run --no-report") == 1
        printed = capsys.readouterr()
        call("--plugin mine.py report run --format listing")
    finally:
        plugins.registry._files.pop((tmp_path / "mine.py").resolve(), None)
    assert "brightness" in printed.out
    lines = [line for line in printed.err.splitlines() if line.startswith("nrbench:") and "no-score" in line]
    assert len(lines) == 1
    assert "returned float instead of Score" in lines[0] or "returned float instead of a Score" in lines[0]
    assert lines[0].endswith("(and 3 more cells)")
    assert (tmp_path / "run" / "lists" / "mine" / "list.txt").read_text() == "4"
