"""`nrbench lattice --straighten`: the lattice of a bent picture, and the picture made straight."""

import json
from pathlib import Path

import numpy as np
import pytest
import skimage.io
from bent_pictures import tilted
from commands import answer_json, call, refusal

import nrbench
from nrbench.cli.lattice_detection import describe_deformation
from nrbench.displacement.deformation_field import Deformation
from nrbench.displacement.growth import Knots
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import read_image, write_image


@pytest.fixture(autouse=True)
def pictures() -> None:
    """Write a bent and a straight picture into the current directory."""
    for name, bend in (("bent", 0.5), ("straight", 0.0)):
        write_image(Path(f"{name}.png"), nrbench.texture("weave", shape=(128, 128), seed=1, bend=bend).image)


def test_a_bent_picture_is_straightened(capsys: pytest.CaptureFixture[str]) -> None:
    """The straight picture repeats by the lattice that JSON states, and is not bent any more."""
    shown = answer_json(capsys, "lattice bent.png --straighten out.png -o overlay.png --json")
    assert shown["deformation"]["bent"] and shown["deformation"]["homography"] is None
    assert shown["detector"] == "consensus" and 0 < shown["confidence"] <= 1
    mean = Lattice(shown["t1"], shown["t2"])
    again = nrbench.track_lattice(read_image(Path("out.png")), mean)
    assert again.amplitude < shown["deformation"]["amplitude"] / 4
    assert mean.is_equivalent(again.lattice, 0.02 * mean.s)
    overlay, picture = read_image(Path("overlay.png")), read_image(Path("bent.png"))
    assert overlay.shape == picture.shape and 0.02 < (np.abs(overlay - picture).max(-1) > 0.1).mean() < 0.3


def test_a_straight_picture_is_written_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """Its lattice is that of the detector, and the text says that it is not bent."""
    assert call("lattice straight.png --straighten out.png") == 0
    assert "not bent" in capsys.readouterr().out
    assert (read_image(Path("out.png")) == read_image(Path("straight.png"))).all()
    detected = answer_json(capsys, "lattice straight.png --json")
    followed = answer_json(capsys, "lattice straight.png --straighten out.png --json")
    same = Lattice(detected["t1"], detected["t2"]).is_equivalent(Lattice(followed["t1"], followed["t2"]), 0.2)
    assert same and not followed["deformation"]["bent"]


def test_a_bent_lattice_is_found_without_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    """A plane in perspective, in which the detector alone finds no lattice, gets the mean one, called bent.

    If a detector is named, its answer alone counts. The symmetry is that of the straightened picture, in Python too.
    """
    image = tilted(160, homography=np.array([[1.0, 0, 0], [0, 1.0, 0], [5e-3, 2.5e-3, 1.0]])).image
    write_image(Path("floor.png"), image)
    assert call("lattice floor.png -o overlay.png --symmetry --json") == 0
    printed = capsys.readouterr()
    shown = json.loads(printed.out)
    assert "without signs" in printed.err
    assert shown["symmetry"] == json.loads(json.dumps(nrbench.detect_symmetry("floor.png").as_dict()))
    assert shown["deformation"]["bent"] and shown["deformation"]["homography"] and "origin" not in shown
    mean = nrbench.track_lattice(image).lattice
    assert mean.is_equivalent(Lattice(shown["t1"], shown["t2"]), 0.02 * mean.s)
    assert 0.02 < (np.abs(read_image(Path("overlay.png")) - image).max(-1) > 0.1).mean() < 0.4
    assert call("lattice floor.png -d consensus --json") == 0
    assert json.loads(capsys.readouterr().out)["lattice"] is None


def test_a_detector_of_bent_lattices_is_refused_for_the_symmetry(capsys: pytest.CaptureFixture[str]) -> None:
    """Its mean lattice is not that of the pixels."""
    assert "straighten the image first" in refusal(capsys, "lattice straight.png -d tracked --symmetry")


def test_a_given_lattice_needs_no_detector(capsys: pytest.CaptureFixture[str]) -> None:
    """It is followed from about the right vectors; neither detector nor confidence is stated."""
    lattice = nrbench.texture("weave", shape=(128, 128), seed=1, bend=0.5).lattice
    numbers = ",".join(f"{1.02 * number:.2f}" for number in (*lattice.t1, *lattice.t2))
    shown = answer_json(capsys, f"lattice bent.png --lattice={numbers} --straighten out.png --json")
    assert shown["deformation"]["bent"] and "detector" not in shown
    assert Lattice(shown["t1"], shown["t2"]).is_equivalent(lattice, 0.02 * lattice.s)


def test_without_a_lattice_nothing_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    """That there is no lattice is an answer, with exit code 0."""
    skimage.io.imsave("constant.png", np.full((64, 64, 3), 99, np.uint8), check_contrast=False)
    assert call("lattice constant.png --straighten out.png --json") == 0
    assert json.loads(capsys.readouterr().out)["lattice"] is None and not Path("out.png").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(
            (option, "leave --all, --pick and --diagnostics out")
            for option in ("--all", "--pick", "--diagnostics d.png")
        ),
        ("-o ./out.png", "would be written twice"),
    ],
)
def test_misuse(options: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One lattice is followed, and two pictures need two names; nothing is written."""
    assert call(f"lattice bent.png --straighten out.png {options}") == 2
    assert message in capsys.readouterr().err and not Path("out.png").exists()


def test_a_lattice_that_was_not_followed_is_not_called_straight() -> None:
    """The text says that nothing is known about the deformation."""
    found = Deformation(np.zeros((64, 64, 1), np.float32), Knots.regular(Lattice((16, 0), (0, 16)), (64, 64)), 0.7)
    assert found.covered == 0 and found.lattice.is_equivalent(Lattice((16, 0), (0, 16)), 1e-6)
    assert "not known" in describe_deformation(found) and "not bent" not in describe_deformation(found)
