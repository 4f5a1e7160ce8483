"""Tests for structure of the pixels that is no lattice of the scene: lines of a sensor, grids of enlarged pictures."""

import numpy as np
import pytest
from scipy.ndimage import zoom

from nrbench import NoLatticeFound, detect_lattice, texture
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error

DETECTORS = ("consensus", "gncc", "dominance")
ATOMS = Lattice((24.3, 3.1), (-3.1, 24.3))
LINES = np.arange(300)


def draw_atoms(offsets: np.ndarray) -> Image:
    """Return atoms on a square lattice in noise, of which some are missing, with offsets of the rows in heights."""
    rng = np.random.default_rng(4)
    y, x = np.indices((len(offsets), 300))
    surface = rng.normal(0, 0.15, x.shape) + offsets[:, np.newaxis]
    for place in ATOMS.points(x.shape, 15):
        surface += (rng.random() > 0.05) * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 50)
    return quantize(((surface - surface.min()) / np.ptp(surface)).astype(np.float32)[..., np.newaxis])


def error_of(image: Image, truth: Lattice, detector: str = "consensus") -> float:
    """Return the error of a detected lattice, px; infinite if it is another lattice."""
    error = lattice_error(detect_lattice(image, detector).lattice, truth, image.shape[:2])
    return error.vector if error.relation == "exact" else np.inf


OFFSETS = {
    "rows": np.random.default_rng(1).normal(0, 0.35, 300),
    "strong rows": np.random.default_rng(2).normal(0, 1.2, 300),
    "banding": 0.4 * np.sin(2 * np.pi * LINES / 41.7),
    "drift": np.cumsum(np.random.default_rng(3).normal(0, 0.2, 300)),
}


@pytest.mark.parametrize("kind", OFFSETS)
def test_offsets_of_lines_do_not_move_the_lattice(kind: str) -> None:
    """Whatever rows or columns are shifted by, the lattice is found to 0.1 px."""
    image = draw_atoms(OFFSETS[kind])
    assert error_of(image, ATOMS) < 0.1
    assert error_of(image.swapaxes(0, 1), Lattice((3.1, 24.3), (24.3, -3.1))) < 0.1


@pytest.mark.parametrize("detector", DETECTORS)
def test_every_detector_is_without_the_offsets(detector: str) -> None:
    """The offsets are removed before any detector sees the image."""
    assert error_of(draw_atoms(OFFSETS["strong rows"]), ATOMS, detector) < 0.1


def test_courses_of_a_wall_stay() -> None:
    """Banding is removed from a wall, and its courses, which are rows, too, are not: the lattice is as precise."""
    wall = texture("brick", shape=(256, 256), seed=0, width=40, height=17)
    lit = wall.image * (1 + 0.25 * np.sin(2 * np.pi * np.arange(256) / 47))[:, np.newaxis, np.newaxis]
    assert error_of(quantize(np.clip(lit, 0, 1).astype(np.float32)), wall.lattice) < 0.03


@pytest.mark.parametrize(("side", "detector"), [(2, "consensus"), (8, "consensus"), (3, "gncc"), (3, "dominance")])
def test_the_grid_of_an_enlarged_picture_is_no_texture(side: int, detector: str) -> None:
    """Copies of pixels show the lattice of the content; if it has none, the reason names the grid."""
    wall = texture("brick", shape=(64, 64), seed=0, color=0.3)
    enlarged = wall.image.repeat(side, 0).repeat(side, 1)[1:, 1:]
    assert error_of(enlarged, Lattice.from_basis(side * wall.lattice.matrix), detector) < 0.3 * side
    noise = np.random.default_rng(side).random((48, 48, 3), np.float32).repeat(side, 0).repeat(side, 1)
    with pytest.raises(NoLatticeFound, match=f"enlarged picture of {side} px a pixel"):
        detect_lattice(noise[:, 1:], detector)


def test_a_board_of_flat_squares_is_content() -> None:
    """A board without noise could be an enlarged picture, too: its lattice is found all the same."""
    board = (np.indices((8, 8)).sum(0) % 2).astype(np.float32).repeat(24, 0).repeat(24, 1)
    assert detect_lattice(board).lattice.is_equivalent(Lattice((24, 24), (24, -24)), 0.2)


@pytest.mark.parametrize("order", [1, 3])
def test_smooth_enlargements_have_no_grid(order: int) -> None:
    """Noise that is enlarged by splines has no lattice."""
    noise = np.random.default_rng(0).random((60, 60)).astype(np.float32)
    with pytest.raises(NoLatticeFound):
        detect_lattice(np.clip(zoom(noise, 3, order=order), 0, 1))
