"""Methods name the detector that finds their lattice."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Detection, NoLatticeFound, Refused, Task
from nrbench.plugins.parameters import parse_spec
from nrbench.plugins.registry import NamedDetector

FINDERS = {
    "auto": "consensus",
    "command:run=tool {sample} {output}": "",
    "command:run=tool {sample} {output} {lattice}": "consensus",
    "fftm-patch": "",
    "fftm-pixel": "",
    "lattice-only": "",
    "regularized-patch": "consensus",
    "representative-tile": "ssdn:primitive=false",
    "representative-tile:preset=paper": "ssdn:preset=paper",
    "rsgf": "consensus",
    "rsgf:geometry=straighten": "consensus",
    "rsgf:preset=paper": "gncc:preset=paper",
    "shuffle": "gncc",
    "supertile": "gncc",
    "tile-set": "consensus",
    "tile-set:geometry=straighten": "consensus",
    "tiling": "gncc",
}


def build(spec: str) -> Any:
    """Return a method with its parameters."""
    return plugins.build("synthesizers", *parse_spec(spec))


@pytest.mark.parametrize("spec", FINDERS)
def test_a_method_asks_its_finder_alone(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A method without a given lattice asks the detector that it names, and no other."""
    asked: list[str] = []

    def detect(self: NamedDetector, image: object) -> None:
        asked.append(self.spec)
        raise NoLatticeFound("none")

    method = build(spec)
    assert getattr(method, "finder", "") == FINDERS[spec]
    monkeypatch.setattr(NamedDetector, "detect", detect)
    task = Task(np.random.default_rng(1).random((96, 96, 1), np.float32), (32, 32), None, np.random.default_rng(0))
    with contextlib.suppress(Refused, BadInput):
        method.synthesize(task)
    assert set(asked) == ({FINDERS[spec]} if FINDERS[spec] else set())


@pytest.mark.parametrize("spec", [spec for spec in FINDERS if FINDERS[spec] and "command" not in spec])
def test_the_lattice_that_is_found_is_used_and_reported(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lattice of the finder is that of the synthesis, with the seconds of the detection."""
    lattice = Lattice((16, 0), (0, 12))
    monkeypatch.setattr(NamedDetector, "detect", lambda self, image: Detection(lattice, 1.0))
    sample = quantize(np.tile(np.random.default_rng(1).random((12, 16, 1), np.float32), (10, 8, 1)))
    made = build(spec).synthesize(Task(sample, (32, 32), None, np.random.default_rng(0)))
    assert made.lattice == lattice and made.detection_seconds > 0 and "no lattice" not in made.note


@pytest.mark.parametrize("spec", [spec for spec in FINDERS if FINDERS[spec]])
def test_without_a_lattice_a_method_refuses_or_says_so(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the finder finds no lattice, the refusal has its reason; RSGF has a mode for it, and a note."""

    def detect(self: NamedDetector, image: object) -> None:
        raise NoLatticeFound("nothing repeats")

    monkeypatch.setattr(NamedDetector, "detect", detect)
    task = Task(np.random.default_rng(1).random((96, 96, 1), np.float32), (80, 80), None, np.random.default_rng(0))
    if spec.startswith(("rsgf", "auto")):
        made = build(spec).synthesize(task)
        assert made.lattice is None and "nothing repeats" in made.note
        return
    with pytest.raises(Refused, match="nothing repeats"):
        build(spec).synthesize(task)


def test_every_method_that_uses_a_lattice_is_listed() -> None:
    """The finder of each installed method that uses a lattice is checked here."""
    using = {p.name for p in plugins.inventory("synthesizers") if p.own and getattr(p.cls, "uses_lattice", True)}
    assert using <= {spec.partition(":")[0] for spec in FINDERS}
