"""The registry: all plugins enter in the same way, broken ones are isolated, and the overview agrees with it."""

import inspect
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import call as shell

import nrbench
from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.forms import Observation
from nrbench.plugins.parameters import nearest, parse_spec, user_path, validated


@pytest.mark.parametrize(
    ("kind", "call"),
    [("datasets", nrbench.texture), ("detectors", nrbench.detect_lattice), ("synthesizers", nrbench.synthesize)],
)
def test_names_taken_by_the_call_are_those_of_its_arguments(kind: str, call: Callable[..., Any]) -> None:
    """No parameter can be called like an argument of the call that takes it; ``tileable`` of a method sets both."""
    own = {name for name, one in inspect.signature(call).parameters.items() if one.kind is not one.VAR_KEYWORD}
    assert set(plugins.FORMS[kind].taken) == own - {"tileable"}


def test_a_named_detector_is_imported_when_it_detects() -> None:
    """A detector by name finds what its class finds; its name is read when it is used, with its parameters."""
    image = nrbench.texture("brick", shape=(96, 96)).image
    found = plugins.NamedDetector("gncc:preset=paper").detect(image)
    assert found.lattice == nrbench.detect_lattice(image, "gncc", preset="paper").lattice
    with pytest.raises(BadInput, match="detector 'gnc' is not known"):
        plugins.NamedDetector("gnc").detect(image)


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("gnc", "did you mean 'gncc'?"),
        ("fftm", "did you mean 'fftm-patch' or 'fftm-pixel'?"),
        ("quilt", "did you mean 'quilting'?"),
        ("mean", "known: gncc, fftm-patch, fftm-pixel, quilting"),
        ("q", "known: gncc, fftm-patch, fftm-pixel, quilting"),
    ],
)
def test_only_a_near_word_is_proposed(word: str, hint: str) -> None:
    """A word of other letters brings the list of the known ones, not the least distant of them."""
    assert nearest(word, ["gncc", "fftm-patch", "fftm-pixel", "quilting"]) == f" ({hint})"


def test_a_missing_parameter_is_named() -> None:
    """A parameter without default must be given."""
    with pytest.raises(BadInput, match="parameter 'run' is missing; give command:run="):
        plugins.build("synthesizers", "command")


@pytest.mark.parametrize(
    ("text", "name", "parameters"),
    [
        ("rsgf", "rsgf", {}),
        ("rsgf:block=20,border=5", "rsgf", {"block": "20", "border": "5"}),
        ("command:run=a b,c --x=1", "command", {"run": "a b,c --x=1"}),
        ("x:t1=3,4,t2=0,5", "x", {"t1": "3,4", "t2": "0,5"}),
    ],
)
def test_specs(text: str, name: str, parameters: dict[str, str]) -> None:
    """``name:param=value,...`` is split where a comma is followed by ``word=``."""
    assert parse_spec(text) == (name, parameters)


@pytest.mark.parametrize("text", ["rsgf:block", "rsgf:=3", "rsgf:block=1,block=2"])
def test_bad_specs(text: str) -> None:
    """A parameter without a value, without a name or given twice is refused."""
    with pytest.raises(BadInput, match=r"write NAME:param=value|is given twice; leave one"):
        parse_spec(text)


def test_text_becomes_the_declared_type() -> None:
    """Values from a command line are converted: numbers, truth values, nothing, pairs."""

    @dataclass(frozen=True)
    class Thing:
        number: int = 1
        share: float | None = 0.5
        flag: bool = False
        pair: tuple[float, float] | None = None

    made = validated(Thing, {"number": "7", "share": "none", "flag": "true", "pair": "3,4.5"}, "thing")
    assert made == Thing(7, None, True, (3.0, 4.5))


