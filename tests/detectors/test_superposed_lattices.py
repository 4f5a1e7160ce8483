"""Tests for several lattices in one image."""

from pathlib import Path

import numpy as np
import pytest
from commands import answer_json

from nrbench import NoLatticeFound, detect_lattice, texture
from nrbench.detectors.candidate_search.superposed_lattices import find_wave_lattices
from nrbench.imaging.convert import Image, quantize
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import write_image

INKS = np.array([(0, 1, 1), (1, 0, 1), (1, 1, 0), (0, 0, 0)], np.float64)


def draw_screens(*screens: tuple[float, float], gray: bool = False) -> tuple[Image, list[Lattice]]:
    """Return screens of dots with (angle in degrees, pitch in px), one for each ink, and their lattices."""
    y, x = np.indices((280, 280))
    rng, image, lattices = np.random.default_rng(0), np.ones((280, 280, 3)), []
    for (angle, pitch), ink in zip(screens, INKS, strict=False):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        waves = np.cos(2 * np.pi * (c * x + s * y) / pitch) + np.cos(2 * np.pi * (c * y - s * x) / pitch)
        image *= 1 - (1 / (1 + np.exp((0.5 - waves) / 0.3)))[..., np.newaxis] * (1 - ink)
        lattices.append(Lattice((pitch * c, pitch * s), (-pitch * s, pitch * c)))
    image += rng.normal(0, 0.02, image.shape)
    return quantize(np.clip(image.mean(2, keepdims=True) if gray else image, 0, 1).astype(np.float32)), lattices


@pytest.mark.parametrize(
    ("screens", "gray"),
    [
        (((15, 6.1), (75, 6.1), (0, 6.1), (45, 6.1)), False),
        (((12, 9.0), (40, 7.3)), True),
        (((0, 8.0), (20, 8.0)), False),
    ],
)
def test_screens_are_named_one_by_one(screens: tuple[tuple[float, float], ...], gray: bool) -> None:
    """Of superposed screens, gray or of inks, all lattices are named, to 0.1 px, and none alone is the answer."""
    image, lattices = draw_screens(*screens, gray=gray)
    with pytest.raises(NoLatticeFound, match="several lattices are superposed") as none:
        detect_lattice(image)
    assert len(none.value.lattices) == len(lattices)
    assert all(any(each.is_equivalent(found, 0.1) for found in none.value.lattices) for each in lattices)


def test_one_lattice_is_not_several() -> None:
    """One screen, large cells, cells of several elements, and noise are not taken for superposed lattices."""
    screen, (lattice,) = draw_screens((15, 6.1))
    assert detect_lattice(screen).lattice.is_equivalent(lattice, 0.02)
    for name in ("wallpaper", "hexagon", "basket", "plaid", "noise"):
        assert len(find_wave_lattices(texture(name, shape=(192, 192), seed=1).image)) < 2


def test_the_command_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``nrbench lattice --json`` has the vectors of each, no lattice, and exit code 0."""
    write_image(tmp_path / "screens.png", draw_screens((12, 9.0), (40, 7.3))[0])
    answer = answer_json(capsys, "lattice", str(tmp_path / "screens.png"), "--json")
    assert answer["lattice"] is None
    assert [sorted(each) for each in answer["lattices"]] == [["t1", "t2"]] * 2


def test_periods_that_cannot_be_told_are_named() -> None:
    """Where a fine screen repeats better by a multiple, there is no lattice, and the reason has the true vectors."""
    image, (lattice,) = draw_screens((20, 3.0), gray=True)
    with pytest.raises(NoLatticeFound, match=r"t1 = \(2.82, 1.03\), .* periods under 5 px") as none:
        detect_lattice(image)
    assert none.value.lattices[0].is_equivalent(lattice, 0.05)
