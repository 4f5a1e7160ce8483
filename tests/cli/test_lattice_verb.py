"""`nrbench lattice`: one detector, all of them, or a lattice by hand, as text, as JSON and drawn."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import skimage.io

from nrbench import plugins
from nrbench.api import synthesize, texture
from nrbench.cli.lattice_figures import lattice_of
from nrbench.cli.main import main
from nrbench.imaging.convert import quantize
from nrbench.imaging.files import read_image, write_image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Observation
from nrbench.suites.cell import Recipe


def call(line: str) -> int:
    """Run a command line in this process and return its exit code."""
    with pytest.raises(SystemExit) as left:
        main(shlex.split(line))
    return int(left.value.code or 0)


@pytest.fixture(autouse=True)
def pictures() -> None:
    """Write a texture with a lattice, and one without, into the current directory."""
    write_image(Path("brick.png"), texture("brick", shape=(96, 112), seed=1, color=0.1).image)
    write_image(Path("small.png"), texture("brick", shape=(40, 48), seed=1, color=0.1, width=9.3, height=7.1).image)
    skimage.io.imsave("constant.png", np.full((64, 64, 3), 99, np.uint8), check_contrast=False)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("brick.png --all --pick", "--all and --pick: choose one"),
        ("brick.png -d gncc --lattice 20,0,0,20", "-d and --lattice: choose one"),
        ("brick.png --all --diagnostics d.png", "leave --all out"),
        ("brick.png --lattice 20,0,0", "four numbers"),
        ("brick.png --lattice 20,0,40,0", "parallel"),
        ("brick.png --diagnostics d.jpg", "outputs are PNG"),
        ("brick.png --pick", "no window can be opened"),
    ],
)
def test_misuse(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each is one line that says what to do, with exit code 2."""
    plt.switch_backend("Agg")
    assert call(f"lattice {line}") == 2
    shown = capsys.readouterr()
    assert message in shown.err and not shown.out and len(shown.err.splitlines()) == 1


def test_the_clicked_anchor_is_carried_through(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--pick` prints six numbers; with them `synth` cuts tiles around the clicked point and keeps bricks whole."""
    recipe = Recipe("brick", {"color": 0.3}, 0, "wall", 0, (128, 128))
    wall = recipe.render()
    assert wall.lattice is not None
    write_image(Path("wall.png"), wall.image)
    x, y = wall.lattice.points((64, 64))[0] + 0.25
    (x1, y1), (x2, y2) = wall.lattice.t1, wall.lattice.t2
    clicked = lattice_of([(x, y), (x + x1, y + y1), (x + x2, y + y2)])
    monkeypatch.setattr("nrbench.cli.lattice_figures.pick", lambda image: clicked)
    assert call("lattice wall.png --pick -o over.png --json") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["origin"] == list(clicked.origin)
    drawn = (read_image("over.png") != read_image("wall.png")).any(-1)
    assert drawn[round(y), round(x)]
    numbers = said.err.strip().rpartition(" ")[2]
    assert numbers.count(",") == 5
    broken = {}
    for name, lattice in (("clicked", numbers), ("vectors", numbers.rpartition(",")[0].rpartition(",")[0])):
        assert call(f"synth wall.png -m tile-set:anchor=given --size 160x160 --lattice {lattice} -o {name}.png") == 0
        output = read_image(f"{name}.png")
        observation = Observation(
            quantize(wall.image), output, wall, lattice_given=Lattice.parse(lattice), again=recipe.again(wall)
        )
        broken[name] = plugins.build("metrics", "integrity").score(observation).values["broken_share"]
    expected = synthesize("tile-set", wall.image, (160, 160), numbers, anchor="given").image
    np.testing.assert_array_equal(read_image("clicked.png"), quantize(expected))
    assert broken["clicked"] < 0.05 and broken["vectors"] > 0.3


def test_a_manual_lattice_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    """`--lattice` answers with its vectors, without a confidence, and draws it."""
    assert call("lattice brick.png --lattice 20,0,0,30 -o over.png --json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer == {"t1": [20, 0], "t2": [0, 30], "detector": "given", "confidence": None}
    changed = (read_image("over.png") != read_image("brick.png")).any(-1)
    assert changed[:, ::20].all() and changed[::30].all() and not changed[5:25, 5:15].any()


def test_all_detectors_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    """`--all --json` is a list with one entry a detector: a lattice with its confidence, or null with the reason.

    Only `frdft` finds an origin.
    """
    assert call("lattice small.png --all --json") == 0
    answers = json.loads(capsys.readouterr().out)
    assert [answer["detector"] for answer in answers] == plugins.names("detectors")
    for answer in answers:
        keys = {"t1", "t2", "confidence"} if "t1" in answer else {"lattice", "reason"}
        keys |= {"origin"} if answer["detector"] == "frdft" else set()
        assert set(answer) == {"detector", "seconds", *keys} and answer["seconds"] > 0


def test_all_detectors_as_a_table_and_a_sheet(capsys: pytest.CaptureFixture[str]) -> None:
    """`--all -o` prints a line a detector under a head, and writes a captioned picture of each."""
    assert call("lattice small.png --all -o sheet.png") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[0] == "detector" and [line.split()[0] for line in lines[1:]] == plugins.names("detectors")
    height, width = read_image("sheet.png").shape[:2]
    assert height > 40 and width > 180 * min(3, len(lines) - 1)


def test_all_detectors_without_a_lattice(capsys: pytest.CaptureFixture[str]) -> None:
    """On a constant picture every detector says why it has none; that is an answer: exit code 0."""
    assert call("lattice constant.png --all -o sheet.png") == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    assert lines and all("no lattice: " in line for line in lines)


def test_a_detector_that_fails_is_a_row(faulty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One that raises has its error in the table and makes exit code 1; the others answer."""
    assert call("lattice small.png --all") == 1
    lines = capsys.readouterr().out.splitlines()
    assert "failed: KeyError: 'gone'" in lines[-1] and lines[-1].startswith("blind")
    assert "failed" not in lines[1]


@pytest.mark.parametrize("picture", ["brick.png", "noise.png"])
def test_diagnostics_are_drawn(picture: str, capsys: pytest.CaptureFixture[str]) -> None:
    """`--diagnostics` draws what led to a lattice, and what led to "there is none"."""
    write_image(Path("noise.png"), texture("noise", shape=(64, 64), seed=2).image)
    assert call(f"lattice {picture} -d gncc --diagnostics why.png") == 0
    drawn = skimage.io.imread("why.png")
    assert min(drawn.shape[:2]) > 300 and len(np.unique(drawn.reshape(-1, drawn.shape[2]), axis=0)) > 50
    assert ("no lattice" in capsys.readouterr().out) == (picture == "noise.png")


def test_diagnostics_of_nothing_are_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the detector left nothing to be drawn, no file is written, and a line says so."""
    assert call("lattice constant.png --diagnostics why.png") == 0
    assert "not written" in capsys.readouterr().err and not (tmp_path / "why.png").exists()
