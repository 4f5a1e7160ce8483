"""A process that coordinates imports no plugin of others: children do, and send plain values, which are checked."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import call

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins import registry
from nrbench.running.guard import Limits
from nrbench.running.plugin_children import guarded_plugins
from nrbench.suites.plan import PlannedMethod

HEAD = """import os, sys, threading, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
Path({marks!r}, f"{name} {{os.getpid()}}").touch()
{before}
@dataclass(frozen=True)
class P:
    "A page."
    {inside}
    {method}
"""
METHOD = "def synthesize(self, task): ..."
FORGED = 'os.write(3, b\'{"status": "ok", "message": "", "facts": %s}\\n\'); os._exit(0)'
AT_IMPORT = {
    "exits": ("os._exit(0)", "ended without an answer"),
    "crashes": ("os.kill(os.getpid(), 11)", "died by SIGSEGV"),
    "interrupts": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "odd": ("class Odd(BaseException): ...\nraise Odd('no')", "Odd: no"),
    "list": (FORGED % "[5]", "input should be an object"),
    "number": (FORGED % '[{"kind": "synthesizers", "version": 1e999}]', "field required"),
}
IN_CLASS = {
    "builds": ("def __post_init__(self): os._exit(0)", "method builds: ended without an answer"),
    "loops": ("def __post_init__(self):\n        while True: ...", "took longer than"),
    "hashes": ("def fingerprint(self): return object()", r"method hashes: fingerprint\(\) returned <object"),
    "named": ("label: ClassVar = 5", "method named: label: input should be a valid string"),
    "raises": ("@property\n    def label(self): raise ValueError('no label')", "ValueError: no label"),
    "lattice": ("uses_lattice: ClassVar = 'no'", "uses_lattice: input should be a valid boolean"),
    "referee": ("reference: ClassVar = 'yes'", "reference: input should be a valid boolean"),
}
FINE = """number: int = 3
    pair: tuple[float, float] = (1.0, 2.0)
    file: Path = Path("x.txt")
    version: ClassVar[str] = "7"
    always_shown: ClassVar = ("number",)
    presets: ClassVar = {"paper": {"number": 5}}
    def fingerprint(self): return self.file.read_text()"""
SUITE = """name = "s"
sample = "48x48"
size = "64x64"
methods = ["tiling"]
lattice = ["given"]
metrics = ["cost"]
texture = [{ name = "one", dataset = "brick" }]
"""


@pytest.fixture
def marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install a distribution of plugins that misbehave; return the folder in which each import leaves a mark."""
    place, marks = tmp_path / "installed", tmp_path / "marks"
    (place / "stranger-1.0.dist-info").mkdir(parents=True)
    marks.mkdir()
    render = "width: int = 80\n    terminal: ClassVar[bool] = True\n    def render(self, run): "
    modules = {name: ("synthesizers", before, "", METHOD) for name, (before, _) in AT_IMPORT.items()}
    modules |= {name: ("synthesizers", "", inside, METHOD) for name, (inside, _) in IN_CLASS.items()}
    modules["fine"] = ("synthesizers", "print('{'); os.write(1, b'{')", FINE, METHOD)
    modules["threaded"] = ("synthesizers", "threading.Timer(60, print).start()", "", METHOD)
    write = "def write(self, run, directory): return []"
    modules["leaver"] = ("reports", "", f"{render}os._exit(0)", write)
    modules["writer"] = ("reports", "", f"{render}return 'written\\x1b[2J\\n'", write)
    points = ""
    for name, (kind, before, inside, method) in modules.items():
        text = HEAD.format(marks=str(marks), name=name, before=before, inside=inside, method=method)
        (place / f"stranger_{name}.py").write_text(text)
        points += f"[nrbench.{kind}]\n{name} = stranger_{name}:P\n"
    (place / "stranger-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (place / "stranger-1.0.dist-info" / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(place)
    monkeypatch.setenv("PYTHONPATH", str(place))
    monkeypatch.setattr(registry, "_loaded", {})
    registry.entry_points_of.cache_clear()
    yield marks
    assert not list(marks.glob(f"* {os.getpid()}"))
    registry.entry_points_of.cache_clear()


def test_a_run_imports_no_plugin_that_it_does_not_use(
    marks: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Methods of others that a run does not name are not imported; a report that ends its process costs one line."""
    (tmp_path / "s.toml").write_text(SUITE)
    assert call(f"run {tmp_path}/s.toml --jobs 0 --no-report --out {tmp_path}/run") == 1
    printed = capfd.readouterr()
    (line,) = [line for line in printed.err.splitlines() if "leaver" in line]
    assert line == "nrbench: report leaver failed: ended without an answer"
    assert "written\n" in printed.out
    assert {path.name.split()[0] for path in marks.iterdir()} == {"leaver", "writer"}
    recorded = json.loads((tmp_path / "run" / "run.json").read_text())["plugins"]
    assert {"kind": "synthesizers", "name": "exits", "distribution": "stranger", "version": "1.0"} in recorded
    assert call(f"run {tmp_path}/s.toml --jobs 0 --no-report --out {tmp_path}/run --json") == 0
    assert json.loads(capfd.readouterr().out)["status"] == {"ok": 1}


@pytest.mark.usefixtures("marks")
def test_what_a_plugin_does_to_the_process_that_asks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A method that exits, crashes, loops, lies or has class variables of other types is one error that names it."""
    monkeypatch.setattr("nrbench.running.plugin_children.IMPORT", Limits(1.0, 512.0))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.txt").write_text("content")
    with guarded_plugins():
        for name, (_, why) in {**AT_IMPORT, **IN_CLASS}.items():
            with pytest.raises(BadInput, match=why) as error:
                PlannedMethod.parse(name)
            assert f"method {name}" in str(error.value) or f"method '{name}' of stranger" in str(error.value)
        plain = PlannedMethod.parse("fine:preset=paper,pair=4,5")
        assert plain.parameters == {"number": 5, "pair": [4.0, 5.0], "file": "x.txt"}
        assert (plain.version, plain.label) == ("7+content", "fine:number=5,pair=[4.0, 5.0]")
        with pytest.raises(BadInput, match="method fine: number='x'"):
            PlannedMethod.parse("fine:number=x")
        with pytest.warns(UserWarning, match="'threaded' starts threads"):
            assert not plugins.find("synthesizers", "threaded").shared
        sound = sorted({"fine", *IN_CLASS} - {"referee"})
        assert plugins.shared_plugins() == [("synthesizers", name) for name in sound]
        page = plugins.find("synthesizers", "fine").cls
        assert (page.__doc__, page().pair) == ("A page.", (1.0, 2.0))  # type: ignore[misc]


@pytest.mark.usefixtures("marks")
def test_broken_plugins_are_listed(capfd: pytest.CaptureFixture[str]) -> None:
    """`list --json` is JSON with the error of each plugin that does not load, whatever its import prints."""
    assert call("list synthesizers --json") == 0
    listed = {each["name"]: each for each in json.loads(capfd.readouterr().out)["synthesizers"]}
    assert [name for name in listed if listed[name].get("error")] == [*AT_IMPORT, "referee"]
    assert listed["fine"]["about"] == "A page."
