"""`nrbench lattice`: one detector, all of them, or a lattice by hand, as text, as JSON and drawn."""

import json
from pathlib import Path

import numpy as np
import pytest
import skimage.io
from candidates import OTHERS, Ranked
from commands import answer_json, call, refusal
from numpy.typing import NDArray

from nrbench import plugins, synthesize, texture
from nrbench.cli.lattice_detection import lattice_of
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.vertices import lay_vertices
from nrbench.pictures.files import read_image, write_image
from nrbench.pictures.truth import read_vertices
from nrbench.plugins.forms import Observation
from nrbench.suites.cell import Recipe


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
        ("brick.png -o ./brick.png", "is the picture itself"),
        ("walls --all", "--all: needs one picture"),
        ("walls --keep --force", "choose one"),
        ("walls", "has no picture"),
        ("brick.png --keep", "is for a folder"),
        ("walls --vertices v.csv", "--vertices: needs one picture"),
        ("brick.png --vertices v.png", "cannot be written in this format; end the name in .csv"),
        ("brick.png --all --vertices v.csv", "leave --all out"),
    ],
)
def test_misuse(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each, for one picture or for a folder, is one line that says what to do, with exit code 2; nothing is written."""
    Path("walls").mkdir()
    assert call(f"lattice {line}") == 2
    shown = capsys.readouterr()
    assert message in shown.err and not shown.out and len(shown.err.splitlines()) == 1
    assert not list(Path("walls").iterdir())


def enlarged(name: str, times: int) -> NDArray[np.float32]:
    """Return a picture with each pixel repeated along both axes."""
    return np.repeat(np.repeat(read_image(Path(name)), times, axis=0), times, axis=1)


def test_the_clicked_anchor_is_carried_through(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--pick` prints six numbers; with them `synth` cuts tiles around the clicked point, and bricks stay whole."""
    recipe = Recipe("brick", {"color": 0.3}, 0, "wall", 0, (128, 128))
    wall = recipe.render()
    write_image(Path("wall.png"), wall.image)
    x, y = wall.lattice.points((64, 64))[0] + 0.25
    (x1, y1), (x2, y2) = wall.lattice.t1, wall.lattice.t2
    clicked = lattice_of([(x, y), (x + x1, y + y1), (x + x2, y + y2)])
    monkeypatch.setattr("nrbench.cli.lattice_detection.pick", lambda image, announce: clicked)
    assert call("lattice wall.png --pick -o over.png --json") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["origin"] == list(clicked.origin)
    drawn = (read_image("over.png") != enlarged("wall.png", 2)).any(-1)
    assert drawn[round(2 * y + 0.5), round(2 * x + 0.5)]
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
    assert "the lattice has no origin" in capsys.readouterr().err
    expected = synthesize("tile-set", wall, (160, 160), numbers, anchor="given").image
    np.testing.assert_array_equal(read_image("clicked.png"), quantize(expected))
    assert max(broken.values()) < 0.05
    assert (read_image("clicked.png") != read_image("vectors.png")).any()


def test_a_manual_lattice_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    """`--lattice` answers with its vectors, without a confidence, and draws it."""
    answer = answer_json(capsys, "lattice brick.png --lattice 20,0,0,30 -o over.png --json")
    assert answer == {"t1": [20, 0], "t2": [0, 30], "detector": "given", "confidence": None}
    changed = (read_image("over.png") != enlarged("brick.png", 3)).any(-1)
    assert changed[:, 1::60].all() and changed[1::90].all() and not changed[5:85, 5:55].any()


def test_vertices_are_written(capsys: pytest.CaptureFixture[str]) -> None:
    """`--vertices` writes the points of the lattice in the picture as a file that can be read as its truth."""
    assert call("lattice brick.png --lattice 20,0,0,30,5,7 --vertices v.csv") == 0
    assert "v.csv: 18 vertices" in capsys.readouterr().err
    vertices = read_vertices(Path("v.csv"), (96, 112))
    assert set(vertices) == set(lay_vertices(Lattice((20.0, 0.0), (0.0, 30.0), (5.0, 7.0)), (96, 112)))
    Path("v.csv").write_text("mine")
    assert call("lattice brick.png --lattice 20,0,0,30 --vertices v.csv") == 2
    assert "v.csv: exists" in capsys.readouterr().err and Path("v.csv").read_text() == "mine"
    assert call("lattice brick.png --lattice 20,0,0,30 --vertices v.csv --force") == 0
    assert len(read_vertices(Path("v.csv"), (96, 112))) > 9
    assert call("lattice constant.png --vertices none.csv") == 0
    assert "not written, there is no lattice" in capsys.readouterr().err and not Path("none.csv").exists()


def test_all_detectors_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    """`--all --json` is a list with one entry a detector: a lattice with its confidence, or null with the reason.

    Only `frdft` finds an origin.
    """
    answers = answer_json(capsys, "lattice small.png --all --json")
    assert [answer["detector"] for answer in answers] == plugins.names("detectors")
    for answer in answers:
        keys = {"t1", "t2", "confidence"} if "t1" in answer else {"lattice", "reason"}
        keys |= {"probabilities", "alternatives"} if "t1" in answer else set()
        keys |= {"origin"} if answer["detector"] == "frdft" else set()
        assert set(answer) == {"detector", "seconds", *keys} and answer["seconds"] > 0


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


@pytest.fixture
def ranked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `consensus` return a ranked list of candidates."""
    monkeypatch.setattr("nrbench.detectors.consensus.Consensus.detect", lambda self, image: Ranked().detect(image))
    skimage.io.imsave("bright.png", np.full((60, 80, 3), 204, np.uint8), check_contrast=False)


def test_candidates_as_json(ranked: None, capsys: pytest.CaptureFixture[str]) -> None:
    """`--json` holds the chosen lattice, its probabilities, and all alternatives with evidence and relation."""
    answer = answer_json(capsys, "lattice bright.png --json")
    assert {name: answer[name] for name in ("t1", "t2", "detector", "confidence")} == {
        "t1": [16, 0], "t2": [0, 12], "detector": "consensus", "confidence": pytest.approx(0.8)
    }  # fmt: skip
    assert answer["probabilities"] == pytest.approx({"exact": 0.8, "sub_or_supercell": 0.1, "none": 0.1})
    second = {"t1": [32, 0], "t2": [0, 12], "confidence": 0.2, "relation": "double along t1"}
    assert answer["alternatives"][0] == {**second, "evidence": 0.31}
    assert len(answer["alternatives"]) == len(OTHERS) == 3


def test_candidates_as_text(ranked: None, capsys: pytest.CaptureFixture[str]) -> None:
    """The first line is the chosen lattice; the second and the third candidate follow, and no others."""
    assert call("lattice bright.png") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "t1 = (16.000, 0.000) px, t2 = (0.000, 12.000) px, consensus, confidence 0.800"
    assert [line.partition(":")[0] for line in lines[1:]] == ["candidate 2", "candidate 3"]
    assert "(32.000, 0.000)" in lines[1] and "double along t1, confidence 0.200" in lines[1]


def test_an_origin_at_zero_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    """Six numbers are a known origin, also (0, 0); four numbers are none."""
    assert call("lattice brick.png --lattice 20,0,0,30,0,0 --json") == 0
    assert json.loads(capsys.readouterr().out)["origin"] == [0, 0]
    assert call("lattice brick.png --lattice 20,0,0,30,3,4") == 0
    assert "origin = (3.000, 4.000) px" in capsys.readouterr().out


def test_a_folder(ranked: None, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder gives truth.csv and sheets, whose paths are printed; a broken picture makes exit code 1."""
    Path("walls").mkdir()
    skimage.io.imsave("walls/bright.png", np.full((60, 80, 3), 204, np.uint8), check_contrast=False)
    assert call("lattice walls") == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[:3] == ["walls/truth.csv", "walls/lattices/page-1.png", "1 pictures: 1 with a lattice"]
    assert said.err.splitlines() == ["[1/1] bright.png"]
    Path("walls/text.png").write_text("no picture")
    assert "--force" in refusal(capsys, "lattice walls")
    assert call("lattice walls --force --json --least 0.9") == 1
    answer = json.loads(capsys.readouterr().out)
    assert [each["file"] for each in answer["pictures"]] == ["bright.png", "text.png"]
    assert answer["pictures"][0]["lattice"] is None and answer["pictures"][0]["candidates"][1]["t1"] == [32, 0]
    assert answer["pictures"][1]["failed"] and answer["truth"] == "walls/truth.csv"


def test_the_symmetry_is_printed_and_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    """``--symmetry`` prints the group, and adds it to JSON and its signs to the overlay; it needs one lattice."""
    wall = texture("brick", shape=(160, 160), seed=1, color=0.05)
    write_image(Path("wall.png"), wall.image)
    command = f"lattice wall.png --lattice {','.join(map(str, wall.lattice.numbers))}"
    assert call(f"{command} -o plain.png") == 0
    assert call(f"{command} --symmetry -o signs.png") == 0
    assert "wallpaper group cmm" in capsys.readouterr().out
    plain, signs = (read_image(Path(f"{name}.png")) for name in ("plain", "signs"))
    assert plain.shape == signs.shape and 0.02 < (plain != signs).any(-1).mean() < 0.5
    symmetry = answer_json(capsys, f"{command} --symmetry --json")["symmetry"]
    assert symmetry["group"] == "cmm" and {each["holds"] for each in symmetry["candidates"]} <= {True, False, None}
    assert call("lattice wall.png --all --symmetry") == 2
