"""Methods name the detector that finds their lattice."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest

from nrbench import plugins
from nrbench.detectors.ssdn import Ssdn
from nrbench.errors import BadInput
from nrbench.plugins.forms import NoLatticeFound, Refused, Task
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
    "representative-tile": "ssdn:depth=0.8,primitive=false",
    "representative-tile:preset=paper,depth=0.7": "ssdn:depth=0.7,primitive=false,subpixel=false,reject=none",
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


def test_every_method_that_uses_a_lattice_is_listed() -> None:
    """The finder of each installed method that uses a lattice is checked here."""
    using = {p.name for p in plugins.inventory("synthesizers") if p.own and getattr(p.cls, "uses_lattice", True)}
    assert using <= {spec.partition(":")[0] for spec in FINDERS}


def test_the_period_of_a_representative_tile_comes_from_ssdn() -> None:
    """The finder of a representative tile is SSDN with the parameters of the method."""
    assert plugins.build("detectors", *parse_spec(build("representative-tile:depth=0.7").finder)) == Ssdn(
        depth=0.7, primitive=False
    )
