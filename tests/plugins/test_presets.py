"""Presets: named sets of parameters, one mechanism for plugins of every kind."""

from collections.abc import Iterator
from dataclasses import make_dataclass
from pathlib import Path

import numpy as np
import pytest
from commands import call

import nrbench
from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins import registry
from nrbench.suites.plan import LatticeSource, PlannedMethod, make_plan
from nrbench.suites.suite import validated_suite

HEAD = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from nrbench.plugins.forms import Detection, Synthesis
from nrbench.lattice.geometry import Lattice

@dataclass(frozen=True)
class {name}:
    "A page."
{body}
"""
GRAYS = """
    level: float = 0.25
    steps: int = 4
    presets: ClassVar = {"paper": {"level": 0.5, "steps": 2}, "dark": {"level": 0.0}}
    patch_shape: ClassVar[str] = "square"
    patch_placement: ClassVar[str] = "nowhere"
    patch_stitching: ClassVar[str] = "paste"
    name: ClassVar[str] = "grays"
    def synthesize(self, task):
        return Synthesis(np.full((*task.shape, task.sample.shape[2]), self.level, np.float32))
"""
FIXED = """
    period: float = 8.0
    presets: ClassVar = {"paper": {"period": 12.0}}
    name: ClassVar[str] = "fixed"
    def detect(self, image):
        return Detection(Lattice((self.period, 0), (0, self.period)), 1.0)
"""


@pytest.fixture(autouse=True)
def two_plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Register a method and a detector that have presets."""
    monkeypatch.setattr(registry, "_files", {})
    for name, body in (("Grays", GRAYS), ("Fixed", FIXED)):
        file = tmp_path / f"{name}.py"
        file.write_text(HEAD.replace("{name}", name).replace("{body}", body), "utf-8")
        plugins.add_file(file)
    yield


def test_a_preset_fills_in_parameters_and_given_ones_take_precedence() -> None:
    """``preset=paper`` gives the preset's values; a parameter beside it wins; without it, defaults hold."""
    assert plugins.parameters_of(plugins.build("synthesizers", "grays")) == {"level": 0.25, "steps": 4}
    filled = plugins.build("synthesizers", "grays", {"preset": "paper"})
    assert plugins.parameters_of(filled) == {"level": 0.5, "steps": 2}
    beside = plugins.build("synthesizers", "grays", {"steps": "3", "preset": "paper"})
    assert plugins.parameters_of(beside) == {"level": 0.5, "steps": 3}


def test_the_python_functions_take_presets() -> None:
    """``preset`` is a parameter of ``synthesize`` and ``detect_lattice``."""
    sample = np.random.default_rng(0).random((16, 16))
    assert np.ptp(nrbench.synthesize("grays", sample, (8, 8), preset="paper").image) == 0
    assert abs(float(nrbench.synthesize("grays", sample, (8, 8), preset="paper").image[0, 0]) - 0.5) < 0.01
    assert nrbench.detect_lattice(sample, "fixed", preset="paper").lattice.t1 == (12.0, 0.0)
    assert nrbench.detect_lattice(sample, "fixed", preset="paper", period=9).lattice.t1 == (9.0, 0.0)


@pytest.mark.parametrize(
    ("kind", "name", "preset", "message"),
    [
        ("synthesizers", "grays", "article", "method grays: preset 'article' is not known; choose one of: paper, dark"),
        ("synthesizers", "scatter", "article", "method scatter: preset 'article' is not known; it has none; leave"),
        ("detectors", "fixed", "article", "detector fixed: preset 'article' is not known; choose one of: paper"),
        *(("synthesizers", "grays", preset, "choose one of: paper, dark") for preset in (None, 3, ["paper"], {"a": 1})),
    ],
)
def test_an_unknown_preset_names_those_that_exist(kind: str, name: str, preset: object, message: str) -> None:
    """The error lists the presets of the plugin, whatever Python value is given."""
    with pytest.raises(BadInput, match=message):
        plugins.build(kind, name, {"preset": preset})


