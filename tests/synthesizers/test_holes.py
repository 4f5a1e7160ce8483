"""Claims about pictures with holes: what fills them, and what methods make of a sample with holes."""

import numpy as np
import pytest
from numpy.typing import NDArray

import nrbench
from nrbench import plugins
from nrbench.displacement.deformation_field import read_spline
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import FoundLattice, Refused, Task
from nrbench.synthesizers.gap_filling.holes import HoleFiller, crop_to_known, trace_places

LATTICE = Lattice((24, 0), (12, 16))
ABLE = [one.name for one in plugins.inventory("synthesizers") if one.built_in and getattr(one.cls, "masks", False)]


def wall(height: int = 96, width: int = 120, tints: float = 0.2, bits: int = 8) -> nrbench.Image:
    """Return a wall on the lattice: bricks of random tints with joints 3 px wide, gray."""
    y, x = np.indices((height, width))
    row, column = y // 16, (x - 12 * (y // 16)) // 24
    tint = 0.4 + tints * np.random.default_rng(3).random((row.max() + 1, np.ptp(column) + 1))
    joint = (y % 16 < 3) | ((x - 12 * row) % 24 < 3)
    return quantize(np.where(joint, 0.9, tint[row, column - column.min()])[..., np.newaxis].astype(np.float32), bits)


def holes(kind: str, height: int = 96, width: int = 120) -> NDArray[np.bool_]:
    """Return where a picture has no holes: a window, a scratch, the half of it, several at the border."""
    y, x = np.indices((height, width))
    return {
        "window": ~((abs(y - 50) < 17) & (abs(x - 61) < 23)),
        "scratch": y != 20 + x // 3,
        "half": x < width // 2,
        "several": ~((y < 20) & (x > 90)) & (np.hypot(y - 96, x - 20) > 25) & (abs(x - 60) + abs(y - 40) > 13),
    }[kind]


def painted(image: nrbench.Image, known: NDArray[np.bool_]) -> nrbench.Image:
    """Return a picture whose holes are black, a color that it shows nowhere else."""
    return np.where(known[..., np.newaxis], image, 0).astype(np.float32)


@pytest.mark.parametrize("kind", ["window", "scratch", "half", "several"])
def test_a_hole_is_filled_by_what_the_lattice_continues(kind: str) -> None:
    """Of a wall without tints each pixel comes back, at any hole; the source map names the known pixels."""
    image, known = wall(tints=0.0), holes(kind)
    made = nrbench.fill(painted(image, known), known, lattice=LATTICE)
    np.testing.assert_array_equal(made.image, image)
    x, y = np.moveaxis(made.source[..., :2].astype(int), -1, 0)
    assert known[y, x].all() and (made.source[..., 2] == 1).all()
    np.testing.assert_array_equal(made.image, image[y, x])


@pytest.mark.parametrize("bits", [8, 16])
def test_known_pixels_stay_and_joints_continue(bits: int) -> None:
    """With tints, known pixels keep all their bits, joints continue exactly, and seams inside bricks are few."""
    image, known = wall(tints=0.3, bits=bits), holes("window")
    made = nrbench.fill(painted(image, known), known, lattice=LATTICE).image
    np.testing.assert_array_equal(made[known], image[known])
    assert ((made > 0.8) == (image > 0.8)).all()
    assert set(made[~known].tolist()[0]) <= set(image[known].ravel().tolist())
    steps = [np.abs(np.diff(np.where(part > 0.8, np.nan, part), axis=1)) > 0.02 for part in (made, image)]
    assert steps[1].sum() == 0 and steps[0].sum() < 40


def test_a_bent_lattice_is_followed_through_the_hole() -> None:
    """In a wall that waves by 3 px the hole shows what the wave continues; known pixels keep their bits."""
    straight, known = wall(220, 270, tints=0.0), holes("window", 200, 240)
    y, x = np.indices((200, 240))
    places = np.stack([x + 15 + 3 * np.sin(y / 35), y + 10 + 3 * np.sin(x / 40)], -1)
    image = quantize(read_spline(straight, places))
    made = nrbench.fill(painted(image, known), known, lattice=LATTICE)
    assert "filled as it is bent" in made.note
    np.testing.assert_array_equal(made.image[known], image[known])
    assert np.abs(made.image - image)[~known].mean() < 0.03
    assert made.source is not None and known[tuple(made.source[..., 1::-1].astype(int).reshape(-1, 2).T)].all()


@pytest.mark.filterwarnings("ignore:rsgf. no lattice")
def test_a_picture_without_lattice_is_filled_from_anywhere() -> None:
    """Noise has no lattice: notes say that once, and the hole holds pixels of the rest."""
    noise = quantize(np.random.default_rng(1).random((64, 64, 1), np.float32))
    known = np.ones((64, 64), bool)
    known[20:40, 25:45] = False
    made = nrbench.fill(painted(noise, known), known)
    assert made.note.count("no lattice found") == 1 and "patches from anywhere" in made.note
    assert nrbench.synthesize("rsgf", noise, (48, 48), mask=known).note.count("no lattice found") == 1
    assert made.source is not None and known[tuple(made.source[..., 1::-1].astype(int).reshape(-1, 2).T)].all()


