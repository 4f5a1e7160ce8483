"""Claims about methods and lattices: the detector that a method names, the choice of auto, and regular figures."""

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthesis_cases import build

from nrbench import plugins, run, texture
from nrbench.api.runs import changed
from nrbench.calling.method_calls import checked_synthesis
from nrbench.errors import BadInput
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Detection, NoLatticeFound, Refused, Synthesis, Task
from nrbench.plugins.registry import NamedDetector
from nrbench.running.runner import Options
from nrbench.suites.suite import load_suite
from nrbench.synthesizers.ann_pixel import AnnPixel
from nrbench.synthesizers.auto import Auto, estimate_regular_share
from nrbench.synthesizers.rsgf import Rsgf
from nrbench.synthesizers.tile_set import TileSet

FINDERS = {
    "auto": "consensus",
    "cartoon": "gncc",
    "command:run=tool {sample} {output}": "",
    "command:run=tool {sample} {output} {lattice}": "consensus",
    "fftm-patch": "",
    "fftm-pixel": "",
    "lattice-only": "",
    "regularized-patch": "consensus",
    "representative-tile": "ssdn:primitive=false",
    "representative-tile:preset=paper": "ssdn:preset=paper",
    "resample": "consensus",
    "rsgf": "consensus",
    "rsgf:preset=paper": "gncc:preset=paper",
    "shuffle": "gncc",
    "supertile": "gncc",
    "tile-set": "consensus",
    "tile-set:preset=paper": "dominance",
    "tiling": "gncc",
}


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
    using = {p.name for p in plugins.inventory("synthesizers") if p.built_in and getattr(p.cls, "uses_lattice", True)}
    assert using <= {spec.partition(":")[0] for spec in FINDERS}


PAPER = Auto(**Auto.presets["paper"])


def task_of(model: str, seed: int = 0, **parameters: float | str) -> tuple[Task, Lattice | None]:
    """Return a task without a lattice, and the true lattice."""
    drawn = texture(model, (112, 112), seed, **parameters)
    return Task(quantize(drawn.image), (90, 100), None, np.random.default_rng(7)), drawn.lattice


@pytest.mark.parametrize("model", ["hexagon", "squares"])
@pytest.mark.parametrize("color", [0.2, 0.8])
def test_a_regular_texture_gets_a_method_of_lattices(model: str, color: float) -> None:
    """On models that the rule was not set on, its output is that of the method for lattices, and the note says so."""
    task, truth = task_of(model, color=color, noise=0.1)
    made = Auto().synthesize(task)
    assert made.lattice is not None and truth is not None and made.lattice.is_equivalent(truth, 0.5)
    assert made.note.startswith("picked rsgf: regularity 0.") and made.detection_seconds > 0
    expected = Rsgf().synthesize(replace(task, lattice=made.lattice, rng=np.random.default_rng(7)))
    np.testing.assert_array_equal(made.image, expected.image)
    assert checked_synthesis(made, task.sample, task.shape).source is not None


@pytest.mark.parametrize("spectrum", ["white", "pink"])
def test_an_irregular_texture_gets_a_method_of_neighborhoods(spectrum: str) -> None:
    """On noise the output is that of the other method, without a lattice, and the note says why."""
    task, _ = task_of("noise", 1, spectrum=spectrum)
    for auto, other in ((Auto(), Rsgf(search="stochastic")), (PAPER, AnnPixel())):
        made = auto.synthesize(replace(task, rng=np.random.default_rng(7)))
        expected = other.synthesize(replace(task, rng=np.random.default_rng(7)))
        np.testing.assert_array_equal(made.image, expected.image)
        assert made.lattice is None and "no lattice (" in made.note


def test_the_threshold_decides() -> None:
    """On a given lattice, the paper's choice is its tile set up to the measured share, and above it the other one."""
    task, truth = task_of("brick", color=0.3)
    task = replace(task, lattice=truth)
    share = estimate_regular_share(task.sample, truth)
    below, above = (replace(PAPER, threshold=share + step).synthesize(task) for step in (-0.01, 0.01))
    assert below.note == f"picked tile-set:preset=paper: regularity {share:.2f}" and below.lattice == truth
    assert above.note == f"picked ann-pixel: regularity {share:.2f}" and above.lattice is None
    expected = TileSet(**TileSet.presets["paper"]).synthesize(replace(task, rng=np.random.default_rng(7)))
    again = PAPER.synthesize(replace(task, rng=np.random.default_rng(7)))
    np.testing.assert_array_equal(again.image, expected.image)


def test_the_share_is_that_of_the_model() -> None:
    """It is 1 for a periodic image, near the model's regular share, 0 for noise, and 0 for less than two periods."""
    tile = np.random.default_rng(0).random((12, 16, 3)).astype(np.float32)
    exact = Lattice((16, 0), (0, 12))
    assert estimate_regular_share(np.tile(tile, (8, 8, 1)), exact) == pytest.approx(1, abs=1e-6)
    assert estimate_regular_share(tile.repeat(2, 1), Lattice((32, 0), (0, 12))) == 0
    noise = np.random.default_rng(1).random((128, 128, 3)).astype(np.float32)
    assert estimate_regular_share(noise, Lattice((16.3, 1), (0, 12.1))) < 0.01
    drawn = texture("brick", (160, 160), 0, color=0.4, noise=0.05)
    assert drawn.lattice is not None and drawn.regular_share is not None
    assert estimate_regular_share(drawn.image, drawn.lattice) == pytest.approx(drawn.regular_share, abs=0.08)


def test_the_regular_figures_are_preserved(tmp_path: Path) -> None:
    """On figures 3 to 7 the verdict on the default outputs is: preserved (Table 2 of the report)."""
    suite = changed(load_suite("report2004"), ["quilting", "patch-based"], ["given"], metrics=["regularity"])
    cells = run(suite, out=tmp_path / "run", textures=["figure-0[3-7]-*"], options=Options(jobs=0)).cells
    verdicts = {(cell.texture, cell.method): cell.values["regularity.preserved"] for cell in cells}
    assert len(verdicts) == 10 and set(verdicts.values()) == {True}, verdicts


def test_auto_takes_the_next_method_where_one_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    """The note says which refused and why; without a lattice, a warning says what to do."""

    def refuse(self: Rsgf, task: Task) -> Synthesis:
        raise Refused("too small")

    monkeypatch.setattr(Rsgf, "synthesize", refuse)
    made = Auto().synthesize(task_of("squares", color=0.2)[0])
    assert made.note.startswith("picked tile-set: regularity 0.") and "rsgf refused: too small" in made.note
    with pytest.warns(UserWarning, match="give its lattice"):
        made = Auto().synthesize(task_of("noise", 1)[0])
    assert made.note.startswith("picked ann-pixel: no lattice (") and "rsgf refused: too small" in made.note