BROKEN = """name = "s"
sample = "48x48"
size = "64x64"
lattice = ["given", "blind"]
methods = ["fine", "broken:level=3"]
metrics = ["cost"]
texture = [{ name = "wall", dataset = "brick" }, { name = "lost", dataset = "gone", parameters = { depth = 2 } }]
"""
FINE = """
from dataclasses import dataclass
from nrbench import Synthesis

@dataclass(frozen=True)
class P:
    'A page.'
    def synthesize(self, task):
        return Synthesis(task.sample.repeat(2, 0).repeat(2, 1)[:64, :64])
"""
CAUSES = {
    "lost": "dataset 'gone' of stranger does not load: ModuleNotFoundError: No module named 'nothing'",
    "broken:level=3": "method 'broken' of stranger does not load: SystemExit: no GPU",
    "blind": "detector 'blind' of stranger does not load: ZeroDivisionError: division by zero",
}


def test_a_plugin_that_does_not_import_costs_only_its_own_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its cells fail with a line that names kind, name, distribution and cause; all others run. `list` shows it."""
    info = tmp_path / "site" / "stranger-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    modules = {"fine": FINE, "broken": "raise SystemExit('no GPU')", "gone": "import nothing", "blind": "1 / 0"}
    kinds = {"gone": "datasets", "blind": "detectors"}
    points = [f"[nrbench.{kinds.get(name, 'synthesizers')}]\n{name} = stranger_{name}:P\n" for name in modules]
    (info / "entry_points.txt").write_text("".join(points))
    for name, text in modules.items():
        (tmp_path / "site" / f"stranger_{name}.py").write_text(f"print('imported')\n{text}\n")
    (tmp_path / "s.toml").write_text(BROKEN)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    plugins.registry.installed_points.cache_clear()
    plugins.registry._installed.cache_clear()
    try:
        assert shell("run s.toml --jobs 1 --no-report --out run --json") == 1
        told = capfd.readouterr()
        cells = json.loads(told.out)["cells"]
        ends = {(cell["texture"], cell["method"], cell["lattice_source"]): cell for cell in cells}
        for where, cell in ends.items():
            cause = next((CAUSES[part] for part in where if part in CAUSES), "")
            assert (cell["status"], cell["message"]) == ("error" if cause else "ok", cause), where
        assert len(ends) == 8 and "Traceback" not in told.err
        assert shell("list synthesizers --json") == 0
        listed = {each["name"]: each for each in json.loads(capfd.readouterr().out)["synthesizers"]}
        assert "no GPU" in listed["broken"]["error"] and listed["fine"]["about"] == "A page."
        assert plugins.lookup("synthesizers", "fine").release == "1.0"
    finally:
        plugins.registry.installed_points.cache_clear()
        plugins.registry._installed.cache_clear()


HEAD = "from dataclasses import dataclass\n"
FROZEN = HEAD + "@dataclass(frozen=True)\n"
FILES = {
    "class X:\n    def synthesize(self, task): ...": "is no dataclass; decorate it with @dataclass",
    HEAD + "@dataclass\nclass X:\n    'Page.'\n    def synthesize(self, task): ...": "is not frozen",
    FROZEN + "class X:\n    'Page.'\n    def synthesize(self): ...": "must take self and 1 argument",
    FROZEN + "class X:\n    def synthesize(self, task): ...": "has no docstring",
    FROZEN
    + "class X:\n    'Page.'\n    shape: str = 'x'\n    def synthesize(self, task): ...": "rename it (taken: method",
    FROZEN + "class X:\n    'Page.'\n    size: int\n    def detect(self, i): ...": "'size' has no default",
    FROZEN + "class X:\n    'Page.'\n    def score(self, o): ...": "declares no columns",
    HEAD + "from nrbench.plugins.forms import Column\n@dataclass(frozen=True)\nclass X:\n    'Page.'\n"
    "    columns = {'a': Column('A.', '', 'none')}\n    def score(self, o): ...": "column 'a' is not valid",
    FROZEN + "class X:\n    'Page.'\n    def render(self, s, r): ...": "lacks the method again",
    FROZEN + "class Rsgf:\n    'Page.'\n    def synthesize(self, t): ...": "the name 'rsgf' is taken",
    "x = 1": "defines no plugin",
    "raise OSError('no')": "does not import: OSError: no",
}


@pytest.mark.parametrize("text", FILES)
def test_a_file_that_holds_no_plugin_says_what_is_missing(text: str, tmp_path: Path) -> None:
    """Each way to miss a plugin's form is answered with what to change, and nothing is registered."""
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(BadInput, match=re.escape(FILES[text])):
        plugins.add_file(file)
    assert str(file) not in plugins.files()


