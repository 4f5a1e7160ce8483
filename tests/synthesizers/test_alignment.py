import math

import numpy as np
import pytest

from nrbench.imaging.convert import Image
from nrbench.synthesizers.gap_filling.matching import align_patch, fit_deformation

Y, X = np.indices((48, 48)).astype(float)
FRAME = np.ones((48, 48))
FRAME[14:34, 14:34] = 0


def texture(x: np.ndarray, y: np.ndarray) -> Image:  # type: ignore[type-arg]
    """Return a texture of lines both ways, at any place."""
    waves = np.cos(2 * math.pi * x / 9.3) + np.cos(2 * math.pi * (y + 0.2 * x) / 8.1) + np.cos(0.9 * (x - y))
    return (0.5 + 0.15 * waves)[..., np.newaxis].astype(np.float32)


@pytest.mark.parametrize("off", [(0.4, -0.3), (-0.8, 0.7), (0.0, 0.05)])
def test_a_patch_is_moved_to_where_it_meets(off: tuple[float, float]) -> None:
    """A place that is off by up to a pixel is mended to a fiftieth, by what the frame alone shows."""
    old = texture(X + 5, Y + 7)
    place = align_patch(lambda at: texture(X + at[0], Y + at[1]), np.add((5.0, 7.0), off), old, FRAME, steps=3)
    np.testing.assert_allclose(place, (5, 7), atol=0.02)


def test_where_both_agree_nothing_moves() -> None:
    """Not even by a rounding error."""
    old = texture(X, Y)
    assert align_patch(lambda at: old, np.array([3.0, 4.0]), old, FRAME).tolist() == [3, 4]
    field = fit_deformation(lambda field: old, old, FRAME, FRAME, 2.0)
    assert (field == 0).all()


def test_flat_pictures_move_nothing() -> None:
    """Where nothing can be told nothing is done, even where the pictures differ in brightness."""
    flat = np.full((48, 48, 1), 0.3, np.float32)
    assert align_patch(lambda at: flat + 0.1, np.array([3.0, 4.0]), flat, FRAME).tolist() == [3, 4]


def test_a_smooth_field_is_found() -> None:
    """A patch bent by up to 1.2 px meets its frame to a quarter of the error, and stays where it is in the hole."""
    bend = np.stack([1.2 * np.sin(Y / 15), 1.0 * np.cos(X / 18)], -1)
    old = texture(X + bend[..., 0], Y + bend[..., 1])

    def shown(field: np.ndarray) -> Image:  # type: ignore[type-arg]
        return texture(X + field[..., 0], Y + field[..., 1])

    field = fit_deformation(shown, old, FRAME, FRAME, 2.0)
    outer = np.s_[:10]
    before, after = (np.abs(shown(one) - old)[outer].mean() for one in (np.zeros_like(field), field))
    assert after < before / 4
    assert np.abs(field - bend)[outer].mean() < 0.25
    assert (field[FRAME == 0] == 0).all()


@pytest.mark.parametrize("limit", [0.5, 1.0])
def test_no_displacement_is_longer_than_allowed(limit: float) -> None:
    """The limit holds pixel by pixel, faded as told."""
    rng = np.random.default_rng(0)
    old, new = rng.random((2, 48, 48, 3)).astype(np.float32)
    fade = np.linspace(0, 1, 48) * np.ones((48, 1))
    field = fit_deformation(lambda field: new, old, FRAME, fade, limit)
    assert (np.hypot(*np.moveaxis(field, -1, 0)) <= limit * fade + 1e-9).all()
    assert np.hypot(*np.moveaxis(field, -1, 0)).max() > 0.3 * limit
