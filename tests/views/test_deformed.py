"""The lattice of a bent image is detected without help; a straight one is not followed knot by knot."""

from __future__ import annotations

import numpy as np
import pytest

import nrbench
from nrbench.imaging.convert import quantize
from nrbench.imaging.fold import interpolate
from nrbench.tracking.homography import map_points

TILT = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.2e-3, 6e-4, 1.0]])
SIDE = 160


def tilted(seed: int, factor: int = 1) -> np.ndarray:
    """Return a weave in perspective, each pixel repeated ``factor`` times along both axes."""
    points = np.stack(np.meshgrid(np.arange(SIDE, dtype=float), np.arange(SIDE, dtype=float)), -1)
    drawn = nrbench.texture("weave", shape=(SIDE, SIDE), seed=seed)
    image = quantize(interpolate(drawn.image, map_points(TILT, points)))
    return image.repeat(factor, 0).repeat(factor, 1)


def test_a_plane_in_perspective_gets_its_lattice() -> None:
    """It is a homography, and straightened the detector finds the mean lattice with high confidence."""
    found = nrbench.track_lattice(tilted(0))
    assert found.bent and found.homography is not None and found.covered > 0.8
    straight, lattice = found.straighten()
    assert nrbench.detect_lattice(straight).lattice.is_equivalent(lattice, 0.03 * lattice.s)


def test_large_elements_are_detected_in_a_smaller_image() -> None:
    """An image that is enlarged three times has a lattice three times as large."""
    small, large = nrbench.track_lattice(tilted(0)), nrbench.track_lattice(tilted(0, 3))
    assert np.abs(large.lattice.reduced().area / small.lattice.reduced().area - 9) < 0.3
    assert large.homography is not None


def test_a_straight_image_has_the_detected_lattice() -> None:
    """It is not followed knot by knot, and not bent."""
    drawn = nrbench.texture("hexagon", shape=(SIDE, SIDE), seed=2)
    found = nrbench.track_lattice(drawn.image)
    assert not found.bent and found.knots is None
    assert drawn.lattice is not None and found.lattice.is_equivalent(drawn.lattice, 0.02 * drawn.lattice.s)


@pytest.mark.parametrize("lattice", [((5000, 0), (0, 5000)), ((5e5, 0), (0, 5e5)), ((900, 0), (0, 9))])
def test_a_lattice_larger_than_the_image_is_refused(lattice: tuple[tuple[float, float], ...]) -> None:
    """The message says that the image is too small for it."""
    with pytest.raises(nrbench.BadInput, match="fewer than two cells"):
        nrbench.track_lattice(np.zeros((64, 64), np.uint8), lattice)


def test_noise_has_no_lattice_that_can_be_followed() -> None:
    """The reason is that of the detector."""
    noise = np.random.default_rng(3).random((96, 96, 1), np.float32)
    with pytest.raises(nrbench.NoLatticeFound):
        nrbench.track_lattice(noise)
