"""Where a picture leaves its own lattice and look: one planted fault at a time, and pictures without any."""

from pathlib import Path

import numpy as np
import pytest
from commands import answer_json, call

from nrbench import Lattice, NoLatticeFound, PictureDefect, find_defects, texture
from nrbench.imaging.convert import Image, quantize
from nrbench.pictures.files import read_image, write_image

LATTICE = Lattice((24, 0), (12, 12))
SIDES = (192, 240)


def wall(seed: int = 0, deviation: float = 0.05) -> Image:
    """Draw a wall of bricks of 24 x 12 px, each of its own color."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIDES[0], : SIDES[1]].astype(float)
    x, y = x + 100, y + 100
    row = np.floor(y / 12).astype(int)
    right = x - 12 * (row % 2)
    column = np.floor(right / 24).astype(int)
    color = rng.normal((0.6, 0.4, 0.3), deviation, (40, 20, 3))[row % 40, column % 20]
    joint = (right % 24 < 2.5) | (y % 12 < 2.5)
    return quantize(np.where(joint[..., None], 0.75, color + rng.normal(0, 0.02, (*SIDES, 1))).clip(0, 1).astype("f4"))


def find_one(image: Image) -> PictureDefect:
    """Return the only defect."""
    found = find_defects(image, LATTICE)
    assert len(found) == 1, found
    return found[0]


def test_nothing_stands_out_in_most_pictures() -> None:
    """Of ten walls, even and colorful ones, at most one has a defect."""
    assert sum(bool(find_defects(wall(seed, deviation), LATTICE)) for seed in range(5) for deviation in (0.0, 0.1)) <= 1


@pytest.mark.parametrize("fault", ["missing", "stain", "hole", "scratch"])
def test_one_cell_of_another_look_is_found_at_its_place(fault: str) -> None:
    """A missing brick, a stain, a hole and a scratch are one defect each, less than a brick from where they are."""
    image, at = wall().copy(), np.s_[96:106, 120:142]
    if fault == "missing":
        image[at] = 0.75
    elif fault == "stain":
        image[at] *= 0.55
    elif fault == "hole":
        image[98:106, 126:136] = 0.0
    else:
        image[98:108, 130:132] = 0.1
    found = find_one(image)
    assert found.kind == "other look" and found.size > 5
    assert abs(found.x - 131) < 20 and abs(found.y - 101) < 12


def test_a_shifted_course_is_out_of_place_by_its_shift() -> None:
    """A course that is moved by a quarter of s is one defect, of that size, over the whole width."""
    image = wall().copy()
    image[92:104] = np.roll(image[92:104], 4, 1)
    found = find_one(image)
    assert found.kind == "out of place" and found.size == pytest.approx(4 / LATTICE.s, abs=0.05)
    assert abs(found.y - 98) < 12 and np.ptp([x for x, _ in found.outline]) > 150


def test_places_in_a_bent_picture_are_those_of_the_picture() -> None:
    """The only defect of bent cloth is its hole, which lies where it is, not where straightening puts it."""
    image = texture("weave", (128, 128), seed=1, bend=0.5).image
    image[56:66, 76:86] = 0.0
    (found,) = find_defects(image)
    assert abs(found.x - 81) < 8 and abs(found.y - 61) < 8


def test_without_a_lattice_there_are_no_defects() -> None:
    """The error for noise names the missing lattice, and the one for a corner of a wall the few cells."""
    with pytest.raises(NoLatticeFound):
        find_defects(texture("noise", (128, 128)))
    with pytest.raises(NoLatticeFound, match="fewer than 12 whole cells"):
        find_defects(wall()[:40, :40], LATTICE)


def test_the_command_draws_and_lists_defects(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`lattice --defects` prints a line for each defect or "no defects", marks them, and writes JSON."""
    spoiled = wall().copy()
    spoiled[98:106, 126:136] = 0.0
    write_image(tmp_path / "clean.png", wall())
    write_image(tmp_path / "hole.png", spoiled)
    assert call("lattice clean.png --defects out.png --lattice 24,0,12,12") == 0
    assert capsys.readouterr().out.startswith("no defects")
    assert (read_image(tmp_path / "out.png") == wall()).all()
    assert call("lattice hole.png --defects out.png --lattice 24,0,12,12") == 0
    assert capsys.readouterr().out.startswith("1: other look by")
    changed = (read_image(tmp_path / "out.png") != spoiled).any(-1)
    assert changed[80:125, 100:160].any() and not changed[:60].any()
    (one,) = answer_json(capsys, "lattice hole.png --defects out.png --lattice 24,0,12,12 --json")["defects"]
    assert one["kind"] == "other look" and len(one["outline"]) >= 4
    assert call("lattice hole.png --defects out.png --symmetry") == 2
    assert call("lattice hole.png --defects hole.png") == 2
