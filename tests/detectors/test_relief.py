import math

import numpy as np
import pytest

from nrbench.detectors.autocorrelation.peak_kernels import highest_ridge
from nrbench.detectors.gncc import find_ridge, remove_stripes
from nrbench.imaging.correlation import half_autocorrelation
from nrbench.lattice.geometry import Lattice

SIDE = 96
Y, X = np.indices((SIDE, SIDE)).astype(np.float64)


def stripes(angle: float, period: float = 11.0) -> np.ndarray:
    """Return stripes whose normal points along ``angle`` (radians), in [0.3, 0.7]."""
    phase = 2 * math.pi * (X * math.cos(angle) + Y * math.sin(angle)) / period
    return (0.5 + 0.2 * np.tanh(3 * np.sin(phase)))[..., np.newaxis].astype(np.float32)


def test_separate_peaks_stand_out_fully() -> None:
    """The correlation of a product of two waves has no ridge between its peaks: relief 1 or more."""
    waves = 0.5 + 0.4 * np.cos(2 * math.pi * X / 12) * np.cos(2 * math.pi * Y / 14)
    gamma = half_autocorrelation(waves[..., np.newaxis].astype(np.float32))
    assert find_ridge(gamma, Lattice((6.0, 7.0), (6.0, -7.0)), (50, 50)).relief >= 0.95


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, 2.2])
def test_stripes_are_a_ridge_along_themselves(angle: float) -> None:
    """Vectors that end on the ridges of a grating are joined by them, in the stripes' direction, however oblique."""
    normal, along = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    t1, t2 = 11 * normal + 5 * along, 22 * normal - 9 * along
    ridge = find_ridge(half_autocorrelation(stripes(angle)), Lattice(tuple(t1), tuple(t2)), (50, 50))
    assert ridge.relief < 0.15
    assert abs(np.array(ridge.direction) @ normal) < 0.05 * math.hypot(*ridge.direction)


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, 2.2])
def test_stripes_are_taken_out(angle: float) -> None:
    """Less than 1 % of a grating's variance remains; of stripes across it, more than 95 %."""
    image = stripes(angle)
    along = (-math.sin(angle), math.cos(angle))
    assert remove_stripes(image, along).var() < 0.01 * image.var()
    assert remove_stripes(image, (math.cos(angle), math.sin(angle))).var() > 0.95 * image.var()


def test_the_highest_ridge_of_a_known_tile() -> None:
    """A wall of 0.8 with a gap of 0.5 along u, and one of 0.4 along v: the ridge runs along u at 0.5."""
    tile = np.zeros((9, 12), np.float32)
    tile[0, :], tile[:, 0] = 0.8, 0.4
    tile[0, 5] = 0.5
    tile[0, 0] = 1
    level, along, across = highest_ridge(tile, np.argsort(-tile.ravel(), kind="stable"))
    assert level == pytest.approx(0.5) and abs(along) == 1 and across == 0


def test_a_ridge_may_pass_several_tiles() -> None:
    """A diagonal that closes only after two turns along u and one along v is followed to its end."""
    tile = np.zeros((8, 8), np.float32)
    for step in range(16):
        tile[step // 2 % 8, step % 8] = 0.7
    tile[0, 0] = 1
    level, along, across = highest_ridge(tile, np.argsort(-tile.ravel(), kind="stable"))
    assert level == pytest.approx(0.7) and (abs(along), abs(across)) == (2, 1)