def test_what_every_cell_leaves_out_is_refused() -> None:
    """Holes that repeat with the lattice, as those of a fence, are filled by nothing: the message names what to do."""
    image = wall()
    known = image[..., 0] > 0.8
    with pytest.raises(Refused, match=r"repeats with the lattice.*--keep-alpha"):
        HoleFiller(image, known, LATTICE, np.random.default_rng(0)).fill(lambda done: None)


def test_fill_needs_a_hole_and_a_method_that_can() -> None:
    """Without a hole there is nothing to fill; a method that cannot is refused with those that can."""
    with pytest.raises(nrbench.BadInput, match="no hole"):
        nrbench.fill(wall())
    with pytest.raises(nrbench.BadInput, match=r"quilting cannot fill holes; .*rsgf can"):
        nrbench.fill(wall(), holes("window"), "quilting")


def test_a_mask_the_wrong_way_round_is_named() -> None:
    """If most of the picture is to be filled, a warning says that white is kept."""
    with pytest.warns(UserWarning, match="white is kept"):
        nrbench.fill(wall(tints=0.0), holes("half") & holes("window"), lattice=LATTICE)


@pytest.mark.parametrize("name", ["rsgf", "tile-set", "quilting", "fftm-patch", "resample"])
def test_outputs_hold_nothing_that_is_left_out(name: str) -> None:
    """No output shows the color of the hole, and source maps name known pixels only, with the right values."""
    image, known = wall(112, 144), holes("window", 112, 144)
    made = nrbench.synthesize(name, painted(image, known), (96, 96), lattice=LATTICE, mask=known)
    assert made.image.min() > 0.3
    if made.source is not None:
        copied = np.isfinite(made.source).all(-1)
        x, y = np.rint(made.source[copied][:, :2]).astype(int).T
        assert known[y, x].all()


def test_the_needed_methods_leave_pixels_out() -> None:
    """Methods that copy or model patches and tiles can; references that know the truth cannot."""
    assert {"rsgf", "tile-set", "resample", "quilting", "fftm-patch", "graph-cuts", "patch-based"} <= {*ABLE}
    assert not {"oracle", "copier", "planted"} & {*ABLE}


def test_places_are_traced_through_a_filled_sample() -> None:
    """The place of a filled pixel is that of the pixel that filled it, moved as far from its middle; others stay."""
    filled = np.ones((4, 4, 3), np.float32)
    filled[..., 0], filled[..., 1] = np.arange(4), np.arange(4)[:, np.newaxis]
    filled[1, 2] = (0, 3, 1)
    places = np.array([(2, 1), (3, 3), (2.25, 0.75), (3.5, -0.5)])
    np.testing.assert_array_equal(trace_places(places, filled), [(0, 3), (3, 3), (0.25, 2.75), (3.5, -0.5)])


def test_a_method_gets_the_filled_sample_only_if_pixels_do_not_count() -> None:
    """A task without a mask reaches the method unchanged, so that outputs keep their bytes."""
    image, method = wall(), plugins.build("synthesizers", "quilting", {"block": 32})
    task = Task(image, (64, 64), LATTICE, np.random.default_rng(5))
    direct = type(method).synthesize.__wrapped__(method, Task(image, (64, 64), LATTICE, np.random.default_rng(5)))
    np.testing.assert_array_equal(method.synthesize(task).image, direct.image)


def test_too_little_to_fill_from_is_refused() -> None:
    """A mask that leaves less than a tenth of the picture is named, and one that leaves less than 8x8 px."""
    known = np.zeros((96, 120), bool)
    known[40:50, 40:50] = True
    with pytest.warns(UserWarning), pytest.raises(Refused, match=r"mask: leaves 0.87 % of 120x96 px, too little"):
        nrbench.fill(wall(), known, lattice="6,0,0,6")
    known[:, 41:] = False
    with pytest.raises(nrbench.BadInput, match="mask: leaves 10 of 11520 px, fewer than 8x8"):
        nrbench.synthesize("rsgf", wall(), (64, 64), mask=known)


def test_of_a_large_hole_only_a_known_part_is_used() -> None:
    """A sample with a large hole is cropped to what is well known, in its phase, and at least four periods large."""
    image, known = wall(320, 320), np.ones((320, 320), bool)
    known[100:300, 90:310] = False
    task = Task(image, (64, 64), LATTICE, np.random.default_rng(0), known=known)
    part, found, corner = crop_to_known(task, FoundLattice(LATTICE))
    assert part.known is not None and part.known.mean() > 0.85 and min(part.known.shape) >= 64
    x, y = corner
    np.testing.assert_array_equal(part.sample, image[y:, x:][: part.sample.shape[0], : part.sample.shape[1]])
    assert found.lattice is not None and found.lattice.is_equivalent(LATTICE, 0.01)
    assert np.abs(LATTICE.wrap(corner)).max() < 0.01
