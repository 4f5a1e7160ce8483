"""The lattice of a bent image is detected without help; a straight one is not followed knot by knot."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from bent_pictures import tilted

import nrbench
from nrbench import plugins
from nrbench.displacement.bent_detection import find_deformation
from nrbench.displacement.deformation_field import Deformation
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Detection, NoLatticeFound

SIDE = 160


@cache
def followed() -> Deformation:
    """Return the lattice that is found in the first weave in perspective."""
    return nrbench.track_lattice(tilted(SIDE).image)


def test_a_plane_in_perspective_gets_its_lattice() -> None:
    """It is a homography, and straightened the detector finds the mean lattice with high confidence."""
    found = followed()
    assert found.bent and found.homography is not None and found.covered > 0.8
    straight, lattice = found.straighten()
    assert nrbench.detect_lattice(straight).lattice.is_equivalent(lattice, 0.03 * lattice.s)


def test_large_elements_are_detected_in_a_smaller_image() -> None:
    """An image that is enlarged three times has a lattice three times as large."""
    small, large = followed(), nrbench.track_lattice(tilted(SIDE).image.repeat(3, 0).repeat(3, 1))
    assert np.abs(large.lattice.reduced().area / small.lattice.reduced().area - 9) < 0.3
    assert large.homography is not None


def test_a_straight_image_has_the_detected_lattice() -> None:
    """It is followed once, at knots about s apart, and not bent."""
    drawn = nrbench.texture("hexagon", shape=(SIDE, SIDE), seed=2)
    found = nrbench.track_lattice(drawn.image)
    assert not found.bent and found.knots.parts == (1, 1)
    assert drawn.lattice is not None and found.lattice.is_equivalent(drawn.lattice, 0.02 * drawn.lattice.s)


@pytest.mark.parametrize("lattice", [((5000, 0), (0, 5000)), ((5e5, 0), (0, 5e5)), ((900, 0), (0, 9))])
def test_a_lattice_larger_than_the_image_is_refused(lattice: tuple[tuple[float, float], ...]) -> None:
    """The message says that the image is too small for it."""
    with pytest.raises(nrbench.BadInput, match="fewer than two cells"):
        nrbench.track_lattice(np.zeros((64, 64), np.uint8), lattice)


@dataclass(frozen=True)
class Equal:
    """A detector whose confidence never changes, and which notes the shapes of the images that it sees."""

    confidence: float
    seen: list[tuple[int, ...]]

    def detect(self, image: Image) -> Detection:
        """Return what dominance finds."""
        self.seen.append(image.shape[:2])
        return replace(plugins.build("detectors", "dominance", {}).detect(image), confidence=self.confidence)


def test_a_doubtful_answer_is_compared_with_those_of_further_views() -> None:
    """The detector then looks at views, too; a confident one looks at the whole image and at the straightened one."""
    image = tilted(SIDE).image
    sure, unsure = Equal(0.99, []), Equal(0.8, [])
    confident, doubtful = (find_deformation(image, detector=each).deformation for each in (sure, unsure))
    assert len(sure.seen) == 2 < len(unsure.seen) and (SIDE // 2, SIDE // 2) in unsure.seen
    assert confident.lattice.is_equivalent(doubtful.lattice, 0.02 * confident.lattice.s)
    assert doubtful.confidence == 0.8


def test_an_image_that_is_bent_too_much_to_be_straightened_is_refused() -> None:
    """Cells of rings and spokes turn around once. Their lattice can be followed, but nothing can be straightened."""
    y, x = np.mgrid[:160, :160] - 79.5
    rings, spokes = np.cos(2 * np.pi * np.hypot(x, y) / 14), np.cos(12 * np.arctan2(y, x))
    with pytest.raises(NoLatticeFound, match="bent so much in the image that only"):
        nrbench.track_lattice(np.clip(0.5 + (rings + spokes) / 4, 0, 1), ((14, 0), (0, 14)))


@pytest.mark.parametrize("shape", [(8, 600), (12, 400)])
def test_a_narrow_strip_has_a_lattice(shape: tuple[int, int]) -> None:
    """If all knots lie on one line, they tell nothing. The lattice is that of the detector, the deformation unknown."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    joints = (y % 8 < 2) | ((x + y // 8 % 2 * 6) % 12 < 2)
    wall = np.clip(0.6 - 0.4 * joints + np.random.default_rng(0).normal(0, 0.03, shape), 0, 1)
    found = nrbench.track_lattice(wall)
    assert not found.bent and found.covered == 0


def test_noise_has_no_lattice_that_can_be_followed() -> None:
    """Cells of a few pixels, which could be bent to fit noise, are not followed."""
    noise = np.random.default_rng(3).random((96, 96, 1), np.float32)
    with pytest.raises(nrbench.NoLatticeFound):
        nrbench.track_lattice(noise)