def test_a_preset_is_the_same_cell_as_its_parameters() -> None:
    """Only the names differ: they say that the preset was chosen, also where parameters of its own stand beside it."""
    rows = [{"name": "brick", "dataset": "brick"}]

    def cells(*methods: str, lattice: str = "own") -> list[tuple[str, str, str]]:
        content = {"name": "x", "texture": rows, "methods": methods, "lattice": [lattice], "sample": "32x32"}
        plan = make_plan(validated_suite({**content, "size": "32x32"}, "x"))
        return [(cell.key, cell.label, cell.lattice_source) for cell, _ in plan.cells]

    by_preset, by_hand = cells("grays:preset=paper", "grays:steps=2,level=0.5")
    assert by_preset[0] == by_hand[0] and by_preset[1:] == ("grays:preset=paper", "own")
    assert by_hand[1] == "grays:level=0.5,steps=2"
    assert PlannedMethod.parse("grays:preset=paper,steps=3").label == "grays:preset=paper,steps=3"
    found, same, default = (cells("grays", lattice=f"fixed{one}")[0] for one in (":preset=paper", ":period=12", ""))
    assert found[0] == same[0] != default[0] and found[2] == "fixed:preset=paper"
    assert PlannedMethod.parse("grays:preset=dark").parameters == {"level": 0.0, "steps": 4}
    assert LatticeSource.parse("fixed:period=8").name == LatticeSource.parse("fixed").name == "fixed"


def test_show_prints_presets_and_patch_terms(capsys: pytest.CaptureFixture[str]) -> None:
    """``show`` lists each preset with its values, and what a patch is, where it goes and how it is joined."""
    assert call("show grays") == 0
    shown = capsys.readouterr().out
    assert "preset=paper:\n  level = 0.5\n  steps = 2" in shown and "preset=dark:\n  level = 0.0" in shown
    assert "patch_shape = square" in shown and "patch_stitching = paste" in shown


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("    presets: ClassVar = {'paper': {'levle': 1}}", "preset 'paper': parameter 'levle' is not known .*'level'"),
        ("    presets: ClassVar = {'paper': {'level': 'high'}}", "preset 'paper': level='high': input should be"),
        ("    presets: ClassVar = {'paper': {'level': 7}}", "preset 'paper': too bright"),
        ("    presets: ClassVar = {'paper': 7}", "presets must be a mapping"),
        ("    presets: ClassVar = ['paper']", "presets must be a mapping"),
        ("    preset: str = ''", "parameter 'preset' has the name by which presets are chosen; rename it"),
        ("    label: str = ''", "parameter 'label' has the name by which methods get their names in tables; rename it"),
        ("    patch_shape: ClassVar = 3", "patch_shape must be text"),
        ("    patch_shape: ClassVar = 'x'", "has patch_shape, but not patch_placement, patch_stitching; give all"),
    ],
)
def test_bad_presets_are_found_at_registration(body: str, message: str, tmp_path: Path) -> None:
    """A preset of unknown parameters or refused values, or a parameter called preset, makes a plugin invalid."""
    method = """
    level: float = 0.25
    def __post_init__(self):
        if self.level > 1:
            raise ValueError("too bright")
    def synthesize(self, task): ...
"""
    file = tmp_path / "bad.py"
    file.write_text(HEAD.replace("{name}", "Bad").replace("{body}", body + method), "utf-8")
    with pytest.raises(BadInput, match=message):
        plugins.add_file(file)


@pytest.mark.parametrize("name", ["preset", "label"])
@pytest.mark.parametrize("kind", list(plugins.FORMS))
def test_no_plugin_has_a_parameter_called_preset_or_label(kind: str, name: str) -> None:
    """Both names are reserved for plugins of all kinds."""
    cls = make_dataclass("Mine", [(name, str, "")], frozen=True, namespace={"__doc__": "A page.", "version": "1"})
    assert f"parameter {name!r} has the name by which" in plugins.fault(kind, cls)
