"""The wallpaper group of pictures whose group is known."""

import dataclasses
import json

import numpy as np
import pytest

import nrbench
from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.wallpaper import GROUPS, Group, Wallpaper
from nrbench.imaging.mean_tile import interpolate
from nrbench.imaging.wallpaper_group import find_wallpaper_group
from nrbench.plugins.forms import Texture

CELL = {"width": 23.3, "height": 19.7, "motif": 2}
MILD = {"color": 0.08, "intensity": 0.05, "noise": 0.02}


def draw(group: Group, rotation: float = 17.0, **departures: float) -> Texture:
    """Return a wallpaper of five to six periods along each side."""
    return Wallpaper(**CELL, group=group, rotation=rotation, **departures).render((120, 120), np.random.default_rng(1))


@pytest.mark.parametrize("group", GROUPS)
def test_all_groups_are_recognized(group: Group) -> None:
    """Every group is found under mild departures, and each symmetry maps the ideal picture to itself."""
    texture = draw(group, **MILD)
    found = find_wallpaper_group(texture.image, texture.lattice)
    assert found.group == group and found.confidence > 0.95
    here = np.random.default_rng(0).uniform(50, 70, (300, 2))
    for each in found.symmetries:
        there = 60 + texture.lattice.wrap(here @ each.matrix + each.offset - 60)
        pictures = (interpolate(texture.ideal, places).ravel() for places in (here, there))
        assert np.corrcoef(*pictures)[0, 1] > 0.9
        assert each.center + np.array(each.axis) / 2 * (each.kind == "glide") == pytest.approx(
            np.array(each.center) @ each.matrix + each.offset
        )


def test_the_group_stays_open_where_noise_hides_it() -> None:
    """Where grain hides the motif, the group is unknown and the reason names the isometry; likewise for few cells."""
    texture = draw("p2", noise=0.9)
    found = find_wallpaper_group(texture.image, texture.lattice)
    assert found.group is None and "agreement" in found.reason and found.reason in str(found)
    few = find_wallpaper_group(texture.image[:40, :40], texture.lattice)
    assert few.group is None and "too few" in few.reason and few.confidence == 0


def test_a_supercell_is_refused() -> None:
    """If the cell is too large, the reason gives the shorter period."""
    lattice = nrbench.Lattice((40, 0), (0, 30))
    y, x = np.indices((160, 160))
    image = np.cos(2 * np.pi * x / 20) + np.cos(2 * np.pi * (x / 20 + y / 15)) / 2 + np.sin(2 * np.pi * y / 15)
    found = find_wallpaper_group(np.float32(0.5 + image[..., np.newaxis] / 6), lattice)
    assert found.group is None and "also repeats by (" in found.reason


def test_models_without_noise() -> None:
    """A running bond is cmm, a honeycomb p6m, whatever the basis and the origin."""
    for model, group in ((Brick(), "cmm"), (Hexagon(rotation=11), "p6m")):
        texture = model.render((160, 160), np.random.default_rng(3))
        (x1, y1), (x2, y2) = texture.lattice.t1, texture.lattice.t2
        for lattice in (texture.lattice, nrbench.Lattice((x1 + 3 * x2, y1 + 3 * y2), (x2, y2), (5.0, 7.0))):
            assert find_wallpaper_group(texture.ideal, lattice).group == group


def test_symmetries_that_others_imply_hold() -> None:
    """A honeycomb has all its rotations and six mirrors, also those that are open alone; these lower no confidence."""
    texture = nrbench.texture("hexagon", shape=(128, 128), seed=0, color=0.3)
    found = find_wallpaper_group(texture.image, texture.lattice)
    own = [dataclasses.replace(each, implied=False) for each in found.candidates]
    assert {each.holds for each in own} == {True, None}
    assert found.group == "p6m" and len(found.symmetries) == len(found.candidates) == 9 and found.confidence > 0.97
    assert str(found).count(", implied") == sum(each.holds is None for each in own)


def test_nothing_to_compare_is_no_group() -> None:
    """Cells of two pixels, of more than the picture, and of rounding errors give a reason, without a warning."""
    y, x = np.indices((100, 100))
    ramp, noise = np.float32(x + 2 * y) / 600, np.random.default_rng(2).normal(0.5, 1e-6, (100, 100))
    for image, side in ((ramp, 10), (noise, 10), (np.float32(x % 10 < 5), 2), (np.float32(x % 10 < 5), 500)):
        found = find_wallpaper_group(np.float32(image[..., np.newaxis]), nrbench.Lattice((side, 0), (0, side)))
        assert found.group is None and found.confidence == 0 and found.reason
        json.loads(json.dumps(found.as_dict(), allow_nan=False))
        assert not found.symmetries


def test_flat_pictures_have_no_group() -> None:
    """A flat picture has no group, and neither has one of noise; the function finds the lattice if none is given."""
    for image in (np.full((64, 64, 1), 0.5, np.float32), np.random.default_rng(0).random((64, 64, 3), np.float32)):
        assert find_wallpaper_group(image, nrbench.Lattice((8, 0), (0, 8))).group is None
    with pytest.raises(nrbench.NoLatticeFound):
        nrbench.detect_symmetry(np.full((64, 64), 0.5))