def test_one_item_is_a_list_of_one() -> None:
    """A parameter that is a list takes one item without a comma; a wrong number keeps its own message."""
    grid = plugins.build("reports", "figure", {"methods": "rsgf", "textures": "a,b"})
    assert (grid.methods, grid.textures) == (("rsgf",), ("a", "b"))
    with pytest.raises(BadInput, match="valid number"):
        plugins.build("reports", "figure", {"width": "wide"})


@dataclass(frozen=True)
class Places:
    """A plugin whose parameters are paths, as docs/plugins.md lists them, and a text."""

    one: Path = Path()
    maybe: Path | None = None
    several: tuple[Path, ...] = ()
    listed: list[Path] = field(default_factory=list)
    text: str = ""


@pytest.mark.parametrize(("folder", "file"), [(None, Path("a.txt")), (Path("/home/me"), Path("/home/me/a.txt"))])
def test_paths_start_from_the_folder_of_the_user(
    folder: Path | None, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once a process has left the user's folder, every parameter that is a path is absolute; texts are unchanged."""
    monkeypatch.setattr("nrbench.plugins.parameters._user_folder", folder)
    given = {"one": "a.txt", "maybe": "a.txt", "several": "a.txt,/b", "listed": ["a.txt"], "text": "a.txt"}
    found = validated(Places, given, "method places")
    assert found == Places(file, file, (file, Path("/b")), [file], "a.txt")
    assert user_path(found.text) == file
    assert validated(Places, {"maybe": "none"}, "method places").maybe is None


WHITE = np.ones((8, 8, 1), np.float32)


def mean_of_output(observation: Observation) -> list[float]:
    """Return a new list at each call, so that two calls can be distinguished."""
    return [float(observation.output.mean())]


def test_metrics_share_what_is_computed_once() -> None:
    """The metrics of an observation get the same object, each with a random stream of its own; other outputs do not."""
    observation = Observation(WHITE, WHITE)
    first, second = (observation.with_stream(np.random.default_rng(seed)) for seed in (1, 2))
    assert first.rng is not second.rng
    assert first.shared(mean_of_output) is second.shared(mean_of_output) is observation.shared(mean_of_output)
    assert replace(observation, output=WHITE / 2).shared(mean_of_output) == [0.5]


@pytest.mark.parametrize("kind", plugins.FORMS)
def test_the_overview_agrees_with_the_classes(kind: str) -> None:
    """Name, version, first line and role that are read from the source are those of the imported class."""
    read = {each.name: each for each in plugins.summaries(kind) if each.distribution == "nrbench"}
    loaded = [plugin for plugin in plugins.inventory(kind) if plugin.built_in]
    assert loaded and set(read) == {plugin.name for plugin in loaded}
    for plugin in loaded:
        page = (inspect.getdoc(plugin.cls) or "").partition("\n")[0]
        shown = read[plugin.name]
        assert (shown.version, shown.about, shown.error) == (plugin.version, page, "")
        assert shown.reference == bool(getattr(plugin.cls, "reference", False))


@pytest.mark.parametrize("kind", plugins.FORMS)
def test_the_plugins_of_nrbench_keep_their_forms(kind: str) -> None:
    """The plugins of nrbench load and have no fault. They are not checked again when they are loaded."""
    for plugin in [plugin for plugin in plugins.inventory(kind) if plugin.built_in]:
        assert not plugin.error, plugin.name
        assert plugins.fault(kind, plugin.cls) == "", plugin.name
