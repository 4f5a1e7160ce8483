"""Tests of detection where some pixels do not count: a wall with a sign, a fence with transparent holes."""

import numpy as np
import pytest

import nrbench
from nrbench import BadInput, Lattice
from nrbench.imaging.correlation import half_autocorrelation
from nrbench.imaging.masks import MaskedImage, fill_periodically

FENCE = Lattice((17.3, 17.3), (17.3, -17.3))


@pytest.fixture(scope="module")
def wall() -> nrbench.Texture:
    """Return a wall without a sign."""
    return nrbench.texture("brick", shape=(200, 220), seed=3)


def _with_sign(image: nrbench.Image) -> tuple[nrbench.Image, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """Return a picture with a striped sign, and which pixels are not of the sign."""
    sign, known = image.copy(), np.ones(image.shape[:2], bool)
    known[60:135, 70:150] = False
    sign[60:135, 70:150] = (np.arange(80) % 9 < 4)[:, np.newaxis]
    return sign, known


def _fence() -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return wires of one color, brighter in their middle, with transparent holes, ``(H, W, 4)``."""
    y, x = np.indices((180, 180)).astype(float)
    u, v = FENCE.to_cell(np.stack([x, y], -1)).transpose(2, 0, 1)
    near = np.minimum(np.abs(u - np.rint(u)), np.abs(v - np.rint(v)))
    gray = 190 - 600 * near
    return np.dstack([gray, gray, gray, 255 * (near < 0.09)]).astype(np.uint8)


@pytest.mark.parametrize("detector", ["consensus", "dominance"])
def test_a_sign_on_a_wall_is_left_out(wall: nrbench.Texture, detector: str) -> None:
    """The lattice of a wall is found to 0.1 px beside a sign that the mask leaves out, whatever the sign shows."""
    image, known = _with_sign(wall.image)
    found = nrbench.detect_lattice(image, detector, mask=known).lattice
    assert found.is_equivalent(wall.lattice, tolerance=0.1)
    assert nrbench.detect_lattice(np.dstack([image, known]).astype(np.float32), detector).lattice == found


@pytest.mark.parametrize("detector", ["consensus", "dominance", "gncc"])
def test_holes_that_repeat_are_texture(detector: str) -> None:
    """A fence has the lattice of its wires, though no pixel counts between them."""
    assert nrbench.detect_lattice(_fence(), detector).lattice.is_equivalent(FENCE, tolerance=0.05)


def test_detectors_that_cannot_leave_out_pixels_are_refused() -> None:
    """The message names those that can."""
    with pytest.raises(BadInput, match=r"ssdn cannot leave out .*; consensus, .*dominance"):
        nrbench.detect_lattice(_fence(), "ssdn")


def test_masked_correlation() -> None:
    """With a mask of all pixels it is the correlation without one; what the mask leaves out does not change it."""
    rng = np.random.default_rng(1)
    image, known = rng.random((24, 31, 3)).astype(np.float32), rng.random((24, 31)) > 0.2
    full = half_autocorrelation(image)[6:-6, :24]
    np.testing.assert_allclose(half_autocorrelation(image, np.ones((24, 31), bool))[6:-6, :24], full, atol=1e-5)
    other = np.where(known[..., np.newaxis], image, 7)
    np.testing.assert_allclose(half_autocorrelation(other, known), half_autocorrelation(image, known), atol=1e-6)


def test_holes_are_filled_by_what_lies_a_lattice_vector_away() -> None:
    """A hole in a periodic image is filled exactly."""
    image = np.tile(np.random.default_rng(2).random((12, 15, 1)).astype(np.float32), (5, 5, 1))
    known = np.ones((60, 75), bool)
    known[10:40, 20:50] = False
    holed = MaskedImage(image, None).without(~known, "hole")
    np.testing.assert_array_equal(fill_periodically(holed.image, known, Lattice((15, 0), (0, 12))), image)


def test_the_judge_does_not_read_the_hole(wall: nrbench.Texture) -> None:
    """An output that holds the sign is worse than the wall beside it, if the mask leaves the sign out."""
    image, known = _with_sign(wall.image)
    good, bad = (nrbench.score(image, output, wall.lattice, "appearance", mask=known) for output in (wall.image, image))
    values = [float(each.values["appearance.score"] or 0) for each in (good, bad)]
    assert values[0] > 0.9 and values[1] < 0.1
